"""Priors, covariances and the sparse solver, beside dense algebra and finite differences."""

import numpy as np
from numpy.testing import assert_allclose

from autonerf_lab.bundle_adjustment.adjustment import PLANAR, SPATIAL, Equations, moved
from autonerf_lab.bundle_adjustment.motion_prior import chain_covariances, motion_equations, motion_errors
from autonerf_lab.geometry import planar_pose

RNG = np.random.default_rng(0)
ROUGH = moved(np.tile(np.eye(4), (5, 1, 1)), RNG.normal(0, 1, (5, 6)), SPATIAL)
SIGMAS = (0.02, 0.01)


def test_errors_of_planar_motions_by_hand() -> None:
    """Half a metre forward became 0.6 m, and the left turn 0.1 rad too large."""
    rough = np.stack([planar_pose(0, 0, 0), planar_pose(0.5, 0, 0.2)])
    poses = np.stack([planar_pose(3, 1, np.pi / 2), planar_pose(3, 1.6, np.pi / 2 + 0.3)])
    assert_allclose(motion_errors(poses, rough), [[0, 0, -0.1, 0, 0.1, 0]], atol=1e-12)


def test_motion_equations_equal_those_of_finite_differences() -> None:
    poses = moved(ROUGH, RNG.normal(0, 1e-4, (5, 6)), SPATIAL)  # rotation errors are linearised around zero
    matrix, vector = motion_equations(poses, ROUGH, SIGMAS)
    weights = 1 / np.repeat(SIGMAS, 3) ** 2
    jacobian, small = np.zeros((4, 6, 12)), 1e-6
    for axis in range(12):
        step = np.zeros((2, 5, 6))
        step[0, : 4 if axis < 6 else 5, axis % 6] = small
        for t in range(4):
            step[:] = 0
            step[0, t + axis // 6, axis % 6], step[1, t + axis // 6, axis % 6] = small, -small
            ahead, back = (motion_errors(moved(poses, part, SPATIAL), ROUGH)[t] for part in step)
            jacobian[t, :, axis] = (ahead - back) / (2 * small)
    errors = motion_errors(poses, ROUGH)
    scale = np.abs(vector).max()
    assert_allclose(
        matrix, np.einsum("tka,k,tkb->tab", jacobian, weights, jacobian), rtol=1e-3, atol=1e-3 / SIGMAS[1] ** 2
    )
    assert_allclose(vector, np.einsum("tka,k,tk->ta", jacobian, weights, errors), rtol=1e-3, atol=1e-3 * scale)


def random_equations(axes: np.ndarray) -> tuple[Equations, np.ndarray, np.ndarray]:
    """Return equations of random pairs and motions, and the same densely."""
    pairs = np.array([[0, 1], [0, 3], [4, 2], [3, 1], [1, 0]])
    factors = RNG.normal(size=(5, 6, 8))
    matrices, vectors = factors @ np.swapaxes(factors, 1, 2), RNG.normal(size=(5, 6))
    rows = np.concatenate([matrices[:, *np.triu_indices(6)], vectors], axis=1)
    equations = Equations(5, axes)
    equations.add_pairs(pairs, rows, ROUGH)
    matrix, vector = motion_equations(moved(ROUGH, RNG.normal(0, 1e-3, (5, 6)), SPATIAL), ROUGH, (1.0, 1.0))
    equations.add_motions(matrix, vector)
    dense, gradient = np.zeros((30, 30)), np.zeros(30)
    for (i, j), h, g in zip(pairs, matrices, vectors, strict=True):
        jacobian = np.zeros((6, 30))  # of the first camera's six equations with respect to all motions
        x, y, z = ROUGH[i, :3, 3] - ROUGH[j, :3, 3]
        turn = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        jacobian[:, 6 * i : 6 * i + 6] += np.eye(6)
        jacobian[:, 6 * j : 6 * j + 6] -= np.block([[np.eye(3), np.zeros((3, 3))], [turn, np.eye(3)]]).T
        dense += jacobian.T @ h @ jacobian
        gradient += jacobian.T @ g
    for t in range(4):
        both = slice(6 * t, 6 * t + 12)
        dense[both, both] += matrix[t]
        gradient[both] += vector[t]
    kept = (6 * np.arange(5)[:, None] + axes).ravel()
    return equations, dense[np.ix_(kept, kept)], gradient[kept]


def test_the_sparse_solution_is_the_dense_one() -> None:
    for axes in (SPATIAL, PLANAR):
        equations, dense, gradient = random_equations(axes)
        k = len(axes)
        expected = np.concatenate([np.zeros(k), np.linalg.solve(dense[k:, k:], -gradient[k:])])
        assert_allclose(equations.solve().ravel(), expected, atol=5e-3 * np.abs(expected).max())


def test_chain_covariances_are_the_diagonal_blocks_of_the_inverse() -> None:
    own = RNG.normal(size=(6, 3, 4))
    own = own @ np.swapaxes(own, 1, 2)
    steps = RNG.normal(size=(5, 6, 7))
    steps = steps @ np.swapaxes(steps, 1, 2)
    dense = np.zeros((18, 18))
    for t in range(6):
        dense[3 * t : 3 * t + 3, 3 * t : 3 * t + 3] += own[t]
    for t in range(5):
        dense[3 * t : 3 * t + 6, 3 * t : 3 * t + 6] += steps[t]
    inverse = np.linalg.inv(dense)
    expected = [inverse[3 * t : 3 * t + 3, 3 * t : 3 * t + 3] for t in range(6)]
    assert_allclose(chain_covariances(own, steps), expected, rtol=1e-6, atol=1e-9)
