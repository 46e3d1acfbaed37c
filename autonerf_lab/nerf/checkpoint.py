"""Fields and trainings on disk: safetensors for numbers, JSON for the rest, nothing that could run code.

``nerf.safetensors`` holds parameters, cameras and the visibility grid; ``nerf.json``, written last, says how to put
them together. A training in progress keeps ``training.safetensors``, which goes when the field is saved.
"""

import time
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from autonerf_lab.errors import DataError, RunFolderError, UnknownNameError
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.nerf.frame import FieldFrame
from autonerf_lab.nerf.model import Model, ModelSpec
from autonerf_lab.nerf.models import MODELS, model_spec
from autonerf_lab.nerf.optimizer import Adam
from autonerf_lab.nerf.radiance_field import NeRF
from autonerf_lab.nerf.ray_batch import Array, assign, to_numpy
from autonerf_lab.nerf.scene_box import SceneBox
from autonerf_lab.nerf.settings import Settings
from autonerf_lab.nerf.visibility import Visibility
from autonerf_lab.utils.plugins import package_of
from autonerf_lab.utils.storage import read_arrays, read_json, write_arrays, write_json

VERSION = 2
SAVE_EVERY = 20.0  # seconds of training between two checkpoints
TRAINING_FILE = "training.safetensors"


class TrainingState:
    """Everything that changes during training."""

    def __init__(self, model: Model, optimizer: Adam, rng: np.random.Generator) -> None:
        self.model, self.optimizer, self.rng = model, optimizer, rng
        self.step, self.psnr, self.seconds = 0, 0.0, 0.0
        self.losses: dict[str, float] = {}
        self._saved = time.perf_counter()

    def resume(self, folder: str | Path, identity: dict[str, Any]) -> None:
        """Go on from the checkpoint in ``folder``, if there is one; ``identity`` tells this training from another.

        Raises:
            RunFolderError: the checkpoint belongs to a training with other data or settings.
            DataError: it is damaged.
        """
        self.identity = {**identity, "settings": _plain(self.model.settings)}
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

    def save_now_and_then(self, folder: str | Path) -> None:
        """Write the checkpoint when the last one is :data:`SAVE_EVERY` seconds old."""
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


def save_nerf(nerf: NeRF, folder: str | Path) -> None:
    """Write a field; a training checkpoint in the same folder has done its work and is removed."""
    folder = Path(folder)
    model, visibility = nerf.model, nerf.visibility
    arrays = {f"parameter/{name}": to_numpy(value) for name, value in model.parameters.items()}
    arrays |= {f"state/{name}": value for name, value in model.state.items()}
    arrays |= {"cameras": nerf.cameras, "visibility": np.packbits(visibility.seen)}
    write_arrays(folder / "nerf.safetensors", arrays)
    write_json(
        folder / "nerf.json",
        {
            "version": VERSION,
            "meta": nerf.meta,
            "package": _package(nerf.meta.get("model")),
            "settings": _plain(model.settings),
            "classes": nerf.classes,
            "frame": {"origin": nerf.frame.origin.tolist(), "unit": nerf.frame.unit},
            "box": {"center": model.box.center.tolist(), "half": model.box.half.tolist(), "shell": model.box.shell},
            "intrinsics": asdict(nerf.intrinsics),
            "visibility": {
                "origin": visibility.origin.tolist(),
                "voxel": visibility.voxel,
                "shape": list(visibility.seen.shape),
            },
        },
    )
    (folder / TRAINING_FILE).unlink(missing_ok=True)


def load_nerf(folder: str | Path, device: str | None = None, model: ModelSpec | None = None) -> NeRF:
    """Read a field that was saved, on whatever device it was trained.

    Args:
        folder: holds ``nerf.json``.
        device: where it shall work: None for this machine's cores, or a torch device.
        model: how to build it, for a model that is registered nowhere.

    Raises:
        DataError: names the file that is missing, damaged or of another version, or the model that is not installed.

    Example:
        >>> load_nerf("/nowhere")
        Traceback (most recent call last):
        autonerf_lab.errors.DataError: /nowhere/nerf.json does not exist
    """
    path = Path(folder) / "nerf.json"
    header = read_json(path)
    if header.get("version") != VERSION:
        raise DataError(f"{path} has version {header.get('version')!r}, this release reads {VERSION}; fit again")
    arrays, _ = read_arrays(Path(folder) / "nerf.safetensors")
    spec = model or _known(header, path)
    try:
        plain: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in header["settings"].items()}
        settings = type(next(iter(spec.settings.values())))(**plain)
        box = SceneBox(
            np.array(header["box"]["center"], np.float32),
            np.array(header["box"]["half"], np.float32),
            float(header["box"]["shell"]),
        )
        cameras = arrays["cameras"]
        built = spec.build(settings, box, len(cameras), header["classes"], np.random.default_rng(0), device)
        for prefix, group in (("parameter", built.parameters), ("state", built.state)):
            for name, value in group.items():
                assign(value, arrays[f"{prefix}/{name}"])
        grid = header["visibility"]
        seen = np.unpackbits(arrays["visibility"], count=int(np.prod(grid["shape"]))).astype(bool)
        visibility = Visibility(np.array(grid["origin"]), float(grid["voxel"]), seen.reshape(grid["shape"]))
        intrinsics, meta = Intrinsics(**header["intrinsics"]), dict(header["meta"])
        frame = FieldFrame(np.array(header["frame"]["origin"], np.float64), float(header["frame"]["unit"]))
        return NeRF(built, cameras, intrinsics, visibility, meta, frame, int(header["classes"]))
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(f"{path} does not describe a field ({error!r}); fit again") from error


def _package(model: Any) -> str | None:
    """What has to be installed before a field can be read, besides this package."""
    return None if model in MODELS else package_of("models", str(model))


def _known(header: dict[str, Any], path: Path) -> ModelSpec:
    meta = header.get("meta")
    name, package = meta.get("model") if isinstance(meta, dict) else None, header.get("package")
    if not isinstance(name, str):
        raise DataError(f"{path} does not describe a field (it names no model); fit again")
    try:
        return model_spec(name)
    except UnknownNameError as error:
        # names out of a file: quoted and cut
        way_out = "" if package is None else f"install the package {str(package)[:80]!r}, if you trust it, or "
        raise DataError(
            f"{path} needs the model {name[:80]!r}, which is not installed; {way_out}pass it: "
            "load_nerf(folder, model=...)"
        ) from error


def _plain(settings: Settings) -> dict[str, Any]:
    """As JSON would read it back."""
    return {f.name: list(v) if isinstance(v := getattr(settings, f.name), tuple) else v for f in fields(settings)}


def _difference(found: Any, wanted: dict[str, Any]) -> str:
    found = found if isinstance(found, dict) else {}
    names = [name for name in wanted if found.get(name) != wanted[name]]
    return "different " + ", ".join(names)
