"""Bundle adjustment of range images: all poses at once, by Gauss-Newton steps on distances between surfaces.

The residuals are those of :mod:`.kernels` between pairs of overlapping frames, and the differences from the rough
relative motions (:mod:`.motion_prior`), whose standard deviation is estimated on the way. The largest distance that
counts shrinks from step to step, and overlapping frames are searched again as the drift vanishes.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import bsr_matrix
from scipy.sparse.linalg import LinearOperator, cg
from scipy.spatial.transform import Rotation
from tqdm.auto import tqdm

from autonerf_lab.bundle_adjustment.kernels import ROW, overlap, register
from autonerf_lab.bundle_adjustment.motion_prior import (
    FIRST_SIGMAS,
    chain_covariances,
    cross_matrix,
    estimate_sigmas,
    motion_equations,
    motion_errors,
)
from autonerf_lab.bundle_adjustment.range_images import RangeImages
from autonerf_lab.errors import DataError

PLANAR = np.array([0, 1, 5])  # x, y and heading among translation and rotation vector
SPATIAL = np.arange(6)
SHARED_NOISE = 0.1  # weight of the pairs: one measured point is compared with many frames, with the same error
# Calibration of the covariances, on training apartments: frames of a room share errors of its surfaces. The information
# of a frame counts less, and positions have a common error, in metres.
KNOWN_SURFACES = 1 / 30
SHARED_ERROR = 0.0025
LEAST_OVERLAP = 0.15  # of the sampled points of a frame, for a pair
LEAST_VIEWS = 0.1  # share of the views that must overlap with another
# Standard deviations of the measurements: of distances (metres, and metres per squared metre of depth), of brightness.
DISTANCE_NOISE = np.array([0.005, 0.001])
BRIGHTNESS_NOISE = 0.02
_ANCHOR = 1e8  # information that holds the first pose


@dataclass(frozen=True)
class Stage:
    """Gauss-Newton steps with one choice of pairs."""

    gates: tuple[float, ...]  # largest distance of each step, metres
    neighbours: int  # of each frame
    stride: int  # pixels


STAGES = (
    Stage((0.4, 0.4, 0.3, 0.3), 12, 3),
    Stage((0.2, 0.2, 0.1, 0.1), 12, 3),
    Stage((0.1, 0.05, 0.05, 0.05), 16, 2),
)
_BRIGHTNESS_GATE = 0.2  # metres; brightness is compared once surfaces are this close


@dataclass(frozen=True)
class Adjusted:
    """Result of :func:`adjust`."""

    poses: np.ndarray  # (T, 4, 4) float64 camera-to-world; the first is that of the rough poses
    covariances: np.ndarray  # (T, k, k) of (x, y, heading), or of translation and rotation vector; metres, radians


def adjust(
    images: RangeImages,
    rough: np.ndarray,
    planar: bool,
    rng: np.random.Generator,
    progress: bool = False,
) -> Adjusted:
    """Adjust the poses of range images.

    Args:
        images: of T frames.
        rough: (T, 4, 4) camera-to-world, with errors of up to about 0.3 m and 5 degrees between frames that overlap.
        planar: move cameras along x and y and turn them about z only.
        rng: choice of pairs.
        progress: show a progress bar.

    Raises:
        DataError: too few views overlap.
    """
    axes = PLANAR if planar else SPATIAL
    poses, sigmas = rough.copy(), FIRST_SIGMAS
    total = sum(len(stage.gates) for stage in STAGES)
    with tqdm(total=total, disable=not progress, desc="refine poses", unit="step") as bar:
        for stage in STAGES:
            pairs = choose_pairs(images, poses, stage.neighbours, stage.gates[0], rng)
            for gate in stage.gates:
                rows = np.empty((len(pairs), ROW))
                register(
                    pairs, poses, images.camera, images.surface, images.normals, images.brightness, stage.stride, gate,
                    DISTANCE_NOISE, BRIGHTNESS_NOISE if gate <= _BRIGHTNESS_GATE else 0.0, rows,
                )  # fmt: skip
                equations = Equations(len(poses), axes)
                equations.add_pairs(pairs, SHARED_NOISE * rows, poses)
                own = equations.diagonal.copy()
                steps = equations.add_motions(*motion_equations(poses, rough, sigmas))
                poses = moved(poses, equations.solve(), axes)
                bar.update()
            sigmas = estimate_sigmas(motion_errors(poses, rough), planar)
    covariances = chain_covariances(KNOWN_SURFACES * own, steps)
    return Adjusted(poses, covariances + np.diag(SHARED_ERROR**2 * (axes < 3)))


class Equations:
    """Normal equations of the small motions of T frames: a sparse matrix of k x k blocks.

    Args:
        frames: T.
        axes: (k,) the components of the 6-vectors that may change.
    """

    def __init__(self, frames: int, axes: np.ndarray) -> None:
        self.axes, k = axes, len(axes)
        self.diagonal, self.gradient = np.zeros((frames, k, k)), np.zeros((frames, k))
        self._pairs: list[np.ndarray] = []
        self._blocks: list[np.ndarray] = []

    def add_pairs(self, pairs: np.ndarray, rows: np.ndarray, poses: np.ndarray) -> None:
        """Add the normal equations that :func:`~.kernels.register` wrote for pairs of frames.

        A row holds those of the first frame of a pair. A motion of the second frame has the opposite effect about its
        own centre, so that its Jacobian is the same times a matrix.
        """
        matrix = np.zeros((len(pairs), 6, 6))
        upper = np.triu_indices(6)
        matrix[:, upper[0], upper[1]] = rows[:, :21]
        matrix[:, upper[1], upper[0]] = rows[:, :21]
        opposite = np.tile(-np.eye(6), (len(pairs), 1, 1))
        opposite[:, 3:, :3] = -cross_matrix(poses[pairs[:, 0], :3, 3] - poses[pairs[:, 1], :3, 3])
        mixed = matrix @ np.swapaxes(opposite, 1, 2)
        self._add(pairs, matrix, mixed, opposite @ mixed, rows[:, 21:], np.einsum("nab,nb->na", opposite, rows[:, 21:]))

    def add_motions(self, matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
        """Add the normal equations of the motions between consecutive frames; return them without fixed components."""
        frames = np.arange(len(matrix))
        pairs = np.stack([frames, frames + 1], axis=1)
        self._add(
            pairs, matrix[:, :6, :6], matrix[:, :6, 6:], matrix[:, 6:, 6:], vector[:, :6], vector[:, 6:]
        )  # fmt: skip
        both = np.concatenate([self.axes, 6 + self.axes])
        return matrix[:, both[:, None], both]

    def _add(
        self,
        pairs: np.ndarray,
        first: np.ndarray,
        mixed: np.ndarray,
        second: np.ndarray,
        to_first: np.ndarray,
        to_second: np.ndarray,
    ) -> None:
        chosen = (slice(None), self.axes[:, None], self.axes)
        for frames, block, vector in ((pairs[:, 0], first, to_first), (pairs[:, 1], second, to_second)):
            np.add.at(self.diagonal, frames, block[chosen])
            np.add.at(self.gradient, frames, vector[:, self.axes])
        self._pairs.append(pairs)
        self._blocks.append(mixed[chosen])

    def solve(self) -> np.ndarray:
        """Return the (T, k) Gauss-Newton step that leaves the first frame where it is, by conjugate gradients."""
        count, k = self.gradient.shape
        diagonal = self.diagonal.copy()
        diagonal[0] += _ANCHOR * np.eye(k)
        first, second = np.concatenate(self._pairs).T
        mixed = np.concatenate(self._blocks)
        rows = np.concatenate([np.arange(count), first, second])
        columns = np.concatenate([np.arange(count), second, first])
        blocks = np.concatenate([diagonal, mixed, np.swapaxes(mixed, 1, 2)])
        order = np.argsort(rows, kind="stable")
        starts = np.searchsorted(rows[order], np.arange(count + 1))
        matrix = bsr_matrix((blocks[order], columns[order], starts), shape=(count * k, count * k))
        inverse = np.linalg.inv(diagonal)

        def precondition(vector: np.ndarray) -> np.ndarray:
            return np.einsum("tab,tb->ta", inverse, vector.reshape(count, k)).ravel()

        step, _ = cg(
            matrix, -self.gradient.ravel(), rtol=1e-3, maxiter=500, M=LinearOperator(matrix.shape, precondition)
        )
        return step.reshape(count, k)


def moved(poses: np.ndarray, steps: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Return (T, 4, 4) poses after small motions (T, k): translations, and rotations about the camera centres.

    Example:
        >>> moved(np.eye(4)[None], np.array([[1.0, 2.0, np.pi / 2]]), PLANAR)[0].round(6) + 0
        array([[ 0., -1.,  0.,  1.],
               [ 1.,  0.,  0.,  2.],
               [ 0.,  0.,  1.,  0.],
               [ 0.,  0.,  0.,  1.]])
    """
    full = np.zeros((len(poses), 6))
    full[:, axes] = steps
    after = poses.copy()
    after[:, :3, 3] += full[:, :3]
    after[:, :3, :3] = Rotation.from_rotvec(full[:, 3:]).as_matrix() @ poses[:, :3, :3]
    return after


