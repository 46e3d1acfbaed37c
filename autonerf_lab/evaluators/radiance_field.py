"""What an evaluator asks of a field: anything that answers these methods can be scored."""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from autonerf_lab.geometry import Intrinsics, camera_rays
from autonerf_lab.nerf.frame import FieldFrame


@dataclass(frozen=True)
class Image:
    """What a field shows from one pose."""

    rgb: np.ndarray  # (H, W, 3) float32 in [0, 1]
    depth: np.ndarray  # (H, W) float32, metres along the optical axis, the median of the weights
    semantics: np.ndarray | None  # (H, W) uint8, class index; None: the field knows no classes
    opacity: np.ndarray  # (H, W) float32 in [0, 1]


def surface_points(image: Any, c2w: np.ndarray, intrinsics: Intrinsics) -> tuple[np.ndarray, np.ndarray]:
    """Where the rays of a picture end; those that collect less than half of the light end nowhere.

    Args:
        image: what a field shows, with the fields of :class:`Image`.
        c2w: (4, 4) camera-to-world it was rendered from.
        intrinsics: of that camera.

    Returns:
        (N, 3) float32 world points, and (H, W) bool: their pixels, in the same order.

    Example:
        >>> one = np.ones((1, 2), np.float32)
        >>> image = Image(one[..., None].repeat(3, axis=2), 2 * one, None, np.array([[1.0, 0.4]]))
        >>> points, ends = surface_points(image, np.eye(4), Intrinsics.from_fov(2, 1))
        >>> points.tolist(), ends.tolist()
        ([[-1.0, 0.0, -2.0]], [[True, False]])
    """
    rays_o, rays_d = camera_rays(intrinsics, c2w)
    ends = (image.depth > 0) & np.isfinite(image.depth) & (image.opacity > 0.5)
    return (rays_o + image.depth[..., None] * rays_d)[ends].astype(np.float32), ends


class Field(Protocol):
    """A trained NeRF, the true geometry, or a toy of a test. Points are world metres, ``rays_d`` has depth 1."""

    cameras: np.ndarray  # (T, 4, 4) training poses
    intrinsics: Intrinsics  # of the training cameras
    meta: dict  # at least ``scene``
    classes: int  # how many it tells apart, 0 for none
    frame: FieldFrame  # where the field has its zero, and what it takes for a metre

    def render(self, c2w: np.ndarray, intrinsics: Intrinsics) -> Any:
        """One image from a pose, with the fields of :class:`Image`."""

    def density(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) -> (N,) float32, per metre."""

    def color(self, points: np.ndarray, directions: np.ndarray | None = None) -> np.ndarray:
        """(N, 3) -> (N, 3) float32 in [0, 1], looking along ``directions``."""

    def semantics(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) -> (N, 16) float32 probabilities."""

    def seen(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) -> (N,) bool: inside a training view, in front of its rendered depth or at it."""

    def ray_gradients(
        self, rays_o: np.ndarray, rays_d: np.ndarray, target: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Squared error per ray (N,), mean over the channels, and its gradients for origins and directions."""
