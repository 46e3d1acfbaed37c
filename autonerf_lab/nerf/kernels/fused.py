"""One training step and one rendering, fused: a block of rays goes through the whole field while it sits in the cache.

A plain torch step writes every activation of 50,000 samples to memory and reads it back, several times. Here each
thread takes a few rays at a time through density, heads, compositing, losses and back, and only gradients leave the
block.

Most samples of a ray lie in empty space or behind a wall. Once the densities of a block are known, only *active*
samples, whose weight exceeds ``min_weight``, go through the heads and back: their columns are packed side by side. The
others have a gradient that is smaller still, for the exponential activation multiplies it by the density.

``params`` is a tuple of float32 matrices, sizes multiples of 4 (``hash_field.MATRICES``): density hidden (H, 2 L) and
output (16, H); colour first layer from the geometry features (H, 16) and from the ray's features (H, F), second (H, H),
output (4, H), of which 3 rows are used; semantic hidden (H, 16) and output (C, H). ``transposed`` holds the same
matrices transposed, for the way back.

Blocks, chunks and padding: :mod:`autonerf_lab.nerf.kernels.tiling`.
"""

import numpy as np
from numba import njit, prange

from autonerf_lab.nerf.kernels.dense import dense, dense_add, relu, relu_backward, weight_gradient
from autonerf_lab.nerf.kernels.tiling import BLOCK_RAYS, CHUNKS, GEOMETRY, LANES, ONE, TWO, ZERO, buffer
from autonerf_lab.nerf.kernels.volume_rendering import (
    distortion,
    expected_depth_error,
    median_depth,
    ray_weights,
    ray_weights_backward,
)


@njit(fastmath=True, cache=True, error_model="numpy")
def _pack(weights, min_weight, columns, owners, owned, packed):
    """Finds the active samples of a block; returns their number, and that number filled up to whole lanes.

    Sums over a ray and copies to its samples become products with two thin matrices, which the dense kernels do fast:
    ``owned[r, k]`` is 1 where sample k lies on ray r, ``packed[r, k]`` is its weight there. Fillers belong to no ray.
    """
    count, samples = 0, weights.shape[1]
    for r in range(weights.shape[0]):
        for i in range(samples):
            if weights[r, i] > min_weight:
                columns[count], owners[count] = r * samples + i, r
                count += 1
    full = (count + LANES - 1) // LANES * LANES
    columns[count:full] = 0
    owners[count:full] = 0
    for r in range(weights.shape[0]):
        for k in range(full):
            owned[r, k] = ZERO
            packed[r, k] = ZERO
    for k in range(count):
        r = owners[k]
        owned[r, k] = ONE
        packed[r, k] = weights[r, columns[k] - r * samples]
    return count, full


@njit(fastmath=True, cache=True, error_model="numpy")
def _gather(source, columns, n, target):
    for j in range(source.shape[0]):
        for k in range(n):
            target[j, k] = source[j, columns[k]]


@njit(fastmath=True, cache=True, error_model="numpy")
def _heads(params, ray_part, owned, n, g, c0, c1, rgb, s0):
    """Colours and the semantic hidden layer of n packed samples; the semantic output waits until after compositing."""
    dense(ray_part, owned, c0, n)
    dense_add(params[2], g, c0, n)
    relu(c0, n)
    dense(params[4], c0, c1, n)
    relu(c1, n)
    dense(params[5], c1, rgb, n)
    for j in range(3):
        for k in range(n):
            rgb[j, k] = ONE / (ONE + np.exp(-rgb[j, k]))
    dense(params[6], g, s0, n)
    relu(s0, n)


@njit(fastmath=True, cache=True, error_model="numpy")
def _composite(values, packed, n, out):
    """out[j, r] = sum over the samples k of ray r of packed[r, k] values[j, k]."""
    for j in range(out.shape[0]):
        for r in range(out.shape[1]):
            out[j, r] = ZERO
    weight_gradient(values, packed, out, n)


