"""Fused training step and rendering of a hash field: a tile of rays passes through all of it while it is in the cache.

A plain torch step writes every activation of 50,000 samples to memory and reads it back, several times. Here each
thread takes a few rays at a time through density, heads, compositing, losses and the backward pass, and only gradients
leave the tile.

Most samples of a ray lie in empty space or behind a wall. Once the densities of a tile are known, only *active*
samples, whose weight exceeds ``min_weight``, pass through the heads and the backward pass: their columns are packed
side by side. The others have even smaller gradients of colour, class and distortion, because the exponential activation
multiplies these by the density.

The gradient of the depth loss does not contain this factor: the loss compares log densities. Samples in the band around
a measured surface, where the log density must rise, are therefore active with any weight. In the free space in front of
the band, samples without this weight count in the value of the loss but have no gradient. So the density in free space
falls to about ``min_weight`` divided by the length of a bin, and not to ``free_density`` if that is lower.

Tiles, chunks and padding: :mod:`autonerf_lab.nerf.kernels.tiling`.
"""

from typing import NamedTuple

import numpy as np
from numba import njit, prange

from autonerf_lab.nerf.kernels.active_samples import composite, force, gather, pack
from autonerf_lab.nerf.kernels.dense import dense, dense_add, relu, relu_backward, weight_gradient
from autonerf_lab.nerf.kernels.tiling import (
    CHUNKS,
    GEOMETRY,
    MAX_EXPONENT,
    ONE,
    TILE_RAYS,
    TWO,
    ZERO,
    buffer,
)
from autonerf_lab.nerf.kernels.volume_rendering import (
    distortion,
    median_depth,
    ray_weights,
    ray_weights_backward,
    surface_error,
)


class FieldMatrices(NamedTuple):
    """Weight matrices of a hash field, float32, sizes multiples of 4.

    The kernels also take their transposes, and gradients with a leading axis of CHUNKS, in the same form. H: hidden
    units, E: encoded features, two for each level and zeros up to a multiple of 4, F: features of a ray, C: classes.
    """

    density_0: np.ndarray  # (H, E)
    density_1: np.ndarray  # (16, H)
    color_geometry: np.ndarray  # (H, 16) first colour layer, geometry features
    color_ray: np.ndarray  # (H, F) first colour layer, features of the ray
    color_1: np.ndarray  # (H, H)
    color_2: np.ndarray  # (4, H), of which 3 rows are used
    semantic_0: np.ndarray  # (H, 16)
    semantic_middle: np.ndarray  # (H, H), second hidden layer, or (0, 0) for none
    semantic_1: np.ndarray  # (C, H)


