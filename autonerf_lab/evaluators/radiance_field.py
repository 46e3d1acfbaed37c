"""Interface between radiance fields and evaluators: every object with these methods can be scored."""

from collections.abc import Iterator
from typing import Any, Protocol

import numpy as np

from autonerf_lab.geometry import Intrinsics, camera_rays
from autonerf_lab.nerf.field_frame import FieldFrame
from autonerf_lab.types import Rendering

_VIEW_SIDE = 64  # pixels


def surface_points(image: Any, c2w: np.ndarray, intrinsics: Intrinsics) -> tuple[np.ndarray, np.ndarray]:
    """Compute the end points of the rays of a rendering; rays with an opacity of at most 0.5 have none.

    Args:
        image: rendering with the attributes of :class:`~autonerf_lab.types.Rendering`.
        c2w: (4, 4) camera-to-world pose of the rendering.
        intrinsics: of its camera.

    Returns:
        (N, 3) float32 world points, and the (H, W) bool mask of their pixels, in the same order.

    Example:
        >>> one = np.ones((1, 2), np.float32)
        >>> image = Rendering(one[..., None].repeat(3, axis=2), 2 * one, None, np.array([[1.0, 0.4]]))
        >>> points, ends = surface_points(image, np.eye(4), Intrinsics.from_fov(2, 1))
        >>> points.tolist(), ends.tolist()
        ([[-1.0, 0.0, -2.0]], [[True, False]])
    """
    rays_o, rays_d = camera_rays(intrinsics, c2w)
    ends = (image.depth > 0) & np.isfinite(image.depth) & (image.opacity > 0.5)
    return (rays_o + image.depth[..., None] * rays_d)[ends].astype(np.float32), ends


class Renderer(Protocol):
    """Interface of an object that renders views: a radiance field, or a baseline of image quality."""

    def render(self, c2w: np.ndarray, intrinsics: Intrinsics) -> Rendering:
        """Render the view from a (4, 4) pose; see :class:`~autonerf_lab.types.Rendering`."""


class RadianceField(Renderer, Protocol):
    """Interface of a radiance field: a trained NeRF, or the true geometry.

    Points are in the world frame, in metres. Ray directions ``rays_d`` have length 1 along the optical axis.
    """

    poses: np.ndarray  # (T, 4, 4) float64 camera-to-world, training poses
    intrinsics: Intrinsics  # of the training cameras
    meta: dict  # origin of the training images, at least ``scene``
    classes: int  # number of classes that the field predicts, 0 for none
    frame: FieldFrame  # origin and unit of the internal coordinates of the field

    def density(self, points: np.ndarray) -> np.ndarray:
        """Return the (N,) float32 density at (N, 3) points, per metre."""

    def color(self, points: np.ndarray, directions: np.ndarray | None = None) -> np.ndarray:
        """Return the (N, 3) float32 colour in [0, 1] at (N, 3) points, seen along ``directions``."""

    def semantics(self, points: np.ndarray) -> np.ndarray:
        """Return the (N, 16) float32 class probabilities at (N, 3) points."""

    def seen(self, points: np.ndarray) -> np.ndarray:
        """Return (N,) bool: True if a point lies in a training view, not behind its rendered depth."""

    def ray_gradients(
        self, rays_o: np.ndarray, rays_d: np.ndarray, target: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the (N,) squared error of the colour, mean over channels, and its gradients.

        Args:
            rays_o: (N, 3) origins.
            rays_d: (N, 3) directions.
            target: (N, 3) colours in [0, 1].

        Returns:
            (N,) errors, (N, 3) gradients for the origins, (N, 3) gradients for the directions.
        """


def training_views(field: RadianceField, rays: int) -> Iterator[tuple[np.ndarray, Intrinsics, Rendering]]:
    """Render evenly spaced training views of a field, resized to at most 64 pixels a side.

    Args:
        field: its training views are rendered.
        rays: approximate number of rays in all views.

    Yields:
        (4, 4) camera-to-world pose, intrinsics and rendering of each view.
    """
    width, height = field.intrinsics.width, field.intrinsics.height
    scale = min(1.0, _VIEW_SIDE / max(width, height))
    intrinsics = field.intrinsics.resized(max(1, round(width * scale)), max(1, round(height * scale)))
    views = min(len(field.poses), max(1, rays // (intrinsics.width * intrinsics.height)))
    for k in np.linspace(0, len(field.poses) - 1, views).round().astype(int):
        yield field.poses[k], intrinsics, field.render(field.poses[k], intrinsics)


def point_cloud(field: RadianceField, rays: int = 1_000_000) -> tuple[np.ndarray, np.ndarray]:
    """Compute the end points of training rays, and their classes.

    Args:
        field: its training views are rendered, see :func:`training_views`.
        rays: approximate number of rays.

    Returns:
        (N, 3) float32 world points and (N,) uint8 classes, all background if the field has no classes.
    """
    points, classes = [], []
    for c2w, intrinsics, image in training_views(field, rays):
        found, ends = surface_points(image, c2w, intrinsics)
        labels = np.zeros(ends.shape) if image.semantics is None else np.asarray(image.semantics)
        points.append(found)
        classes.append(labels[ends].astype(np.uint8))
    return np.concatenate(points), np.concatenate(classes)
