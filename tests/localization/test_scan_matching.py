"""Scans and scan matching: planes against least squares, the kernel against numpy, and motions by hand."""

import numpy as np
import pytest
import toy_scene

from autonerf_lab.geometry import Intrinsics
from autonerf_lab.localization.scan import INVERSE_DEPTH_SIGMA, make_scan
from autonerf_lab.localization.scan_matching import _FLOOR, CORRELATION, compare, match
from autonerf_lab.localization.se2 import between, compose, to_matrices
from autonerf_lab.simulator import Simulator

CAMERA = Intrinsics.from_fov(64, 64)
PRIOR = np.diag([0.05, 0.05, 0.05]) ** 2


@pytest.fixture(scope="module")
def sim():
    return Simulator(toy_scene.two_rooms(), CAMERA, rgb=False)


def scan_at(sim, x, y, heading, noise=None):
    depth = sim.render(to_matrices(np.array([[x, y, heading]]))[0], rgb=False).depth
    return make_scan(depth if noise is None else depth + noise, CAMERA)


def test_planes_of_a_slanted_wall_by_hand():
    """The wall x + y = 3, from the origin: q = (1/3, 1/3, 0)."""
    across = (CAMERA.cx - np.arange(64) - 0.5) / CAMERA.fl_x
    scan = make_scan(np.broadcast_to(3 / (1 + across), (64, 64)), CAMERA)
    found = scan.planes[8:-8, 8:-8]  # near enough, and not at the border
    near = scan.points[8:-8, 8:-8, 0] > 0
    np.testing.assert_allclose(found[near], np.broadcast_to([1 / 3, 1 / 3, 0], found[near].shape), atol=1e-9)
    np.testing.assert_allclose((scan.planes * scan.points).sum(axis=2)[scan.planes.any(axis=2)], 1, atol=1e-9)


def test_planes_are_least_squares_fits():
    rng = np.random.default_rng(0)
    inverse = 0.5 + rng.normal(0, 0.001, (16, 16))
    scan = make_scan((1 / inverse).repeat(2, axis=0).repeat(2, axis=1), CAMERA.resized(32, 32))
    rays = scan.points / scan.points[..., :1]
    for row, col in ((5, 5), (9, 12)):
        window = np.s_[row - 2 : row + 3, col - 2 : col + 3]
        expected = np.linalg.lstsq(rays[window].reshape(-1, 3), inverse[window].ravel(), rcond=None)[0]
        np.testing.assert_allclose(scan.planes[row, col], expected, atol=1e-8)


def test_floor_edges_and_missing_depth_have_no_planes(sim):
    scan = scan_at(sim, 2.0, 1.5, 0.0)
    assert not scan.planes[-1].any()  # the floor in front of the robot
    assert scan.count > 200
    assert make_scan(np.zeros((64, 64), np.float32), CAMERA).count == 0


def reference_factor(scan, reference, motion, width):
    """Compute information and gradient with arrays instead of loops."""
    own, points = scan.planes.reshape(-1, 3), scan.points.reshape(-1, 3)
    usable = own[:, :2].any(axis=1)
    own, points = own[usable], points[usable]
    c, s = np.cos(motion[2]), np.sin(motion[2])
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    turned = points @ turn.T
    moved = turned + np.array([motion[0], motion[1], 0])
    f_x, f_y, c_x, c_y = reference.camera
    u = np.rint(c_x - f_x * moved[:, 1] / moved[:, 0]).astype(int)
    v = np.rint(c_y - f_y * moved[:, 2] / moved[:, 0]).astype(int)
    rows, cols = reference.planes.shape[:2]
    seen = (moved[:, 0] >= 0.1) & (u >= 0) & (v >= 0) & (u < cols) & (v < rows)
    u, v = u.clip(0, cols - 1), v.clip(0, rows - 1)
    plane = reference.planes[v, u]
    seen &= plane[:, :2].any(axis=1) & (moved[:, 0] <= reference.points[v, u, 0] + 3 * width + 0.1)
    length = np.linalg.norm(plane, axis=1).clip(1e-9)
    normal, residual = plane / length[:, None], ((plane * moved).sum(axis=1) - 1) / length
    facing = ((own @ turn.T) * normal).sum(axis=1) >= 0.7 * np.linalg.norm(own, axis=1)
    sigma = INVERSE_DEPTH_SIGMA * points[:, 0] * (normal * turned).sum(axis=1)
    variance = sigma**2 + _FLOOR**2
    weight = (seen & facing) * ((width**2 + variance) / (width**2 + variance + residual**2)) ** 2 / variance
    lever = normal[:, 1] * turned[:, 0] - normal[:, 0] * turned[:, 1]
    jacobian = np.column_stack([normal[:, :2], lever])
    information = (jacobian * weight[:, None]).T @ jacobian / CORRELATION
    return information, jacobian.T @ (weight * residual) / CORRELATION, int(seen.sum())


