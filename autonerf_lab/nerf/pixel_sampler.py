"""The training pixels of photographs, drawn at random, in the field's own coordinates."""

from functools import cached_property

import numpy as np

from autonerf_lab.data.dataset import Dataset
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.nerf.frame import FieldFrame
from autonerf_lab.nerf.ray_batch import NO_DEPTH, NO_LABEL, Rays, Targets


class Pixels:
    """Every pixel of every photograph, as a ray and what it should show.

    Args:
        data: the photographs.
        frame: the field's coordinates.
    """

    def __init__(self, data: Dataset, frame: FieldFrame) -> None:
        self.poses = frame.enter_poses(data.poses).astype(np.float32)
        sizes = [image.shape[0] * image.shape[1] for image in data.images]
        self.first = np.concatenate([[0], np.cumsum(sizes)])  # of each photograph's pixels
        self.rgb = np.concatenate([image.reshape(-1, 3) for image in data.images])
        self.labels = _flat(data.semantics)
        self.depth = _flat(data.depths)
        self._unit = np.float32(frame.unit)
        self._width = np.array([camera.width for camera in data.cameras])
        self._focal = np.array([(camera.fl_x, camera.fl_y) for camera in data.cameras])
        self._center = np.array([(camera.cx, camera.cy) for camera in data.cameras])
        # Without a lens a pixel's direction is a division. Lenses take a table; photographs of one camera share it.
        known: dict[Intrinsics, int] = {}
        tables = [np.zeros((0, 2), np.float32)]
        self._table = np.full(len(data), -1)
        for t, camera in enumerate(data.cameras):
            if any(camera.lens):
                if camera not in known:
                    known[camera] = sum(len(table) for table in tables)
                    tables.append(camera.directions()[..., :2].reshape(-1, 2).astype(np.float32))
                self._table[t] = known[camera]
        self._bent = np.concatenate(tables)

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
            by_label, sizes, first, chances = self._classes
            drawn = np.searchsorted(chances, rng.random(some), side="right")
            pixels[:some] = by_label[first[drawn] + (rng.random(some) * sizes[drawn]).astype(np.int64)]
        return pixels

    @cached_property
    def _classes(self) -> tuple[np.ndarray, ...]:
        """All pixels in the order of their labels; of each class its pixels, the first of them, cumulative chance."""
        assert self.labels is not None
        sizes = np.bincount(self.labels)
        chances = np.cumsum(np.sqrt(sizes))
        by_label = np.argsort(self.labels, kind="stable").astype(np.int32)
        return by_label, sizes, np.cumsum(sizes) - sizes, chances / chances[-1]

    def rays(self, pixels: np.ndarray) -> Rays:
        """The rays of (R,) pixels, in the field's coordinates."""
        frames, directions = self._directions(pixels)
        poses = self.poses[frames]
        unit = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32)
        return Rays(np.ascontiguousarray(poses[:, :3, 3]), np.einsum("rij,rj->ri", poses[:, :3, :3], unit), frames)

    def targets(self, pixels: np.ndarray) -> Targets:
        """What the rays of (R,) pixels should show."""
        color = self.rgb[pixels].astype(np.float32) / np.float32(255)
        labels, depth = np.full(len(pixels), NO_LABEL), np.full(len(pixels), NO_DEPTH, np.float32)
        if self.labels is not None:
            labels = self.labels[pixels].astype(np.int64)
        if self.depth is not None:
            length = np.linalg.norm(self._directions(pixels)[1], axis=1).astype(np.float32)
            depth = self.depth[pixels] * length / self._unit
        return Targets(color, labels, depth)

    def _directions(self, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Photograph (R,) of each pixel, and its direction (R, 3) float64 in the camera's frame, at depth 1."""
        frames = np.searchsorted(self.first, pixels, side="right") - 1
        inside = pixels - self.first[frames]
        rows, columns = np.divmod(inside, self._width[frames])
        x, y = ((np.stack([columns, rows], axis=1) + 0.5 - self._center[frames]) / self._focal[frames]).T
        directions = np.stack([x, -y, -np.ones_like(x)], axis=1)
        bent = self._table[frames] >= 0
        directions[bent, :2] = self._bent[self._table[frames[bent]] + inside[bent]]
        return frames, directions


def _flat(layers: list[np.ndarray] | None) -> np.ndarray | None:
    return None if layers is None else np.concatenate([layer.reshape(-1) for layer in layers])
