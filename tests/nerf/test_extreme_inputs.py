"""Kernels, torch reference, samplers and pose offsets with extreme inputs: every result is finite.

fastmath assumes that no value is infinite or NaN, so that exponentials, logarithms, quotients and roots need bounds.
Inputs are drawn from zeros, the smallest and largest values that the settings and networks allow, and in between.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch

from autonerf_lab.nerf import rendering
from autonerf_lab.nerf.kernels import (
    distance_grid,
    hash_encoding,
    hash_field,
    proposals,
    ray_marching,
    volume_rendering,
)
from autonerf_lab.nerf.kernels.adam import SERIAL_SIZE, adam
from autonerf_lab.nerf.kernels.tiling import TILE_RAYS
from autonerf_lab.nerf.models import MODELS, model_spec
from autonerf_lab.nerf.optimizer import Adam
from autonerf_lab.nerf.pose_offsets import PoseOffsets
from autonerf_lab.nerf.ray_batch import Rays, Targets, TrainOutput, to_numpy
from autonerf_lab.nerf.scene_box import SceneBox
from autonerf_lab.nerf.settings import SurfaceSettings

SETTINGS = SurfaceSettings()
SMALL = {"samples": 8, "levels": 4, "log2_entries": 8, "hidden": 16}  # sizes of the models, where they have them
SMALL |= {"layers": 3, "skip": 1, "width": 16, "coarse_samples": 8, "fine_samples": 8}
SAMPLES, SEEDS = 16, range(8)
TINY = np.float32([0, 1e-45, 1e-40, 1.2e-38, 1e-20, 1e-12, 1e-7])  # zero, denormal and small values
NETWORK = np.concatenate([TINY, np.float32([1, 80, 90, 1e4, 1e10, 1e20, 1e30, 1e38])])  # outputs of a network
PROFILE = volume_rendering.SurfaceProfile(*map(np.float32, (4.2, 120.0, -6.5, 0.04)))


def draw(rng, values, *shape, signed=True):
    """Return float32 values of extreme size."""
    found = rng.choice(values, shape) * (rng.choice([-1, 1], shape) if signed else 1)
    return found.astype(np.float32)


def bins(rng, rays, count=SAMPLES):
    """Return (rays, count + 1) increasing edges: many bins are empty or tiny, others reach to the largest setting."""
    steps = draw(rng, np.concatenate([TINY, np.float32([0.1, 1, 100, 1e6])]), rays, count + 1, signed=False)
    return np.cumsum(steps, axis=1, dtype=np.float32)


def histogram(rng, rays, count=SAMPLES):
    """Return (rays, count) weights with a sum of at most 1; of some rays all are zero."""
    weights = draw(rng, np.concatenate([TINY, np.float32([1e-3, 0.1, 1])]), rays, count, signed=False)
    weights[rng.random(rays) < 0.3] = 0
    return weights / np.maximum(weights.sum(axis=1, keepdims=True), 1)


def ray_weights(rng):
    raw, edges = draw(rng, NETWORK, 1, SAMPLES), bins(rng, 1)
    weights, d_raw = np.empty(SAMPLES, np.float32), np.empty(SAMPLES, np.float32)
    left = volume_rendering.ray_weights(raw[0], edges[0, :-1], edges[0, 1:], weights)
    assert weights.min() >= 0 and weights.sum() + left == pytest.approx(1, abs=1e-5)
    d_weights = draw(rng, NETWORK[:-4], SAMPLES)
    volume_rendering.ray_weights_backward(
        raw[0], edges[0, :-1], edges[0, 1:], weights, np.float32(left), d_weights, np.float32(1e4), d_raw
    )
    depth = volume_rendering.median_depth(edges[0, :-1], edges[0, 1:], histogram(rng, 1)[0])
    assert edges[0, 0] <= depth <= edges[0, -1] * (1 + 1e-6)
    return weights, d_raw


def warps(rng):
    turn = draw(rng, np.float32([1e-12, 1e-3, 1, 1e6]), 1, signed=False)[0]
    t = draw(rng, np.concatenate([NETWORK, np.float32([turn, 3e38])]), 40, signed=False)
    found = np.float32([volume_rendering.warp(value, turn) for value in t])
    assert found.min() >= 0 and found.max() <= 1
    edges = np.empty((4, SAMPLES + 1), np.float32)
    far = np.float32(rng.choice([1e-3, 1, 1e6]))
    volume_rendering.first_edges(np.float32(rng.choice([0, 1e-12, 1e-4])), far, turn, rng.random(4, np.float32), edges)
    assert (np.diff(edges, axis=1) >= -1e-6 * far).all() and edges.max() <= far * 1.2 + turn
    return found, edges


def losses_along_a_ray(rng):
    edges, weights, d_weights = bins(rng, 1)[0], histogram(rng, 1)[0], draw(rng, NETWORK[:-4], SAMPLES)
    turn = np.float32(rng.choice([1e-12, 4.0, 1e6]))
    spread = volume_rendering.distortion(edges[:-1], edges[1:], weights, turn, np.float32(1e6), d_weights)
    fine, d_proposal = histogram(rng, 1)[0], np.empty(SAMPLES, np.float32)
    bound = volume_rendering.interlevel(edges, weights, bins(rng, 1)[0], fine, np.float32(1e6), d_proposal)
    raw, d_raw = draw(rng, NETWORK[:-1], SAMPLES), np.zeros(SAMPLES, np.float32)
    depth = np.float32(rng.choice([1e-45, 1e-7, 0.5, 65.5, 1e6]))
    error = volume_rendering.surface_error(raw, edges[:-1], edges[1:], depth, PROFILE, np.float32(1), d_raw)
    return np.float64([spread, bound, error]), d_weights, d_proposal, d_raw


def points_on_rays(rng):
    rays_o, rays_d = draw(rng, NETWORK[:12], 4, 3), draw(rng, np.float32([0, 1e-45, 1e-20, 0.6, 1]), 4, 3)
    t = bins(rng, 4, SAMPLES - 1)
    half = draw(rng, np.float32([1e-12, 0.1, 1.5, 1e6]), 3, signed=False)
    center, shell = draw(rng, NETWORK[:12], 3), np.float32(rng.choice([1e-12, 0.25, 1, 1e6]))
    x = np.empty((3, 4 * SAMPLES), np.float32)
    volume_rendering.ray_points(rays_o, rays_d, t, center, half, shell, x)
    assert x.min() >= -1e-6 and x.max() <= 1 + 1e-6
    d_o, d_d = np.empty((4, 3), np.float32), np.empty((4, 3), np.float32)
    half, d_x = np.maximum(half, np.float32(0.1)), draw(rng, NETWORK[:-4], *x.shape)
    volume_rendering.ray_points_backward(rays_o, rays_d, t, center, half, shell, d_x, d_o, d_d)
    return x, d_o, d_d


def resampling(rng):
    edges, out = bins(rng, 6), np.empty((6, 25), np.float32)
    padding = np.float32(rng.choice([1e-38, 1e-12, 1e-3]))
    volume_rendering.resample(edges, histogram(rng, 6), rng.random(6, np.float32), padding, out)
    assert (np.diff(out, axis=1) >= -1e-5 * edges[:, -1:]).all() and out.max() <= edges.max() * (1 + 1e-6)
    return (out,)


def colours_and_classes(rng):
    """Sigmoid of the colours, and softmax and logarithm of the cross entropy."""
    n = TILE_RAYS
    matrices = hash_field.FieldMatrices(*(np.zeros(shape, np.float32) for shape in [(4, 4)] * 9))
    matrices = matrices._replace(color_2=draw(rng, NETWORK, 4, 4), color_1=np.eye(4, dtype=np.float32))
    g, c0, c1, rgb, s0, s1 = (np.zeros((4, n), np.float32) for _ in range(6))
    hash_field._heads(matrices, np.eye(4, n, dtype=np.float32), np.eye(n, dtype=np.float32), n, g, c0, c1, rgb, s0, s1)
    assert rgb[:3].min() >= 0 and rgb[:3].max() <= 1
    logits, d_logits = draw(rng, NETWORK, 16, n), np.empty((16, n), np.float32)
    labels, trust = rng.integers(-1, 17, n), draw(rng, TINY, n, signed=False)
    entropy, _ = hash_field._cross_entropy(logits, labels, trust, 0, np.float32(1), d_logits)
    return rgb[:3], d_logits, np.float64([entropy])


def proposal_networks(rng):
    """Values up to 1e18 in the products: their sums must stay below the end of float32."""
    values = NETWORK[NETWORK < 1e11]
    shapes = {"hidden": (4, 4), "output": (4, 4)}
    matrices = proposals.ProposalMatrices(*(draw(rng, values[:-1], *shape) for shape in shapes.values()))
    transposed = proposals.ProposalMatrices(*(np.ascontiguousarray(m.T) for m in matrices))
    gradients = proposals.ProposalMatrices(*(np.zeros((16, 4, 4), np.float32) for _ in matrices))
    enc, edges = draw(rng, TINY, 1, 4, TILE_RAYS * SAMPLES), bins(rng, TILE_RAYS)
    weights, raw = (np.empty((TILE_RAYS, SAMPLES), np.float32) for _ in range(2))
    proposals.propose(matrices, enc, edges, weights, raw)
    fine, losses = histogram(rng, TILE_RAYS), np.zeros(16)
    proposals.propose_backward(
        matrices, transposed, gradients, enc, edges, weights, raw, edges, fine, np.float32(1), losses
    )
    return weights, raw, losses, *gradients


def occupied_bins(rng):
    rays, shape = 8, (3, 4, 5)
    density = draw(rng, np.concatenate([TINY, np.float32([0.1, 1, 14765])]), *shape, signed=False)
    starts, ends = np.empty((rays, SAMPLES), np.float32), np.empty((rays, SAMPLES), np.float32)
    rays_o, rays_d = draw(rng, NETWORK[:11], rays, 3), draw(rng, np.float32([0, 1e-20, 0.6, 1]), rays, 3)
    half = draw(rng, np.float32([1e-12, 1.5, 1e6]), 3, signed=False)
    threshold, reach = (np.float32(rng.choice([1e-12, 0.1, 1e6])) for _ in range(2))
    ray_marching.occupied_bins(
        rays_o, rays_d, bins(rng, rays, 32), half * 0, half, np.float32(0.25), density, threshold, reach,
        rng.random(rays, np.float32), starts, ends,
    )  # fmt: skip
    return starts, ends


def visible_bins(rng):
    edges, density = bins(rng, 8, 32), draw(rng, np.concatenate([TINY, np.float32([0.1, 14765])]), 8, 32, signed=False)
    starts, ends = np.empty((8, SAMPLES), np.float32), np.empty((8, SAMPLES), np.float32)
    ray_marching.visible_bins(edges[:, :-1], edges[:, 1:], density, rng.random(8, np.float32), starts, ends)
    return starts, ends


def surface_bins(rng):
    rays = 8
    grid = rng.choice(np.int16([-32768, -90, 0, 1, 90, 32766, 32767]), (6, 5, 4))
    depth, edges = draw(rng, np.float32([0, 1e-45, 1e-7, 0.5, 65.5, 1e6, 1e30]), rays, signed=False), None
    edges = np.empty((rays, SAMPLES + 1), np.float32)
    rays_o, rays_d = draw(rng, NETWORK[:11], rays, 3), draw(rng, np.float32([0, 1e-20, 0.6, 1]), rays, 3)
    voxel = np.float32(rng.choice([1e-3, 0.03, 1e6]))
    near, far = np.float32(0.05), np.float32(rng.choice([0.1, 16, 1e6]))
    distance_grid.surface_bins(
        rays_o, rays_d, depth, np.zeros(3, np.float32), voxel, grid, near, far, np.float32(0.06), np.float32(0.05),
        np.float32(0.04), rng.random(rays, np.float32), edges,
    )  # fmt: skip
    assert (np.diff(edges, axis=1) >= -1e-5 * np.abs(edges[:, -1:])).all()
    surfaces = np.empty(rays, np.float32)
    distance_grid.surface_depth(
        rays_o, rays_d, depth, np.zeros(3, np.float32), voxel, grid, np.float32(0.135), surfaces
    )
    assert ((surfaces == 0) | (np.abs(surfaces - depth) < 0.135)).all()
    return edges, surfaces


def hash_features(rng):
    x = draw(rng, np.concatenate([TINY, np.float32([0.5, 1 - 6e-8, 1])]), 3, TILE_RAYS, signed=False)
    table = draw(rng, NETWORK[NETWORK < 1e31], 5**3 + 64, 2)
    offsets, resolutions = np.array([0, 125]), np.array([[4, 4, 4], [512, 512, 512]])
    out, d_table = np.empty((1, 4, TILE_RAYS), np.float32), np.zeros_like(table)
    hash_encoding.hash_encode(x, table, offsets, resolutions, np.array([0, 63]), out)
    d_out = draw(rng, NETWORK[NETWORK < 1e31], *out.shape)
    hash_encoding.hash_encode_backward(x, d_out, offsets, resolutions, np.array([0, 63]), d_table)
    return out, d_table


def adam_steps(rng):
    """Gradients without a limit, also infinite ones; moments of any earlier step."""
    count = SERIAL_SIZE + 100 if rng.random() < 0.2 else 100
    p, g = draw(rng, NETWORK, count), draw(rng, np.append(NETWORK, np.float32(np.inf)), count)
    m, v = draw(rng, NETWORK[:12], count), draw(rng, NETWORK[:-2], count, signed=False)
    step = int(rng.choice([1, 2, 1000, 10**6]))
    adam(p, g, m, v, np.float32(1e-2), step)
    return p, m, v


@pytest.mark.parametrize(
    "kernel",
    [
        *(ray_weights, warps, losses_along_a_ray, points_on_rays, resampling, colours_and_classes, proposal_networks),
        *(occupied_bins, visible_bins, surface_bins, hash_features, adam_steps),
    ],
)
def test_kernels(kernel):
    for seed in SEEDS:
        for k, values in enumerate(kernel(np.random.default_rng(seed))):
            assert np.isfinite(values).all(), (kernel.__name__, seed, k)


def volume(rng):
    """Functions of autonerf_lab.nerf.rendering with their gradients, in the order of a training step."""
    raw = tensor(draw(rng, NETWORK[:-1], 4, SAMPLES))
    edges = torch.from_numpy(bins(rng, 4))
    starts, ends = edges[:, :-1], edges[:, 1:]
    turn = float(rng.choice([1e-12, 4.0, 1e6]))
    weights = rendering.weights_from_density(rendering.density_from_raw(raw), starts, ends)
    depth = torch.from_numpy(rng.choice(np.float32([0, 1e-45, 0.5, 65.5, 1e6]), 4))
    fine = torch.from_numpy(histogram(rng, 4))
    losses = [
        rendering.distortion_loss(weights, starts, ends, turn),
        rendering.interlevel_loss(edges, weights, torch.from_numpy(bins(rng, 4)), fine),
        rendering.surface_loss(raw, starts, ends, depth, SETTINGS),
        rendering.composite(weights, torch.sigmoid(tensor(draw(rng, NETWORK, 4, SAMPLES, 3)))).sum(dim=1),
    ]
    (gradient,) = torch.autograd.grad(sum(loss.sum() for loss in losses), raw)
    return weights, gradient, rendering.median_depth(fine, starts, ends), *losses


def points(rng):
    half = draw(rng, np.float32([1e-12, 0.1, 1.5, 1e6]), 3, signed=False)
    box = SceneBox(draw(rng, NETWORK[:12], 3), half, float(rng.choice([1e-12, 0.25, 1e6])))
    places = tensor(draw(rng, NETWORK[:13], 50, 3))
    found = box.contract_tensor(places)
    assert found.min() >= -1e-6 and found.max() <= 1 + 1e-6
    inside = box.expand(rng.choice([1e-45, 1e-12, 0.5, 1 - 1e-12], (50, 3)))
    return found, box.contract(places.detach().numpy()), inside


def placed_bins(rng):
    near, far, turn = float(rng.choice([0, 1e-12])), float(rng.choice([1e-3, 1e6])), float(rng.choice([1e-12, 4, 1e6]))
    jitter = torch.from_numpy(rng.random(4, np.float32))
    edges = rendering.first_edges(near, far, turn, jitter, SAMPLES)
    finer = rendering.resample(torch.from_numpy(bins(rng, 4)), torch.from_numpy(histogram(rng, 4)), jitter, 1e-12, 20)
    density = draw(rng, np.concatenate([TINY, np.float32([0.1, 14765])]), 4, SAMPLES, signed=False)
    density = torch.from_numpy(density)
    starts, ends = rendering.occupied_bins(edges, density, 0.1, 1e6, jitter, SAMPLES)
    return edges, finer, starts, ends, *rendering.visible_bins(starts, ends, density, jitter, 8)


def adam_of_tensors(rng):
    value = {"p": tensor(draw(rng, NETWORK, 100))}
    optimizer = Adam(value)
    for _ in range(3):
        gradient = torch.from_numpy(draw(rng, np.append(NETWORK, np.float32(np.inf)), 100))
        optimizer.step({"p": gradient}, {"p": 1e-2})
    return value["p"], optimizer.first["p"], optimizer.second["p"]


def tensor(values):
    return torch.from_numpy(values).requires_grad_()


@pytest.mark.parametrize("function", [volume, points, placed_bins, adam_of_tensors])
def test_torch_reference(function):
    for seed in SEEDS:
        for k, values in enumerate(function(np.random.default_rng(seed))):
            assert np.isfinite(to_numpy(values)).all(), (function.__name__, seed, k)


@pytest.fixture(params=[(name, device) for name in MODELS for device in (None, "cpu")], ids=str)
def batch(request):
    """A small model of each kind, with kernels and with torch, and a batch of rays with extreme values."""
    name, device = request.param
    spec = model_spec(name)
    small = {key: value for key, value in SMALL.items() if hasattr(spec.settings["smoke"], key)}
    settings = replace(spec.settings["smoke"], **small)
    box = SceneBox(np.zeros(3, np.float32), np.ones(3, np.float32), 0.25)
    model = spec.build(settings, box, 3, 16, np.random.default_rng(0), device)
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(32, 3)).astype(np.float32)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    rays = Rays(draw(rng, NETWORK[:9], 32, 3), directions, rng.integers(3, size=32))
    depth = draw(rng, np.float32([0, 1e-45, 0.5, 65.5, 1e6]), 32, signed=False)
    color = draw(rng, np.float32([0, 1e-45, 1]), 32, 3, signed=False)
    return model, rays, Targets(color, rng.integers(-1, 16, 32), depth)


def check_step(model, rays, targets, what):
    """A training step and a rendering have finite losses, gradients and images."""
    gradients, losses = model.train_step(rays, targets, np.random.default_rng(2))
    assert all(np.isfinite(loss) for loss in losses.values()), (what, losses)
    for key, value in gradients.items():
        assert np.isfinite(to_numpy(value)).all(), (what, key)
    for value in model.render_rays(rays.origins, rays.directions):
        assert np.isfinite(value).all(), what


@pytest.mark.parametrize("scale", [0.0, 1e-45, 1e-3, 1e3])
def test_whole_step_with_all_parameters_extreme(batch, scale):
    model, rays, targets = batch
    rng = np.random.default_rng(1)
    for value in model.parameters.values():
        found = to_numpy(value)
        found[...] = rng.choice([-1, 1], found.shape) * np.float32(scale)
    check_step(model, rays, targets, scale)


def test_whole_step_with_one_layer_extreme(batch):
    """Features, densities, colours and logits are extreme in turn: each array of the model drives its outputs."""
    model, rays, targets = batch
    rng = np.random.default_rng(1)
    for name, value in model.parameters.items():
        found = to_numpy(value)
        initial, mixed = found.copy(), rng.choice([-1, 1], found.shape)
        for scale in (0, 1e4, -1e4, 1e30, -1e30):
            for signs in (1, mixed):
                found[...] = signs * np.float32(scale)
                check_step(model, rays, targets, (name, scale, signs))
        found[...] = initial


def test_no_rays(batch):
    model, rays, _ = batch
    none = rays.origins[:0]
    assert [value.shape for value in model.render_rays(none, none)] == [(0, 3), (0, 16), (0,), (0,)]
    assert [value.shape for value in model.ray_gradients(none, none, none)] == [(0,), (0, 3), (0, 3)]


def test_pose_offsets():
    """Rotation vectors of any length, and gradients up to the largest that a step passes on."""
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        offsets = PoseOffsets(5)
        for value in offsets.parameters.values():
            value[...] = draw(rng, NETWORK[:-1], *value.shape)
        rays = Rays(
            np.zeros((20, 3), np.float32), draw(rng, np.float32([0, 1e-45, 1]), 20, 3), rng.integers(5, size=20)
        )
        d_o, d_d = draw(rng, NETWORK[:-1], 20, 3), draw(rng, NETWORK[:-1], 20, 3)
        found = offsets.gradients(rays, TrainOutput({}, {}, np.zeros(0, np.float32), d_o, d_d))
        turned = offsets.rotations()
        np.testing.assert_allclose(turned @ np.swapaxes(turned, 1, 2), np.tile(np.eye(3), (5, 1, 1)), atol=1e-5)
        assert all(np.isfinite(value).all() for value in found.values())
