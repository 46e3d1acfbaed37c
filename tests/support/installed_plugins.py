"""Installed packages with entry points: fake ones, and the examples of plug-ins in ``examples``."""

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

EXAMPLES = Path(__file__).parents[2] / "examples"


@dataclass(frozen=True)
class Site:
    """Folder of installed packages."""

    folder: Path

    def install(self, package: str, name: str, code: str, value: str = "SPEC", group: str = "models") -> None:
        """Write the files of an installed package with one module and one entry point."""
        module = package.replace("-", "_")
        sys.modules.pop(module, None)  # from a previous test
        (self.folder / f"{module}.py").write_text(code)
        info = self.folder / f"{module}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[autonerf_lab.{group}]\n{name} = {module}:{value}\n")

    def uninstall(self, package: str) -> None:
        """Remove the metadata of a package."""
        module = package.replace("-", "_")
        for file in (self.folder / f"{module}-1.0.dist-info").iterdir():
            file.unlink()
        (self.folder / f"{module}-1.0.dist-info").rmdir()


def install_example(name: str, tmp_path: Path) -> Path:
    """Install an example of a plug-in with pip, from a copy and without a network; return the folder of packages."""
    copy = _copy(name, tmp_path)
    pip = [sys.executable, "-m", "pip", "install", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*pip, "--target", tmp_path / "target", copy], check=True, capture_output=True)
    return tmp_path / "target"


def run_example_tests(name: str, tmp_path: Path) -> str:
    """Run the tests that an example of a plug-in has, in a copy; return the output of pytest."""
    copy = _copy(name, tmp_path)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:dash", copy]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout
    return result.stdout


def run_command(packages: Path, *arguments: str) -> subprocess.CompletedProcess:
    """Run the command line of the package with the plug-ins of a folder of packages."""
    path = os.pathsep.join([str(packages), os.environ["PYTHONPATH"]])
    command = [sys.executable, "-m", "autonerf_lab.cli", *arguments]
    return subprocess.run(command, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, check=False)


def _copy(name: str, tmp_path: Path) -> Path:
    made = shutil.ignore_patterns("__pycache__", "build", "*.egg-info")
    return shutil.copytree(EXAMPLES / name, tmp_path / "source", ignore=made)
