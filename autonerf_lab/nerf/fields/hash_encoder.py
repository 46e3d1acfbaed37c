"""Hash encoding of points on rays for the CPU, shared by the hash field and the proposal sampler."""

import numpy as np

from autonerf_lab.nerf.hash_grid import HashGrid
from autonerf_lab.nerf.kernels import volume_rendering
from autonerf_lab.nerf.kernels.hash_encoding import hash_encode, hash_encode_backward, hash_encode_points_backward
from autonerf_lab.nerf.kernels.tiling import TILE_RAYS
from autonerf_lab.nerf.ray_batch import Rays
from autonerf_lab.nerf.scene_box import SceneBox

TABLE_INIT = 1e-2  # initial table values are uniform in [-TABLE_INIT, TABLE_INIT]
TILE_POINTS = 128  # points that are encoded and evaluated together, outside of rays


def encoded_size(levels: int) -> int:
    """Return the number of encoded features, two for each level, rounded up to the multiple of 4 that kernels take.

    The features that fill up are 0, and so are their weights and gradients.

    Example:
        >>> encoded_size(4), encoded_size(5)
        (8, 12)
    """
    return -(-2 * levels // 4) * 4


def he_uniform(shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Return initial weights (outputs, inputs) of a layer without bias before a ReLU (He et al. 2015)."""
    bound = np.sqrt(6 / max(shape[1], 1))
    return rng.uniform(-bound, bound, shape).astype(np.float32)


def first_layer(units: int, levels: int, rng: np.random.Generator) -> np.ndarray:
    """Return initial weights (units, E) of a layer on encoded features; those of features that fill up are 0."""
    return np.pad(he_uniform((units, 2 * levels), rng), ((0, 0), (0, encoded_size(levels) - 2 * levels)))


class Buffers:
    """Scratch arrays that are reused between steps, because allocating fresh pages is slower than the work on them."""

    def __init__(self) -> None:
        self._arrays: dict[str, np.ndarray] = {}

    def __call__(self, name: str, *shape: int) -> np.ndarray:
        """Return the float32 array of a name, with its previous content; zeros after a change of shape."""
        found = self._arrays.get(name)
        if found is None or found.shape != shape:
            found = self._arrays[name] = np.zeros(shape, np.float32)
        return found


class HashEncoder:
    """Hash encoding of bin midpoints with one table; features come in tiles of TILE_RAYS rays.

    E is the number of features, :func:`encoded_size`.

    Args:
        grid: layout of the table.
        box: contracts the world into the unit cube.
        table: (entries, 2) float32.
    """

    def __init__(self, grid: HashGrid, box: SceneBox, table: np.ndarray) -> None:
        self.grid, self.box, self.table = grid, box, table
        self._layout = grid.offsets, grid.resolutions, grid.masks
        self._buffer = Buffers()

    def __call__(self, rays: Rays, midpoints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Encode the points at distances (R, S) on whole tiles of rays.

        Returns:
            contracted points (3, R S), and features (R / TILE_RAYS, E, TILE_RAYS S). The next call reuses both.
        """
        count, samples = midpoints.shape
        x = self._buffer("x", 3, count * samples)
        box = self.box
        volume_rendering.ray_points(
            rays.origins, rays.directions, midpoints, box.center, box.half, np.float32(box.shell), x
        )
        enc = self._buffer("enc", count // TILE_RAYS, encoded_size(len(self.grid.offsets)), TILE_RAYS * samples)
        enc[:, 2 * len(self.grid.offsets) :] = 0  # a batch that is not finite leaves NaN in the padding
        hash_encode(x, self.table, *self._layout, enc)
        return x, enc

    def points(self, points: np.ndarray) -> np.ndarray:
        """Encode (N, 3) points: (B, E, :data:`TILE_POINTS`) features, the last tile padded."""
        box, tiles = self.box, -(-len(points) // TILE_POINTS)
        x = np.empty((3, tiles * TILE_POINTS), np.float32)
        points = np.ascontiguousarray(points, np.float32)
        volume_rendering.contracted_points(points, box.center, box.half, np.float32(box.shell), x)
        enc = np.zeros((tiles, encoded_size(len(self.grid.offsets)), TILE_POINTS), np.float32)
        hash_encode(x, self.table, *self._layout, enc)
        return enc

    def table_gradient(self, x: np.ndarray, d_enc: np.ndarray) -> np.ndarray:
        """Return the gradient of the table, in a buffer that the optimiser clears after use."""
        gradient = self._buffer("gradient", *self.table.shape)
        hash_encode_backward(x, d_enc, *self._layout, gradient)
        return gradient

    def ray_gradient(self, rays: Rays, midpoints: np.ndarray, x: np.ndarray, d_enc: np.ndarray) -> tuple:
        """Return the gradients (R, 3) of origins and directions, with the distances held fixed."""
        d_x, d_o, d_d = np.empty_like(x), np.empty_like(rays.origins), np.empty_like(rays.directions)
        hash_encode_points_backward(x, self.table, d_enc, *self._layout, d_x)
        box = self.box
        volume_rendering.ray_points_backward(
            rays.origins, rays.directions, midpoints, box.center, box.half, np.float32(box.shell), d_x, d_o, d_d
        )
        return d_o, d_d
