"""Poses of photographs by structure from motion, with pycolmap on the CPU: ``autonerf-lab fit DIR --poses colmap``.

The model is written to ``OUT/colmap/sparse/0`` and read like any COLMAP model. Scale and origin are arbitrary.
"""

import hashlib
import warnings
from pathlib import Path
from typing import Any

from tqdm import tqdm

from autonerf_lab.data.images import image_size
from autonerf_lab.errors import DataError
from autonerf_lab.utils import storage
from autonerf_lab.utils.extras import optional
from autonerf_lab.utils.resources import threads

ENDINGS = (".jpg", ".jpeg", ".png", ".webp")
MIN_PHOTOGRAPHS = 3
ENOUGH = 0.8  # share of the photographs that must register
EXHAUSTIVE = 60  # photographs up to which every pair is matched; more are matched with their neighbours by name
_SHOWN = 10  # names in a message


def photographs_of(folder: Path) -> list[Path]:
    """Return the images of a folder (or of its folder ``images``), sorted by name."""
    place = folder / "images" if (folder / "images").is_dir() else folder
    return sorted(file for file in place.iterdir() if file.suffix.lower() in ENDINGS and file.is_file())


def estimate_poses(folder: str | Path, work: str | Path, *, progress: bool = True) -> Path:
    """Estimate the poses of photographs, and return the folder of the COLMAP model.

    Args:
        folder: Photographs of a static scene with overlap.
        work: Folder for the database and the model; a finished model of the same photographs is used again.
        progress: Show a progress bar.

    Raises:
        MissingPackageError: pycolmap is not installed (extra ``colmap``).
        DataError: There are fewer than three photographs, or more than a fifth did not register; the message names
            them. Fewer are left out with a UserWarning.
    """
    folder, work = Path(folder), Path(work)
    if not folder.is_dir():
        raise DataError(f"{folder} does not exist; give a folder of photographs")
    files = photographs_of(folder)
    if len(files) < MIN_PHOTOGRAPHS:
        raise DataError(f"{folder} holds {len(files)} photographs ({', '.join(ENDINGS)}); at least three are needed")
    sizes = [image_size(file) for file in files]  # damaged files fail here, by name
    target, listed = work / "sparse/0", work / "photographs.json"
    digests = {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}
    if (target / "images.bin").exists() and listed.exists() and storage.read_json(listed, dict[str, str]) == digests:
        return target
    (target / "images.bin").unlink(missing_ok=True)
    pycolmap = optional("pycolmap", "colmap")
    (work / "all").mkdir(parents=True, exist_ok=True)
    database = work / "database.db"
    database.unlink(missing_ok=True)
    pycolmap.logging.minloglevel = 3  # its log would break the progress bar
    pycolmap.set_random_seed(0)
    with tqdm(total=2 * len(files) + 1, disable=not progress, desc="features") as bar:
        _extract(pycolmap, database, files, sizes, bar)
        bar.set_description("matches")
        match = pycolmap.match_exhaustive if len(files) <= EXHAUSTIVE else pycolmap.match_sequential
        match(database, device=pycolmap.Device.cpu)
        bar.update()
        bar.set_description("poses")
        models = pycolmap.incremental_mapping(
            database, files[0].parent, work / "all", next_image_callback=lambda: bar.update() and None
        )
    if not models:
        raise DataError(
            f"{folder}: no photograph registered; take sharp photographs of a textured scene that overlap by two thirds"
        )
    model = max(models.values(), key=lambda model: model.num_reg_images())
    missing = sorted({file.name for file in files} - {image.name for image in model.images.values()})
    if missing:
        names = ", ".join(missing[:_SHOWN]) + (f" and {len(missing) - _SHOWN} more" if len(missing) > _SHOWN else "")
        text = f"{folder}: {len(missing)} of {len(files)} photographs did not register: {names}"
        if len(missing) > (1 - ENOUGH) * len(files):
            raise DataError(f"{text}; remove them, or add photographs that connect them with the others")
        warnings.warn(f"{text}; they are left out", stacklevel=2)
    model.write_binary(work / "all")
    storage.write_json(listed, digests)
    for name in ("cameras", "images"):  # images last: it marks the model as complete
        storage.write_bytes(target / f"{name}.bin", (work / "all" / f"{name}.bin").read_bytes())
    return target


def _extract(pycolmap: Any, database: Path, files: list[Path], sizes: list[tuple[int, int]], bar: Any) -> None:
    """Extract the features of each photograph; photographs of one size share a camera."""
    options = pycolmap.FeatureExtractionOptions()
    options.num_threads = threads()
    cameras: dict[tuple[int, int], int] = {}
    for file, size in zip(files, sizes, strict=True):
        reader = pycolmap.ImageReaderOptions()
        reader.existing_camera_id = cameras.get(size, -1)
        pycolmap.extract_features(
            database, file.parent, [file.name], pycolmap.CameraMode.SINGLE, reader, options, pycolmap.Device.cpu
        )
        cameras.setdefault(size, len(cameras) + 1)
        bar.update()