def test_the_kernel_equals_its_reference(sim):
    reference, scan = scan_at(sim, 2.0, 1.5, 0.3), scan_at(sim, 2.2, 1.45, 0.1)
    motion = np.array([0.18, -0.1, -0.17])
    factor = compare(scan, reference, motion, 0.1)
    information, gradient, overlap = reference_factor(scan, reference, motion, 0.1)
    np.testing.assert_allclose(factor.information, information, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(factor.gradient, gradient, rtol=1e-6, atol=1e-6)
    assert factor.overlap == overlap > 300


@pytest.mark.parametrize("motion", [(0.25, 0.0, 0.0), (0.0, 0.0, 0.52), (0.1, -0.05, -0.3)])
def test_a_motion_is_recovered(sim, motion):
    start = np.array([2.0, 1.5, 0.4])
    true = compose(start, np.array(motion))
    guess = true + np.array([0.03, -0.03, 0.04])
    found = match(scan_at(sim, *true), guess, np.eye(3), [(start, scan_at(sim, *start))])
    error = between(true, found.pose)
    assert np.hypot(*error[:2]) < 0.004 and abs(error[2]) < 0.003
    assert found.factors[0].inliers > 0.8 * found.factors[0].overlap


def test_a_single_wall_leaves_the_motion_along_it_to_the_prior():
    wall = make_scan(np.full((64, 64), 2.0), CAMERA)
    found = match(make_scan(np.full((64, 64), 1.9), CAMERA), np.array([0.0, 0.07, 0.0]), PRIOR, [(np.zeros(3), wall)])
    np.testing.assert_allclose(found.pose, [0.1, 0.07, 0.0], atol=1e-3)
    assert found.information[1, 1] < 1e-6 * found.information[0, 0]


def test_any_depth_and_motion_gives_a_finite_factor(sim):
    """Depth beyond the limits of a scan is left out; motions far away overlap with nothing."""
    rng = np.random.default_rng(0)
    depth = sim.render(to_matrices(np.array([[2.0, 1.5, 0.3]]))[0], rgb=False).depth
    extreme = np.float32([-1, 0, 1e-45, 1e-20, 0.1, 0.101, 65.5, 1e38, np.inf, -np.inf, np.nan])
    scans = []
    for share in (0.0, 0.05, 1.0):
        wrong = rng.random(depth.shape) < share
        scans.append(make_scan(np.where(wrong, rng.choice(extreme, depth.shape), depth), CAMERA))
        assert np.isfinite(scans[-1].points).all() and np.isfinite(scans[-1].planes).all()
    for motion in ([0, 0, 0], [1e-45, 0, 1e-45], [1e9, -1e9, 1e9], [1e38, 1e38, 1e5], [0.1, 0, 7.0]):
        for scan in scans:
            for width in (1e-12, 0.1, 1e30):
                factor = compare(scan, scans[0], np.array(motion, dtype=np.float64), width)
                assert np.isfinite(factor.information).all() and np.isfinite(factor.gradient).all(), (motion, width)
