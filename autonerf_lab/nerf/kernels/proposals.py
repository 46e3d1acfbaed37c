"""Proposal networks (section 3.2): a small density that says where to ask the field, and what it learns from."""

import numpy as np
from numba import njit, prange

from autonerf_lab.nerf.kernels.dense import dense, relu, relu_backward, weight_gradient
from autonerf_lab.nerf.kernels.tiling import BLOCK_RAYS, CHUNKS, ONE, ZERO, buffer
from autonerf_lab.nerf.kernels.volume_rendering import interlevel, ray_weights, ray_weights_backward


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def propose(params, enc, edges, weights, raw):
    """Weights of a proposal network: hidden (H, 2 L) and output (4, H), of which the first row is the log density.

    Args:
        params: the two matrices.
        enc: (R / BLOCK_RAYS, 2 L, BLOCK_RAYS P).
        edges: (R, P + 1).
        weights, raw: (R, P), written.
    """
    blocks, width, samples = enc.shape[0], enc.shape[2], weights.shape[1]
    for chunk in prange(CHUNKS):
        h, g = buffer(params[0].shape[0], width), buffer(4, width)
        for b in range(chunk, blocks, CHUNKS):
            dense(params[0], enc[b], h, width)
            relu(h, width)
            dense(params[1], h, g, width)
            for r in range(BLOCK_RAYS):
                ray = b * BLOCK_RAYS + r
                raw[ray] = g[0, r * samples : (r + 1) * samples]
                ray_weights(raw[ray], edges[ray, :-1], edges[ray, 1:], weights[ray])


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def propose_backward(params, transposed, grads, enc, edges, weights, raw, fine_edges, fine_weights, scale, losses):
    """Interlevel loss of a proposal network, and its gradients; enc is overwritten by its own.

    Args:
        params, enc, edges, weights, raw: as in :func:`propose`.
        transposed, grads: as in :func:`train_rays`.
        fine_edges, fine_weights: (R, S + 1), (R, S), what the proposal should have foreseen.
        scale: factor of the loss, 1 / R included.
        losses: (CHUNKS,) float64, written.
    """
    blocks, width, samples = enc.shape[0], enc.shape[2], weights.shape[1]
    hidden = params[0].shape[0]
    per_chunk = (blocks + CHUNKS - 1) // CHUNKS
    for chunk in prange(CHUNKS):
        h, d_h, d_g = buffer(hidden, width), buffer(hidden, width), buffer(4, width)
        d_weights = np.zeros(samples, np.float32)
        total = 0.0
        for b in range(chunk * per_chunk, min((chunk + 1) * per_chunk, blocks)):
            dense(params[0], enc[b], h, width)
            relu(h, width)
            for r in range(BLOCK_RAYS):
                ray = b * BLOCK_RAYS + r
                total += interlevel(edges[ray], weights[ray], fine_edges[ray], fine_weights[ray], scale, d_weights)
                left = ONE - weights[ray].sum()
                d_raw = d_g[0, r * samples : (r + 1) * samples]
                ray_weights_backward(
                    raw[ray], edges[ray, :-1], edges[ray, 1:], weights[ray], left, d_weights, ZERO, d_raw
                )
            weight_gradient(d_g, h, grads[1][chunk], width)
            dense(transposed[1], d_g, d_h, width)
            relu_backward(h, d_h, width)
            weight_gradient(d_h, enc[b], grads[0][chunk], width)
            dense(transposed[0], d_h, enc[b], width)
        losses[chunk] = total
