"""Notebooks of the course: where they are, and a copy of them for a student."""

import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path

from autonerf_lab.errors import DataError, MissingPackageError

# Packages that need a system library or another extra, and the notebook that uses them.
PACKAGES = {"open3d": "11", "imageio_ffmpeg": "13", "stable_baselines3": "05"}


def notebook_paths() -> list[Path]:
    """Return the notebooks, sorted by number: those of the checkout, or those inside the installed package.

    Raises:
        DataError: Neither folder contains them.

    Example:
        >>> notebook_paths()[0].name
        '00_tour.ipynb'
    """
    package = Path(__file__).resolve().parents[1]
    for folder in (package.parent / "notebooks", package / "notebooks"):
        if paths := sorted(folder.glob("[0-9][0-9]_*.ipynb")):
            return paths
    raise DataError(f"the notebooks are missing in {package / 'notebooks'}; reinstall autonerf-lab")


def copy_notebooks(folder: Path, overwrite: bool = False) -> tuple[list[Path], list[Path]]:
    """Copy the notebooks into a folder, which is created.

    Args:
        folder: Target folder.
        overwrite: Replace notebooks of the same name. By default they are kept: they hold the work of a student.

    Returns:
        The copied notebooks and the notebooks that were kept, as paths in the folder.

    Raises:
        DataError: The folder cannot be made or written; names the folder.
    """
    copied, kept = [], []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for source in notebook_paths():
            target = folder / source.name
            if target.exists() and not overwrite:
                kept.append(target)
            else:
                shutil.copyfile(source, target)  # without the permissions of the source, which may be read-only
                copied.append(target)
    except OSError as error:
        raise DataError(f"cannot copy the notebooks to {folder}: {error.strerror or error}") from error
    return copied, kept


def missing_parts() -> list[str]:
    """Return one line for each missing package or system library: which notebook needs it, and how to install it."""
    lines = []
    for package, notebook in PACKAGES.items():
        where = f"notebook {notebook} shows more with {package.replace('_', '-')}"
        if importlib.util.find_spec(package) is None:
            lines.append(f'{where}: pip install "autonerf-lab[{package if package == "open3d" else "notebooks"}]"')
        elif reason := _reason_of_failure(package):
            lines.append(f"{where}, which cannot be loaded: {reason}{_system_libraries()}")
    return lines


def _reason_of_failure(package: str) -> str:
    """Import a package in a process of its own, and return the last line of the error; "" if there is none."""
    command = [sys.executable, "-c", f"import {package}"]
    result = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    return (result.stderr.strip() or f"exit code {result.returncode}").splitlines()[-1] if result.returncode else ""


def _system_libraries() -> str:
    if sys.platform.startswith("linux"):
        return ". On Debian and Ubuntu: sudo apt install libegl1 libgl1 libgomp1 libusb-1.0-0"
    return ". It needs the Microsoft Visual C++ redistributable" if sys.platform == "win32" else ""


def open_jupyterlab(folder: Path, browser: bool = True) -> None:
    """Run JupyterLab on a folder, in this process, until it is stopped.

    Args:
        folder: Folder with the notebooks.
        browser: Open a browser.

    Raises:
        MissingPackageError: JupyterLab or a package of the notebooks is not installed.
    """
    for package in ("jupyterlab", "ipykernel", "ipywidgets", "anywidget"):
        if importlib.util.find_spec(package) is None:
            raise MissingPackageError(f'the notebooks need {package}: pip install "autonerf-lab[notebooks]"')
    from jupyterlab.labapp import main

    # dash, a dependency of open3d, would make JupyterLab ask for a build that is not needed
    no_build = "--ServerApp.tornado_settings={'page_config_data': {'buildCheck': False}}"
    main([str(folder), no_build, *([] if browser else ["--no-browser"])])
