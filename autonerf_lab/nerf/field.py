"""A trained field, as everything downstream sees it: images from any camera, and answers at any point."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from autonerf_lab.geometry import Intrinsics, camera_rays
from autonerf_lab.nerf.encodings import spherical_harmonics
from autonerf_lab.nerf.nerfacto import SemanticNerfacto
from autonerf_lab.nerf.rendering import density_from_raw
from autonerf_lab.nerf.visibility import Visibility


@dataclass(frozen=True)
class Rendering:
    """What the field shows from one pose."""

    rgb: np.ndarray  # (H, W, 3) float32 in [0, 1]
    depth: np.ndarray  # (H, W) float32, metres along the optical axis, where half of the light is collected
    semantics: np.ndarray  # (H, W) uint8, the class of the largest rendered logit
    opacity: np.ndarray  # (H, W) float32, share of the light that was collected


class NeRF:
    """A trained model with its training cameras.

    Args:
        model: the parameters and the sampler.
        cameras: (T, 4, 4) camera-to-world poses it was trained on.
        intrinsics: the training camera.
        visibility: what those cameras saw.
        meta: scene, policy, seed, preset, steps, seconds, PSNR: whatever tells this field from another; JSON values.
    """

    def __init__(
        self,
        model: SemanticNerfacto,
        cameras: np.ndarray,
        intrinsics: Intrinsics,
        visibility: Visibility,
        meta: dict[str, Any],
    ) -> None:
        self.model, self.cameras, self.intrinsics = model, cameras, intrinsics
        self.visibility, self.meta = visibility, meta

    def render(self, c2w: np.ndarray, intrinsics: Intrinsics | None = None) -> Rendering:
        """The view of a camera.

        Args:
            c2w: (4, 4) camera-to-world, world frame of the training poses.
            intrinsics: the camera; the training camera when none is given.
        """
        intrinsics = intrinsics or self.intrinsics
        rays_o, rays_d = camera_rays(intrinsics, c2w)
        shape = rays_d.shape[:2]
        origins, directions, length = _unit(rays_o.reshape(-1, 3), rays_d.reshape(-1, 3))
        color, logits, depth, opacity = self.model.render_rays(origins, directions)
        return Rendering(
            color.reshape(*shape, 3),
            (depth / length).reshape(shape),
            logits.argmax(axis=1).astype(np.uint8).reshape(shape),
            opacity.reshape(shape),
        )

    def density(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) world points -> (N,) float32, sigma per metre."""
        return density_from_raw(torch.from_numpy(self.model.geometry(points)[:, 0])).numpy()

    def color(self, points: np.ndarray, directions: np.ndarray | None = None) -> np.ndarray:
        """Colours at points.

        Args:
            points: (N, 3) world.
            directions: (N, 3) unit viewing directions; straight down when none are given.

        Returns:
            (N, 3) float32 in [0, 1].
        """
        p, geometry = self.model.parameters, self.model.geometry(points)
        if directions is None:
            directions = np.broadcast_to(np.array([0, 0, -1.0]), (len(points), 3))
        harmonics = spherical_harmonics(torch.from_numpy(np.ascontiguousarray(directions, np.float32))).numpy()
        mean = np.broadcast_to(p["appearance"].mean(axis=0), (len(points), p["appearance"].shape[1]))
        hidden = geometry @ p["color_geometry"].T + np.concatenate([harmonics, mean], axis=1) @ p["color_ray"].T
        hidden = np.maximum(np.maximum(hidden, 0) @ p["color_1"].T, 0)
        return 1 / (1 + np.exp(-(hidden @ p["color_2"][:3].T)))

    def semantics(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) world points -> (N, 16) float32 probabilities of the classes."""
        p, geometry = self.model.parameters, self.model.geometry(points)
        logits = np.maximum(geometry @ p["semantic_0"].T, 0) @ p["semantic_1"].T
        odds = np.exp(logits - logits.max(axis=1, keepdims=True))
        return odds / odds.sum(axis=1, keepdims=True)

    def seen(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) world points -> (N,) bool: on the way from a training camera to the surface it shows, or on it."""
        return self.visibility(points)

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
        origins, directions, length = _unit(rays_o, rays_d)
        error, d_o, d_unit = self.model.ray_gradients(origins, directions, np.ascontiguousarray(target, np.float32))
        along = (d_unit * directions).sum(axis=1, keepdims=True)
        return error, d_o, (d_unit - along * directions) / length[:, None]

    def save(self, folder: str | Path) -> None:
        """Write ``nerf.safetensors`` and ``nerf.json``: see :mod:`autonerf_lab.nerf.checkpoint`."""
        from autonerf_lab.nerf.checkpoint import save_nerf

        save_nerf(self, folder)

    def __repr__(self) -> str:
        scene, steps = self.meta.get("scene", "?"), self.meta.get("steps", "?")
        return f"NeRF({self.meta.get('model', '?')}, scene={scene}, {len(self.cameras)} views, {steps} steps)"


def _unit(rays_o: np.ndarray, rays_d: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """float32 origins, unit directions and the lengths that directions had."""
    length = np.linalg.norm(rays_d, axis=1)
    origins = np.ascontiguousarray(rays_o, np.float32)
    return origins, np.ascontiguousarray(rays_d / length[:, None], np.float32), length.astype(np.float32)
