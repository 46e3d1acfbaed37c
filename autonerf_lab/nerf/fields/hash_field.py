"""Hash encoding and small networks (section 3.2), in fused numba kernels.

The paper's symbols::

    x~ = h(x)                       hash encoding                   table
    phi~ = sh(phi)                  spherical harmonics             encodings.spherical_harmonics
    e                               appearance embedding            appearance
    (sigma, h_d) = f_d(x~)          density network                 density_0, density_1
    s = f_s(h_d)                    semantic network                semantic_0, semantic_1
    c = f_c(h_d, phi~, e)           colour network                  color_geometry, color_ray, color_1, color_2

This file holds the parameters and the order of the work; the work itself is in :mod:`autonerf_lab.nerf.kernels`, and
the same in torch in :mod:`autonerf_lab.nerf.fields.torch_hash_field`.
"""

import numpy as np
import torch

from autonerf_lab.nerf.encodings import HashGrid, spherical_harmonics
from autonerf_lab.nerf.kernels import fused, volume_rendering
from autonerf_lab.nerf.kernels.hash_encoding import hash_encode, hash_encode_backward, hash_encode_points_backward
from autonerf_lab.nerf.kernels.tiling import BLOCK_RAYS, CHUNKS, GEOMETRY
from autonerf_lab.nerf.ray_batch import NO_LABEL, Arrays, Learned, Rays, Rendered, Samples, Targets
from autonerf_lab.nerf.scene_box import SceneBox
from autonerf_lab.nerf.settings import HashSettings

MATRICES = (
    "density_0",
    "density_1",
    "color_geometry",
    "color_ray",
    "color_1",
    "color_2",
    "semantic_0",
    "semantic_1",
)
HARMONICS = 16
TABLE_START = 1e-2  # half the range of a table's initial values


def build_grid(settings: HashSettings, box: SceneBox) -> HashGrid:
    """The layout of the field's table."""
    return HashGrid.build(box.size, settings.coarse, settings.fine, settings.levels, settings.log2_entries)


