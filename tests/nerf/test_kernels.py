"""Comparison of the fused CPU kernels with the torch reference: values and all gradients."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from autonerf_lab.nerf import rendering
from autonerf_lab.nerf.fields.hash_field import HashField, build_grid, surface_profile
from autonerf_lab.nerf.fields.torch_field import RenderedTensors
from autonerf_lab.nerf.fields.torch_hash_field import TorchHashField
from autonerf_lab.nerf.kernels import dense, volume_rendering
from autonerf_lab.nerf.kernels.volume_rendering import LOG_SIGMA_START, SurfaceProfile, surface_error
from autonerf_lab.nerf.model import Model
from autonerf_lab.nerf.models import semantic_nerfacto
from autonerf_lab.nerf.pose_offsets import level_weights
from autonerf_lab.nerf.ray_batch import Rays, Samples, Targets
from autonerf_lab.nerf.samplers.occupancy import OccupancySampler
from autonerf_lab.nerf.samplers.torch_occupancy import TorchOccupancySampler
from autonerf_lab.nerf.scene_box import SceneBox
from autonerf_lab.nerf.settings import OccupancySettings, ProposalSettings

RAYS = 64
BOX = SceneBox(np.zeros(3, np.float32), np.array([2, 1.5, 1], np.float32), 0.25)
SETTINGS = ProposalSettings(
    samples=8, proposal_samples=(12, 10), levels=4, log2_entries=10, hidden=16, appearance=4,
    proposal_levels=2, proposal_log2_entries=9, distortion_weight=0.5, semantic_weight=0.3, depth_weight=200.0,
    far=6.0, fine=0.2, min_weight=0.0, histogram_padding=0.05, sharpness=4.0, behind=0.5,
)  # fmt: skip


def small_models(settings: ProposalSettings = SETTINGS, classes: int = 16) -> tuple[Model, Model]:
    """Return two models with equal parameters: kernels in float32, autograd in double."""
    models = [
        semantic_nerfacto.build(settings, BOX, 3, classes, np.random.default_rng(0), device) for device in (None, "cpu")
    ]
    rng = np.random.default_rng(1)
    for name, value in models[0].parameters.items():
        if name.endswith(("table", "appearance")):  # large features reach all branches
            value[...] = rng.normal(size=value.shape)
        models[1].parameters[name].data = torch.from_numpy(np.asarray(value)).double()
    return models[0], models[1]


def some_rays(seed: int = 1) -> tuple[Rays, Targets]:
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(RAYS, 3))
    unit = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32)
    rays = Rays(rng.uniform(-1, 1, (RAYS, 3)).astype(np.float32), unit, rng.integers(3, size=RAYS))
    depth = rng.uniform(0.5, 5, RAYS).astype(np.float32) * (rng.random(RAYS) < 0.7)
    color, labels = rng.random((RAYS, 3), dtype=np.float32), rng.integers(-1, 16, RAYS)
    return rays, Targets(color, labels, depth, importance=rng.uniform(0.2, 2, RAYS).astype(np.float32))


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"view_dependent": False},
        {"depth_weight": 0.0},
        {"appearance": 0},
        {"density_gain": 2.0},
        {"levels": 5, "proposal_levels": 3, "proposal_ratio": 2.0},
        {"semantic_layers": 2},
    ],
)
def test_training_step_agrees_with_autograd(options: dict) -> None:
    kernels, reference = small_models(replace(SETTINGS, **options))
    rays, targets = some_rays()
    expected_gradients, expected = reference.train_step(rays, targets, np.random.default_rng(5))
    gradients, losses = kernels.train_step(rays, targets, np.random.default_rng(5))
    assert losses.keys() == expected.keys()
    for name, value in expected.items():
        assert losses[name] == pytest.approx(value, rel=1e-4), name
    assert gradients.keys() == expected_gradients.keys()
    for name, wanted in expected_gradients.items():
        assert np.abs(gradients[name] - wanted.numpy()).max() <= 2e-3 * wanted.abs().max(), name


def test_faded_levels_agree_with_autograd_and_closed_ones_do_not_matter() -> None:
    """After a quarter of the training, one level is on, one half way, and two are closed."""
    kernels, reference = small_models()
    rays, targets = some_rays()
    for model in (kernels, reference):
        model.field.set_level_weights(lambda levels: level_weights(levels, 0.25))
    expected_gradients, _ = reference.train_step(rays, targets, np.random.default_rng(5))
    gradients, losses = kernels.train_step(rays, targets, np.random.default_rng(5))
    for name, wanted in expected_gradients.items():
        assert np.abs(gradients[name] - wanted.numpy()).max() <= 2e-3 * wanted.abs().max(), name
    closed = build_grid(SETTINGS, BOX).offsets[2]
    table = kernels.parameters["table"]
    assert np.abs(gradients["table"][:closed]).max() > 0 and not gradients["table"][closed:].any()
    table[closed:] += 1
    for value in gradients.values():
        value[...] = 0
    assert kernels.train_step(rays, targets, np.random.default_rng(5))[1] == losses
    kernels.field.set_level_weights(lambda levels: level_weights(levels, 1.0))
    assert kernels.train_step(rays, targets, np.random.default_rng(5))[1] != losses


def test_a_field_without_classes_agrees_with_autograd() -> None:
    kernels, reference = small_models(classes=0)
    rays, targets = some_rays()
    expected_gradients, expected = reference.train_step(rays, targets, np.random.default_rng(5))
    gradients, losses = kernels.train_step(rays, targets, np.random.default_rng(5))
    assert losses.keys() == expected.keys() and "cross_entropy" not in losses
    for name, wanted in expected_gradients.items():
        if wanted.numel():
            assert np.abs(gradients[name] - wanted.numpy()).max() <= 2e-3 * wanted.abs().max(), name


def test_labels_weigh_as_much_as_their_confidence() -> None:
    """Kernels and autograd agree; a label of confidence 0 counts like none, and ones like no confidences."""
    kernels, reference = small_models()
    rays, targets = some_rays()
    trust = np.random.default_rng(2).random(RAYS).astype(np.float32)
    expected_gradients, expected = reference.train_step(rays, replace(targets, trust=trust), np.random.default_rng(5))
    gradients, losses = kernels.train_step(rays, replace(targets, trust=trust), np.random.default_rng(5))
    assert losses["cross_entropy"] == pytest.approx(expected["cross_entropy"], rel=1e-4)
    for name in ("semantic_0", "semantic_1", "density_1"):
        wanted = expected_gradients[name]
        assert np.abs(gradients[name] - wanted.numpy()).max() <= 2e-3 * wanted.abs().max(), name
    unlabelled = replace(targets, labels=np.where(trust < 0.5, -1, targets.labels))
    pairs = (
        (replace(targets, trust=np.ones(RAYS, np.float32)), targets),
        (replace(targets, trust=(trust >= 0.5).astype(np.float32)), unlabelled),
    )
    for weighted, plain in pairs:
        made = [
            kernels.train_step(rays, t, np.random.default_rng(5))[0]["semantic_1"].copy() for t in (weighted, plain)
        ]
        np.testing.assert_array_equal(*made)


def test_samples_around_a_measured_surface_learn_without_weight() -> None:
    """With a limit that no weight reaches, only the samples that the measured depth compares have a gradient."""
    rays, targets = some_rays()
    for depth, learns in ((np.full(RAYS, 3.0, np.float32), True), (np.zeros(RAYS, np.float32), False)):
        model = small_models(replace(SETTINGS, min_weight=1.0, samples=16))[0]
        gradients, _ = model.train_step(rays, replace(targets, depth=depth), np.random.default_rng(5))
        assert bool(np.abs(gradients["density_1"][0]).max() > 0) is learns


def test_surface_error_by_hand() -> None:
    """Bins at 0.9 and 1.02 m, surface at 1 m: wanted log densities are 4 - 10 = -6, at least -2, and 4 + 2 = 6."""
    profile = SurfaceProfile(*map(np.float32, (4.0, 100.0, -2.0, 0.05)))
    raw = np.float32([1.5, 3.5, 9.0]) - LOG_SIGMA_START  # log densities 1.5, 3.5 and 9
    starts, ends, d_raw = np.float32([0.8, 1.01, 1.1]), np.float32([1.0, 1.03, 1.2]), np.zeros(3, np.float32)
    total = surface_error(raw, starts, ends, np.float32(1), profile, np.float32(2), d_raw)
    assert total == pytest.approx(0.5 * (3.5**2 + 2.5**2) / 100**2, rel=1e-4)  # the third bin is too far behind
    np.testing.assert_allclose(d_raw, [2 * 3.5 / 100**2, -2 * 2.5 / 100**2, 0], rtol=1e-4)
    raw[0] = -5 - LOG_SIGMA_START  # emptier than asked for
    assert surface_error(raw[:1], starts, ends, np.float32(1), profile, np.float32(2), d_raw) == 0


def test_large_surface_errors_count_linearly() -> None:
    """An error of 5000 m, by kernel and torch: 1000 (5000 - 1000 / 2), with the gradient of an error of 1000 m."""
    settings = replace(SETTINGS, surface_density=1.0, sharpness=100.0)
    raw, starts, ends = np.float32([5e5]) - LOG_SIGMA_START, np.float32([1.0]), np.float32([1.0])
    d_raw = np.zeros(1, np.float32)
    profile = surface_profile(settings)
    assert surface_error(raw, starts, ends, np.float32(1), profile, np.float32(1), d_raw) == pytest.approx(4.5e6)
    tensor, edge = torch.from_numpy(raw[None]).requires_grad_(), torch.ones(1, 1)
    loss = rendering.surface_loss(tensor, edge, edge, torch.ones(1), settings)
    assert loss.item() == pytest.approx(4.5e6)
    loss.backward()
    assert d_raw[0] == pytest.approx(10) == tensor.grad.item()


def test_rendering_agrees_with_the_reference() -> None:
    kernels, reference = small_models()
    rays, _ = some_rays()
    found = kernels.render_rays(rays.origins[:61], rays.directions[:61])
    wanted = reference.render_rays(rays.origins[:61], rays.directions[:61])
    for a, b in zip(found, wanted, strict=True):
        assert a.shape == b.shape and a.dtype == np.float32
        np.testing.assert_allclose(a, b, rtol=2e-3, atol=2e-4)


@pytest.mark.parametrize("gain", [1.0, 2.0])
def test_queries_agree_with_the_reference(gain: float) -> None:
    kernels, reference = small_models(replace(SETTINGS, density_gain=gain))
    points = np.random.default_rng(2).uniform(-3, 3, (200, 3))
    directions = some_rays()[0].directions[np.arange(200) % RAYS]
    for a, b in (
        (kernels.field.density(points), reference.field.density(points)),
        (kernels.field.color(points, directions), reference.field.color(points, directions)),
        (kernels.field.logits(points), reference.field.logits(points)),
    ):
        # rounding moves a few points into the next cell, with another slope
        assert np.quantile(np.abs(a - b), 0.99) <= 2e-3 * np.abs(b).max()


def test_gradients_of_rays_agree_with_autograd() -> None:
    kernels, reference = small_models()
    rays, targets = some_rays()
    samples = kernels.sampler.sample(rays, np.full(RAYS, 0.5, np.float32))
    assert isinstance(kernels.field, HashField) and isinstance(reference.field, TorchHashField)
    found = kernels.field.ray_gradients(rays, samples, targets.color)
    wanted = reference.field.ray_gradients(rays, samples, targets.color)
    np.testing.assert_allclose(found[0], wanted[0], rtol=5e-3, atol=1e-5)
    learned, expected = (
        m.field.train(rays, samples, targets, np.random.default_rng(3), True) for m in (kernels, reference)
    )
    pairs = [*zip(found[1:], wanted[1:], strict=True)]
    pairs += [(learned.d_origins, expected.d_origins), (learned.d_directions, expected.d_directions)]
    for a, b in pairs:
        assert a is not None and b is not None
        # The slope of a trilinear cell jumps at its faces, and rounding moves a few samples to the other side.
        assert np.quantile(np.abs(a - b), 0.95) <= 1e-3 * np.abs(b).max()


class Shells:
    """Stand-in for a field: density where the distance from the origin is 1 to 1.5, 2 to 2.5 and so on."""

    def __init__(self, density: float) -> None:
        self._density = np.float32(density)

    def density(self, points: np.ndarray) -> np.ndarray:
        radius = np.linalg.norm(points, axis=1)
        return self._density * ((radius >= 1) & (radius % 1 < 0.5))


def test_marching_agrees_with_the_reference_and_skips_empty_cells() -> None:
    settings = OccupancySettings(samples=12, marched=20, candidates=64, cell=0.25, far=6.0, reach=0.5, levels=4)
    field = Shells(4)
    kernels, reference = OccupancySampler(settings, BOX, field), TorchOccupancySampler(settings, BOX, field, "cpu")
    rng = np.random.default_rng(4)
    density = (rng.random(kernels.state["occupancy"].shape) < 0.2) * rng.exponential(
        20, kernels.state["occupancy"].shape
    )
    for sampler in (kernels, reference):
        sampler.state["occupancy"][...] = density
    rays, _ = some_rays()
    for jitter in (np.full(RAYS, 0.5, np.float32), rng.random(RAYS, dtype=np.float32)):
        a, b = kernels.sample(rays, jitter), reference.sample(rays, jitter)
        close = np.isclose(a.starts, b.starts, atol=2e-4) & np.isclose(a.ends, b.ends, atol=2e-4)
        assert close.mean() > 0.97  # rounding moves a few steps of a ray into the next cell
        assert (a.starts[:, 1:] >= a.ends[:, :-1] - 1e-4).all()
        middles = rays.origins[:, None] + a.midpoints[..., None] * rays.directions[:, None]
        cells = (BOX.contract(middles.reshape(-1, 3)) * density.shape).astype(int)
        assert (density[tuple(cells.T)] > 0).mean() > 0.8  # steps along the ray sample the cells approximately


def test_a_ray_through_empty_space_is_divided_over_its_whole_length() -> None:
    settings = OccupancySettings(samples=4, candidates=32, near=1.0, far=3.0, turn=4.0, levels=4)
    sampler = OccupancySampler(settings, BOX, Shells(0))
    sampler.state["occupancy"][...] = 0
    sampler.state["occupancy"][0, 0, 0] = 1e6  # raises the mean, so that no other cell counts as occupied
    rays = Rays(np.zeros((8, 3), np.float32), np.tile(np.float32([1, 0, 0]), (8, 1)))
    samples = sampler.sample(rays, np.full(8, 0.5, np.float32))
    np.testing.assert_allclose(samples.starts[0], [1, 1.5, 2, 2.5], atol=1e-3)
    np.testing.assert_allclose(samples.ends[0], [1.5, 2, 2.5, 3], atol=1e-3)


def test_a_ray_ends_where_the_field_is_dense_and_not_where_a_cell_of_the_grid_is() -> None:
    settings = OccupancySettings(samples=4, marched=20, candidates=64, near=0.5, far=2.5, turn=4.0, levels=4, reach=9.0)
    rays = Rays(np.zeros((8, 3), np.float32), np.tile(np.float32([1, 0, 0]), (8, 1)))
    ends = {}
    for density in (0, 12, 1000):
        sampler = OccupancySampler(settings, BOX, Shells(density))
        sampler.state["occupancy"][...] = 1000
        samples = sampler.sample(rays, np.full(8, 0.5, np.float32))
        np.testing.assert_allclose(samples.starts[:, 1:], samples.ends[:, :-1], atol=1e-3)
        np.testing.assert_allclose(samples.starts[:, 0], 0.5, atol=1e-3)
        ends[density] = samples.ends[0, -1]
    # Marched bins of 10 cm begin at 0.5 m. An optical depth of 9.2 takes 77 cm of 12 per metre: 50 cm in the shell from
    # 1 m, and 27 cm, which are three bins, in the shell from 2 m. Of 1000 per metre it takes one bin.
    assert ends == pytest.approx({0: 2.5, 12: 2.3, 1000: 1.1}, abs=1e-3)


def test_bins_with_gaps() -> None:
    kernels, reference = small_models()
    rays, targets = some_rays()
    edges = np.sort(np.random.default_rng(6).uniform(0.1, 5, (RAYS, 16)), axis=1).astype(np.float32)
    samples = Samples(np.ascontiguousarray(edges[:, ::2]), np.ascontiguousarray(edges[:, 1::2]))
    a, b = (m.field.train(rays, samples, targets, np.random.default_rng(3), False) for m in (kernels, reference))
    np.testing.assert_allclose(a.weights, b.weights, rtol=2e-3, atol=1e-5)
    for name, value in b.losses.items():
        assert a.losses[name] == pytest.approx(value, rel=1e-4), name


def test_any_number_of_rays_is_accepted() -> None:
    """37 rays do not fill whole tiles; padding adds no loss and no gradient."""
    kernels, reference = small_models()
    rays, targets = some_rays()
    assert rays.frames is not None
    rays = Rays(rays.origins[:37], rays.directions[:37], rays.frames[:37])
    assert targets.importance is not None
    targets = Targets(targets.color[:37], targets.labels[:37], targets.depth[:37], importance=targets.importance[:37])
    expected_gradients, expected = reference.train_step(rays, targets, np.random.default_rng(5))
    gradients, losses = kernels.train_step(rays, targets, np.random.default_rng(5))
    for name, value in expected.items():
        assert losses[name] == pytest.approx(value, rel=1e-4), name
    for name, wanted in expected_gradients.items():
        assert np.abs(gradients[name] - wanted.numpy()).max() <= 2e-3 * wanted.abs().max(), name
    samples = kernels.sampler.sample(rays, np.full(37, 0.5, np.float32))
    assert samples.starts.shape == (37, SETTINGS.samples)
    output = kernels.field.train(rays, samples, targets, np.random.default_rng(3), True)
    assert output.weights.shape == samples.starts.shape and output.d_origins is not None
    assert output.d_origins.shape == (37, 3) and kernels.field.render(rays, samples).color.shape == (37, 3)


def test_the_distortion_of_two_bins_by_hand() -> None:
    """Bins [0, 1] and [2, 4] m with the weights 0.5 and 0.25; distances are halved up to ``turn`` = 4 m: s = t / 8.

    Midpoints 1/16 and 6/16: 2 * 0.5 * 0.25 * 5/16 between the bins, and (0.5**2 / 8 + 0.25**2 / 4) / 3 inside of them.
    The gradient of w_i is 2 * (w_j * 5/16 + w_i * width_i / 3).
    """
    starts, ends, weights = (np.float32(a) for a in ([0, 2], [1, 4], [0.5, 0.25]))
    d_weights = np.float32([10, 20])
    loss = volume_rendering.distortion(starts, ends, weights, np.float32(4), np.float32(3), d_weights)
    assert loss == pytest.approx(0.25 * 5 / 16 + (0.25 / 8 + 0.0625 / 4) / 3)
    added = [2 * (0.25 * 5 / 16 + 0.5 / 8 / 3), 2 * (0.5 * 5 / 16 + 0.25 / 4 / 3)]
    assert d_weights == pytest.approx([10 + 3 * added[0], 20 + 3 * added[1]])


def test_a_custom_loss_extends_the_loss_of_the_field() -> None:
    class OpaqueField(TorchHashField):
        def loss(self, rendered: RenderedTensors, targets: Targets) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
            total, losses = super().loss(rendered, targets)
            losses["transparency"] = rendered.left.mean()
            return total + losses["transparency"], losses

    plain, opaque = (
        kind(SETTINGS, BOX, 3, 16, np.random.default_rng(0), "cpu") for kind in (TorchHashField, OpaqueField)
    )
    rays, targets = some_rays()
    samples = small_models()[0].sampler.sample(rays, np.full(RAYS, 0.5, np.float32))
    a, b = (field.train(rays, samples, targets, np.random.default_rng(3), False) for field in (plain, opaque))
    assert b.losses["transparency"] == pytest.approx(1 - float(b.weights.sum(axis=1).mean()), abs=1e-5)
    assert {name: b.losses[name] for name in a.losses} == a.losses
    assert not torch.equal(a.gradients["density_1"], b.gradients["density_1"])


@pytest.mark.parametrize(("rows", "columns", "n"), [(4, 4, 16), (8, 20, 48), (16, 6, 32), (0, 4, 16), (4, 4, 0)])
def test_dense_layers_are_products_of_matrices(rows: int, columns: int, n: int) -> None:
    """Integer values are summed without rounding in any order; columns beyond n stay unchanged."""
    rng = np.random.default_rng(7)
    weights, x, y, upstream = (
        rng.integers(-9, 10, shape).astype(np.float32)
        for shape in ((rows, columns), (columns, 64), (rows, 64), (rows, 64))
    )
    product = weights @ x[:, :n]
    for kernel, expected in ((dense.dense, product), (dense.dense_add, y[:, :n] + product)):
        out = y.copy()
        kernel(weights, x, out, n)
        np.testing.assert_array_equal(out, np.hstack([expected, y[:, n:]]))
    gradient = weights.copy()
    dense.weight_gradient(y, x, gradient, n)
    np.testing.assert_array_equal(gradient, weights + y[:, :n] @ x[:, :n].T)
    out = y.copy()
    dense.relu(out, n)
    np.testing.assert_array_equal(out, np.hstack([np.maximum(y[:, :n], 0), y[:, n:]]))
    out = upstream.copy()
    dense.relu_backward(y, out, n)
    np.testing.assert_array_equal(out, np.hstack([upstream[:, :n] * (y[:, :n] > 0), upstream[:, n:]]))
