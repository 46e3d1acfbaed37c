"""Visual concepts: what kinds of views there are, found in descriptors that need no training."""

import numpy as np
from PIL import Image

from autonerf_lab.rewards.learner import State
from autonerf_lab.types import Observation

CONCEPTS = 50
SIDE = 84  # pixels a side of what is described
GRID = 4  # parts of the image along each side
ORIENTATIONS = 8
FAR = 5.0  # metres; depth is cut there
DESCRIPTOR = GRID**2 * (3 + ORIENTATIONS + 1)


def describe(observation: Observation) -> np.ndarray:
    """Coarse layout of colours and depth, and orientations of edges, over 4 x 4 parts of the image.

    Colours are a brightness and two opponent axes (red - green, blue - yellow). Orientations are weighted by the
    contrast of the edge (histograms of gradients, Dalal and Triggs 2005). A black image is told from others by its
    depth alone.

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
    """50 clusters of descriptors, learned in mini-batches (Sculley 2010, "Web-Scale K-Means Clustering").

    Args:
        seed: of which descriptors the clusters begin at.
    """

    def __init__(self, seed: int) -> None:
        self._centres = np.zeros((CONCEPTS, DESCRIPTOR), np.float32)
        self._counts = np.zeros(CONCEPTS, np.int64)  # descriptors that fell to each; 0 = it has no place yet
        self._spread = np.zeros(2)  # sum of the squared distances to the nearest centre, and of how many
        self._seed = seed

    @property
    def known(self) -> bool:
        """Whether all of them have a place."""
        return bool(self._counts.all())

    @property
    def prior(self) -> np.ndarray:
        """(50,) float32, how frequent each is."""
        return ((self._counts + 1) / (self._counts + 1).sum()).astype(np.float32)

    def learn(self, descriptors: np.ndarray) -> None:
        """Move the centres towards descriptors (N, 192), each the less the more it has seen."""
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

    def of(self, descriptors: np.ndarray) -> np.ndarray:
        """Shares of the concepts in descriptors (..., 192): a softmax of squared distances, (..., 50) float32."""
        scale = self._spread[0] / self._spread[1] if self._spread[1] else 1.0
        squares = np.square(self._centres).sum(axis=1) - 2 * descriptors @ self._centres.T
        shares = np.exp((squares.min(axis=-1, keepdims=True) - squares) * np.float32(2 / (scale + 1e-6)))
        return np.asarray(shares / shares.sum(axis=-1, keepdims=True), np.float32)

    def state_dict(self) -> State:
        """Centres, counts, spread and seed."""
        return {
            "centres": self._centres.copy(),
            "counts": self._counts.copy(),
            "spread": self._spread.copy(),
            "seed": np.array(self._seed),
        }

    def load_state_dict(self, state: State) -> None:
        """Go on from there."""
        self._centres, self._counts, self._spread = (np.array(state[k]) for k in ("centres", "counts", "spread"))
        self._seed = int(state["seed"])
