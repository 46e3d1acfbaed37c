"""Random training pixels of a dataset, without the masked ones, as rays and targets in the coordinates of the field."""

from collections.abc import Callable

import numpy as np

from autonerf_lab.data.dataset import Dataset
from autonerf_lab.errors import DataError
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.nerf.field_frame import FieldFrame
from autonerf_lab.nerf.ray_batch import NO_DEPTH, NO_LABEL, Rays, Targets

FLAT = 2  # of 255: added to the contrast of pixels, so that those without contrast are sampled, too


class PixelSampler:
    """All pixels of a dataset, numbered through all images.

    Args:
        data: posed images.
        frame: conversion to the coordinates of the field.
        label_distance: the weight of a label is its confidence times min(1, (label_distance / depth)²), because a
            segmenter sees more of what is near; in the unit of the measured depth images. 0: its confidence.
        by_class: share of the sampled pixels that is drawn by class, with class probabilities proportional to the
            square root of their pixel counts, so that small objects are seen often enough.
        by_contrast: share that is drawn with a probability that grows with the contrast to the neighbours, because
            the gradients of colours vary most at edges.
        on_planes: share that is drawn from the pixels of :meth:`learn_planes`, if there are any. The rest is uniform.
    """

    def __init__(
        self,
        data: Dataset,
        frame: FieldFrame,
        label_distance: float = 0.0,
        by_class: float = 0.0,
        by_contrast: float = 0.0,
        on_planes: float = 0.0,
    ) -> None:
        self.names, self.frame = data.names, frame
        self.poses = frame.poses_to_field(data.poses).astype(np.float32)
        sizes = [image.shape[0] * image.shape[1] for image in data.images]
        self.first = np.concatenate([[0], np.cumsum(sizes)])  # first pixel of each image
        self.rgb = np.concatenate([image.reshape(-1, 3) for image in data.images])
        self.labels = _flat(data.semantics)
        self.depth = _flat(data.depths)
        self._confidence = _flat(data.confidences)
        self._label_distance, self._on_planes = label_distance, on_planes
        used = _flat(data.masks)
        self._used = None if used is None else np.flatnonzero(used)  # pixels that may be sampled; None: all
        self._strata: dict[str, _Stratum] = {}
        if by_class and self.labels is not None:
            self._strata["class"] = _Stratum(by_class, self._of_used(self.labels), self._used, np.sqrt)
        self._contrast = _flat([_contrast(image) for image in data.images] if by_contrast else None)
        if self._contrast is not None:
            self._strata["contrast"] = _Stratum(
                by_contrast,
                self._of_used(self._contrast),
                self._used,
                lambda sizes: sizes * (FLAT + np.arange(len(sizes))),
            )
        self._width = np.array([camera.width for camera in data.intrinsics])
        self._focal = np.array([(camera.fl_x, camera.fl_y) for camera in data.intrinsics])
        self._center = np.array([(camera.cx, camera.cy) for camera in data.intrinsics])
        # Without lens distortion, the direction of a pixel is one division. With it, directions are tabulated; images
        # with equal intrinsics share a table.
        known: dict[Intrinsics, int] = {}
        tables = [np.zeros((0, 2), np.float32)]
        self._table = np.full(len(data), -1)
        for t, camera in enumerate(data.intrinsics):
            if any(camera.lens):
                if camera not in known:
                    known[camera] = sum(len(table) for table in tables)
                    tables.append(camera.directions()[..., :2].reshape(-1, 2).astype(np.float32))
                self._table[t] = known[camera]
        self._distorted = np.concatenate(tables)

    def __len__(self) -> int:
        """Return the number of pixels."""
        return len(self.rgb)

    def sample(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Sample (count,) int64 pixel indices with replacement."""
        parts = [stratum.sample(int(stratum.share * count), rng) for stratum in self._strata.values()]
        rest = count - sum(len(part) for part in parts)
        pixels = rng.integers(len(self) if self._used is None else len(self._used), size=rest)
        return np.concatenate([*parts, pixels if self._used is None else self._used[pixels]])

    def learn_planes(self, pixels: np.ndarray, depth: np.ndarray) -> None:
        """Set the depth of (N,) pixels that show planes of the field, see :mod:`~autonerf_lab.nerf.planes`.

        Raises:
            DataError: there are no such pixels.
        """
        if len(pixels) and not 0 <= pixels.min() <= pixels.max() < len(self):
            raise DataError("the planes are those of other images; remove the checkpoint to start the training again")
        if self.depth is None:
            self.depth = np.full(len(self), NO_DEPTH, np.float32)
        self.depth[pixels] = depth
        if self._on_planes and len(pixels):
            self._strata["planes"] = _Stratum(self._on_planes, np.zeros(len(pixels), np.uint8), pixels, np.sqrt)

    def grid(self, views: int, per_view: int) -> np.ndarray:
        """Return (T, H, W) indices of a grid of pixels: at most ``views`` and ``per_view`` in each direction.

        All images must have the same size.
        """
        width, height = int(self._width[0]), int(self.first[1] // self._width[0])
        spacing, skipped = -(-max(width, height) // per_view), -(-len(self._width) // views)
        rows = np.arange(min(spacing // 2, height - 1), height, spacing)[:, None] * width
        return self.first[:-1:skipped, None, None] + rows + np.arange(min(spacing // 2, width - 1), width, spacing)

    def used(self, pixels: np.ndarray) -> np.ndarray:
        """Return (R,) bool: whether pixels are not masked."""
        return np.ones(len(pixels), bool) if self._used is None else np.isin(pixels, self._used)

    def spread(self, count: int) -> np.ndarray:
        """Return (count,) int64 indices of pixels without masked ones, evenly spaced; all if there are fewer."""
        total = len(self) if self._used is None else len(self._used)
        chosen = np.linspace(0, total - 1, min(count, total)).round().astype(np.int64)
        return chosen if self._used is None else self._used[chosen]

    def _of_used(self, layer: np.ndarray) -> np.ndarray:
        return layer if self._used is None else layer[self._used]

    def rays(self, pixels: np.ndarray) -> Rays:
        """Return the rays of (R,) pixels, in the coordinates of the field."""
        return self._rays_and_length(pixels)[0]

    def measured(self, pixels: np.ndarray) -> tuple[Rays, np.ndarray]:
        """Return the rays of (R,) pixels and their measured (R,) float32 distances, 0 for none."""
        assert self.depth is not None
        rays, length = self._rays_and_length(pixels)
        return rays, self.depth[pixels] * length.astype(np.float32) / np.float32(self.frame.unit)

    def _rays_and_length(self, pixels: np.ndarray) -> tuple[Rays, np.ndarray]:
        frames, directions = self._directions(pixels)
        length = np.linalg.norm(directions, axis=1)
        poses = self.poses[frames]
        unit = (directions / length[:, None]).astype(np.float32)
        rotated = np.einsum("rij,rj->ri", poses[:, :3, :3], unit)
        return Rays(np.ascontiguousarray(poses[:, :3, 3]), rotated, frames), length

    def targets(self, pixels: np.ndarray) -> Targets:
        """Return the ground truth of (R,) pixels."""
        color = self.rgb[pixels].astype(np.float32) / np.float32(255)
        labels, depth = np.full(len(pixels), NO_LABEL), np.full(len(pixels), NO_DEPTH, np.float32)
        if self.labels is not None:
            labels = self.labels[pixels].astype(np.int64)
        trust = None if self._confidence is None else self._confidence[pixels].astype(np.float32) / np.float32(255)
        if self.depth is not None:
            measured = self.depth[pixels]
            if trust is not None and self._label_distance:
                trust *= self._share_of_near(measured)
            depth = measured * self.length(pixels) / np.float32(self.frame.unit)
        return Targets(color, labels, depth, trust, self._importance(pixels))

    def _importance(self, pixels: np.ndarray) -> np.ndarray | None:
        """Return (R,) float32 weights of the colour loss, which undo that edges are sampled more often; None: 1."""
        if self._contrast is None:
            return None
        stratum = self._strata["contrast"]
        ratio = stratum.ratio[self._contrast[pixels]]
        return (1 / (1 - stratum.share + stratum.share * ratio)).astype(np.float32)

    def length(self, pixels: np.ndarray) -> np.ndarray:
        """Return (R,) float32: the distance along the ray of each pixel at which the depth is 1."""
        return np.linalg.norm(self._directions(pixels)[1], axis=1).astype(np.float32)

    def _share_of_near(self, depth: np.ndarray) -> np.ndarray:
        """Return the factor of the weights of labels at (R,) depths; missing depth counts as twice the distance."""
        relative = np.divide(depth, self._label_distance, out=np.full(len(depth), 2.0, np.float32), where=depth > 0)
        return np.maximum(relative, 1) ** -2

    def _directions(self, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the image (R,) and the direction (R, 3) float64 of pixels, in the camera frame with depth 1."""
        frames = np.searchsorted(self.first, pixels, side="right") - 1
        inside = pixels - self.first[frames]
        rows, columns = np.divmod(inside, self._width[frames])
        x, y = ((np.stack([columns, rows], axis=1) + 0.5 - self._center[frames]) / self._focal[frames]).T
        directions = np.stack([x, -y, -np.ones_like(x)], axis=1)
        distorted = self._table[frames] >= 0
        directions[distorted, :2] = self._distorted[self._table[frames[distorted]] + inside[distorted]]
        return frames, directions


class _Stratum:
    """A share of the sampled pixels that is drawn in groups: first a group, then uniformly one of its pixels.

    Args:
        share: share of the sampled pixels.
        group: (N,) group of each pixel that may be sampled, small integers.
        pixels: (N,) indices of these pixels; None if they are all.
        chances: returns the relative probabilities of the groups for their sizes.
    """

    def __init__(
        self, share: float, group: np.ndarray, pixels: np.ndarray | None, chances: Callable[[np.ndarray], np.ndarray]
    ) -> None:
        self.share = share
        order: np.ndarray = np.argsort(group, kind="stable").astype(np.int32)
        self._pixels = order if pixels is None else pixels[order]
        self._sizes = np.bincount(group)
        self._first = np.cumsum(self._sizes) - self._sizes
        cumulative = np.cumsum(chances(self._sizes))
        self._cumulative = cumulative / cumulative[-1]
        # Of each group: the probability of a pixel, divided by that in uniform sampling.
        self.ratio = np.diff(self._cumulative, prepend=0) * len(group) / np.maximum(self._sizes, 1)

    def sample(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Sample (count,) pixel indices."""
        groups = np.searchsorted(self._cumulative, rng.random(count), side="right")
        inside = (rng.random(count) * self._sizes[groups]).astype(np.int64)
        return self._pixels[self._first[groups] + inside]


def _contrast(image: np.ndarray) -> np.ndarray:
    """Return (H, W) uint8 sums of the differences in brightness to the right and lower neighbours of (H, W, 3)."""
    brightness = image.sum(axis=2, dtype=np.int16) // 3
    contrast = np.zeros_like(brightness)
    contrast[:, :-1] += np.abs(np.diff(brightness, axis=1))
    contrast[:-1] += np.abs(np.diff(brightness, axis=0))
    return np.minimum(contrast, 255).astype(np.uint8)


def _flat(layers: list[np.ndarray] | None) -> np.ndarray | None:
    return None if layers is None else np.concatenate([layer.reshape(-1) for layer in layers])
