"""Trained radiance fields: images from any camera, and densities, colours and classes at any point."""

import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.errors import DataError, UnknownNameError
from autonerf_lab.geometry import Intrinsics, camera_rays
from autonerf_lab.nerf.checkpoint import FIELD_FILE, FieldHeader, load_parts, save_parts, settings_to_json
from autonerf_lab.nerf.field_frame import FieldFrame
from autonerf_lab.nerf.model import Model, ModelSpec, check_device
from autonerf_lab.nerf.models import MODELS, model_spec
from autonerf_lab.nerf.ray_batch import restore, to_numpy
from autonerf_lab.nerf.scene_box import SceneBox
from autonerf_lab.nerf.visibility import Visibility
from autonerf_lab.types import Rendering
from autonerf_lab.utils.plugins import package_name_of

MAX_COORDINATE = 1e9  # of points, in units of the poses; squares of larger float32 values overflow


class NeRF:
    """A trained model with its training poses. Points and poses are in the world frame of the training poses.

    The methods raise a :class:`~autonerf_lab.errors.DataError` for points, poses and rays that are not finite.

    Args:
        model: field architecture and sampler, with the trained parameters.
        poses: (T, 4, 4) float64 camera-to-world training poses, after pose refinement if it was on.
        intrinsics: camera model of the first training image.
        visibility: voxels that the training views have seen, in the coordinates of the field.
        meta: JSON: scene, policy, seed, preset, steps, seconds, training PSNR; if the poses were not the true ones,
            their source, and ``true_poses`` (x, y, heading) if they are known.
        frame: conversion between the world and the coordinates of the field; the identity for trajectories.
        classes: number of semantic classes, 0 for a field trained without labels.
    """

    def __init__(
        self,
        model: Model,
        poses: np.ndarray,
        intrinsics: Intrinsics,
        visibility: Visibility,
        meta: dict[str, Any],
        frame: FieldFrame | None = None,
        classes: int = NUM_CLASSES,
    ) -> None:
        self.model, self.poses, self.intrinsics = model, poses, intrinsics
        self.visibility, self.meta, self.classes = visibility, meta, classes
        self.frame = frame or FieldFrame()

    def render(self, c2w: np.ndarray, intrinsics: Intrinsics | None = None) -> Rendering:
        """Render the view of a camera.

        Args:
            c2w: (4, 4) camera-to-world.
            intrinsics: camera model; that of the training images by default.
        """
        return render(self.model, self.frame, c2w, intrinsics or self.intrinsics)

    def density(self, points: np.ndarray) -> np.ndarray:
        """Return (N,) float32 densities at (N, 3) world points, per metre (or per unit of the poses)."""
        return self.model.density(self._to_field(points)) / np.float32(self.frame.unit)

    def color(self, points: np.ndarray, directions: np.ndarray | None = None) -> np.ndarray:
        """Return colours at points.

        Args:
            points: (N, 3) world.
            directions: (N, 3) unit viewing directions; straight down by default.

        Returns:
            (N, 3) float32 in [0, 1].
        """
        if directions is None:
            directions = np.broadcast_to(np.array([0, 0, -1.0]), (len(points), 3))
        return self.model.field.color(self._to_field(points), _checked("directions", directions))

    def semantics(self, points: np.ndarray) -> np.ndarray:
        """Return (N, 16) float32 class probabilities at (N, 3) world points.

        Raises:
            DataError: the field was trained without labels.
        """
        if not self.classes:
            raise DataError("this field has no classes: it was trained on images without semantics")
        logits = self.model.field.logits(self._to_field(points))
        odds = np.exp(logits - logits.max(axis=1, keepdims=True))
        return odds / odds.sum(axis=1, keepdims=True)

    def seen(self, points: np.ndarray) -> np.ndarray:
        """Return (N,) bool: True if a world point (N, 3) lies between a training camera and its surface, or on it."""
        return self.visibility(self._to_field(points))

    def _to_field(self, points: np.ndarray) -> np.ndarray:
        return self.frame.to_field(_checked("points", points))

    def ray_gradients(
        self, rays_o: np.ndarray, rays_d: np.ndarray, target: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the squared colour error of rays and its gradients, as used by pose refinement.

        Args:
            rays_o: (N, 3) origins.
            rays_d: (N, 3) directions, of any length.
            target: (N, 3) colours in [0, 1].

        Returns:
            error (N,), mean over the channels; gradients of ``rays_o`` and of ``rays_d``, (N, 3) each.
        """
        origins, directions, length = _unit(self.frame.to_field(rays_o), rays_d)
        error, d_o, d_unit = self.model.ray_gradients(origins, directions, np.ascontiguousarray(target, np.float32))
        along = (d_unit * directions).sum(axis=1, keepdims=True)
        return error, d_o / np.float32(self.frame.unit), (d_unit - along * directions) / length[:, None]

    def save(self, folder: str | Path) -> None:
        """Write ``nerf.safetensors``, which :func:`load_nerf` reads, and ``nerf.json``, a copy of its header.

        A training checkpoint in the folder is removed.

        Raises:
            DataError: a file cannot be written.
        """
        model, visibility = self.model, self.visibility
        arrays = {f"parameter/{name}": to_numpy(value) for name, value in model.parameters.items()}
        arrays |= {f"state/{name}": value for name, value in {**model.state, **model.observed}.items()}
        arrays |= {"cameras": self.poses, "visibility": np.packbits(visibility.seen)}
        name = self.meta.get("model")
        header = {
            "meta": self.meta,
            "package": None if name in MODELS else package_name_of("models", str(name)),
            "settings": settings_to_json(model.settings),
            "classes": self.classes,
            "frame": {"origin": self.frame.origin.tolist(), "unit": self.frame.unit},
            "box": {"center": model.box.center.tolist(), "half": model.box.half.tolist(), "shell": model.box.shell},
            "intrinsics": asdict(self.intrinsics),
            "visibility": {
                "origin": visibility.origin.tolist(),
                "voxel": visibility.voxel,
                "shape": list(visibility.seen.shape),
            },
        }
        save_parts(folder, arrays, header)

    def __repr__(self) -> str:
        scene, steps = self.meta.get("scene", "?"), self.meta.get("steps", "?")
        return f"NeRF({self.meta.get('model', '?')}, scene={scene}, {len(self.poses)} views, {steps} steps)"


def load_nerf(folder: str | Path, device: str | None = None, model: ModelSpec | None = None) -> NeRF:
    """Load a saved field; it need not run on the device on which it was trained.

    Args:
        folder: holds ``nerf.safetensors``.
        device: None for the CPU, or a torch device.
        model: the recipe of a model that is not registered.

    Raises:
        DataError: the file is missing, damaged or of another version, or the model is not installed.
        DeviceError: the device does not exist on this machine.

    Example:
        >>> load_nerf("/nowhere")
        Traceback (most recent call last):
        autonerf_lab.errors.DataError: /nowhere/nerf.safetensors does not exist
    """
    check_device(device)
    path = Path(folder) / FIELD_FILE
    arrays, header = load_parts(folder)
    spec = model or _installed_model(header, path)
    try:
        plain: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in header.settings.items()}
        settings = type(next(iter(spec.settings.values())))(**plain)
        center, half = (np.array(values, np.float32) for values in (header.box.center, header.box.half))
        poses = arrays["cameras"]
        if min(half) <= 0 or header.box.shell <= 0 or not 0 <= header.classes <= NUM_CLASSES:
            raise ValueError("box or classes out of range")
        if poses.shape[1:] != (4, 4) or not all(np.isfinite(a).all() for a in arrays.values() if a.dtype.kind == "f"):
            raise ValueError("poses have the wrong shape, or values are not finite")
        box = SceneBox(center, half, header.box.shell)
        built = spec.build(settings, box, len(poses), header.classes, np.random.default_rng(0), device)
        for prefix, group in (("parameter", built.parameters), ("state", built.state), ("state", built.observed)):
            for name in group:
                restore(group, name, arrays[f"{prefix}/{name}"])
        grid = header.visibility
        voxels = math.prod(grid.shape)
        if (
            min(grid.shape) < 1
            or len(arrays["visibility"]) != -(-voxels // 8)
            or grid.voxel <= 0
            or header.frame.unit <= 0
        ):
            raise ValueError("the visibility grid has another size, or a length is not positive")
        seen = np.unpackbits(arrays["visibility"], count=voxels).astype(bool)
        visibility = Visibility(np.array(grid.origin), grid.voxel, seen.reshape(grid.shape))
        frame = FieldFrame(np.array(header.frame.origin), header.frame.unit)
        return NeRF(built, poses, header.intrinsics, visibility, header.meta, frame, header.classes)
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(f"{path} does not describe a field ({error!r}); fit again") from error


def _installed_model(header: FieldHeader, path: Path) -> ModelSpec:
    """Return the registered model that a file names.

    Raises:
        DataError: the file names no model, or one that is not installed.
    """
    name, package = header.meta.get("model"), header.package
    if not isinstance(name, str):
        raise DataError(f"{path} does not describe a field (it names no model); fit again")
    try:
        return model_spec(name)
    except UnknownNameError as error:
        # Names from a file are quoted and shortened.
        advice = "" if package is None else f"install the package {str(package)[:80]!r}, if you trust it, or "
        raise DataError(
            f"{path} needs the model {name[:80]!r}, which is not installed; {advice}pass it: "
            "load_nerf(folder, model=...)"
        ) from error


def render(model: Model, frame: FieldFrame, c2w: np.ndarray, intrinsics: Intrinsics) -> Rendering:
    """Render the view of a camera by a model, which may still be in training.

    Args:
        model: needs only a method ``render_rays``.
        frame: conversion between the world and the coordinates of the field.
        c2w: (4, 4) camera-to-world.
        intrinsics: camera model.
    """
    rays_o, rays_d = camera_rays(intrinsics, c2w)
    shape = rays_d.shape[:2]
    origins, directions, length = _unit(frame.to_field(rays_o.reshape(-1, 3)), rays_d.reshape(-1, 3))
    color, logits, depth, opacity = map(np.asarray, model.render_rays(origins, directions))
    return Rendering(
        color.reshape(*shape, 3),
        (frame.unit * depth / length).reshape(shape),
        logits.argmax(axis=1).astype(np.uint8).reshape(shape) if logits.shape[1] else None,
        opacity.reshape(shape),
    )


def _unit(rays_o: np.ndarray, rays_d: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return float32 origins, unit directions, and the lengths of the given directions."""
    length = np.linalg.norm(_checked("rays", rays_d), axis=1)
    if length.size and not length.min() > 0:
        raise DataError("a ray has a direction of length zero")
    origins = np.ascontiguousarray(_checked("rays", rays_o), np.float32)
    return origins, np.ascontiguousarray(rays_d / length[:, None], np.float32), length.astype(np.float32)


def _checked(name: str, values: np.ndarray) -> np.ndarray:
    """Return values within the range of float32 coordinates.

    Raises:
        DataError: a value is not finite, or too large.
    """
    largest = float(np.abs(values).max(initial=0.0))
    if not largest < MAX_COORDINATE:
        raise DataError(f"{name} must be finite and below {MAX_COORDINATE:g}; the largest value is {largest:g}")
    return values
