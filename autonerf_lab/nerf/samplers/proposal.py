"""Proposal sampling (section 3.2, Barron et al. 2022): small density networks predict where the field is opaque."""

from typing import NamedTuple

import numpy as np

from autonerf_lab.nerf.fields.hash_encoder import TABLE_INIT, Buffers, HashEncoder, first_layer, he_uniform
from autonerf_lab.nerf.fields.hash_field import transposed
from autonerf_lab.nerf.hash_grid import HashGrid
from autonerf_lab.nerf.kernels import proposals, volume_rendering
from autonerf_lab.nerf.kernels.tiling import CHUNKS, pad_rows
from autonerf_lab.nerf.ray_batch import Arrays, Rays, Samples, Targets
from autonerf_lab.nerf.scene_box import SceneBox
from autonerf_lab.nerf.settings import ProposalSettings


class ProposalRound(NamedTuple):
    """Arrays of one proposal round on whole tiles of rays. P: bins of the round."""

    points: np.ndarray  # (3, R P) float32, contracted
    enc: np.ndarray  # encoded points, overwritten by their gradient in training
    edges: np.ndarray  # (R, P + 1) float32 distances, metres
    weights: np.ndarray  # (R, P) float32
    raw: np.ndarray  # (R, P) float32 log densities


def initial_values(settings: ProposalSettings, box: SceneBox, rng: np.random.Generator) -> tuple[list[HashGrid], dict]:
    """Return the table layout of each round, and the initial values of all networks by name."""
    s = settings
    finest = [s.proposal_fine * s.proposal_ratio**k for k in reversed(range(len(s.proposal_samples)))]
    grids = [
        HashGrid.build(box.size, s.coarse, min(fine, s.coarse), s.proposal_levels, s.proposal_log2_entries)
        for fine in finest
    ]
    values = {}
    for k, grid in enumerate(grids):
        values[f"proposal_{k}_0"] = first_layer(s.proposal_hidden, s.proposal_levels, rng)
        values[f"proposal_{k}_1"] = he_uniform((4, s.proposal_hidden), rng)  # row 0 is the log density
        values[f"proposal_{k}_table"] = rng.uniform(-TABLE_INIT, TABLE_INIT, (grid.entries, 2)).astype(np.float32)
    return grids, values


class ProposalSampler:
    """Rounds of proposal networks on the CPU; each round places the bins of the next.

    The record of its samples is (edges, list of :class:`ProposalRound`).

    Args:
        settings: bins of each round, sizes of the networks, loss weight.
        box: region of full resolution.
        rng: random generator of the initial values.
    """

    def __init__(self, settings: ProposalSettings, box: SceneBox, rng: np.random.Generator) -> None:
        self.settings = settings
        grids, self._values = initial_values(settings, box, rng)
        self.parameters: Arrays = dict(self._values)
        self.state = {"proposal_steps": np.zeros(1, np.int64)}
        self._encoders = [HashEncoder(grid, box, self._values[f"proposal_{k}_table"]) for k, grid in enumerate(grids)]
        self._buffer = Buffers()

    def sample(self, rays: Rays, jitter: np.ndarray) -> Samples:
        """Place bins on rays; see :class:`~autonerf_lab.nerf.model.Sampler`."""
        s, given = self.settings, len(rays)
        rays, jitter = Rays(pad_rows(rays.origins), pad_rows(rays.directions)), pad_rows(jitter)
        count = len(rays)
        edges = self._buffer("edges 0", count, s.proposal_samples[0] + 1)
        volume_rendering.first_edges(np.float32(s.near), np.float32(s.far), np.float32(s.turn), jitter, edges)
        rounds = []
        for k, following in enumerate((*s.proposal_samples[1:], s.samples)):
            samples = edges.shape[1] - 1
            x, enc = self._encoders[k](rays, np.float32(0.5) * (edges[:, 1:] + edges[:, :-1]))
            weights, raw = self._buffer(f"weights {k}", count, samples), self._buffer(f"raw {k}", count, samples)
            proposals.propose(self._matrices(k), enc, edges, weights, raw)
            rounds.append(ProposalRound(x, enc, edges, weights, raw))
            finer = self._buffer(f"edges {k + 1}", count, following + 1)
            volume_rendering.resample(edges, weights, jitter, np.float32(s.histogram_padding), finer)
            edges = finer
        return Samples.between(edges[:given], (edges, rounds))

    def learn(
        self,
        rays: Rays,
        samples: Samples,
        targets: Targets,
        weights: np.ndarray,
        rng: np.random.Generator,
    ) -> tuple[Arrays, dict[str, float]]:
        """Return gradients and losses of the proposals; see :class:`~autonerf_lab.nerf.model.Sampler`."""
        if not is_due(self.state, self.settings):
            return {}, {}
        fine_edges, rounds = samples.record
        missing = len(fine_edges) - len(weights)
        fine_weights = np.pad(weights, ((0, missing), (0, 0))) if missing else weights  # no weight, no loss
        gradients: Arrays = {}
        scale, total = np.float32(self.settings.interlevel_weight / len(rays)), 0.0
        for k, (x, enc, edges, coarse_weights, raw) in enumerate(rounds):
            matrices, sums = self._matrices(k), np.zeros(CHUNKS)
            parts = proposals.ProposalMatrices(*(np.zeros((CHUNKS, *m.shape), np.float32) for m in matrices))
            proposals.propose_backward(
                matrices, transposed(matrices), parts, enc, edges, coarse_weights, raw, fine_edges, fine_weights,
                scale, sums,
            )  # fmt: skip
            gradients[f"proposal_{k}_0"], gradients[f"proposal_{k}_1"] = (part.sum(axis=0) for part in parts)
            gradients[f"proposal_{k}_table"] = self._encoders[k].table_gradient(x, enc)
            total += float(sums.sum() / len(rays))
        return gradients, {"interlevel": total}

    def _matrices(self, k: int) -> proposals.ProposalMatrices:
        return proposals.ProposalMatrices(self._values[f"proposal_{k}_0"], self._values[f"proposal_{k}_1"])


def is_due(state: dict[str, np.ndarray], settings: ProposalSettings) -> bool:
    """Count a step; return True in the first tenth of the training, then every ``proposal_every`` steps.

    The densities that the proposals follow change more and more slowly.
    """
    step = int(state["proposal_steps"][0])
    state["proposal_steps"] += 1
    return step < settings.steps // 10 or step % settings.proposal_every == 0
