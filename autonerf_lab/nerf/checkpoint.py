"""Fields and training states on disk: safetensors for arrays, a JSON header for the rest; no file can contain code.

``nerf.safetensors`` holds a field; ``nerf.json`` is a copy of its header for readers, written last. A training in
progress stores ``training.safetensors``, which is removed when the field is saved.
"""

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from autonerf_lab.errors import DataError, RunFolderError
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.nerf.model import Model
from autonerf_lab.nerf.optimizer import Adam, ParameterAverage
from autonerf_lab.nerf.ray_batch import Array, assign, to_numpy
from autonerf_lab.nerf.settings import Settings
from autonerf_lab.utils.storage import parse_json, read_arrays, write_arrays, write_json
from autonerf_lab.version import __version__

VERSION = 5  # of nerf.safetensors
SAVE_EVERY = 20.0  # seconds of training between two checkpoints
TRAINING_FILE = "training.safetensors"
FIELD_FILE = "nerf.safetensors"

Point = tuple[float, float, float]


@dataclass(frozen=True)
class BoxHeader:
    """Scene box of a field, see :class:`~autonerf_lab.nerf.scene_box.SceneBox`."""

    center: Point
    half: Point
    shell: float


@dataclass(frozen=True)
class VisibilityHeader:
    """Visibility grid of a field; its voxels are an array."""

    origin: Point
    voxel: float
    shape: tuple[int, int, int]


@dataclass(frozen=True)
class FrameHeader:
    """Coordinates of a field, see :class:`~autonerf_lab.nerf.field_frame.FieldFrame`."""

    origin: Point
    unit: float


@dataclass(frozen=True)
class FieldHeader:
    """Header of a field."""

    version: int
    settings: dict[str, Any]
    box: BoxHeader
    frame: FrameHeader
    visibility: VisibilityHeader
    intrinsics: Intrinsics
    classes: int
    meta: dict[str, Any]
    package: str | None = None  # that registers the model


@dataclass(eq=False, repr=False)
class Progress:
    """Progress of a training."""

    step: int = 0  # steps done
    psnr: float = 0.0  # running mean of the training PSNR, dB
    seconds: float = 0.0  # duration of the training so far
    losses: dict[str, float] = field(default_factory=dict)  # mean losses of the last step
    skipped: int = 0  # steps whose losses or gradients were not finite
    rate_scale: float = 1.0  # factor of the learning rates, below 1 after failures


@dataclass(frozen=True)
class TrainingHeader:
    """Header of a training checkpoint."""

    identity: dict[str, Any]
    optimizer_steps: dict[str, int]
    averaged: Annotated[int, msgspec.Meta(ge=0)]
    rng: dict[str, Any]
    progress: Progress


