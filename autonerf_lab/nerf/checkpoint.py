"""Fields and training states on disk: safetensors for arrays, JSON for the rest; no file can contain code.

``nerf.safetensors`` holds the arrays of a field; ``nerf.json``, written last, describes how to rebuild it. A training
in progress stores ``training.safetensors``, which is removed when the field is saved.
"""

import time
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from autonerf_lab.errors import DataError, RunFolderError
from autonerf_lab.nerf.model import Model
from autonerf_lab.nerf.optimizer import Adam
from autonerf_lab.nerf.ray_batch import Array, assign, to_numpy
from autonerf_lab.nerf.settings import Settings
from autonerf_lab.utils.storage import read_arrays, read_json, write_arrays, write_json

VERSION = 2  # of nerf.json
SAVE_EVERY = 20.0  # seconds of training between two checkpoints
TRAINING_FILE = "training.safetensors"


class TrainingState:
    """Everything that changes during training, and its checkpoint.

    Args:
        model: holds the parameters.
        optimizer: holds the moments.
        rng: generator of all random draws of the training.

    Attributes:
        step: number of steps done.
        psnr: running mean of the training PSNR, dB.
        seconds: duration of the training so far.
        losses: mean losses of the last step.
    """

    def __init__(self, model: Model, optimizer: Adam, rng: np.random.Generator) -> None:
        self.model, self.optimizer, self.rng = model, optimizer, rng
        self.step, self.psnr, self.seconds = 0, 0.0, 0.0
        self.losses: dict[str, float] = {}
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
        arrays, header = read_arrays(path)
        if header.get("identity") != self.identity:
            raise RunFolderError(
                f"{path} belongs to another training ({_difference(header.get('identity'), self.identity)}); "
                "remove it, or use another folder"
            )
        try:
            for prefix, group in self._groups().items():
                for name, array in group.items():
                    assign(array, arrays[f"{prefix}/{name}"])
            self.optimizer.steps.update(header["optimizer_steps"])
            self.rng.bit_generator.state = header["rng"]
            self.step, self.psnr, self.seconds = header["step"], header["psnr"], header["seconds"]
        except (KeyError, TypeError, ValueError) as error:
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
            "rng": self.rng.bit_generator.state,
            "step": self.step,
            "psnr": self.psnr,
            "seconds": self.seconds,
        }
        write_arrays(Path(folder) / TRAINING_FILE, arrays, header)
        self._saved = time.perf_counter()

    def _groups(self) -> dict[str, Mapping[str, Array]]:
        moments: dict[str, Mapping[str, Array]] = {"first": self.optimizer.first, "second": self.optimizer.second}
        return {"parameter": self.model.parameters, "state": self.model.state, **moments}


def save_parts(folder: str | Path, arrays: dict[str, np.ndarray], header: dict[str, Any]) -> None:
    """Write the arrays and the JSON description of a field, and remove the training checkpoint of the folder."""
    folder = Path(folder)
    write_arrays(folder / "nerf.safetensors", arrays)
    write_json(folder / "nerf.json", {"version": VERSION, **header})
    (folder / TRAINING_FILE).unlink(missing_ok=True)


def load_parts(folder: str | Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Read the arrays and the JSON description of a field.

    Raises:
        DataError: a file is missing, damaged or of another version.
    """
    path = Path(folder) / "nerf.json"
    header = read_json(path)
    if header.get("version") != VERSION:
        raise DataError(f"{path} has version {header.get('version')!r}, this release reads {VERSION}; fit again")
    return read_arrays(Path(folder) / "nerf.safetensors")[0], header


def settings_to_json(settings: Settings) -> dict[str, Any]:
    """Return settings as JSON reads them back: tuples become lists."""
    return {f.name: list(v) if isinstance(v := getattr(settings, f.name), tuple) else v for f in fields(settings)}


def _difference(found: Any, wanted: dict[str, Any]) -> str:
    found = found if isinstance(found, dict) else {}
    names = [name for name in wanted if found.get(name) != wanted[name]]
    return "different " + ", ".join(names)
