"""Corrections of training poses: gradients by finite differences, planar robots, and the schedules."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from autonerf_lab.geometry import is_planar, planar_pose
from autonerf_lab.nerf.pose_offsets import FINAL_RATE, FIRST_RATE, PoseOffsets, level_weights, pose_rate
from autonerf_lab.nerf.ray_batch import Rays

RNG = np.random.default_rng(0)
FRAMES = np.array([0, 0, 1, 2, 2, 2])
ORIGINS, DIRECTIONS = (RNG.normal(size=(6, 3)).astype(np.float32) for _ in range(2))
SLOPES_O, SLOPES_D = RNG.normal(size=(2, 6, 3)).astype(np.float32)


def loss(offsets: PoseOffsets) -> float:
    """Return a linear function of the corrected rays, plus the penalties."""
    rays = offsets.apply(Rays(ORIGINS, DIRECTIONS, FRAMES))
    total = (SLOPES_O * rays.origins).sum() + (SLOPES_D * rays.directions).sum()
    return float(total + sum(w * (offsets.parameters[name] ** 2).sum() / 3 for name, w in offsets.PENALTY.items()))


@pytest.mark.parametrize("planar", [False, True])
def test_gradients_equal_finite_differences(planar: bool) -> None:
    offsets = PoseOffsets(3)
    offsets.planar = planar
    for value in offsets.parameters.values():
        value[...] = RNG.normal(0, 0.3, value.shape)
    rays = offsets.apply(Rays(ORIGINS, DIRECTIONS, FRAMES))
    output = SimpleNamespace(d_origins=SLOPES_O, d_directions=SLOPES_D)
    found = offsets.gradients(rays, output)
    free = {"camera_shift": [0, 1], "camera_rotation": [2]} if planar else {name: [0, 1, 2] for name in found}
    for name, value in offsets.parameters.items():
        expected = np.zeros_like(value)
        for t, axis in np.ndindex(3, 3):
            if axis in free[name]:
                before, sides = value[t, axis], []
                for sign in (1, -1):
                    value[t, axis] = before + sign * 1e-2
                    sides.append(loss(offsets))
                value[t, axis] = before
                expected[t, axis] = (sides[0] - sides[1]) / 2e-2
        assert_allclose(found[name], expected, atol=2e-3)


def test_corrections_of_a_planar_robot_stay_planar() -> None:
    poses = np.stack([planar_pose(x, 0.2 * x, x) for x in range(3)])
    offsets = PoseOffsets(3)
    offsets.parameters["camera_shift"][:, :2] = 0.1
    offsets.parameters["camera_rotation"][:, 2] = [0.1, 0.2, 0.0]
    assert is_planar(offsets.corrected(poses, 2.0))
    assert_allclose(offsets.corrected(poses, 2.0)[0, :3, 3], [0.2, 0.2, 0.88])


def test_rates_fall_and_levels_open_in_order() -> None:
    shares = np.linspace(0, 1, 21)
    rates = [pose_rate(share) for share in shares]
    assert rates[0] == FIRST_RATE and rates[-1] == pytest.approx(FINAL_RATE) and (np.diff(rates) < 0).all()
    weights = np.stack([level_weights(10, share) for share in shares])
    assert (weights[:, 0] == 1).all() and (weights[2, 1:] == 0).all() and (weights[10:] == 1).all()
    assert (np.diff(weights, axis=0) >= 0).all() and (np.diff(weights, axis=1) <= 0).all()