def initial_parameters(
    settings: HashSettings, grid: HashGrid, frames: int, classes: int, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Random values, the same for kernels and torch; without classes there is no semantic network."""
    s = settings
    semantic = s.hidden if classes else 0
    shapes = {
        "density_0": (s.hidden, 2 * s.levels),
        "density_1": (GEOMETRY, s.hidden),
        "color_geometry": (s.hidden, GEOMETRY),
        "color_ray": (s.hidden, HARMONICS + s.appearance),
        "color_1": (s.hidden, s.hidden),
        "color_2": (4, s.hidden),
        "semantic_0": (semantic, GEOMETRY),
        "semantic_1": (classes, semantic),
    }
    parameters = {name: he_uniform(shape, rng) for name, shape in shapes.items()}
    parameters["color_2"][3] = 0  # the fourth row only fills the block
    parameters["table"] = rng.uniform(-TABLE_START, TABLE_START, (grid.entries, 2)).astype(np.float32)
    parameters["appearance"] = np.zeros((frames, s.appearance), np.float32)
    return parameters


def he_uniform(shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Initial weights (outputs, inputs) of a layer without bias before a relu (He et al. 2015)."""
    bound = np.sqrt(6 / max(shape[1], 1))
    return rng.uniform(-bound, bound, shape).astype(np.float32)


class Buffers:
    """Scratch memory that is kept between steps: fresh pages cost more than the work done on them."""

    def __init__(self) -> None:
        self._arrays: dict[str, np.ndarray] = {}

    def __call__(self, name: str, *shape: int) -> np.ndarray:
        """A float32 array with whatever was left in it, zeros at first."""
        found = self._arrays.get(name)
        if found is None or found.shape != shape:
            found = self._arrays[name] = np.zeros(shape, np.float32)
        return found


class Encoder:
    """Hash encoding of the middles of bins, with one table; features come in blocks of BLOCK_RAYS rays."""

    def __init__(self, grid: HashGrid, box: SceneBox, table: np.ndarray) -> None:
        self.grid, self.box, self.table = grid, box, table
        self._layout = grid.offsets, grid.resolutions, grid.masks
        self._buffer = Buffers()

    def __call__(self, rays: Rays, middles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Contracted points (3, R S) and features (R / BLOCK_RAYS, 2 L, BLOCK_RAYS S) for distances (R, S)."""
        count, samples = middles.shape
        x = self._buffer("x", 3, count * samples)
        box = self.box
        volume_rendering.ray_points(
            rays.origins, rays.directions, middles, box.center, box.half, np.float32(box.shell), x
        )
        enc = self._buffer("enc", count // BLOCK_RAYS, 2 * len(self.grid.offsets), BLOCK_RAYS * samples)
        hash_encode(x, self.table, *self._layout, enc)
        return x, enc

    def points(self, points: np.ndarray, width: int = 128) -> np.ndarray:
        """(N, 3) world points -> (B, 2 L, width) features, the last block filled up with anything."""
        x = self.box.contract(points)
        blocks = -(-len(x) // width)
        x = np.ascontiguousarray(np.concatenate([x, np.zeros((blocks * width - len(x), 3), np.float32)]).T)
        enc = np.empty((blocks, 2 * len(self.grid.offsets), width), np.float32)
        hash_encode(x, self.table, *self._layout, enc)
        return enc

    def table_gradient(self, x: np.ndarray, d_enc: np.ndarray) -> np.ndarray:
        """Gradient of the table, in a buffer that the optimiser clears after use."""
        gradient = self._buffer("gradient", *self.table.shape)
        hash_encode_backward(x, d_enc, *self._layout, gradient)
        return gradient

    def ray_gradient(self, rays: Rays, middles: np.ndarray, x: np.ndarray, d_enc: np.ndarray) -> tuple:
        """Gradients (R, 3) of origins and directions, the distances held fixed."""
        d_x, d_o, d_d = np.empty_like(x), np.empty_like(rays.origins), np.empty_like(rays.directions)
        hash_encode_points_backward(x, self.table, d_enc, *self._layout, d_x)
        box = self.box
        volume_rendering.ray_points_backward(
            rays.origins, rays.directions, middles, box.center, box.half, np.float32(box.shell), d_x, d_o, d_d
        )
        return d_o, d_d


class HashField:
    """The field of Semantic Nerfacto and of Instant-NGP, on this machine's cores.

    Args:
        settings: sizes and loss weights.
        box: where the scene is.
        frames: number of training images, for the appearance embedding.
        classes: number of classes, 0 for a field without semantics.
        rng: initial values.
    """

    def __init__(
        self, settings: HashSettings, box: SceneBox, frames: int, classes: int, rng: np.random.Generator
    ) -> None:
        self.settings = settings
        grid = build_grid(settings, box)
        values = initial_parameters(settings, grid, frames, classes, rng)
        self.parameters: Arrays = dict(values)
        self._values = values
        self._encoder = Encoder(grid, box, values["table"])
        self._buffer = Buffers()

    def train(
        self, rays: Rays, samples: Samples, targets: Targets, rng: np.random.Generator, rays_too: bool
    ) -> Learned:
        s, count = self.settings, len(rays)
        # a random colour behind the last bin: a field that stays transparent is never right
        background = rng.random((count, 3), dtype=np.float32)
        scales = np.array(
            [
                1 / (3 * count),
                s.semantic_weight / count,
                s.distortion_weight / count,
                s.turn,
                s.min_weight,
                s.depth_weight / count,
            ],
            np.float32,
        )
        x, enc, d_features, weights, _, sums, gradients = self._forward_backward(
            rays, samples, targets, background, scales, True
        )
        squared, entropy, spread, correct, depth_error = sums.sum(axis=0) / count
        losses = {"mse": squared / 3, "distortion": spread}
        if len(gradients["semantic_1"]):
            losses |= {"cross_entropy": entropy, "class_accuracy": correct}
        if s.depth_weight:
            losses["depth"] = depth_error
        found: Arrays = dict(gradients)
        if s.appearance and rays.frames is not None:
            found["appearance"] = np.zeros_like(self._values["appearance"])
            d_appearance = d_features.transpose(0, 2, 1).reshape(count, -1)[:, HARMONICS:]
            np.add.at(found["appearance"], rays.frames, d_appearance)
        d_rays = self._ray_gradient(rays, samples, x, enc, d_features) if rays_too else (None, None)
        found["table"] = self._encoder.table_gradient(x, enc)
        return Learned(found, losses, weights, *d_rays)

    def render(self, rays: Rays, samples: Samples) -> Rendered:
        count = len(rays)
        _, enc = self._encoder(rays, samples.middles)
        weights = np.empty_like(samples.starts)
        color, depth = np.empty((count, 3), np.float32), np.empty(count, np.float32)
        logits = np.empty((count, len(self._values["semantic_1"])), np.float32)
        fused.render_rays(
            self._matrices(), enc, self._ray_features(rays), samples.starts, samples.ends,
            np.float32(self.settings.min_weight), weights, color, logits, depth,
        )  # fmt: skip
        return Rendered(color, logits, depth, weights)

    def density(self, points: np.ndarray) -> np.ndarray:
        return np.exp(
            np.minimum(self._geometry(points)[:, 0] + volume_rendering.LOG_SIGMA_START, volume_rendering.MAX_LOG_SIGMA)
        )

    def color(self, points: np.ndarray, directions: np.ndarray) -> np.ndarray:
        p = self._values
        features = self._direction_features(directions, None)
        hidden = self._geometry(points) @ p["color_geometry"].T + features @ p["color_ray"].T
        hidden = np.maximum(np.maximum(hidden, 0) @ p["color_1"].T, 0)
        return 1 / (1 + np.exp(-(hidden @ p["color_2"][:3].T)))

    def logits(self, points: np.ndarray) -> np.ndarray:
        p = self._values
        return np.maximum(self._geometry(points) @ p["semantic_0"].T, 0) @ p["semantic_1"].T

    def ray_gradients(
        self, rays: Rays, samples: Samples, target: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        count = len(rays)
        targets = Targets(target, np.full(count, NO_LABEL), np.zeros(count, np.float32))
        scales = np.array([1 / 3, 0, 0, self.settings.turn, self.settings.min_weight, 0], np.float32)
        black = np.zeros((count, 3), np.float32)
        x, enc, d_features, _, color, _, _ = self._forward_backward(rays, samples, targets, black, scales, False)
        d_o, d_d = self._ray_gradient(rays, samples, x, enc, d_features)
        return ((color - target) ** 2).mean(axis=1), d_o, d_d

    # ---- the pieces

    def _matrices(self, semantic: bool = True) -> tuple[np.ndarray, ...]:
        """In the kernels' order; without the semantic network as of a field that has none."""
        *shared, semantic_0, semantic_1 = (self._values[name] for name in MATRICES)
        return (*shared, semantic_0, semantic_1) if semantic else (*shared, semantic_0[:0], semantic_1[:0, :0])

    def _forward_backward(
        self, rays: Rays, samples: Samples, targets: Targets, background: np.ndarray, scales: np.ndarray, learn: bool
    ) -> tuple:
        """Points, gradients of their features, of the rays' features; weights, colours, sums of losses, gradients."""
        x, enc = self._encoder(rays, samples.middles)
        features = self._ray_features(rays)
        d_features, weights = (
            self._buffer("d features", *features.shape),
            self._buffer("weights", *samples.starts.shape),
        )
        color, sums = self._buffer("color", len(rays), 3), np.zeros((CHUNKS, 5))
        matrices = self._matrices(semantic=learn)  # a pose is found by its colours
        gradients = tuple(np.zeros((CHUNKS, *m.shape), np.float32) for m in matrices)
        fused.train_rays(
            matrices, transposed(matrices), gradients, enc, features, samples.starts, samples.ends,
            targets.color, targets.labels, targets.depth, background, scales, learn, d_features, weights, color, sums,
        )  # fmt: skip
        summed = {name: value.sum(axis=0) for name, value in zip(MATRICES, gradients, strict=True)}
        return x, enc, d_features, weights, color, sums, summed

    def _direction_features(self, directions: np.ndarray, frames: np.ndarray | None) -> np.ndarray:
        """(N, 3) unit directions and (N,) images -> (N, F) harmonics and embeddings, the mean one of no image."""
        harmonics = spherical_harmonics(directions.astype(np.float32, copy=False))
        if not self.settings.view_dependent:
            harmonics[:, 1:] = 0
        table = self._values["appearance"]
        if frames is None:
            embedding = np.broadcast_to(table.mean(axis=0), (len(directions), table.shape[1]))
        else:
            embedding = table[frames]
        return np.concatenate([harmonics, embedding], axis=1)

    def _ray_features(self, rays: Rays) -> np.ndarray:
        """(R / BLOCK_RAYS, F, BLOCK_RAYS)."""
        features = self._direction_features(rays.directions, rays.frames)
        return np.ascontiguousarray(features.reshape(-1, BLOCK_RAYS, features.shape[1]).transpose(0, 2, 1))

    def _ray_gradient(
        self, rays: Rays, samples: Samples, x: np.ndarray, d_enc: np.ndarray, d_features: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        d_o, d_d = self._encoder.ray_gradient(rays, samples.middles, x, d_enc)
        if self.settings.view_dependent:
            d_harmonics = d_features.transpose(0, 2, 1).reshape(len(rays), -1)[:, :HARMONICS]
            directions = torch.from_numpy(rays.directions).requires_grad_()
            harmonics = spherical_harmonics(directions)
            upstream = torch.from_numpy(np.ascontiguousarray(d_harmonics))
            d_d += torch.autograd.grad(harmonics, directions, upstream)[0].numpy()
        return d_o, d_d

    def _geometry(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) world points -> (N, 16) float32 outputs of the density network; the first is the log density."""
        out = np.empty((len(points), GEOMETRY), np.float32)
        piece = 1 << 17
        for first in range(0, len(points), piece):
            enc = self._encoder.points(points[first : first + piece])
            g = np.empty((len(enc), GEOMETRY, enc.shape[2]), np.float32)
            fused.geometry_features(self._matrices()[:2], enc, g)
            count = min(piece, len(points) - first)
            out[first : first + count] = g.transpose(0, 2, 1).reshape(-1, GEOMETRY)[:count]
        return out


def transposed(matrices: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    """Copies, for the kernels' way back."""
    return tuple(np.ascontiguousarray(m.T) for m in matrices)