@njit(fastmath=True, cache=True, error_model="numpy")
def _cross_entropy(logits, labels, first, scale, d_logits):
    """Sum of the cross entropies and number of correct labels of a block; gradients written."""
    entropy, correct = 0.0, 0.0
    classes = logits.shape[0]
    for r in range(BLOCK_RAYS):
        label = labels[first + r]
        for k in range(classes):
            d_logits[k, r] = ZERO
        if label < 0 or label >= classes:  # of a field without classes, none is right
            continue
        peak, total = logits[0, r], ZERO
        for k in range(classes):
            peak = max(peak, logits[k, r])
        for k in range(classes):
            d_logits[k, r] = np.exp(logits[k, r] - peak)
            total += d_logits[k, r]
        entropy += np.log(total) + peak - logits[label, r]
        correct += 1.0 if logits[label, r] == peak else 0.0
        for k in range(classes):
            d_logits[k, r] *= scale / total
        d_logits[label, r] -= scale
    return entropy, correct


@njit(fastmath=True, cache=True, error_model="numpy")
def _photometric(shown, left, target, background, first, scale, color, d_color, d_left):
    """Sum of the squared errors of a block; gradients of the rendered colours and of the light that is left."""
    squared = 0.0
    for r in range(BLOCK_RAYS):
        d_left[r] = ZERO
        for k in range(3):
            color[first + r, k] = shown[k, r] + left[r] * background[first + r, k]
            error = color[first + r, k] - target[first + r, k]
            squared += error * error
            d_color[k, r] = TWO * scale * error
            d_left[r] += d_color[k, r] * background[first + r, k]
    return squared


@njit(fastmath=True, cache=True, error_model="numpy")
def _samples_backward(rgb, s0, d_color, d_s_ray, d_s_ray_t, packed, owners, n, d_rgb, d_s0, slopes, d_packed):
    """From the gradients of what is rendered to those of packed colours (before the sigmoid), features and weights."""
    dense(d_s_ray, packed, d_s0, n)
    dense(d_s_ray_t, s0, slopes, n)
    for k in range(n):
        d_packed[k] = slopes[owners[k], k]
    for j in range(3):
        for k in range(n):
            value, slope = rgb[j, k], d_color[j, owners[k]]
            d_packed[k] += slope * value
            d_rgb[j, k] = packed[owners[k], k] * slope * value * (ONE - value)