def choose_pairs(
    images: RangeImages, poses: np.ndarray, neighbours: int, tolerance: float, rng: np.random.Generator
) -> np.ndarray:
    """Choose pairs of frames that see the same surfaces, at random, those that share more of them more often.

    Args:
        images: of T frames.
        poses: (T, 4, 4).
        neighbours: number of pairs of each frame, fewer if fewer overlap.
        tolerance: largest distance of a shared surface, metres.
        rng: random generator.

    Returns:
        (P, 2) int64: points of the first frame lie on surfaces of the second.

    Raises:
        DataError: too few views overlap.
    """
    height, width = images.surface.shape[1:]
    rows, columns = np.meshgrid(np.arange(3, height, 7), np.arange(3, width, 7), indexing="ij")
    points = np.stack([rows.ravel(), columns.ravel()], axis=1)
    shared = np.zeros((len(images), len(images)), np.int16)
    overlap(poses, images.camera, images.surface, images.normals, points, tolerance, shared)
    np.fill_diagonal(shared, 0)
    # The smallest exponential variates, divided by the weights, are a weighted sample without replacement.
    keys = rng.standard_exponential(shared.shape, dtype=np.float32) / np.maximum(shared, 1)
    keys[shared < max(3, LEAST_OVERLAP * len(points))] = np.inf
    count = min(neighbours, len(images) - 1)
    chosen = np.argpartition(keys, count - 1, axis=1)[:, :count]
    frames = np.repeat(np.arange(len(images)), count)
    pairs = np.stack([frames, chosen.ravel()], axis=1)
    pairs = pairs[np.isfinite(keys[pairs[:, 0], pairs[:, 1]])]
    views = len(np.unique(pairs))
    if views < max(2, LEAST_VIEWS * len(images)):
        raise DataError(
            f"{views} of {len(images)} views overlap with another one at their rough poses, too few to refine them; "
            "add views of the same surfaces with depth, or better rough poses"
        )
    return pairs
