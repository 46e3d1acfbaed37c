"""Semantic Nerfacto (section 3.2): proposal networks, hash encoding, density, colour and semantic heads.

The paper's symbols::

    x~ = h(x)                       hash encoding                   table
    phi~ = sh(phi)                  spherical harmonics             encodings.spherical_harmonics
    e                               appearance embedding            appearance
    (sigma, h_d) = f_d(x~)          density network                 density_0, density_1
    s = f_s(h_d)                    semantic network                semantic_0, semantic_1
    c = f_c(h_d, phi~, e)           colour network                  color_geometry, color_ray, color_1, color_2

This file holds the parameters and the order of the work; the work itself is in :mod:`autonerf_lab.nerf.kernels`.
"""

import numpy as np
import torch

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.nerf.encodings import HashGrid, spherical_harmonics
from autonerf_lab.nerf.kernels import fused, proposals, volume
from autonerf_lab.nerf.kernels.blocks import BLOCK_RAYS, CHUNKS, GEOMETRY
from autonerf_lab.nerf.kernels.hashing import hash_encode, hash_encode_backward, hash_encode_points_backward
from autonerf_lab.nerf.scene_box import SceneBox
from autonerf_lab.nerf.settings import NerfactoSettings

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
NO_LABEL = -1


class SemanticNerfacto:
    """The field and its sampler: parameters, one training step, rendering and point queries, all in numpy on the CPU.

    Args:
        settings: sizes.
        box: where the scene is.
        frames: number of training images, for the appearance embedding.
        rng: initial values.
    """

    def __init__(self, settings: NerfactoSettings, box: SceneBox, frames: int, rng: np.random.Generator) -> None:
        self.settings, self.box, self.frames = settings, box, frames
        s = settings
        self.grid = HashGrid.build(box.size, s.coarse, s.fine, s.levels, s.log2_entries)
        self.proposal_grids = [
            HashGrid.build(box.size, s.coarse, s.proposal_fine, s.proposal_levels, s.proposal_log2_entries)
            for _ in s.proposal_samples
        ]
        shapes = {
            "density_0": (s.hidden, 2 * s.levels),
            "density_1": (GEOMETRY, s.hidden),
            "color_geometry": (s.hidden, GEOMETRY),
            "color_ray": (s.hidden, HARMONICS + s.appearance),
            "color_1": (s.hidden, s.hidden),
            "color_2": (4, s.hidden),
            "semantic_0": (s.hidden, GEOMETRY),
            "semantic_1": (NUM_CLASSES, s.hidden),
        }
        tables = {"table": self.grid.entries}
        for k, grid in enumerate(self.proposal_grids):
            shapes[f"proposal_{k}_0"] = (s.proposal_hidden, 2 * s.proposal_levels)
            shapes[f"proposal_{k}_1"] = (4, s.proposal_hidden)
            tables[f"proposal_{k}_table"] = grid.entries
        self.parameters: dict[str, np.ndarray] = {}
        for name, shape in shapes.items():
            bound = np.sqrt(6 / shape[1])  # He et al. 2015, for layers without bias before a relu
            self.parameters[name] = rng.uniform(-bound, bound, shape).astype(np.float32)
        self.parameters["color_2"][3] = 0  # the fourth row only fills the block
        for name, entries in tables.items():
            self.parameters[name] = rng.uniform(-1e-2, 1e-2, (entries, 2)).astype(np.float32)
        self.parameters["appearance"] = np.zeros((frames, s.appearance), np.float32)
        self._buffers: dict[str, np.ndarray] = {}

    # ---- the pieces of a ray's way through the field

    def _buffer(self, name: str, *shape: int) -> np.ndarray:
        """Scratch memory that is kept between steps: fresh pages cost more than the work done on them."""
        found = self._buffers.get(name)
        if found is None or found.shape != shape:
            found = self._buffers[name] = np.empty(shape, np.float32)
        return found

    def _matrices(self, names: tuple[str, ...]) -> tuple[np.ndarray, ...]:
        return tuple(self.parameters[name] for name in names)

    def _encode(self, name: str, grid: HashGrid, rays: tuple[np.ndarray, np.ndarray], edges: np.ndarray) -> tuple:
        """Contracted bin middles (3, N) and their features in blocks."""
        count, samples = edges.shape[0], edges.shape[1] - 1
        x = self._buffer(f"{name} x", 3, count * samples)
        volume.ray_points(*rays, edges, self.box.center, self.box.half, np.float32(self.box.shell), x)
        enc = self._buffer(f"{name} enc", count // BLOCK_RAYS, 2 * len(grid.offsets), BLOCK_RAYS * samples)
        hash_encode(x, self.parameters[name], grid.offsets, grid.resolutions, grid.masks, enc)
        return x, enc

    def _propose(self, rays: tuple[np.ndarray, np.ndarray], jitter: np.ndarray) -> tuple[np.ndarray, list]:
        """The final bins (R, S + 1), and what each proposal round needs to learn."""
        s, count = self.settings, len(jitter)
        edges = self._buffer("edges 0", count, s.proposal_samples[0] + 1)
        volume.first_edges(np.float32(s.near), np.float32(s.far), np.float32(s.turn), jitter, edges)
        rounds = []
        for k, (samples, following) in enumerate(
            zip(s.proposal_samples, (*s.proposal_samples[1:], s.samples), strict=True)
        ):
            x, enc = self._encode(f"proposal_{k}_table", self.proposal_grids[k], rays, edges)
            weights, raw = self._buffer(f"weights {k}", count, samples), self._buffer(f"raw {k}", count, samples)
            proposals.propose(self._matrices((f"proposal_{k}_0", f"proposal_{k}_1")), enc, edges, weights, raw)
            rounds.append((x, enc, edges, weights, raw))
            finer = self._buffer(f"edges {k + 1}", count, following + 1)
            volume.resample(edges, weights, jitter, np.float32(s.padding / samples), finer)
            edges = finer
        return edges, rounds

    def _ray_features(self, rays_d: np.ndarray, appearance: np.ndarray) -> np.ndarray:
        """(R / BLOCK_RAYS, F, BLOCK_RAYS) of unit directions and (R, E) embeddings."""
        harmonics = spherical_harmonics(torch.from_numpy(rays_d)).numpy()
        features = np.concatenate([harmonics, appearance], axis=1)
        return np.ascontiguousarray(features.reshape(-1, BLOCK_RAYS, features.shape[1]).transpose(0, 2, 1))

    # ---- training

    def train_step(
        self,
        rays: tuple[np.ndarray, np.ndarray],
        target: np.ndarray,
        labels: np.ndarray,
        frames: np.ndarray,
        rng: np.random.Generator,
        learn_proposals: bool = True,
    ) -> tuple[dict[str, np.ndarray], dict[str, float]]:
        """Losses and gradients of a batch.

        Args:
            rays: origins and unit directions, (R, 3) float32 each; R a multiple of BLOCK_RAYS.
            target: (R, 3) float32 colours in [0, 1].
            labels: (R,) int64 classes, NO_LABEL where there is none.
            frames: (R,) training image of each ray.
            rng: jitter and backgrounds.
            learn_proposals: whether the proposal networks learn in this step.

        Returns:
            gradients by parameter name (buffers that the next step reuses), and mean losses.
        """
        s, count = self.settings, len(target)
        jitter = rng.random(count, dtype=np.float32)
        # a random colour behind the last bin: a field that stays transparent is never right
        background = rng.random((count, 3), dtype=np.float32)
        edges, rounds = self._propose(rays, jitter)
        x, enc = self._encode("table", self.grid, rays, edges)
        features = self._ray_features(rays[1], self.parameters["appearance"][frames])
        weights, d_features = self._buffer("weights", count, s.samples), self._buffer("d features", *features.shape)
        matrices = self._matrices(MATRICES)
        sums = np.zeros((CHUNKS, 4))
        factors = 1 / (3 * count), s.semantic_weight / count, s.distortion_weight / count
        scales = np.array([*factors, s.turn, s.min_weight], np.float32)
        gradients = {name: np.zeros((CHUNKS, *self.parameters[name].shape), np.float32) for name in MATRICES}
        fused.train_rays(
            matrices, _transposed(matrices), tuple(gradients.values()), enc, features, edges, target, labels,
            background, scales, True, d_features, weights, self._buffer("color", count, 3), sums,
        )  # fmt: skip
        gradients = {name: value.sum(axis=0) for name, value in gradients.items()}
        gradients["table"] = self._table_gradient("table", self.grid, x, enc)
        if s.appearance:
            gradients["appearance"] = np.zeros_like(self.parameters["appearance"])
            d_appearance = d_features.transpose(0, 2, 1).reshape(count, -1)[:, HARMONICS:]
            np.add.at(gradients["appearance"], frames, d_appearance)
        interlevel = 0.0
        if learn_proposals:
            for k, learned in enumerate(rounds):
                interlevel += self._train_proposal(k, learned, edges, weights, gradients)
        squared, entropy, spread, correct = sums.sum(axis=0) / count
        losses = {"mse": squared / 3, "cross_entropy": entropy, "distortion": spread, "interlevel": interlevel}
        return gradients, {**losses, "class_accuracy": correct}

    def _train_proposal(self, k: int, learned: tuple, edges: np.ndarray, weights: np.ndarray, gradients: dict) -> float:
        x, enc, coarse_edges, coarse_weights, raw = learned
        names = (f"proposal_{k}_0", f"proposal_{k}_1")
        matrices = self._matrices(names)
        sums = np.zeros(CHUNKS)
        parts = tuple(np.zeros((CHUNKS, *m.shape), np.float32) for m in matrices)
        scale = np.float32(self.settings.interlevel_weight / len(edges))
        proposals.propose_backward(
            matrices, _transposed(matrices), parts, enc, coarse_edges, coarse_weights, raw, edges, weights, scale, sums
        )
        gradients.update(zip(names, (part.sum(axis=0) for part in parts), strict=True))
        name = f"proposal_{k}_table"
        gradients[name] = self._table_gradient(name, self.proposal_grids[k], x, enc)
        return float(sums.sum() / len(edges))

    def _table_gradient(self, name: str, grid: HashGrid, x: np.ndarray, d_enc: np.ndarray) -> np.ndarray:
        gradient = self._buffers.get(f"d {name}")
        if gradient is None:  # the optimiser clears it after use, so it is zeroed only here
            gradient = self._buffers[f"d {name}"] = np.zeros_like(self.parameters[name])
        hash_encode_backward(x, d_enc, grid.offsets, grid.resolutions, grid.masks, gradient)
        return gradient

    # ---- use

    def render_rays(self, rays_o: np.ndarray, rays_d: np.ndarray) -> tuple[np.ndarray, ...]:
        """Render rays, in pieces.

        Args:
            rays_o: (N, 3) float32 origins, metres.
            rays_d: (N, 3) float32 unit directions.

        Returns:
            color (N, 3), logits (N, C), depth (N,) median distance along the ray in metres, opacity (N,); float32.
        """
        color, depth = np.empty((len(rays_o), 3), np.float32), np.empty(len(rays_o), np.float32)
        logits, opacity = np.empty((len(rays_o), NUM_CLASSES), np.float32), np.empty(len(rays_o), np.float32)
        appearance = self.parameters["appearance"].mean(axis=0)
        piece = 4096
        for first in range(0, len(rays_o), piece):
            here = slice(first, min(first + piece, len(rays_o)))
            count = here.stop - here.start
            rays = _padded(rays_o[here]), _padded(rays_d[here])
            edges, _ = self._propose(rays, np.full(len(rays[0]), 0.5, np.float32))
            _, enc = self._encode("table", self.grid, rays, edges)
            features = self._ray_features(rays[1], np.broadcast_to(appearance, (len(rays[0]), len(appearance))))
            weights = self._buffer("weights", len(edges), self.settings.samples)
            out_color, out_depth = np.empty((len(edges), 3), np.float32), np.empty(len(edges), np.float32)
            out_logits = np.empty((len(edges), NUM_CLASSES), np.float32)
            smallest = np.float32(self.settings.min_weight)
            fused.render_rays(
                self._matrices(MATRICES), enc, features, edges, smallest, weights, out_color, out_logits, out_depth
            )
            color[here], logits[here], depth[here] = out_color[:count], out_logits[:count], out_depth[:count]
            opacity[here] = weights.sum(axis=1)[:count]
        return color, logits, depth, opacity

    def geometry(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) world points -> (N, 16) float32 outputs of the density network; the first is the log density."""
        out = np.empty((len(points), GEOMETRY), np.float32)
        piece, width = 1 << 17, 128
        for first in range(0, len(points), piece):
            x = self.box.contract(points[first : first + piece])
            count, blocks = len(x), -(-len(x) // width)
            x = np.ascontiguousarray(np.concatenate([x, np.zeros((blocks * width - count, 3), np.float32)]).T)
            enc = np.empty((blocks, 2 * len(self.grid.offsets), width), np.float32)
            hash_encode(x, self.parameters["table"], self.grid.offsets, self.grid.resolutions, self.grid.masks, enc)
            g = np.empty((blocks, GEOMETRY, width), np.float32)
            fused.geometry_features(self._matrices(MATRICES[:2]), enc, g)
            out[first : first + count] = g.transpose(0, 2, 1).reshape(-1, GEOMETRY)[:count]
        return out

    def ray_gradients(
        self, rays_o: np.ndarray, rays_d: np.ndarray, target: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Squared error of rays and its gradient, through the frozen field (section 4.3, task 4).

        The distances of the samples are held fixed, as they are in training.

        Args:
            rays_o: (N, 3) float32 origins, metres.
            rays_d: (N, 3) float32 unit directions.
            target: (N, 3) float32 colours in [0, 1].

        Returns:
            error (N,), mean over the channels; gradients (N, 3) for origins and for unit directions.
        """
        count = len(rays_o)
        rays, target = (_padded(rays_o), _padded(rays_d)), _padded(target)
        padded = len(target)
        edges, _ = self._propose(rays, np.full(padded, 0.5, np.float32))
        x, enc = self._encode("table", self.grid, rays, edges)
        directions = torch.from_numpy(rays[1]).requires_grad_()
        mean = self.parameters["appearance"].mean(axis=0)
        features = self._ray_features(rays[1], np.broadcast_to(mean, (padded, len(mean))))
        d_features, color = np.empty_like(features), np.empty((padded, 3), np.float32)
        matrices = self._matrices(MATRICES)
        unused = tuple(np.zeros((CHUNKS, *m.shape), np.float32) for m in matrices)
        fused.train_rays(
            matrices, _transposed(matrices), unused, enc, features, edges, target,
            np.full(padded, NO_LABEL), np.zeros((padded, 3), np.float32),
            np.array([1 / 3, 0, 0, self.settings.turn, self.settings.min_weight], np.float32),
            False, d_features, self._buffer("weights", padded, self.settings.samples), color,
            np.empty((CHUNKS, 4)),
        )  # fmt: skip
        d_x, d_o, d_d = np.empty_like(x), np.empty_like(rays[0]), np.empty_like(rays[1])
        grid, box = self.grid, self.box
        hash_encode_points_backward(x, self.parameters["table"], enc, grid.offsets, grid.resolutions, grid.masks, d_x)
        volume.ray_points_backward(*rays, edges, box.center, box.half, np.float32(box.shell), d_x, d_o, d_d)
        d_harmonics = d_features.transpose(0, 2, 1).reshape(padded, -1)[:, :HARMONICS]
        harmonics = spherical_harmonics(directions)
        upstream = torch.from_numpy(np.ascontiguousarray(d_harmonics))
        d_d += torch.autograd.grad(harmonics, directions, upstream)[0].numpy()
        return ((color - target) ** 2).mean(axis=1)[:count], d_o[:count], d_d[:count]


def _transposed(matrices: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    return tuple(np.ascontiguousarray(m.T) for m in matrices)


def _padded(rays: np.ndarray) -> np.ndarray:
    """Rows repeated at the end until they fill whole blocks."""
    missing = -len(rays) % BLOCK_RAYS
    return np.ascontiguousarray(np.concatenate([rays, np.repeat(rays[-1:], missing, axis=0)]) if missing else rays)
