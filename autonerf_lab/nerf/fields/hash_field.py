"""Hash encoding and small networks (section 3.2), computed by fused numba kernels.

The paper's symbols::

    x~ = h(x)                       hash encoding                   table
    phi~ = sh(phi)                  spherical harmonics             spherical_harmonics.spherical_harmonics
    e                               appearance embedding            appearance
    (sigma, h_d) = f_d(x~)          density network                 density_0, density_1
    s = f_s(h_d)                    semantic network                semantic_0, (semantic_middle,) semantic_1
    c = f_c(h_d, phi~, e)           colour network                  color_geometry, color_ray, color_1, color_2

This module holds the parameters and calls the kernels of :mod:`autonerf_lab.nerf.kernels`. It pads rays to whole tiles,
so that callers may pass any number of rays. The same field in torch: :mod:`autonerf_lab.nerf.fields.torch_hash_field`.
"""

import math
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from autonerf_lab.nerf.fields.hash_encoder import (
    TABLE_INIT,
    Buffers,
    HashEncoder,
    encoded_size,
    first_layer,
    he_uniform,
)
from autonerf_lab.nerf.hash_grid import HashGrid
from autonerf_lab.nerf.kernels import hash_field as kernels
from autonerf_lab.nerf.kernels import volume_rendering
from autonerf_lab.nerf.kernels.proposals import ProposalMatrices
from autonerf_lab.nerf.kernels.tiling import CHUNKS, GEOMETRY, MAX_EXPONENT, TILE_RAYS, pad_rows
from autonerf_lab.nerf.ray_batch import NO_DEPTH, NO_LABEL, Arrays, Rays, RenderOutput, Samples, Targets, TrainOutput
from autonerf_lab.nerf.scene_box import SceneBox
from autonerf_lab.nerf.settings import HashSettings
from autonerf_lab.nerf.spherical_harmonics import spherical_harmonics, spherical_harmonics_gradient

Matrices = TypeVar("Matrices", kernels.FieldMatrices, ProposalMatrices)

HARMONICS = 16  # spherical harmonics up to degree 3


def build_grid(settings: HashSettings, box: SceneBox) -> HashGrid:
    """Return the layout of the field's table."""
    return HashGrid.build(box.size, settings.coarse, settings.fine, settings.levels, settings.log2_entries)