@njit(fastmath=True, cache=True, error_model="numpy")
def _heads_backward(transposed, grads, chunk, learn, owned, n, g, c0, c1, s0, d_rgb, d_s0, d_ray, d_c, d_h, d_g):
    """Gradients of both heads' weights, of the rays' part and of the packed geometry features."""
    dense(transposed[5], d_rgb, d_c, n)
    relu_backward(c1, d_c, n)
    dense(transposed[4], d_c, d_h, n)
    relu_backward(c0, d_h, n)
    relu_backward(s0, d_s0, n)
    if learn:
        weight_gradient(d_rgb, c1, grads[5][chunk], n)
        weight_gradient(d_c, c0, grads[4][chunk], n)
        weight_gradient(d_h, g, grads[2][chunk], n)
        weight_gradient(d_s0, g, grads[6][chunk], n)
    _composite(d_h, owned, n, d_ray)
    dense(transposed[2], d_h, d_g, n)
    dense_add(transposed[6], d_s0, d_g, n)


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def train_rays(
    params, transposed, grads, enc, features, starts, ends, target, labels, depths, background, settings,
    learn, d_features, weights, color, losses,
):  # fmt: skip
    """Forward and backward of a batch of rays.

    Args:
        params, transposed: see the module.
        grads: like ``params`` with a leading axis of CHUNKS, added to.
        enc: (R / BLOCK_RAYS, 2 L, BLOCK_RAYS S), encoded bin middles; overwritten by their gradient.
        features: (R / BLOCK_RAYS, F, BLOCK_RAYS), spherical harmonics and appearance of the rays.
        starts, ends: (R, S), distances of the bins, metres.
        target: (R, 3), colours in [0, 1].
        labels: (R,), class index, or -1 where there is none.
        depths: (R,), metres along the ray, or 0 where there is none.
        background: (R, 3), colour of what is behind the last bin.
        settings: (6,) scales of squared error, cross entropy and distortion (1 / R included), turn of the warp in
            metres, smallest weight of an active sample, scale of the depth error.
        learn: whether gradients of the parameters are wanted; pose refinement needs those of the positions only.
        d_features: like ``features``, written.
        weights: (R, S), written.
        color: (R, 3), written, what the ray shows.
        losses: (CHUNKS, 5) float64, written: sums of squared error, cross entropy, distortion, correct labels, depth
            error.
    """
    blocks, width, samples = enc.shape[0], enc.shape[2], weights.shape[1]
    inputs, hidden, semantic, classes = enc.shape[1], params[0].shape[0], params[6].shape[0], params[7].shape[0]
    per_chunk = (blocks + CHUNKS - 1) // CHUNKS
    for chunk in prange(CHUNKS):
        h_all, g_all, d_all = buffer(hidden, width), buffer(GEOMETRY, width), buffer(1, width)
        x, h, g = buffer(inputs, width), buffer(hidden, width), buffer(GEOMETRY, width)
        d_x, d_h, d_g = buffer(inputs, width), buffer(hidden, width), buffer(GEOMETRY, width)
        c0, c1, d_c = buffer(hidden, width), buffer(hidden, width), buffer(hidden, width)
        s0, d_s0, rgb, d_rgb = buffer(semantic, width), buffer(semantic, width), buffer(4, width), buffer(4, width)
        ray_part, d_ray = buffer(hidden, BLOCK_RAYS), buffer(hidden, BLOCK_RAYS)
        s_ray, d_s_ray = buffer(semantic, BLOCK_RAYS), buffer(semantic, BLOCK_RAYS)
        logits, d_logits = buffer(classes, BLOCK_RAYS), buffer(classes, BLOCK_RAYS)
        shown, d_color = buffer(4, BLOCK_RAYS), buffer(3, BLOCK_RAYS)
        left, d_left = np.zeros(BLOCK_RAYS, np.float32), np.zeros(BLOCK_RAYS, np.float32)
        columns, owners = np.zeros(width, np.int64), np.zeros(width, np.int64)
        owned, packed = buffer(BLOCK_RAYS, width), buffer(BLOCK_RAYS, width)
        slopes, d_packed = buffer(BLOCK_RAYS, width), np.zeros(width, np.float32)
        d_s_ray_t = buffer(BLOCK_RAYS, semantic)
        d_weights = np.zeros(samples, np.float32)
        squared, entropy, spread, correct, depth_error = 0.0, 0.0, 0.0, 0.0, 0.0
        for b in range(chunk * per_chunk, min((chunk + 1) * per_chunk, blocks)):
            first = b * BLOCK_RAYS
            w = weights[first : first + BLOCK_RAYS]
            dense(params[0], enc[b], h_all, width)
            relu(h_all, width)
            dense(params[1], h_all, g_all, width)
            for r in range(BLOCK_RAYS):
                raw = g_all[0, r * samples : (r + 1) * samples]
                left[r] = ray_weights(raw, starts[first + r], ends[first + r], w[r])
            count, n = _pack(w, settings[4], columns, owners, owned, packed)
            _gather(g_all, columns, n, g)
            dense(params[3], features[b], ray_part, BLOCK_RAYS)
            _heads(params, ray_part, owned, n, g, c0, c1, rgb, s0)
            _composite(rgb, packed, n, shown)
            _composite(s0, packed, n, s_ray)
            dense(params[7], s_ray, logits, BLOCK_RAYS)

            block_entropy, block_correct = _cross_entropy(logits, labels, first, settings[1], d_logits)
            entropy += block_entropy
            correct += block_correct
            squared += _photometric(shown, left, target, background, first, settings[0], color, d_color, d_left)

            weight_gradient(d_logits, s_ray, grads[7][chunk], BLOCK_RAYS)
            dense(transposed[7], d_logits, d_s_ray, BLOCK_RAYS)
            for j in range(semantic):
                for r in range(BLOCK_RAYS):
                    d_s_ray_t[r, j] = d_s_ray[j, r]
            _samples_backward(rgb, s0, d_color, d_s_ray, d_s_ray_t, packed, owners, n, d_rgb, d_s0, slopes, d_packed)
            _heads_backward(transposed, grads, chunk, learn, owned, n, g, c0, c1, s0, d_rgb, d_s0, d_ray, d_c, d_h, d_g)
            weight_gradient(d_ray, features[b], grads[3][chunk], BLOCK_RAYS)
            dense(transposed[3], d_ray, d_features[b], BLOCK_RAYS)
            k = 0
            for r in range(BLOCK_RAYS):
                near, far = r * samples, (r + 1) * samples
                d_weights[:] = ZERO
                while k < count and columns[k] < far:
                    d_weights[columns[k] - near] = d_packed[k]
                    k += 1
                t0, t1 = starts[first + r], ends[first + r]
                spread += distortion(t0, t1, w[r], settings[3], settings[2], d_weights)
                if depths[first + r] > ZERO:
                    error, slope = expected_depth_error(
                        t0, t1, w[r], left[r], depths[first + r], settings[5], d_weights
                    )
                    depth_error += error
                    d_left[r] += slope
                ray_weights_backward(
                    g_all[0, near:far], t0, t1, w[r], left[r], d_weights, d_left[r], d_all[0, near:far]
                )
            for k in range(count):
                d_g[0, k] += d_all[0, columns[k]]
            for k in range(count, n):
                d_g[:, k] = ZERO
            _gather(h_all, columns, n, h)
            _gather(enc[b], columns, n, x)
            dense(transposed[1], d_g, d_h, n)
            relu_backward(h, d_h, n)
            if learn:
                weight_gradient(d_g, h, grads[1][chunk], n)
                weight_gradient(d_h, x, grads[0][chunk], n)
            dense(transposed[0], d_h, d_x, n)
            enc[b] = ZERO
            for j in range(inputs):
                for k in range(count):
                    enc[b, j, columns[k]] = d_x[j, k]
        losses[chunk, 0], losses[chunk, 1], losses[chunk, 2] = squared, entropy, spread
        losses[chunk, 3], losses[chunk, 4] = correct, depth_error


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def render_rays(params, enc, features, starts, ends, min_weight, weights, color, logits, depth):
    """Forward only.

    Args:
        params, enc, features, starts, ends: as in :func:`train_rays`; enc is kept.
        min_weight: smallest weight of an active sample.
        weights: (R, S), written.
        color: (R, 3), written; what is left of the light is black.
        logits: (R, C), written, rendered logits.
        depth: (R,), written, median distance along the ray, metres.
    """
    blocks, width, samples = enc.shape[0], enc.shape[2], weights.shape[1]
    hidden, semantic, classes = params[0].shape[0], params[6].shape[0], params[7].shape[0]
    for chunk in prange(CHUNKS):
        h, g_all, g = buffer(hidden, width), buffer(GEOMETRY, width), buffer(GEOMETRY, width)
        c0, c1, s0, rgb = buffer(hidden, width), buffer(hidden, width), buffer(semantic, width), buffer(4, width)
        ray_part, s_ray = buffer(hidden, BLOCK_RAYS), buffer(semantic, BLOCK_RAYS)
        block_logits, shown = buffer(classes, BLOCK_RAYS), buffer(4, BLOCK_RAYS)
        columns, owners = np.zeros(width, np.int64), np.zeros(width, np.int64)
        owned, packed = buffer(BLOCK_RAYS, width), buffer(BLOCK_RAYS, width)
        for b in range(chunk, blocks, CHUNKS):
            first = b * BLOCK_RAYS
            w = weights[first : first + BLOCK_RAYS]
            dense(params[0], enc[b], h, width)
            relu(h, width)
            dense(params[1], h, g_all, width)
            for r in range(BLOCK_RAYS):
                t0, t1 = starts[first + r], ends[first + r]
                ray_weights(g_all[0, r * samples : (r + 1) * samples], t0, t1, w[r])
                depth[first + r] = median_depth(t0, t1, w[r])
            _, n = _pack(w, min_weight, columns, owners, owned, packed)
            _gather(g_all, columns, n, g)
            dense(params[3], features[b], ray_part, BLOCK_RAYS)
            _heads(params, ray_part, owned, n, g, c0, c1, rgb, s0)
            _composite(rgb, packed, n, shown)
            _composite(s0, packed, n, s_ray)
            dense(params[7], s_ray, block_logits, BLOCK_RAYS)
            for r in range(BLOCK_RAYS):
                for k in range(3):
                    color[first + r, k] = shown[k, r]
                for k in range(classes):
                    logits[first + r, k] = block_logits[k, r]


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def geometry_features(params, enc, out):
    """Outputs (B, 16, W) of the density network for encoded points (B, 2 L, W); the first row is the log density."""
    for chunk in prange(CHUNKS):
        h = buffer(params[0].shape[0], enc.shape[2])
        for b in range(chunk, enc.shape[0], CHUNKS):
            dense(params[0], enc[b], h, enc.shape[2])
            relu(h, enc.shape[2])
            dense(params[1], h, out[b], enc.shape[2])