class Scales(NamedTuple):
    """Loss factors and limits of a training step, float32; factors include 1 / R."""

    squared_error: np.float32
    cross_entropy: np.float32
    distortion: np.float32
    turn: np.float32  # distance where the warp changes from linear to disparity, metres
    min_weight: np.float32  # smallest weight of an active sample
    depth_error: np.float32
    density_gain: np.float32  # factor of the first output of the density network


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def _heads(matrices, ray_part, owned, n, g, c0, c1, rgb, s0, s1):
    """Compute colours and the semantic hidden layers of n packed samples; the semantic output follows compositing."""
    dense(ray_part, owned, c0, n)
    dense_add(matrices.color_geometry, g, c0, n)
    relu(c0, n)
    dense(matrices.color_1, c0, c1, n)
    relu(c1, n)
    dense(matrices.color_2, c1, rgb, n)
    for j in range(3):
        for k in range(n):
            rgb[j, k] = ONE / (ONE + np.exp(min(-rgb[j, k], MAX_EXPONENT)))
    dense(matrices.semantic_0, g, s0, n)
    relu(s0, n)
    dense(matrices.semantic_middle, s0, s1, n)
    relu(s1, n)


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def _cross_entropy(logits, labels, trust, first, scale, d_logits):
    """Return the weighted sum of cross entropies and the number of correct labels; write the gradients."""
    entropy, correct = 0.0, 0.0
    classes = logits.shape[0]
    for r in range(TILE_RAYS):
        label = labels[first + r]
        for k in range(classes):
            d_logits[k, r] = ZERO
        if label < 0 or label >= classes:  # no label, or a field without classes
            continue
        peak, total = logits[0, r], ZERO
        for k in range(classes):
            peak = max(peak, logits[k, r])
        for k in range(classes):
            d_logits[k, r] = np.exp(logits[k, r] - peak)
            total += d_logits[k, r]
        entropy += trust[first + r] * (np.log(total) + peak - logits[label, r])
        weight = scale * trust[first + r]
        correct += 1.0 if logits[label, r] == peak else 0.0
        for k in range(classes):
            d_logits[k, r] *= weight / total
        d_logits[label, r] -= weight
    return entropy, correct


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def _photometric(shown, left, target, importance, background, first, scale, color, d_color, d_left):
    """Return the weighted squared error of a tile; write the gradients of colours and remaining transmittance."""
    squared = 0.0
    for r in range(TILE_RAYS):
        d_left[r] = ZERO
        weight = importance[first + r]
        for k in range(3):
            color[first + r, k] = shown[k, r] + left[r] * background[first + r, k]
            error = color[first + r, k] - target[first + r, k]
            squared += weight * error * error
            d_color[k, r] = TWO * scale * weight * error
            d_left[r] += d_color[k, r] * background[first + r, k]
    return squared


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def _samples_backward(rgb, s, d_color, d_s_ray, d_s_ray_t, packed, owners, n, d_rgb, d_s, slopes, d_packed):
    """Write the gradients of packed colours (before the sigmoid), semantic features and weights."""
    dense(d_s_ray, packed, d_s, n)
    dense(d_s_ray_t, s, slopes, n)
    for k in range(n):
        d_packed[k] = slopes[owners[k], k]
    for j in range(3):
        for k in range(n):
            value, slope = rgb[j, k], d_color[j, owners[k]]
            d_packed[k] += slope * value
            d_rgb[j, k] = packed[owners[k], k] * slope * value * (ONE - value)


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def _heads_backward(
    transposed, gradients, chunk, learn, owned, n, g, c0, c1, s0, s1, d_rgb, d_s0, d_s1, d_ray, d_c, d_h, d_g
):
    """Add the gradients of both heads' matrices; write those of the rays' part and of the geometry features."""
    dense(transposed.color_2, d_rgb, d_c, n)
    relu_backward(c1, d_c, n)
    dense(transposed.color_1, d_c, d_h, n)
    relu_backward(c0, d_h, n)
    if len(s1):
        relu_backward(s1, d_s1, n)
        dense(transposed.semantic_middle, d_s1, d_s0, n)
    relu_backward(s0, d_s0, n)
    if learn:
        weight_gradient(d_rgb, c1, gradients.color_2[chunk], n)
        weight_gradient(d_c, c0, gradients.color_1[chunk], n)
        weight_gradient(d_h, g, gradients.color_geometry[chunk], n)
        weight_gradient(d_s0, g, gradients.semantic_0[chunk], n)
        weight_gradient(d_s1, s0, gradients.semantic_middle[chunk], n)
    composite(d_h, owned, n, d_ray)
    dense(transposed.color_geometry, d_h, d_g, n)
    dense_add(transposed.semantic_0, d_s0, d_g, n)


