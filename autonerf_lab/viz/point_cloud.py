"""Point clouds of a radiance field, for other programs."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from autonerf_lab.errors import DataError
from autonerf_lab.evaluators.radiance_field import surface_points
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.utils import storage
from autonerf_lab.viz.render_image import layer_image

if TYPE_CHECKING:
    from autonerf_lab.evaluators.radiance_field import RadianceField

VIEW_RAYS = 2048  # pixels per training camera; fewer would use more cameras, but each rendering has a fixed cost


@dataclass(frozen=True)
class PointCloud:
    """Points with colours and classes."""

    points: np.ndarray  # (N, 3) float32, world frame, in the units of the camera poses: metres for a trajectory
    colors: np.ndarray  # (N, 3) uint8
    classes: np.ndarray | None  # (N,) uint8, index into CLASS_NAMES; None if the field has no classes

    def __len__(self) -> int:
        return len(self.points)

    def save(self, path: str | Path) -> Path:
        """Write a binary PLY: x, y, z, red, green, blue, alpha (always 255) and, if there are classes, ``label``.

        Raises:
            DataError: another extension, no points, or a file that cannot be written.
        """
        from trimesh import PointCloud as Points
        from trimesh.exchange.ply import export_ply

        path = Path(path)
        if path.suffix.lower() != ".ply":
            raise DataError(f"{path}: unknown extension; a point cloud is saved as .ply")
        if not len(self):
            raise DataError(f"{path}: no points to save; the field shows no surface in its training views")
        points: Any = Points(self.points, colors=self.colors)
        if self.classes is not None:
            points.vertex_attributes = {"label": self.classes}  # the PLY writer stores them for any geometry
        storage.write_bytes(path, export_ply(points))
        return path


def point_cloud(field: "RadianceField", count: int = 200_000, seed: int = 0) -> PointCloud:
    """Return surface points at the end of rays from the training cameras.

    Pixels are sampled as random lattices: every s-th row and column of a training image, with a random offset, is the
    image of another camera, which the field can render. All pixels are equally likely.

    Args:
        field: a trained radiance field.
        count: maximum number of points. Rays with an opacity below one half give no point.
        seed: random seed.

    Returns:
        Points in the world frame, with colours and, if the field has classes, classes.

    Example:
        >>> from autonerf_lab.evaluators import Rendering
        >>> class Wall:  # two metres in front of the only camera, which looks down
        ...     poses, intrinsics, meta = np.eye(4)[None], Intrinsics.from_fov(4, 4), {}
        ...     def render(self, c2w, intrinsics):
        ...         one = np.ones((intrinsics.height, intrinsics.width))
        ...         return Rendering(one[..., None].repeat(3, axis=2), 2 * one, one.astype(np.uint8), one)
        >>> cloud = point_cloud(Wall())
        >>> len(cloud), cloud.points[0], cloud.colors[0], cloud.classes[0]
        (16, array([-1.5,  1.5, -2. ], dtype=float32), array([255, 255, 255], dtype=uint8), np.uint8(1))
    """
    rng = np.random.default_rng(seed)
    camera = field.intrinsics
    views = min(len(field.poses), -(-count // VIEW_RAYS))
    stride = int(np.sqrt(views * camera.width * camera.height / max(count, 1)))
    stride = min(max(stride, 1), camera.width, camera.height)
    points, colors, classes = [], [], []
    for view in np.sort(rng.choice(len(field.poses), views, replace=False)):
        lattice = _lattice(camera, stride, *rng.integers(stride, size=2).tolist())
        image = field.render(field.poses[view], lattice)
        found, ends = surface_points(image, field.poses[view], lattice)
        points.append(found)
        colors.append(layer_image(image, "rgb")[ends])
        if image.semantics is not None:
            classes.append(np.asarray(image.semantics)[ends].astype(np.uint8))
    cloud = PointCloud(np.concatenate(points), np.concatenate(colors), np.concatenate(classes) if classes else None)
    if len(cloud) <= count:
        return cloud
    sample = np.sort(rng.choice(len(cloud), count, replace=False))
    sampled_classes = None if cloud.classes is None else cloud.classes[sample]
    return PointCloud(cloud.points[sample], cloud.colors[sample], sampled_classes)


def _lattice(camera: Intrinsics, stride: int, column: int, row: int) -> Intrinsics:
    """Return the camera whose pixels are every ``stride``-th pixel of another, starting at (row, column).

    Example:
        >>> camera = replace(Intrinsics.from_fov(8, 8), k1=-0.05)
        >>> np.allclose(_lattice(camera, 3, 1, 2).directions(), camera.directions()[2::3, 1::3])
        True
    """
    return replace(
        camera,
        width=-(-(camera.width - column) // stride),
        height=-(-(camera.height - row) // stride),
        fl_x=camera.fl_x / stride,
        fl_y=camera.fl_y / stride,
        cx=(camera.cx - column - 0.5) / stride + 0.5,
        cy=(camera.cy - row - 0.5) / stride + 0.5,
    )
