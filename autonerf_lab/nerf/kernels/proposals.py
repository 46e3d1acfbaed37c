"""Proposal networks (section 3.2): small density networks that place the samples of the field, and their loss."""

from typing import NamedTuple

import numpy as np
from numba import njit, prange

from autonerf_lab.nerf.kernels.dense import dense, relu, relu_backward, weight_gradient
from autonerf_lab.nerf.kernels.tiling import CHUNKS, ONE, TILE_RAYS, ZERO, buffer
from autonerf_lab.nerf.kernels.volume_rendering import interlevel, ray_weights, ray_weights_backward


class ProposalMatrices(NamedTuple):
    """Weight matrices of a proposal network, or their transposes, or gradients with a leading axis of CHUNKS."""

    hidden: np.ndarray  # (H, E) float32
    output: np.ndarray  # (4, H) float32; only the first row is used, the log density


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def propose(matrices, enc, edges, weights, raw):
    """Compute the weights of a proposal network.

    Args:
        matrices: hidden (H, E) and output (4, H), a :class:`ProposalMatrices`.
        enc: (R / TILE_RAYS, E, TILE_RAYS P) encoded bin midpoints.
        edges: (R, P + 1) distances, metres.
        weights, raw: (R, P), written: volume-rendering weights and log densities.
    """
    tiles, width, samples = enc.shape[0], enc.shape[2], weights.shape[1]
    for chunk in prange(CHUNKS):
        h, g = buffer(matrices.hidden.shape[0], width), buffer(4, width)
        for b in range(chunk, tiles, CHUNKS):
            dense(matrices.hidden, enc[b], h, width)
            relu(h, width)
            dense(matrices.output, h, g, width)
            for r in range(TILE_RAYS):
                ray = b * TILE_RAYS + r
                raw[ray] = g[0, r * samples : (r + 1) * samples]
                ray_weights(raw[ray], edges[ray, :-1], edges[ray, 1:], weights[ray])


@njit(parallel=True, fastmath=True, cache=True, error_model="numpy")
def propose_backward(
    matrices, transposed, gradients, enc, edges, weights, raw, fine_edges, fine_weights, scale, losses
):
    """Compute the interlevel loss of a proposal network and its gradients; ``enc`` is overwritten by its gradient.

    Args:
        matrices, enc, edges, weights, raw: as in :func:`propose`.
        transposed, gradients: as in :func:`~autonerf_lab.nerf.kernels.hash_field.train_rays`.
        fine_edges, fine_weights: (R, S + 1), (R, S) histogram that the proposal must bound.
        scale: factor of the loss, 1 / R included.
        losses: (CHUNKS,) float64, written.
    """
    tiles, width, samples = enc.shape[0], enc.shape[2], weights.shape[1]
    hidden = matrices.hidden.shape[0]
    per_chunk = (tiles + CHUNKS - 1) // CHUNKS
    for chunk in prange(CHUNKS):
        h, d_h, d_g = buffer(hidden, width), buffer(hidden, width), buffer(4, width)
        d_weights = np.zeros(samples, np.float32)
        total = 0.0
        for b in range(chunk * per_chunk, min((chunk + 1) * per_chunk, tiles)):
            dense(matrices.hidden, enc[b], h, width)
            relu(h, width)
            for r in range(TILE_RAYS):
                ray = b * TILE_RAYS + r
                total += interlevel(edges[ray], weights[ray], fine_edges[ray], fine_weights[ray], scale, d_weights)
                left = ONE - weights[ray].sum()
                d_raw = d_g[0, r * samples : (r + 1) * samples]
                ray_weights_backward(
                    raw[ray], edges[ray, :-1], edges[ray, 1:], weights[ray], left, d_weights, ZERO, d_raw
                )
            weight_gradient(d_g, h, gradients.output[chunk], width)
            dense(transposed.output, d_g, d_h, width)
            relu_backward(h, d_h, width)
            weight_gradient(d_h, enc[b], gradients.hidden[chunk], width)
            dense(transposed.hidden, d_h, enc[b], width)
        losses[chunk] = total