def initial_parameters(
    settings: HashSettings, grid: HashGrid, frames: int, classes: int, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Return random initial values by name, the same for kernels and torch.

    Without classes the semantic network has no units.
    """
    s = settings
    semantic = s.hidden if classes else 0
    shapes = {
        "density_1": (GEOMETRY, s.hidden),
        "color_geometry": (s.hidden, GEOMETRY),
        "color_ray": (s.hidden, HARMONICS + s.appearance),
        "color_1": (s.hidden, s.hidden),
        "color_2": (4, s.hidden),
        "semantic_0": (semantic, GEOMETRY),
        "semantic_1": (classes, semantic),
    }
    if s.semantic_layers == 2:
        shapes["semantic_middle"] = (semantic, semantic)
    parameters = {"density_0": first_layer(s.hidden, s.levels, rng)}
    parameters |= {name: he_uniform(shape, rng) for name, shape in shapes.items()}
    parameters["color_2"][3] = 0  # padding: colour has three rows
    parameters["table"] = rng.uniform(-TABLE_INIT, TABLE_INIT, (grid.entries, 2)).astype(np.float32)
    parameters["appearance"] = np.zeros((frames, s.appearance), np.float32)
    return parameters


class HashField:
    """Field of Semantic Nerfacto and of Instant-NGP, on the CPU.

    Args:
        settings: sizes and loss weights.
        box: region of full resolution.
        frames: number of training images, for the appearance embedding.
        classes: number of classes, 0 for a field without semantics.
        rng: random generator of the initial values.
    """

    def __init__(
        self, settings: HashSettings, box: SceneBox, frames: int, classes: int, rng: np.random.Generator
    ) -> None:
        self.settings = settings
        grid = build_grid(settings, box)
        values = initial_parameters(settings, grid, frames, classes, rng)
        self.parameters: Arrays = dict(values)
        self._values = values
        self._encoder = HashEncoder(grid, box, values["table"])
        self._buffer = Buffers()
        self._feature_weights: np.ndarray | None = None  # (E,) of the encoded features

    def set_level_weights(self, weights_at: Callable[[int], np.ndarray]) -> None:
        """Weight the levels of the table; see :class:`~autonerf_lab.nerf.model.CoarseToFineField`."""
        weights = np.repeat(weights_at(self.settings.levels), 2)
        weights = np.pad(weights, (0, encoded_size(self.settings.levels) - len(weights)), constant_values=1)
        self._feature_weights = None if (weights == 1).all() else weights

    def train(
        self, rays: Rays, samples: Samples, targets: Targets, rng: np.random.Generator, ray_gradients: bool
    ) -> TrainOutput:
        """Return losses and gradients of a batch; see :class:`~autonerf_lab.nerf.model.Field`."""
        s, count = self.settings, len(rays)
        # A random colour behind the last bin: a field that stays transparent cannot fit it.
        background = rng.random((count, 3), dtype=np.float32)
        scales = kernels.Scales(
            squared_error=np.float32(1 / (3 * count)),
            cross_entropy=np.float32(s.semantic_weight / count),
            distortion=np.float32(s.distortion_weight / count),
            turn=np.float32(s.turn),
            min_weight=np.float32(s.min_weight),
            depth_error=np.float32(s.distance_weight / count),
            density_gain=np.float32(s.density_gain),
        )
        rays, samples, targets, background = _padded_batch(rays, samples, targets, background)
        x, enc, d_features, weights, _, sums, gradients = self._forward_backward(
            rays, samples, targets, background, scales, True
        )
        squared, entropy, spread, correct, depth_error = sums.sum(axis=0) / count
        losses = {"mse": squared / 3, "distortion": spread}
        if len(gradients["semantic_1"]):
            losses |= {"cross_entropy": entropy, "class_accuracy": correct}
        if s.distance_weight:
            losses["depth"] = depth_error
        found: Arrays = dict(gradients)
        if s.appearance and rays.frames is not None:
            found["appearance"] = np.zeros_like(self._values["appearance"])
            d_appearance = d_features.transpose(0, 2, 1).reshape(-1, d_features.shape[1])[:, HARMONICS:]
            np.add.at(found["appearance"], rays.frames, d_appearance)
        d_rays = self._ray_gradient(rays, samples, x, enc, d_features, count) if ray_gradients else (None, None)
        found["table"] = self._encoder.table_gradient(x, enc)
        return TrainOutput(found, losses, weights[:count], *d_rays)

    def render(self, rays: Rays, samples: Samples) -> RenderOutput:
        """Render rays; see :class:`~autonerf_lab.nerf.model.Field`."""
        count = len(rays)
        rays, samples = _padded(rays, samples)
        _, enc = self._encoder(rays, samples.midpoints)
        weights = np.empty_like(samples.starts)
        color, depth = np.empty((len(rays), 3), np.float32), np.empty(len(rays), np.float32)
        logits = np.empty((len(rays), len(self._values["semantic_1"])), np.float32)
        kernels.render_rays(
            self._matrices(), enc, self._ray_features(rays), samples.starts, samples.ends,
            np.float32(self.settings.min_weight), np.float32(self.settings.density_gain), weights, color, logits, depth,
        )  # fmt: skip
        return RenderOutput(color[:count], logits[:count], depth[:count], weights[:count])

    def density(self, points: np.ndarray) -> np.ndarray:
        """Return densities at points; see :class:`~autonerf_lab.nerf.model.Field`."""
        raw = np.float32(self.settings.density_gain) * self._geometry(points, 1)[:, 0]
        return np.exp(np.minimum(raw + volume_rendering.LOG_SIGMA_START, volume_rendering.MAX_LOG_SIGMA))

    def color(self, points: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Return colours at points; see :class:`~autonerf_lab.nerf.model.Field`."""
        p = self._values
        features = self._direction_features(directions, None)
        hidden = self._geometry(points) @ p["color_geometry"].T + features @ p["color_ray"].T
        hidden = np.maximum(np.maximum(hidden, 0) @ p["color_1"].T, 0)
        return 1 / (1 + np.exp(np.minimum(-(hidden @ p["color_2"][:3].T), MAX_EXPONENT)))

    def logits(self, points: np.ndarray) -> np.ndarray:
        """Return class logits at points; see :class:`~autonerf_lab.nerf.model.Field`."""
        p = self._values
        hidden = np.maximum(self._geometry(points) @ p["semantic_0"].T, 0)
        if "semantic_middle" in p:
            hidden = np.maximum(hidden @ p["semantic_middle"].T, 0)
        return hidden @ p["semantic_1"].T

    def ray_gradients(
        self, rays: Rays, samples: Samples, target: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return errors and gradients of rays; see :class:`~autonerf_lab.nerf.model.Field`."""
        count = len(rays)
        rays, samples = _padded(rays, samples)
        target, tiled = pad_rows(target), len(rays)
        targets = Targets(target, np.full(tiled, NO_LABEL), np.full(tiled, NO_DEPTH, np.float32))
        zero = np.float32(0)
        turn, min_weight = np.float32(self.settings.turn), np.float32(self.settings.min_weight)
        gain = np.float32(self.settings.density_gain)
        scales = kernels.Scales(np.float32(1 / 3), zero, zero, turn, min_weight, zero, gain)
        black = np.zeros((tiled, 3), np.float32)
        x, enc, d_features, _, color, _, _ = self._forward_backward(rays, samples, targets, black, scales, False)
        d_o, d_d = self._ray_gradient(rays, samples, x, enc, d_features, count)
        return ((color - target) ** 2).mean(axis=1)[:count], d_o, d_d

    def _matrices(self, semantic: bool = True) -> kernels.FieldMatrices:
        """Return the weight matrices; without ``semantic``, those of a field that has no semantic network."""
        values = {"semantic_middle": np.zeros((0, 0), np.float32)} | self._values
        matrices = kernels.FieldMatrices(*(values[name] for name in kernels.FieldMatrices._fields))
        if self._feature_weights is not None:  # columns of the first layer instead of features: the same products
            matrices = matrices._replace(density_0=matrices.density_0 * self._feature_weights)
        if semantic:
            return matrices
        none = matrices.semantic_middle[:0, :0]
        return matrices._replace(
            semantic_0=matrices.semantic_0[:0], semantic_middle=none, semantic_1=matrices.semantic_1[:0, :0]
        )

    def _forward_backward(
        self,
        rays: Rays,
        samples: Samples,
        targets: Targets,
        background: np.ndarray,
        scales: kernels.Scales,
        learn: bool,
    ) -> tuple:
        """Run the training kernel on whole tiles of rays.

        Returns:
            contracted points; gradients of their encoding; gradients of the rays' features; weights; colours; sums of
            the losses; gradients of the matrices by name.
        """
        x, enc = self._encoder(rays, samples.midpoints)
        features = self._ray_features(rays)
        d_features, weights = (
            self._buffer("d features", *features.shape),
            self._buffer("weights", *samples.starts.shape),
        )
        color, sums = self._buffer("color", len(rays), 3), np.zeros((CHUNKS, 5))
        ones = np.ones(len(rays), np.float32)
        trust = ones if targets.trust is None else targets.trust
        importance = ones if targets.importance is None else targets.importance
        matrices = self._matrices(semantic=learn)  # pose refinement uses colours only
        gradients = kernels.FieldMatrices(*(np.zeros((CHUNKS, *m.shape), np.float32) for m in matrices))
        kernels.train_rays(
            matrices, transposed(matrices), gradients, enc, features, samples.starts, samples.ends,
            targets.color, importance, targets.labels, trust, targets.depth, background, scales,
            surface_profile(self.settings), learn, d_features, weights, color, sums,
        )  # fmt: skip
        summed = {name: value.sum(axis=0) for name, value in gradients._asdict().items() if name in self._values}
        if self._feature_weights is not None:
            summed["density_0"] *= self._feature_weights
        return x, enc, d_features, weights, color, sums, summed

    def _direction_features(self, directions: np.ndarray, frames: np.ndarray | None) -> np.ndarray:
        """Return (N, F) harmonics and embeddings of (N, 3) unit directions in (N,) images; mean embedding for None."""
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
        """Return the (R / TILE_RAYS, F, TILE_RAYS) features of whole tiles of rays."""
        features = self._direction_features(rays.directions, rays.frames)
        return np.ascontiguousarray(features.reshape(-1, TILE_RAYS, features.shape[1]).transpose(0, 2, 1))

    def _ray_gradient(
        self, rays: Rays, samples: Samples, x: np.ndarray, d_enc: np.ndarray, d_features: np.ndarray, count: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the gradients of origins and directions of the first ``count`` rays."""
        d_o, d_d = self._encoder.ray_gradient(rays, samples.midpoints, x, d_enc)
        if self.settings.view_dependent:
            d_harmonics = d_features.transpose(0, 2, 1).reshape(-1, d_features.shape[1])[:, :HARMONICS]
            d_d += spherical_harmonics_gradient(rays.directions, d_harmonics)
        return d_o[:count], d_d[:count]

    def _geometry(self, points: np.ndarray, outputs: int = GEOMETRY) -> np.ndarray:
        """Return the first (N, outputs) values of the density network at (N, 3) points; column 0 is the log density."""
        out = np.empty((len(points), outputs), np.float32)
        chunk = 1 << 17
        for first in range(0, len(points), chunk):
            enc = self._encoder.points(points[first : first + chunk])
            g = np.empty((len(enc), GEOMETRY, enc.shape[2]), np.float32)
            kernels.geometry_features(self._matrices(), enc, g)
            count = min(chunk, len(points) - first)
            out[first : first + count] = g[:, :outputs].transpose(0, 2, 1).reshape(-1, outputs)[:count]
        return out


def surface_profile(settings: HashSettings) -> volume_rendering.SurfaceProfile:
    """Return the log density around a measured surface, for the kernels."""
    values = (math.log(settings.surface_density), settings.sharpness, math.log(settings.free_density), settings.behind)
    return volume_rendering.SurfaceProfile(*map(np.float32, values))


def transposed(matrices: Matrices) -> Matrices:
    """Return a named tuple with transposed copies, for the backward pass of the kernels."""
    return type(matrices)(*(np.ascontiguousarray(m.T) for m in matrices))


def _padded(rays: Rays, samples: Samples) -> tuple[Rays, Samples]:
    """Repeat the last ray and its samples until the rays fill whole tiles."""
    if len(rays) % TILE_RAYS == 0:
        return rays, samples
    frames = None if rays.frames is None else pad_rows(rays.frames)
    padded = Rays(pad_rows(rays.origins), pad_rows(rays.directions), frames)
    return padded, Samples(pad_rows(samples.starts), pad_rows(samples.ends))


def _padded_batch(
    rays: Rays, samples: Samples, targets: Targets, background: np.ndarray
) -> tuple[Rays, Samples, Targets, np.ndarray]:
    """Pad a training batch to whole tiles by rays without loss and gradient: empty bins before a known background."""
    count = len(rays)
    if count % TILE_RAYS == 0:
        return rays, samples, targets, background
    rays, samples = _padded(rays, samples)
    background, color = pad_rows(background), pad_rows(targets.color)
    labels, depth = pad_rows(targets.labels), pad_rows(targets.depth)
    samples.starts[count:] = samples.ends[count:]
    color[count:], labels[count:], depth[count:] = background[count:], NO_LABEL, NO_DEPTH
    trust, importance = (None if value is None else pad_rows(value) for value in (targets.trust, targets.importance))
    return rays, samples, Targets(color, labels, depth, trust, importance), background
