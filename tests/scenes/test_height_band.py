"""Rasterisation of a height band, cell by cell."""

import numpy as np

from autonerf_lab.scenes.height_band import occupied_cells


def grid(vertices: list, low: float = 0.0, high: float = 1.0, shape: tuple[int, int] = (4, 4)) -> np.ndarray:
    return occupied_cells(np.array(vertices, dtype=float), np.array([[0, 1, 2]]), low, high, (0, 0), 1.0, shape)


def test_triangle_touches_exactly_these_cells() -> None:
    # right angle at (0.5, 0.5), hypotenuse from (2.5, 0.5) to (0.5, 2.5): it crosses cell (1, 1), misses (2, 1)
    found = grid([[0.5, 0.5, 0.5], [2.5, 0.5, 0.5], [0.5, 2.5, 0.5]])
    assert found.astype(int).tolist() == [[1, 1, 1, 0], [1, 1, 1, 0], [1, 1, 0, 0], [0, 0, 0, 0]]


def test_vertical_wall_is_a_line() -> None:
    found = grid([[0.2, 1.5, 0], [3.8, 1.5, 0], [2.0, 1.5, 2]])
    assert found[1].all() and found.sum() == 4


def test_diagonal_wall_marks_every_cell_it_crosses() -> None:
    # the line y = x / 2 + 0.25 from x = 0.1 to 3.9 leaves row 0 at x = 1.5 and row 1 at x = 3.5
    found = grid([[0.1, 0.3, 0], [3.9, 2.2, 0], [3.9, 2.2, 1]])
    assert found.astype(int).tolist() == [[1, 1, 0, 0], [0, 1, 1, 1], [0, 0, 0, 1], [0, 0, 0, 0]]


def test_only_the_band_counts() -> None:
    # a ramp that rises with x: z = x / 4, so that z in [0.5, 0.7] is x in [2, 2.8]
    ramp = [[0, 0.5, 0], [4, 0.5, 1], [4, 0.6, 1]]
    assert grid(ramp, 0.51, 0.7)[0].tolist() == [False, False, True, False]
    assert not grid(ramp, 1.1, 2).any()


def test_surface_exactly_on_the_ends_counts() -> None:
    flat = [[1.2, 1.2, 0.5], [1.8, 1.2, 0.5], [1.5, 1.8, 0.5]]
    assert grid(flat, 0.5, 1)[1, 1] and grid(flat, 0, 0.5)[1, 1]
    assert not grid(flat, 0.500001, 1).any()


def test_outside_the_grid_is_ignored() -> None:
    assert not grid([[-3, -3, 0.5], [-1, -3, 0.5], [-1, -1, 0.5]]).any()
    assert grid([[-9, -9, 0.5], [30, -9, 0.5], [-9, 30, 0.5]]).all()


def test_no_faces() -> None:
    assert not occupied_cells(np.zeros((0, 3)), np.zeros((0, 3), int), 0, 1, (0, 0), 1, (2, 2)).any()


def test_against_dense_points() -> None:
    """Every sampled point of random triangles lies in a marked cell, and marked cells are near the triangle."""
    rng = np.random.default_rng(0)
    for _ in range(50):
        corners = rng.uniform(0.2, 3.8, (3, 3)) * [1, 1, 0.3]
        found = grid(corners.tolist(), 0.3, 0.8)
        weights = rng.dirichlet((1, 1, 1), 4000)
        points = weights @ corners
        points = points[(points[:, 2] >= 0.3) & (points[:, 2] <= 0.8)]
        cells = np.zeros_like(found)
        cells[points[:, 1].astype(int), points[:, 0].astype(int)] = True
        assert (found | ~cells).all()
        assert (found & ~cells).sum() <= 3  # thin cells without a sample
