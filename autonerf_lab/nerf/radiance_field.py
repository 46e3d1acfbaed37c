"""A trained field, as everything downstream sees it: images from any camera, and answers at any point."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.errors import DataError
from autonerf_lab.geometry import Intrinsics, camera_rays
from autonerf_lab.nerf.frame import FieldFrame
from autonerf_lab.nerf.model import Model
from autonerf_lab.nerf.visibility import Visibility


@dataclass(frozen=True)
class Rendering:
    """What the field shows from one pose."""

    rgb: np.ndarray  # (H, W, 3) float32 in [0, 1]
    depth: np.ndarray  # (H, W) float32, along the optical axis, in the cameras' units: where half of the light is
    semantics: np.ndarray | None  # (H, W) uint8, the class of the largest rendered logit; None: nothing was labelled
    opacity: np.ndarray  # (H, W) float32, share of the light that was collected


class NeRF:
    """A trained model with its training cameras.

    Args:
        model: the parameters and the sampler.
        cameras: (T, 4, 4) camera-to-world poses it was trained on.
        intrinsics: the training camera.
        visibility: what those cameras saw, in the field's coordinates.
        meta: scene, policy, seed, preset, steps, seconds, PSNR: whatever tells this field from another; JSON values.
        frame: the field's coordinates in the world of the cameras; the same for a walk.
        classes: how many it tells apart, 0 where nothing was labelled.
    """

    def __init__(
        self,
        model: Model,
        cameras: np.ndarray,
        intrinsics: Intrinsics,
        visibility: Visibility,
        meta: dict[str, Any],
        frame: FieldFrame | None = None,
        classes: int = NUM_CLASSES,
    ) -> None:
        self.model, self.cameras, self.intrinsics = model, cameras, intrinsics
        self.visibility, self.meta, self.classes = visibility, meta, classes
        self.frame = frame or FieldFrame()

    def render(self, c2w: np.ndarray, intrinsics: Intrinsics | None = None) -> Rendering:
        """The view of a camera.

        Args:
            c2w: (4, 4) camera-to-world, world frame of the training poses.
            intrinsics: the camera; the training camera when none is given.
        """
        return render(self.model, self.frame, c2w, intrinsics or self.intrinsics)

    def density(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) world points -> (N,) float32, sigma per metre, or per whatever unit the cameras have."""
        return self.model.field.density(self.frame.enter(points)) / np.float32(self.frame.unit)

    def color(self, points: np.ndarray, directions: np.ndarray | None = None) -> np.ndarray:
        """Colours at points.

        Args:
            points: (N, 3) world.
            directions: (N, 3) unit viewing directions; straight down when none are given.

        Returns:
            (N, 3) float32 in [0, 1].
        """
        if directions is None:
            directions = np.broadcast_to(np.array([0, 0, -1.0]), (len(points), 3))
        return self.model.field.color(self.frame.enter(points), directions)

    def semantics(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) world points -> (N, 16) float32 probabilities of the classes.

        Raises:
            DataError: the field was trained without labels.
        """
        if not self.classes:
            raise DataError("this field knows no classes: it was trained on images without semantics")
        logits = self.model.field.logits(self.frame.enter(points))
        odds = np.exp(logits - logits.max(axis=1, keepdims=True))
        return odds / odds.sum(axis=1, keepdims=True)

    def seen(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) world points -> (N,) bool: on the way from a training camera to the surface it shows, or on it."""
        return self.visibility(self.frame.enter(points))

    def ray_gradients(
        self, rays_o: np.ndarray, rays_d: np.ndarray, target: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Squared error of rays against colours, and its gradients: what pose refinement descends.

        Args:
            rays_o: (N, 3) origins.
            rays_d: (N, 3) directions, of any length.
            target: (N, 3) colours in [0, 1].

        Returns:
            error (N,), mean over the channels; its gradients for ``rays_o`` and for ``rays_d``, (N, 3) each.
        """
        origins, directions, length = _unit(self.frame.enter(rays_o), rays_d)
        error, d_o, d_unit = self.model.ray_gradients(origins, directions, np.ascontiguousarray(target, np.float32))
        along = (d_unit * directions).sum(axis=1, keepdims=True)
        return error, d_o / np.float32(self.frame.unit), (d_unit - along * directions) / length[:, None]

    def save(self, folder: str | Path) -> None:
        """Write ``nerf.safetensors`` and ``nerf.json``: see :mod:`autonerf_lab.nerf.checkpoint`."""
        from autonerf_lab.nerf.checkpoint import save_nerf

        save_nerf(self, folder)

    def __repr__(self) -> str:
        scene, steps = self.meta.get("scene", "?"), self.meta.get("steps", "?")
        return f"NeRF({self.meta.get('model', '?')}, scene={scene}, {len(self.cameras)} views, {steps} steps)"


def render(model: Model, frame: FieldFrame, c2w: np.ndarray, intrinsics: Intrinsics) -> Rendering:
    """The view of a camera, of a model that may still be in training: all that is asked of it is ``render_rays``.

    Args:
        model: the parameters and the sampler.
        frame: its coordinates in the world of the camera.
        c2w: (4, 4) camera-to-world.
        intrinsics: the camera.
    """
    rays_o, rays_d = camera_rays(intrinsics, c2w)
    shape = rays_d.shape[:2]
    origins, directions, length = _unit(frame.enter(rays_o.reshape(-1, 3)), rays_d.reshape(-1, 3))
    color, logits, depth, opacity = map(np.asarray, model.render_rays(origins, directions))
    return Rendering(
        color.reshape(*shape, 3),
        (frame.unit * depth / length).reshape(shape),
        logits.argmax(axis=1).astype(np.uint8).reshape(shape) if logits.shape[1] else None,
        opacity.reshape(shape),
    )


def _unit(rays_o: np.ndarray, rays_d: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """float32 origins, unit directions and the lengths that directions had."""
    length = np.linalg.norm(rays_d, axis=1)
    origins = np.ascontiguousarray(rays_o, np.float32)
    return origins, np.ascontiguousarray(rays_d / length[:, None], np.float32), length.astype(np.float32)
