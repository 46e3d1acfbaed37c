"""Baseline for semantics: Bayesian fusion of the frames' labels in a point cloud, without a field.

Each pixel of the trajectory with depth votes in the voxel of its surface point. With confidence c for its label and the
rest of the probability spread over the other classes, the log-likelihood of its label exceeds that of the others by
``log(c (K - 1) / (1 - c))``; the logs are summed over all frames as if these were independent (naive Bayes), and the
label of a voxel is the class with the largest sum. A view takes colours and depth from the field, and at each pixel the
label of the nearest voxel. So the two differ in nothing but the fusion of labels.
"""

import numpy as np
from scipy.spatial import cKDTree

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import DataError
from autonerf_lab.evaluators.radiance_field import RadianceField
from autonerf_lab.geometry import Intrinsics, camera_rays
from autonerf_lab.types import Rendering

VOXEL = 0.04  # metres
REACH = 0.15  # metres; a surface without a voxel nearby is background
FAR = 6.0  # metres; depth beyond is not fused, because the pixels are larger than the voxels
STRIDE = 2  # pixels between two that vote
_CERTAIN = 0.95  # largest confidence of one frame: errors of neighbouring frames are not independent


class FusedLabels:
    """Radiance field with the labels of a point cloud; only ``render`` differs from the field.

    Args:
        field: gives colours and depth.
        trajectory: with depth, predicted labels and confidences.

    Raises:
        DataError: the trajectory has no depth or no confidences.
    """

    def __init__(self, field: RadianceField, trajectory: Trajectory) -> None:
        self.field, self.meta, self.poses, self.intrinsics = field, field.meta, field.poses, field.intrinsics
        self.frame = field.frame
        if trajectory.depth is None or trajectory.semantics is None or trajectory.confidence is None:
            raise DataError("fusion of labels needs a trajectory with depth, predicted labels and confidences")
        points, labels, confidence = _points(trajectory)
        centers, votes = fuse(points, labels, confidence)
        self._labels, self._tree = votes.argmax(axis=1).astype(np.uint8), cKDTree(centers)

    def render(self, c2w: np.ndarray, intrinsics: Intrinsics) -> Rendering:
        """Render the field and label each pixel by the nearest voxel."""
        image = self.field.render(c2w, intrinsics)
        rays_o, rays_d = camera_rays(intrinsics, c2w)
        points = rays_o + rays_d * np.asarray(image.depth)[..., None]
        distance, index = self._tree.query(points.reshape(-1, 3), distance_upper_bound=REACH)
        labels = np.append(self._labels, 0)[np.where(np.isfinite(distance), index, len(self._labels))]
        return Rendering(image.rgb, image.depth, labels.astype(np.uint8).reshape(image.depth.shape), image.opacity)


def fuse(points: np.ndarray, labels: np.ndarray, confidence: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sum the log-likelihoods of labels in voxels.

    Args:
        points: (N, 3) surface points, metres.
        labels: (N,) uint8, class index.
        confidence: (N,) in [0, 1].

    Returns:
        (V, 3) centres of the voxels with a point, and (V, 16) sums, relative to a uniform distribution.

    Example:
        >>> points = np.zeros((3, 3)) + 0.01
        >>> centers, votes = fuse(points, np.array([1, 2, 2]), np.array([0.9, 0.6, 0.6]))
        >>> votes[0, 1:3].round(2).tolist()  # log(0.9 * 15 / 0.1), 2 log(0.6 * 15 / 0.4)
        [4.91, 6.23]
    """
    grid = np.floor(points / VOXEL).astype(np.int64)
    low = grid.min(axis=0)
    shape = grid.max(axis=0) - low + 1
    # one number per voxel: sorting triples takes ten times as long
    numbers, voxel = np.unique(np.ravel_multi_index(tuple((grid - low).T), tuple(shape)), return_inverse=True)
    cells = np.stack(np.unravel_index(numbers, tuple(shape)), axis=1) + low
    c = np.clip(confidence, 1 / NUM_CLASSES, _CERTAIN)
    gain = np.log(c * (NUM_CLASSES - 1) / (1 - c))
    index = voxel.ravel() * NUM_CLASSES + labels
    votes = np.bincount(index, gain, minlength=len(cells) * NUM_CLASSES).reshape(-1, NUM_CLASSES)
    return (cells + 0.5) * VOXEL, votes


def _points(trajectory: Trajectory) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    assert trajectory.depth is not None and trajectory.semantics is not None and trajectory.confidence is not None
    pixels = np.s_[::STRIDE, ::STRIDE]
    points, labels, confidence = [], [], []
    for t, c2w in enumerate(trajectory.poses):
        rays_o, rays_d = camera_rays(trajectory.intrinsics, c2w)
        depth = trajectory.depth[t][pixels]
        known = (depth > 0) & (depth < FAR)
        points.append((rays_o[pixels] + depth[..., None] * rays_d[pixels])[known].astype(np.float32))
        labels.append(trajectory.semantics[t][pixels][known])
        confidence.append(trajectory.confidence[t][pixels][known].astype(np.float32) / 255)
    return np.concatenate(points), np.concatenate(labels), np.concatenate(confidence)
