"""The training pixels of photographs, drawn at random, in the field's own units."""

import numpy as np

from autonerf_lab.dataset import Dataset
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.nerf.bundles import NO_DEPTH, NO_LABEL, Rays, Targets

SPREAD = 2.0  # what the typical distance of photographs' cameras from what they look at becomes, in the field's units


def field_unit(data: Dataset) -> float:
    """What the field calls one metre, in the user's units: 1 for a walk; for photographs, whose scale is unknown, what
    makes the cameras' distance from their common focus, or from each other where that is more, a room's.

    The focus is the point nearest to all optical axes, where they are not too parallel to have one.

    Example:
        >>> from autonerf_lab.trajectory import Trajectory
        >>> from autonerf_lab.geometry import Intrinsics, planar_pose
        >>> ring = np.linspace(0, 6, 8)
        >>> poses = np.stack([planar_pose(9 * np.cos(a), 9 * np.sin(a), a + np.pi) for a in ring])
        >>> walk = Trajectory(poses, np.zeros((8, 2, 2, 3), np.uint8), None, None, Intrinsics.from_fov(2, 2))
        >>> data = Dataset.of(walk)
        >>> import dataclasses
        >>> field_unit(data), round(field_unit(dataclasses.replace(data, metric=False)), 2)
        (1.0, 4.5)
    """
    if data.metric:
        return 1.0
    positions, axes = data.poses[:, :3, 3], -data.poses[:, :3, 2]
    spread = np.median(np.linalg.norm(positions - positions.mean(axis=0), axis=1))
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    mean = across.mean(axis=0)
    if np.linalg.eigvalsh(mean)[0] > 1e-3:
        focus = np.linalg.solve(mean, np.einsum("tij,tj->i", across, positions) / len(positions))
        spread = max(spread, np.median(np.linalg.norm(positions - focus, axis=1)))
    return float(spread / SPREAD) if spread > 0 else 1.0


class Pixels:
    """Every pixel of every photograph, as a ray and what it should show.

    Args:
        data: the photographs.
        unit: see :func:`field_unit`.
    """

    def __init__(self, data: Dataset, unit: float = 1.0) -> None:
        self.poses = data.poses.astype(np.float32)
        self.poses[:, :3, 3] = data.poses[:, :3, 3] / unit
        sizes = [image.shape[0] * image.shape[1] for image in data.images]
        self.first = np.concatenate([[0], np.cumsum(sizes)])  # of each photograph's pixels
        self.rgb = np.concatenate([image.reshape(-1, 3) for image in data.images])
        self.labels = _flat(data.semantics)
        self.depth = _flat(data.depths)
        if self.labels is not None:
            self._by_class = np.argsort(self.labels, kind="stable").astype(np.int32)
            self._class_pixels = np.bincount(self.labels)
        tables: list[np.ndarray] = []
        self._table = np.zeros(len(data), np.int64)  # photographs of one camera share its directions
        known: dict[Intrinsics, int] = {}
        for t, camera in enumerate(data.cameras):
            if camera not in known:
                known[camera] = sum(len(table) for table in tables)
                tables.append(camera.directions().reshape(-1, 3))
            self._table[t] = known[camera]
        directions = np.concatenate(tables)
        length = np.linalg.norm(directions, axis=1, keepdims=True)
        self._directions, self._length = (directions / length).astype(np.float32), length[:, 0].astype(np.float32)
        self._unit = np.float32(unit)

    def __len__(self) -> int:
        return len(self.rgb)

    def draw(self, count: int, rng: np.random.Generator, by_class: float = 0.0) -> np.ndarray:
        """(count,) pixels, uniform over all of them but for a share.

        The share ``by_class`` is uniform within classes, and these are drawn by the square root of their pixels: a cup
        is a pixel in ten thousand, and would hardly be met.
        """
        some = round(by_class * count) if self.labels is not None else 0
        pixels = rng.integers(len(self), size=count)
        if some:
            ends = np.cumsum(self._class_pixels)
            chance = np.cumsum(np.sqrt(self._class_pixels))
            drawn = np.searchsorted(chance / chance[-1], rng.random(some), side="right")
            within = (rng.random(some) * self._class_pixels[drawn]).astype(np.int64)
            pixels[:some] = self._by_class[ends[drawn] - self._class_pixels[drawn] + within]
        return pixels

    def rays(self, pixels: np.ndarray) -> Rays:
        """The rays of (R,) pixels, world frame, the field's units."""
        frames, where = self._find(pixels)
        poses = self.poses[frames]
        directions = np.einsum("rij,rj->ri", poses[:, :3, :3], self._directions[where])
        return Rays(np.ascontiguousarray(poses[:, :3, 3]), directions, frames)

    def targets(self, pixels: np.ndarray) -> Targets:
        """What the rays of (R,) pixels should show."""
        color = self.rgb[pixels].astype(np.float32) / np.float32(255)
        labels, depth = np.full(len(pixels), NO_LABEL), np.full(len(pixels), NO_DEPTH, np.float32)
        if self.labels is not None:
            labels = self.labels[pixels].astype(np.int64)
        if self.depth is not None:
            depth = self.depth[pixels] * self._length[self._find(pixels)[1]] / self._unit
        return Targets(color, labels, depth)

    def _find(self, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Photograph, and row of the table of directions."""
        frames = np.searchsorted(self.first, pixels, side="right") - 1
        return frames, self._table[frames] + pixels - self.first[frames]


def _flat(layers: list[np.ndarray] | None) -> np.ndarray | None:
    return None if layers is None else np.concatenate([layer.reshape(-1) for layer in layers])