@njit(fastmath=True, cache=True, error_model="numpy", forceinline=True)
def _train_chunk(
    chunk, matrices, transposed, gradients, enc, features, starts, ends, target, importance, labels, trust, depths,
    background, scales, surface, learn, d_features, weights, color, losses,
):  # fmt: skip
    """Run one chunk of the tiles; arguments as in :func:`train_rays`."""
    tiles, width, samples = enc.shape[0], enc.shape[2], weights.shape[1]
    inputs, hidden = enc.shape[1], matrices.density_0.shape[0]
    semantic, classes = matrices.semantic_0.shape[0], matrices.semantic_1.shape[0]
    middle = matrices.semantic_middle.shape[0]
    per_chunk = (tiles + CHUNKS - 1) // CHUNKS
    front = (surface.log_density - surface.log_free) / surface.sharpness
    h_all, g_all, d_all = buffer(hidden, width), buffer(GEOMETRY, width), buffer(1, width)
    x, h, g = buffer(inputs, width), buffer(hidden, width), buffer(GEOMETRY, width)
    d_x, d_h, d_g = buffer(inputs, width), buffer(hidden, width), buffer(GEOMETRY, width)
    c0, c1, d_c = buffer(hidden, width), buffer(hidden, width), buffer(hidden, width)
    s0, d_s0, rgb, d_rgb = buffer(semantic, width), buffer(semantic, width), buffer(4, width), buffer(4, width)
    s1, d_s1 = buffer(middle, width), buffer(middle, width)
    last, d_last = (s1, d_s1) if middle else (s0, d_s0)  # last hidden layer of the semantic network
    ray_part, d_ray = buffer(hidden, TILE_RAYS), buffer(hidden, TILE_RAYS)
    s_ray, d_s_ray = buffer(semantic, TILE_RAYS), buffer(semantic, TILE_RAYS)
    logits, d_logits = buffer(classes, TILE_RAYS), buffer(classes, TILE_RAYS)
    shown, d_color = buffer(4, TILE_RAYS), buffer(3, TILE_RAYS)
    left, d_left = np.zeros(TILE_RAYS, np.float32), np.zeros(TILE_RAYS, np.float32)
    columns, owners = np.zeros(width, np.int64), np.zeros(width, np.int64)
    owned, packed = buffer(TILE_RAYS, width), buffer(TILE_RAYS, width)
    slopes, d_packed = buffer(TILE_RAYS, width), np.zeros(width, np.float32)
    d_s_ray_t = buffer(TILE_RAYS, semantic)
    d_weights, raw = np.zeros(samples, np.float32), np.zeros(width, np.float32)
    forced = np.zeros((TILE_RAYS, samples), np.bool_)
    squared, entropy, spread, correct, depth_error = 0.0, 0.0, 0.0, 0.0, 0.0
    for b in range(chunk * per_chunk, min((chunk + 1) * per_chunk, tiles)):
        first = b * TILE_RAYS
        w = weights[first : first + TILE_RAYS]
        dense(matrices.density_0, enc[b], h_all, width)
        relu(h_all, width)
        dense(matrices.density_1, h_all, g_all, width)
        for s in range(width):
            raw[s] = scales.density_gain * g_all[0, s]
        for r in range(TILE_RAYS):
            t0, t1 = starts[first + r], ends[first + r]
            left[r] = ray_weights(raw[r * samples : (r + 1) * samples], t0, t1, w[r])
            force(t0, t1, depths[first + r] if scales.depth_error > ZERO else ZERO, front, surface.behind, forced[r])
        count, n = pack(w, forced, scales.min_weight, columns, owners, owned, packed)
        gather(g_all, columns, n, g)
        dense(matrices.color_ray, features[b], ray_part, TILE_RAYS)
        _heads(matrices, ray_part, owned, n, g, c0, c1, rgb, s0, s1)
        composite(rgb, packed, n, shown)
        composite(last, packed, n, s_ray)
        dense(matrices.semantic_1, s_ray, logits, TILE_RAYS)

        tile_entropy, tile_correct = _cross_entropy(logits, labels, trust, first, scales.cross_entropy, d_logits)
        entropy += tile_entropy
        correct += tile_correct
        squared += _photometric(
            shown, left, target, importance, background, first, scales.squared_error, color, d_color, d_left
        )

        weight_gradient(d_logits, s_ray, gradients.semantic_1[chunk], TILE_RAYS)
        dense(transposed.semantic_1, d_logits, d_s_ray, TILE_RAYS)
        for j in range(semantic):
            for r in range(TILE_RAYS):
                d_s_ray_t[r, j] = d_s_ray[j, r]
        _samples_backward(rgb, last, d_color, d_s_ray, d_s_ray_t, packed, owners, n, d_rgb, d_last, slopes, d_packed)
        _heads_backward(
            transposed, gradients, chunk, learn, owned, n, g, c0, c1, s0, s1, d_rgb, d_s0, d_s1, d_ray, d_c, d_h,
            d_g,
        )  # fmt: skip
        weight_gradient(d_ray, features[b], gradients.color_ray[chunk], TILE_RAYS)
        dense(transposed.color_ray, d_ray, d_features[b], TILE_RAYS)
        k = 0
        for r in range(TILE_RAYS):
            near, far = r * samples, (r + 1) * samples
            d_weights[:] = ZERO
            while k < count and columns[k] < far:
                d_weights[columns[k] - near] = d_packed[k]
                k += 1
            t0, t1 = starts[first + r], ends[first + r]
            spread += distortion(t0, t1, w[r], scales.turn, scales.distortion, d_weights)
            d_raw = d_all[0, near:far]
            ray_weights_backward(raw[near:far], t0, t1, w[r], left[r], d_weights, d_left[r], d_raw)
            if scales.depth_error > ZERO and depths[first + r] > ZERO:
                depth_error += surface_error(
                    raw[near:far], t0, t1, depths[first + r], surface, scales.depth_error, d_raw
                )
        for k in range(count):
            d_g[0, k] += scales.density_gain * d_all[0, columns[k]]
        for k in range(count, n):
            d_g[:, k] = ZERO
        gather(h_all, columns, n, h)
        gather(enc[b], columns, n, x)
        dense(transposed.density_1, d_g, d_h, n)
        relu_backward(h, d_h, n)
        if learn:
            weight_gradient(d_g, h, gradients.density_1[chunk], n)
            weight_gradient(d_h, x, gradients.density_0[chunk], n)
        dense(transposed.density_0, d_h, d_x, n)
        enc[b] = ZERO
        for j in range(inputs):
            for k in range(count):
                enc[b, j, columns[k]] = d_x[j, k]
    losses[chunk, 0], losses[chunk, 1], losses[chunk, 2] = squared, entropy, spread
    losses[chunk, 3], losses[chunk, 4] = correct, depth_error


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def train_rays(
    matrices, transposed, gradients, enc, features, starts, ends, target, importance, labels, trust, depths, background,
    scales, surface, learn, d_features, weights, color, losses,
):  # fmt: skip
    """Run the forward and backward pass of a batch of rays.

    Args:
        matrices, transposed: :class:`FieldMatrices`, and the same transposed.
        gradients: like ``matrices`` with a leading axis of CHUNKS, added to.
        enc: (R / TILE_RAYS, E, TILE_RAYS S), encoded bin midpoints; overwritten by their gradient.
        features: (R / TILE_RAYS, F, TILE_RAYS), spherical harmonics and appearance of the rays.
        starts, ends: (R, S), distances of the bins, metres.
        target, importance: (R, 3), colours in [0, 1]; and (R,), weight of their squared error in the loss.
        labels, trust: (R,), class index, or -1 for none; and its weight in the loss.
        depths: (R,), metres along the ray, or 0 for none.
        background: (R, 3), colour behind the last bin.
        scales: loss factors and limits, :class:`Scales`.
        surface: log density around measured surfaces, :class:`~.volume_rendering.SurfaceProfile`.
        learn: compute gradients of the matrices; pose refinement needs only those of the positions.
        d_features: like ``features``, written.
        weights: (R, S), written.
        color: (R, 3), written, rendered colour.
        losses: (CHUNKS, 5) float64, written: sums of squared error, cross entropy, distortion, correct labels, surface
            error.
    """
    for chunk in prange(CHUNKS):
        _train_chunk(
            np.int64(chunk),  # prange counts in uint64, for which all of the chunk would be compiled once more
            matrices, transposed, gradients, enc, features, starts, ends, target, importance, labels, trust, depths,
            background, scales, surface, learn, d_features, weights, color, losses,
        )  # fmt: skip


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def render_rays(matrices, enc, features, starts, ends, min_weight, density_gain, weights, color, logits, depth):
    """Run the forward pass of a batch of rays.

    Args:
        matrices, enc, features, starts, ends: as in :func:`train_rays`; ``enc`` is not overwritten.
        min_weight: smallest weight of an active sample.
        density_gain: factor of the first output of the density network.
        weights: (R, S), written.
        color: (R, 3), written; the remaining transmittance shows black.
        logits: (R, C), written, rendered logits of the classes.
        depth: (R,), written, median distance along the ray, metres.
    """
    tiles, width, samples = enc.shape[0], enc.shape[2], weights.shape[1]
    hidden, semantic, classes = matrices.density_0.shape[0], matrices.semantic_0.shape[0], matrices.semantic_1.shape[0]
    for chunk in prange(CHUNKS):
        h, g_all, g = buffer(hidden, width), buffer(GEOMETRY, width), buffer(GEOMETRY, width)
        c0, c1, s0, rgb = buffer(hidden, width), buffer(hidden, width), buffer(semantic, width), buffer(4, width)
        s1 = buffer(matrices.semantic_middle.shape[0], width)
        last = s1 if len(s1) else s0
        ray_part, s_ray = buffer(hidden, TILE_RAYS), buffer(semantic, TILE_RAYS)
        tile_logits, shown = buffer(classes, TILE_RAYS), buffer(4, TILE_RAYS)
        columns, owners = np.zeros(width, np.int64), np.zeros(width, np.int64)
        owned, packed = buffer(TILE_RAYS, width), buffer(TILE_RAYS, width)
        raw, forced = np.zeros(samples, np.float32), np.zeros((TILE_RAYS, samples), np.bool_)
        for b in range(chunk, tiles, CHUNKS):
            first = b * TILE_RAYS
            w = weights[first : first + TILE_RAYS]
            dense(matrices.density_0, enc[b], h, width)
            relu(h, width)
            dense(matrices.density_1, h, g_all, width)
            for r in range(TILE_RAYS):
                t0, t1 = starts[first + r], ends[first + r]
                for i in range(samples):
                    raw[i] = density_gain * g_all[0, r * samples + i]
                ray_weights(raw, t0, t1, w[r])
                depth[first + r] = median_depth(t0, t1, w[r])
            _, n = pack(w, forced, min_weight, columns, owners, owned, packed)
            gather(g_all, columns, n, g)
            dense(matrices.color_ray, features[b], ray_part, TILE_RAYS)
            _heads(matrices, ray_part, owned, n, g, c0, c1, rgb, s0, s1)
            composite(rgb, packed, n, shown)
            composite(last, packed, n, s_ray)
            dense(matrices.semantic_1, s_ray, tile_logits, TILE_RAYS)
            for r in range(TILE_RAYS):
                for k in range(3):
                    color[first + r, k] = shown[k, r]
                for k in range(classes):
                    logits[first + r, k] = tile_logits[k, r]


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def geometry_features(matrices, enc, out):
    """Write the density network's outputs (B, 16, W) for encoded points (B, E, W); row 0 is the log density.

    ``matrices`` is a :class:`FieldMatrices`.
    """
    for chunk in prange(CHUNKS):
        h = buffer(matrices.density_0.shape[0], enc.shape[2])
        for b in range(chunk, enc.shape[0], CHUNKS):
            dense(matrices.density_0, enc[b], h, enc.shape[2])
            relu(h, enc.shape[2])
            dense(matrices.density_1, h, out[b], enc.shape[2])
