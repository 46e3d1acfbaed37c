"""Fields and training states on disk: safetensors for arrays, JSON for the rest; no file can contain code.

``nerf.safetensors`` holds the arrays of a field; ``nerf.json``, written last, describes how to rebuild it. A training
in progress stores ``training.safetensors``, which is removed when the field is saved.
"""

import hashlib
import time
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, ClassVar

import msgspec
import numpy as np

from autonerf_lab.errors import DataError, RunFolderError
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.nerf.model import Model
from autonerf_lab.nerf.optimizer import Adam, ParameterAverage
from autonerf_lab.nerf.ray_batch import Array, assign, to_numpy
from autonerf_lab.nerf.settings import Settings
from autonerf_lab.utils.storage import (
    MAX_ARRAY_BYTES,
    parse_arrays,
    read_arrays,
    read_bytes,
    read_json,
    write_arrays,
    write_json,
)

VERSION = 3  # of nerf.json
SAVE_EVERY = 20.0  # seconds of training between two checkpoints
TRAINING_FILE = "training.safetensors"
ARRAYS_FILE = "nerf.safetensors"


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
    """Content of ``nerf.json``."""

    version: int
    arrays_sha256: str  # of the file of the arrays
    settings: dict[str, Any]
    box: BoxHeader
    frame: FrameHeader
    visibility: VisibilityHeader
    intrinsics: Intrinsics
    classes: int
    meta: dict[str, Any]
    package: str | None = None  # that registers the model


@dataclass(frozen=True)
class TrainingHeader:
    """Header of a training checkpoint."""

    identity: dict[str, Any]
    optimizer_steps: dict[str, int]
    averaged: Annotated[int, msgspec.Meta(ge=0)]
    rng: dict[str, Any]
    step: int
    psnr: float
    seconds: float
    losses: dict[str, float]
    skipped: int
    failures: int
    rate_scale: float


class TrainingState:
    """Everything that changes during training, and its checkpoint.

    Args:
        model: holds the parameters.
        optimizer: holds the moments.
        rng: generator of all random draws of the training.

    Attributes:
        average: mean of the parameters at the end of the training, if the settings ask for it.
        step: number of steps done.
        psnr: running mean of the training PSNR, dB.
        seconds: duration of the training so far.
        losses: mean losses of the last step.
        skipped: number of steps whose losses or gradients were not finite.
        failures: number of such steps in a row.
        rate_scale: factor of the learning rate, below 1 after failures.
    """

    _COUNTERS: ClassVar = ("step", "psnr", "seconds", "losses", "skipped", "failures", "rate_scale")

    def __init__(self, model: Model, optimizer: Adam, rng: np.random.Generator) -> None:
        self.model, self.optimizer, self.rng = model, optimizer, rng
        self.average = ParameterAverage(model.parameters if model.settings.averaged else {})
        self.step, self.psnr, self.seconds = 0, 0.0, 0.0
        self.losses: dict[str, float] = {}
        self.skipped, self.failures, self.rate_scale = 0, 0, 1.0
        self._snapshot: tuple[list[np.ndarray], dict[str, int], int] | None = None
        self._saved = time.perf_counter()

    def resume(self, folder: str | Path, identity: dict[str, Any]) -> None:
        """Continue from the checkpoint in ``folder``, if there is one.

        Args:
            folder: may hold a checkpoint.
            identity: JSON that identifies the training, with its data and seed; the settings are added.

        Raises:
            RunFolderError: the checkpoint belongs to a training with other data or settings.
            DataError: the checkpoint is damaged.
        """
        self.identity = {**identity, "settings": settings_to_json(self.model.settings)}
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
            self.optimizer.steps.update(header.optimizer_steps)
            self.average.count = header.averaged
            self.rng.bit_generator.state = header.rng
            for name in self._COUNTERS:
                setattr(self, name, getattr(header, name))
            if not all(
                np.isfinite(to_numpy(array)).all() for group in self._groups().values() for array in group.values()
            ):
                raise ValueError("values that are not finite")
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise DataError(f"{path} is damaged ({error!r}); remove it to start the training again") from error

    def save_periodically(self, folder: str | Path) -> None:
        """Write the checkpoint if the last one is :data:`SAVE_EVERY` seconds old."""
        if time.perf_counter() - self._saved < SAVE_EVERY:
            return
        arrays = {
            f"{prefix}/{name}": to_numpy(array)
            for prefix, group in self._groups().items()
            for name, array in group.items()
        }
        header = {
            "identity": self.identity,
            "optimizer_steps": self.optimizer.steps,
            "averaged": self.average.count,
            "rng": self.rng.bit_generator.state,
            **{name: getattr(self, name) for name in self._COUNTERS},
        }
        write_arrays(Path(folder) / TRAINING_FILE, arrays, header)
        self._saved = time.perf_counter()

    def take_snapshot(self) -> None:
        """Copy the parameters and moments, to return to them if the training fails."""
        arrays = [np.copy(to_numpy(array)) for group in self._groups().values() for array in group.values()]
        self._snapshot = arrays, dict(self.optimizer.steps), self.average.count

    def restore_snapshot(self) -> None:
        """Return to the last snapshot, and halve the learning rate."""
        self.rate_scale /= 2
        if self._snapshot is not None:
            arrays, steps, self.average.count = self._snapshot
            targets = (array for group in self._groups().values() for array in group.values())
            for target, array in zip(targets, arrays, strict=True):
                assign(target, array)
            self.optimizer.steps.update(steps)

    def _groups(self) -> dict[str, Mapping[str, Array]]:
        moments: dict[str, Mapping[str, Array]] = {"first": self.optimizer.first, "second": self.optimizer.second}
        return {
            "parameter": self.model.parameters,
            "state": self.model.state,
            "average": self.average.sums,
            **moments,
        }


def save_parts(folder: str | Path, arrays: dict[str, np.ndarray], header: dict[str, Any]) -> None:
    """Write the arrays and the JSON description of a field, and remove the training checkpoint of the folder."""
    folder = Path(folder)
    write_arrays(folder / ARRAYS_FILE, arrays)
    digest = _digest(read_bytes(folder / ARRAYS_FILE, MAX_ARRAY_BYTES))
    write_json(folder / "nerf.json", {"version": VERSION, "arrays_sha256": digest, **header})
    (folder / TRAINING_FILE).unlink(missing_ok=True)


def load_parts(folder: str | Path) -> tuple[dict[str, np.ndarray], FieldHeader]:
    """Read the arrays and the JSON description of a field.

    Raises:
        DataError: a file is missing, damaged or of another version, or the two files are of different fields.
    """
    path, arrays = Path(folder) / "nerf.json", Path(folder) / ARRAYS_FILE
    header = read_json(path, FieldHeader)
    if header.version != VERSION:
        raise DataError(f"{path} has version {header.version}, this release reads {VERSION}; fit again")
    data = read_bytes(arrays, MAX_ARRAY_BYTES)
    if header.arrays_sha256 != _digest(data):
        raise DataError(f"{arrays} does not belong to {path.name} beside it: saving was interrupted; fit again")
    return parse_arrays(data, dict[str, Any], str(arrays))[0], header


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def settings_to_json(settings: Settings) -> dict[str, Any]:
    """Return settings as JSON reads them back: tuples become lists."""
    return {f.name: list(v) if isinstance(v := getattr(settings, f.name), tuple) else v for f in fields(settings)}


def _difference(found: dict[str, Any], wanted: dict[str, Any]) -> str:
    names = (name for name in {**wanted, **found} if found.get(name) != wanted.get(name))
    return "different " + ", ".join(names)
