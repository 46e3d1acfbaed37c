"""Visual concepts: clusters of hand-crafted image descriptors."""

import numpy as np
from PIL import Image

from autonerf_lab.rewards.learner import State
from autonerf_lab.types import Observation

CONCEPTS = 50
SIDE = 84  # pixels a side of the resized image
GRID = 4  # parts of the image along each side
ORIENTATIONS = 8
FAR = 5.0  # metres; larger depths are clipped
DESCRIPTOR = GRID**2 * (3 + ORIENTATIONS + 1)


def describe(observation: Observation) -> np.ndarray:
    """Describe an image by mean color, mean depth and edge orientations of its 4 x 4 parts.

    Colors are brightness and two opponent axes (red - green, blue - yellow). Orientations are weighted by gradient
    magnitude (histograms of oriented gradients, Dalal and Triggs 2005). The descriptors of black images differ only in
    depth.

    Returns:
        (192,) float32.
    """
    size = (SIDE, SIDE)
    rgb = np.asarray(Image.fromarray(observation.rgb).resize(size, Image.Resampling.BILINEAR), np.float32) / 255
    depth = Image.fromarray(np.minimum(observation.depth, np.float32(FAR)) / np.float32(FAR))
    r, g, b = rgb[..., 0], rgb[..., 1], rgb[..., 2]
    light = (r + g + b) / 3
    planes = np.stack([light, (r - g) / 2, b / 2 - (r + g) / 4, np.asarray(depth.resize(size))])
    part = SIDE // GRID
    layout = planes.reshape(4, GRID, part, GRID, part).mean(axis=(2, 4))
    down, right = np.gradient(light)
    angle = np.arctan2(down, right) % np.pi
    bins = np.minimum((angle * (ORIENTATIONS / np.pi)).astype(np.int64), ORIENTATIONS - 1)
    parts = np.arange(SIDE) // part
    where = (parts[:, None] * GRID + parts) * ORIENTATIONS + bins
    edges = np.bincount(where.ravel(), np.hypot(down, right).ravel(), GRID**2 * ORIENTATIONS)
    return np.concatenate([layout.ravel(), edges / (np.linalg.norm(edges) + 1e-3)]).astype(np.float32)


class Concepts:
    """50 clusters of descriptors by mini-batch k-means (Sculley 2010, "Web-Scale K-Means Clustering").

    Args:
        seed: random seed of the order of the descriptors.
    """

    def __init__(self, seed: int) -> None:
        self._centres = np.zeros((CONCEPTS, DESCRIPTOR), np.float32)
        self._counts = np.zeros(CONCEPTS, np.int64)  # descriptors of each cluster; 0 = no centre yet
        self._spread = np.zeros(2)  # sum of squared distances to the nearest centre, and their count
        self._seed = seed

    @property
    def known(self) -> bool:
        """True if all clusters have a centre."""
        return bool(self._counts.all())

    @property
    def prior(self) -> np.ndarray:
        """Frequency of each concept, (50,) float32."""
        return ((self._counts + 1) / (self._counts + 1).sum()).astype(np.float32)

    def learn(self, descriptors: np.ndarray) -> None:
        """Move the centres towards descriptors (N, 192), with a step of 1 / count."""
        rng = np.random.default_rng((self._seed, int(self._counts.sum())))
        for descriptor in rng.permutation(descriptors):
            placed = int(np.count_nonzero(self._counts))
            distances = np.square(self._centres[:placed] - descriptor).sum(axis=1)
            if placed < CONCEPTS:
                if not placed or distances.min() > 0:
                    self._centres[placed] = descriptor
                    self._counts[placed] = 1
                continue
            nearest = int(distances.argmin())
            self._counts[nearest] += 1
            self._centres[nearest] += (descriptor - self._centres[nearest]) / self._counts[nearest]
            self._spread += distances[nearest], 1

    def probabilities(self, descriptors: np.ndarray) -> np.ndarray:
        """Return the softmax of negative squared distances of descriptors (..., 192): (..., 50) float32."""
        scale = self._spread[0] / self._spread[1] if self._spread[1] else 1.0
        squares = np.square(self._centres).sum(axis=1) - 2 * descriptors @ self._centres.T
        shares = np.exp((squares.min(axis=-1, keepdims=True) - squares) * np.float32(2 / (scale + 1e-6)))
        return np.asarray(shares / shares.sum(axis=-1, keepdims=True), np.float32)

    def state_dict(self) -> State:
        """Return centres, counts, spread and seed."""
        return {
            "centres": self._centres.copy(),
            "counts": self._counts.copy(),
            "spread": self._spread.copy(),
            "seed": np.array(self._seed),
        }

    def load_state_dict(self, state: State) -> None:
        """Load a state of :meth:`state_dict`."""
        self._centres, self._counts, self._spread = (np.array(state[k]) for k in ("centres", "counts", "spread"))
        self._seed = int(state["seed"])
