"""The fused CPU kernels against the torch reference: values and every gradient."""

import numpy as np
import pytest
import torch

from autonerf_lab.nerf import reference
from autonerf_lab.nerf.nerfacto import SemanticNerfacto
from autonerf_lab.nerf.scene_box import SceneBox
from autonerf_lab.nerf.settings import NerfactoSettings

RAYS = 64


def small_model(seed: int = 0) -> SemanticNerfacto:
    settings = NerfactoSettings(
        samples=8, proposal_samples=(12, 10), levels=4, log2_entries=10, hidden=16, appearance=4,
        proposal_levels=2, proposal_log2_entries=9, distortion_weight=0.5, semantic_weight=0.3, far=6.0,
        min_weight=0.0, padding=0.5,
    )  # fmt: skip
    rng = np.random.default_rng(seed)
    box = SceneBox(np.zeros(3, np.float32), np.array([2, 1.5, 1], np.float32), 0.25)
    model = SemanticNerfacto(settings, box, 3, rng)
    for name in ("table", "proposal_0_table", "proposal_1_table"):  # large features: every branch is taken
        model.parameters[name] = rng.normal(size=model.parameters[name].shape).astype(np.float32)
    model.parameters["appearance"] = rng.normal(size=(3, 4)).astype(np.float32)
    return model


def rays(seed: int = 1) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(RAYS, 3))
    return {
        "rays_o": rng.uniform(-1, 1, (RAYS, 3)).astype(np.float32),
        "rays_d": (directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32),
        "target": rng.random((RAYS, 3), dtype=np.float32),
        "labels": rng.integers(-1, 16, RAYS),
        "frames": rng.integers(3, size=RAYS),
    }


def reference_step(model: SemanticNerfacto, batch: dict[str, np.ndarray], seed: int) -> tuple[dict, dict]:
    """Losses and gradients by autograd, in double, with the random numbers that the kernels draw."""
    rng = np.random.default_rng(seed)
    jitter, background = rng.random(RAYS, dtype=np.float32), rng.random((RAYS, 3), dtype=np.float32)
    p = reference.parameters_of(model, dtype=torch.float64)
    double = {key: torch.from_numpy(value).double() for key, value in batch.items() if value.dtype == np.float32}
    appearance = p["appearance"][torch.from_numpy(batch["frames"])]
    rendered = reference.render(
        model, p, double["rays_o"], double["rays_d"], appearance, torch.from_numpy(jitter).double()
    )
    terms = reference.losses(
        model, rendered, double["target"], torch.from_numpy(batch["labels"]), torch.from_numpy(background).double()
    )
    reference.total_loss(model, terms).backward()
    gradients = {name: value.grad.numpy() for name, value in p.items() if value.grad is not None}
    return {name: value.item() for name, value in terms.items()}, gradients


def test_training_step_agrees_with_autograd() -> None:
    model, batch = small_model(), rays()
    expected, expected_gradients = reference_step(model, batch, seed=5)
    gradients, losses = model.train_step(
        (batch["rays_o"], batch["rays_d"]), batch["target"], batch["labels"], batch["frames"], np.random.default_rng(5)
    )
    for name, value in expected.items():
        assert losses[name] == pytest.approx(value, rel=1e-4), name
    assert gradients.keys() == expected_gradients.keys()
    for name, value in expected_gradients.items():
        assert np.abs(gradients[name] - value).max() <= 2e-3 * np.abs(value).max(), name


def test_rendering_agrees_with_the_reference() -> None:
    model, batch = small_model(), rays()
    color, logits, depth, opacity = model.render_rays(batch["rays_o"][:61], batch["rays_d"][:61])
    p = reference.parameters_of(model)
    mean = p["appearance"].mean(dim=0).expand(RAYS, -1)
    rendered = reference.render(
        model, p, torch.from_numpy(batch["rays_o"]), torch.from_numpy(batch["rays_d"]), mean, torch.full((RAYS,), 0.5)
    )
    for found, wanted in ((color, rendered.color), (logits, rendered.logits), (depth, rendered.depth)):
        np.testing.assert_allclose(found, wanted.detach().numpy()[:61], rtol=2e-3, atol=2e-4)
    np.testing.assert_allclose(opacity, rendered.weights.sum(dim=1).detach().numpy()[:61], rtol=2e-3)


def test_gradients_of_rays_agree_with_autograd() -> None:
    model, batch = small_model(), rays()
    error, d_o, d_d = model.ray_gradients(batch["rays_o"], batch["rays_d"], batch["target"])
    p = reference.parameters_of(model, dtype=torch.float64)
    origin, direction = (torch.from_numpy(batch[k]).double().requires_grad_() for k in ("rays_o", "rays_d"))
    mean = p["appearance"].mean(dim=0).expand(RAYS, -1)
    # bins are held fixed: take them from a pass that records nothing
    with torch.no_grad():
        edges = reference.render(model, p, origin, direction, mean, torch.full((RAYS,), 0.5).double()).edges
    expected = _error_with_fixed_bins(model, p, origin, direction, mean, edges, torch.from_numpy(batch["target"]))
    expected.sum().backward()
    np.testing.assert_allclose(error, expected.detach().numpy(), rtol=5e-3, atol=1e-5)
    for found, wanted in ((d_o, origin.grad), (d_d, direction.grad)):
        assert wanted is not None
        # the slope of a trilinear cell jumps at its faces, and rounding puts a few samples on the other side
        assert np.quantile(np.abs(found - wanted.numpy()), 0.95) <= 1e-3 * wanted.abs().max().item()


def _error_with_fixed_bins(model, p, origin, direction, mean, edges, target):  # type: ignore[no-untyped-def]
    from autonerf_lab.nerf import rendering
    from autonerf_lab.nerf.encodings import spherical_harmonics

    g = reference.geometry(model, p, reference.middles(origin, direction, edges))
    features = torch.cat([spherical_harmonics(direction), mean], dim=1)
    samples = edges.shape[1] - 1
    hidden = g @ p["color_geometry"].T + (features @ p["color_ray"].T).repeat_interleave(samples, dim=0)
    hidden = torch.relu(torch.relu(hidden) @ p["color_1"].T)
    color = torch.sigmoid(hidden @ p["color_2"][:3].T).view(RAYS, samples, 3)
    weights = rendering.weights_from_density(rendering.density_from_raw(g[:, 0]).view(RAYS, samples), edges)
    return ((rendering.composite(weights, color) - target) ** 2).mean(dim=1)
