"""Encodings, sampling and volume rendering: values computed by hand, invariants and gradients."""

import numpy as np
import pytest
import torch

from autonerf_lab.nerf import rendering
from autonerf_lab.nerf.encodings import hash_encode
from autonerf_lab.nerf.hash_grid import HashGrid
from autonerf_lab.nerf.scene_box import SceneBox
from autonerf_lab.nerf.spherical_harmonics import spherical_harmonics, spherical_harmonics_gradient

GRID = HashGrid.build(np.array([4.0, 3.0, 2.0]), coarse=1.0, fine=0.2, levels=3, log2_entries=8)


def test_grid_is_dense_where_it_fits_and_hashed_elsewhere() -> None:
    assert GRID.resolutions.tolist() == [[4, 3, 2], [9, 7, 5], [20, 15, 10]]
    assert GRID.masks.tolist() == [0, 255, 255]
    assert GRID.offsets.tolist() == [0, 60, 316]
    assert GRID.entries == 60 + 256 + 256


def test_a_dense_level_interpolates_a_linear_function_exactly() -> None:
    grid = HashGrid.build(np.ones(3), 0.25, 0.25, levels=1, log2_entries=10)
    corner = np.stack(np.meshgrid(*[np.arange(5)] * 3, indexing="ij"), axis=-1).transpose(2, 1, 0, 3).reshape(-1, 3) / 4
    values = corner @ np.array([1.0, 2.0, 3.0])
    table = torch.tensor(np.stack([values, -values], axis=1))
    x = torch.rand(50, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    expected = x @ torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64)
    torch.testing.assert_close(hash_encode(x, table, grid), torch.stack([expected, -expected], dim=1))


def test_encoding_gradients() -> None:
    generator = torch.Generator().manual_seed(1)
    x = torch.rand(6, 3, generator=generator, dtype=torch.float64) * 0.98 + 0.01
    table = torch.randn(GRID.entries, 2, generator=generator, dtype=torch.float64)
    assert torch.autograd.gradcheck(
        lambda x, table: hash_encode(x, table, GRID), (x.requires_grad_(), table.requires_grad_()), eps=1e-7, atol=1e-5
    )


def test_spherical_harmonics_are_orthonormal() -> None:
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(200_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    y = spherical_harmonics(torch.from_numpy(directions)).numpy()
    np.testing.assert_allclose(4 * np.pi * y.T @ y / len(y), np.eye(16), atol=0.03)


def test_gradient_of_spherical_harmonics_agrees_with_automatic_differentiation() -> None:
    rng = np.random.default_rng(0)
    directions, upstream = rng.normal(size=(20, 3)), rng.normal(size=(20, 16))
    tensor = torch.from_numpy(directions).requires_grad_()
    (expected,) = torch.autograd.grad(spherical_harmonics(tensor), tensor, torch.from_numpy(upstream))
    np.testing.assert_allclose(spherical_harmonics_gradient(directions, upstream), expected.numpy(), atol=1e-12)


def test_weights_by_hand() -> None:
    starts, ends = torch.tensor([[0.0, 2.0, 4.0]]), torch.tensor([[1.0, 4.0, 5.0]])  # empty between 1 and 2
    sigma = torch.tensor([[np.log(2), np.log(2), 0.0]], dtype=torch.float32)
    weights = rendering.weights_from_density(sigma, starts, ends)
    torch.testing.assert_close(weights, torch.tensor([[0.5, 0.5 * 0.75, 0.0]]))
    # Half of the total weight (0.4375 of 0.875) is reached at 0.875 of the first bin.
    torch.testing.assert_close(rendering.median_depth(weights, starts, ends), torch.tensor([0.875]))


def test_unwarp_inverts_warp() -> None:
    t = torch.tensor([0.05, 1.0, 3.999, 4.001, 15.0, 1000.0], dtype=torch.float64)
    torch.testing.assert_close(rendering.unwarp(rendering.warp(t, 4.0), 4.0), t)


def test_resampling_follows_the_weights() -> None:
    edges = torch.linspace(0, 10, 11)[None].expand(3, -1)
    weights = torch.zeros(3, 10)
    weights[:, 4] = 1.0
    finer = rendering.resample(edges, weights, torch.tensor([0.0, 0.5, 0.99]), padding=0.0, bins=20)
    assert (finer.diff(dim=1) >= 0).all()
    assert (finer[:, 0] == 0).all() and (finer[:, -1] == 10).all()
    assert ((finer[:, 1:-1] >= 4) & (finer[:, 1:-1] <= 5)).all()


def test_losses_by_hand() -> None:
    edges = torch.tensor([[0.0, 1.0, 2.0]])
    bins = edges[:, :-1], edges[:, 1:]
    # All weight in one bin of width 1, with a warped width of 1 / 8: 1 * (1 / 8) / 3.
    loss = rendering.distortion_loss(torch.tensor([[1.0, 0.0]]), *bins, turn=4.0)
    torch.testing.assert_close(loss, torch.tensor([1 / 24]))
    fine_edges, fine = torch.tensor([[0.0, 0.5, 1.5, 2.0]]), torch.tensor([[0.2, 0.6, 0.2]])
    # The middle bin overlaps both proposal bins (0.5), the others overlap one each (0.1 and 0.4).
    expected = 0.1**2 / 0.2 + 0.1**2 / 0.6
    found = rendering.interlevel_loss(edges, torch.tensor([[0.1, 0.4]]), fine_edges, fine)
    torch.testing.assert_close(found, torch.tensor([expected]), rtol=1e-5, atol=1e-6)


def test_box_is_metric_inside_and_contains_the_world() -> None:
    box = SceneBox.around(np.array([[0.0, 0, 1], [4, 2, 1]]), margin=1.0, shell=0.25)
    inside = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]])
    np.testing.assert_allclose(np.diff(box.contract(inside), axis=0)[0] * box.size, [1, 0, 0], atol=1e-6)
    far = box.contract(np.array([[1e6, -1e6, 1e6]]))
    assert ((far >= 0) & (far <= 1)).all()
    points = np.random.default_rng(0).uniform(-20, 20, (100, 3))
    np.testing.assert_allclose(box.expand(box.contract(points).astype(np.float64)), points, rtol=1e-3, atol=1e-4)
    double = box.contract_tensor(torch.from_numpy(points)).numpy()
    np.testing.assert_allclose(double, box.contract(points), atol=1e-6)


@pytest.mark.parametrize("margin", [1e-3, 1e-2])
def test_the_slope_of_the_box_is_continuous(margin: float) -> None:
    box = SceneBox(np.zeros(3, np.float32), np.ones(3, np.float32), 0.25)
    near = box.contract(np.array([[1 - margin] * 3, [1.0] * 3, [1 + margin] * 3], np.float64))[:, 0].astype(np.float64)
    assert near[2] - near[1] == pytest.approx(near[1] - near[0], rel=0.05 + 5 * margin)
