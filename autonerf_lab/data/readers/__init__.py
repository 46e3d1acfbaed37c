"""Readers of posed images, one module a source, behind one function that recognises the format."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from autonerf_lab.data.posed_frames import PosedFrames
from autonerf_lab.data.readers.colmap import model_folder, read_colmap
from autonerf_lab.data.readers.phone import read_polycam, read_record3d
from autonerf_lab.data.readers.replica import read_replica
from autonerf_lab.data.readers.scannet import read_scannet
from autonerf_lab.data.readers.transforms_json import SPLITS, read_blender, read_transforms_json
from autonerf_lab.data.readers.tum import read_tum
from autonerf_lab.errors import DataError

_SHOWN = 12  # names in a message


@dataclass(frozen=True)
class Format:
    """Source of posed images."""

    name: str
    files: str  # that identify it, for messages
    matches: Callable[[Path], bool]  # of a folder
    read: Callable[[Path], PosedFrames]


def _has(*names: str) -> Callable[[Path], bool]:
    return lambda folder: all((folder / name).exists() for name in names)


FORMATS = (  # in the order of the search
    Format(
        "nerfstudio",
        "transforms.json",
        _has("transforms.json"),
        lambda folder: read_transforms_json(folder / "transforms.json"),
    ),
    Format(
        "Blender",
        "transforms_train.json",
        lambda folder: any((folder / f"transforms_{name}.json").is_file() for name in SPLITS),
        read_blender,
    ),
    Format("TUM RGB-D", "rgb.txt and groundtruth.txt", _has("rgb.txt", "groundtruth.txt"), read_tum),
    Format("Replica", "traj.txt and results/", _has("traj.txt", "results"), read_replica),
    Format("ScanNet", "color/, pose/ and intrinsic/", _has("color", "pose", "intrinsic"), read_scannet),
    Format("Polycam", "keyframes/", _has("keyframes"), read_polycam),
    Format("Record3D", "metadata.json and rgb/", _has("metadata.json", "rgb"), read_record3d),
    Format(
        "COLMAP",
        "sparse/0/cameras.bin or .txt",
        lambda folder: model_folder(folder) is not None,
        read_colmap,
    ),
)


def find_format(folder: Path) -> Format | None:
    """Return the format of a folder, or None."""
    return next((form for form in FORMATS if form.matches(folder)), None)


def read_frames(path: Path, colmap: Path | None = None) -> PosedFrames:
    """Read the frames of a folder, or of a file like ``transforms.json``; ``colmap``: a model in another folder.

    Raises:
        DataError: no format is recognised, or a file is missing or damaged.
    """
    if path.suffix == ".json" and path.is_file():
        return read_transforms_json(path)
    if not path.is_dir():
        problem = "is no JSON file" if path.is_file() else "does not exist"
        raise DataError(f"{path} {problem}; give a folder of posed photographs, or the path of its JSON file")
    if colmap is not None:
        return read_colmap(path, colmap)
    form = find_format(path)
    if form is None:
        looked = "; ".join(f"{form.files} ({form.name})" for form in FORMATS)
        found = sorted(file.name for file in path.iterdir())
        more = f" and {len(found) - _SHOWN} more" if len(found) > _SHOWN else ""
        raise DataError(
            f"{path} has no poses in a known format; looked for {looked}; found "
            f"{', '.join(found[:_SHOWN]) or 'nothing'}{more}"
        )
    try:
        return form.read(path)
    except OSError as error:
        raise DataError(f"{path}: the {form.name} data cannot be read: {error}") from error