class TrainingState(Progress):
    """Everything that changes during training, and its checkpoint.

    Args:
        model: holds the parameters.
        optimizer: holds the moments.
        rng: generator of all random draws of the training.

    Attributes:
        average: mean of the parameters at the end of the training, if the settings ask for it.
        planes: arguments of :meth:`~autonerf_lab.nerf.pixel_sampler.PixelSampler.learn_planes`; empty before the
            training looks for planes.
        failures: number of skipped steps in a row. After one, the parameters may be no longer finite.
    """

    def __init__(self, model: Model, optimizer: Adam, rng: np.random.Generator) -> None:
        super().__init__()
        self.model, self.optimizer, self.rng = model, optimizer, rng
        self.average = ParameterAverage(model.parameters if model.settings.averaged else {})
        self.planes: dict[str, np.ndarray] = {}
        self.failures = 0
        self._snapshot: tuple[list[np.ndarray], dict[str, int], int] | None = None
        self._saved = time.perf_counter()

    def resume(self, folder: str | Path, identity: dict[str, Any]) -> None:
        """Continue from the checkpoint in ``folder``, if there is one.

        Args:
            folder: may hold a checkpoint.
            identity: JSON that identifies the training, with its data and seed; the settings and the version of the
                package are added.

        Raises:
            RunFolderError: the checkpoint belongs to a training with other data or settings, or of another version.
            DataError: the checkpoint is damaged.
        """
        self.identity = {"version": __version__, **identity, "settings": settings_to_json(self.model.settings)}
        path = Path(folder) / TRAINING_FILE
        if not path.exists():
            return
        try:
            arrays, header = read_arrays(path, TrainingHeader)
        except DataError as error:
            raise DataError(f"{error}; remove the file to start the training again") from error
        if header.identity != self.identity:
            raise RunFolderError(
                f"{path} belongs to another training ({_difference(header.identity, self.identity)}); "
                "remove it, or use another folder"
            )
        try:
            for prefix, group in self._groups().items():
                for name, array in group.items():
                    assign(array, arrays[f"{prefix}/{name}"])
            if header.optimizer_steps.keys() != self.optimizer.steps.keys() or min(header.optimizer_steps.values()) < 0:
                raise ValueError("optimizer_steps")
            if "planes/pixels" in arrays:
                self.planes = {name: arrays[f"planes/{name}"] for name in ("pixels", "depth")}
                pixels, depth = self.planes.values()
                if pixels.dtype != np.int64 or pixels.ndim != 1 or pixels.shape != depth.shape or not (depth > 0).all():
                    raise ValueError("planes")
            self.optimizer.steps.update(header.optimizer_steps)
            self.average.count = header.averaged
            self.rng.bit_generator.state = header.rng
            vars(self).update(vars(header.progress))
            if not self.is_finite():
                raise ValueError("values that are not finite")
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise DataError(f"{path} is damaged ({error!r}); remove it to start the training again") from error

    def save_periodically(self, folder: str | Path) -> None:
        """Write the checkpoint if the last one is :data:`SAVE_EVERY` seconds old; not after a failed step."""
        if self.failures or time.perf_counter() - self._saved < SAVE_EVERY:
            return
        arrays = {
            f"{prefix}/{name}": to_numpy(array)
            for prefix, group in {**self._groups(), "planes": self.planes}.items()
            for name, array in group.items()
        }
        header = {
            "identity": self.identity,
            "optimizer_steps": self.optimizer.steps,
            "averaged": self.average.count,
            "rng": self.rng.bit_generator.state,
            "progress": {f.name: getattr(self, f.name) for f in fields(Progress)},
        }
        write_arrays(Path(folder) / TRAINING_FILE, arrays, header)
        self._saved = time.perf_counter()

    def take_snapshot(self) -> None:
        """Copy the parameters and moments, to return to them if the training fails."""
        arrays = [np.copy(to_numpy(array)) for group in self._groups().values() for array in group.values()]
        self._snapshot = arrays, dict(self.optimizer.steps), self.average.count

    def restore_snapshot(self) -> None:
        """Return to the last snapshot, and halve the learning rates."""
        self.rate_scale /= 2
        if self._snapshot is not None:
            arrays, steps, self.average.count = self._snapshot
            targets = (array for group in self._groups().values() for array in group.values())
            for target, array in zip(targets, arrays, strict=True):
                assign(target, array)
            self.optimizer.steps.update(steps)

    def is_finite(self) -> bool:
        """Return True if all parameters, moments and arrays of the sampler are finite."""
        return all(np.isfinite(to_numpy(array)).all() for group in self._groups().values() for array in group.values())

    def _groups(self) -> dict[str, Mapping[str, Array]]:
        moments: dict[str, Mapping[str, Array]] = {"first": self.optimizer.first, "second": self.optimizer.second}
        return {
            "parameter": self.model.parameters,
            "state": self.model.state,
            "average": self.average.sums,
            **moments,
        }


def save_parts(folder: str | Path, arrays: dict[str, np.ndarray], header: dict[str, Any]) -> None:
    """Write the arrays and the header of a field, and remove the training checkpoint of the folder."""
    folder, header = Path(folder), {"version": VERSION, **header}
    write_arrays(folder / FIELD_FILE, arrays, header)
    write_json(folder / "nerf.json", header)
    (folder / TRAINING_FILE).unlink(missing_ok=True)


def load_parts(folder: str | Path) -> tuple[dict[str, np.ndarray], FieldHeader]:
    """Read the arrays and the header of a field.

    Raises:
        DataError: the file is missing, damaged or of another version.
    """
    path = Path(folder) / FIELD_FILE
    arrays, header = read_arrays(path, dict[str, Any])
    version = header.get("version")
    if version != VERSION:
        found = version if isinstance(version, int) else "3 or lower"  # whose header was a file of its own
        raise DataError(f"{path} has version {found}, this release reads {VERSION}; fit again")
    return arrays, parse_json(json.dumps(header).encode(), FieldHeader, f"the header of {path}")


def settings_to_json(settings: Settings) -> dict[str, Any]:
    """Return settings as JSON reads them back: tuples become lists."""
    return {f.name: list(v) if isinstance(v := getattr(settings, f.name), tuple) else v for f in fields(settings)}


def _difference(found: dict[str, Any], wanted: dict[str, Any]) -> str:
    names = (name for name in {**wanted, **found} if found.get(name) != wanted.get(name))
    return "different " + ", ".join(names)
