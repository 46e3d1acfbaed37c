"""A field as coloured points, for programs that know no fields."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from autonerf_lab.errors import DataError
from autonerf_lab.evaluators.radiance_field import surface_points
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.utils import storage
from autonerf_lab.viz.render_image import paint

if TYPE_CHECKING:
    from autonerf_lab.evaluators.radiance_field import Field

VIEW_RAYS = 2048  # in one training camera: fewer would see more of them, but rendering pays for each picture


@dataclass(frozen=True)
class PointCloud:
    """Points with colours and classes."""

    points: np.ndarray  # (N, 3) float32, world frame, in the units of the cameras: metres for a walk
    colors: np.ndarray  # (N, 3) uint8
    classes: np.ndarray | None  # (N,) uint8, index into CLASS_NAMES; None: the field knows none

    def __len__(self) -> int:
        return len(self.points)

    def save(self, path: str | Path) -> Path:
        """Write a binary PLY: x, y, z, red, green, blue, alpha (always 255) and, where there are classes, ``label``.

        Raises:
            DataError: another ending, no points, or a file that cannot be written.
        """
        from trimesh import PointCloud as Points
        from trimesh.exchange.ply import export_ply

        path = Path(path)
        if path.suffix.lower() != ".ply":
            raise DataError(f"{path}: a point cloud is written as .ply")
        if not len(self):
            raise DataError(f"{path}: there are no points, the field holds nothing that its training cameras see")
        points: Any = Points(self.points, colors=self.colors)
        if self.classes is not None:
            points.vertex_attributes = {"label": self.classes}  # what the writer takes along from any geometry
        storage.write_bytes(path, export_ply(points))
        return path


def point_cloud(field: "Field", count: int = 200_000, seed: int = 0) -> PointCloud:
    """Points where rays of the training cameras end.

    The pixels are drawn at random, but as lattices: every s-th row and column of a camera from a random first one is
    again the picture of a camera, which a field can render, and each pixel is as likely as any other.

    Args:
        field: a trained NeRF.
        count: how many points at most. Rays that collect less than half of the light end nowhere, and leave none.
        seed: of the choice.

    Example:
        >>> from autonerf_lab.evaluators import Image
        >>> class Wall:  # two metres in front of its one camera, which looks down
        ...     cameras, intrinsics, meta = np.eye(4)[None], Intrinsics.from_fov(4, 4), {}
        ...     def render(self, c2w, intrinsics):
        ...         one = np.ones((intrinsics.height, intrinsics.width))
        ...         return Image(one[..., None].repeat(3, axis=2), 2 * one, one.astype(np.uint8), one)
        >>> cloud = point_cloud(Wall())
        >>> len(cloud), cloud.points[0], cloud.colors[0], cloud.classes[0]
        (16, array([-1.5,  1.5, -2. ], dtype=float32), array([255, 255, 255], dtype=uint8), np.uint8(1))
    """
    rng = np.random.default_rng(seed)
    camera = field.intrinsics
    views = min(len(field.cameras), -(-count // VIEW_RAYS))
    stride = int(np.sqrt(views * camera.width * camera.height / max(count, 1)))
    stride = min(max(stride, 1), camera.width, camera.height)
    points, colors, classes = [], [], []
    for view in np.sort(rng.choice(len(field.cameras), views, replace=False)):
        lattice = _lattice(camera, stride, *rng.integers(stride, size=2).tolist())
        image = field.render(field.cameras[view], lattice)
        found, ends = surface_points(image, field.cameras[view], lattice)
        points.append(found)
        colors.append(paint(image, "rgb")[ends])
        if image.semantics is not None:
            classes.append(np.asarray(image.semantics)[ends].astype(np.uint8))
    cloud = PointCloud(np.concatenate(points), np.concatenate(colors), np.concatenate(classes) if classes else None)
    if len(cloud) <= count:
        return cloud
    kept = np.sort(rng.choice(len(cloud), count, replace=False))
    return PointCloud(cloud.points[kept], cloud.colors[kept], None if cloud.classes is None else cloud.classes[kept])


def _lattice(camera: Intrinsics, stride: int, column: int, row: int) -> Intrinsics:
    """The camera whose pixels are every ``stride``-th pixel of another, from (row, column) on.

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
