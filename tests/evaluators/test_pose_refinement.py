"""Pose refinement: scores and optimisation steps by hand, gradients compared with finite differences."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import toy_scene

from autonerf_lab.evaluators import Rendering, TrueField
from autonerf_lab.evaluators.pose_refinement import (
    PoseRefinementTask,
    Refinement,
    evaluate_pose_refinement,
    interest_regions,
    move,
    perturb,
    pose_errors,
    pose_gradients,
    refine,
    refinement_result,
)
from autonerf_lab.evaluators.rendering import sample_test_poses
from autonerf_lab.geometry import Intrinsics, camera_rays, planar_pose, so3_exp
from autonerf_lab.presets import preset
from autonerf_lab.simulator import Simulator


@pytest.fixture(scope="module")
def sim():
    return Simulator(toy_scene.two_rooms(), Intrinsics.from_fov(48, 48), supersample=2)


def test_scores_by_hand():
    """Poses 0 and 1 converged; 2 is rotated, 3 is moved too far, both exactly by the thresholds; 4 is lost."""
    rotation, translation = np.array([0.2, 1.0, 3.0, 1.0, 40.0]), np.array([0.01, 0.004, 0.01, 0.02, 0.5])
    result = refinement_result(rotation, translation)
    assert result.values == {
        "convergence_rate": 40.0,
        "rotation_convergence_rate": 60.0,
        "translation_convergence_rate": 60.0,
        "rotation_error_deg": pytest.approx((0.2 + 1.0) / 2),  # of the converged poses only
        "translation_error_m": pytest.approx((0.01 + 0.004) / 2),
    }
    rates = {name: 5 for name in result.values if name.endswith("rate")}
    assert result.n == rates | {"rotation_error_deg": 2, "translation_error_m": 2} and result.status == {}
    close = refinement_result(np.array([2.99]), np.array([0.0199]))
    assert close.values["convergence_rate"] == 100.0
    lost = refinement_result(rotation[2:], translation[2:])
    assert lost.values["rotation_error_deg"] is None and lost.values["translation_error_m"] is None
    assert lost.status == dict.fromkeys(("rotation_error_deg", "translation_error_m"), "none converged")


class Slope:
    """A field whose error has the given gradients for the ray origins in each iteration, the same for all rays."""

    def __init__(self, *gradients):
        self.gradients, self.rays = list(gradients), []

    def ray_gradients(self, rays_o, rays_d, target):
        self.rays.append((rays_o, rays_d, target))
        gradient = np.broadcast_to(np.array(self.gradients.pop(0), np.float64), rays_o.shape)
        return np.arange(len(rays_o), dtype=np.float64), gradient, np.zeros_like(rays_d)


def test_steps_of_adam_by_hand():
    """The gradient of x is constant: every step is the learning rate, downhill. That of y changes its sign.

    Moments of y after gradients 1 and -1: first = 0.9 * 0.1 - 0.1 = -0.01, second = 0.001 * 0.999 + 0.001 = 0.001999,
    and corrected -0.01 / 0.19 and 0.001999 / 0.001999: the step is -0.01 / 0.19 of the learning rate.
    The rate decays from 0.01 over 0.001 to 0.0001.
    """
    camera, targets = Intrinsics.from_fov(4, 4), np.zeros((1, 4, 4, 3), np.uint8)
    field, ticks = Slope((0.5, 1, 0), (0.5, -1, 0), (0.5, 0, 0)), []
    settings = Refinement(3, 8, lr=0.01, lr_final=0.0001)
    trace, losses = refine(field, np.eye(4)[None], targets, camera, settings, tick=lambda: ticks.append(0))
    assert trace.shape == (4, 1, 4, 4) and losses.shape == (3, 1) and len(ticks) == 3
    assert losses.ravel() == pytest.approx([3.5] * 3)  # mean of 0, 1, ... 7
    x, y, z = trace[:, 0, :3, 3].T
    assert x == pytest.approx([0, -0.01, -0.011, -0.0111], abs=1e-7)
    assert y[:3] == pytest.approx([0, -0.01, -0.01 + 0.001 * 0.01 / 0.19], abs=1e-7)
    assert not z.any() and (trace[:, 0, :3, :3] == np.eye(3)).all()


@pytest.mark.parametrize("size", [0, 1e-45, 1e-38, 1e-20, 1e20, 1e38, np.inf, np.nan])
def test_poses_stay_rigid_with_any_gradient(size):
    """Gradients are float32: the largest moves a pose by the learning rate, one that is not finite not at all."""
    field = Slope(*[np.float32([size, -size, 0])] * 3)
    camera, targets = Intrinsics.from_fov(4, 4), np.zeros((1, 4, 4, 3), np.uint8)
    trace, _ = refine(field, np.eye(4)[None], targets, camera, Refinement(3, 8, lr=0.01))
    assert np.isfinite(trace).all() and np.abs(trace[-1, 0, :3, 3]).max() <= 0.031
    assert (trace[-1] == np.eye(4)).all() or 0 < size < np.inf


def test_the_default_settings_are_those_of_the_protocol():
    assert Refinement() == Refinement(iterations=200, rays=1024, lr=0.01, lr_final=0.0003, interest=False)


def test_rays_of_an_iteration_are_pixels_of_their_target():
    """Each target has its own camera and colour; the colours are in [0, 1]."""
    camera = Intrinsics.from_fov(4, 4)
    starts = np.stack([planar_pose(1, 2, 0.3), planar_pose(-1, 0, 2.0)])
    targets = np.zeros((2, 4, 4, 3), np.uint8)
    targets[0, ..., 0] = np.arange(16).reshape(4, 4)  # red is the index of the pixel
    targets[1] = 255
    field = Slope((0, 0, 0))
    refine(field, starts, targets, camera, Refinement(1, 100))
    ((rays_o, rays_d, wanted),) = field.rays
    assert rays_o.dtype == rays_d.dtype == wanted.dtype == np.float32
    np.testing.assert_allclose(rays_o, np.repeat(starts[:, :3, 3], 100, axis=0), atol=1e-6)
    pixel = np.rint(wanted[:100, 0] * 255).astype(int)
    np.testing.assert_allclose(rays_d[:100], camera_rays(camera, starts[0])[1].reshape(-1, 3)[pixel], atol=1e-6)
    assert set(pixel) == set(range(16)) and (wanted[100:] == 1).all() and not wanted[:100, 1:].any()


def test_start_poses_are_the_disturbed_true_poses():
    truth = np.stack([planar_pose(k, -k, k) for k in range(5)])
    targets, camera = np.zeros((5, 4, 4, 3), np.uint8), Intrinsics.from_fov(4, 4)
    field = Grey()
    result = evaluate_pose_refinement(field, truth, targets, camera, Refinement(3, 4), seed=3)
    rotation, translation = pose_errors(result.artifact["trace"][0], truth)
    assert rotation == pytest.approx([5] * 5, abs=1e-6) and translation == pytest.approx([0.05] * 5)
    np.testing.assert_array_equal(result.artifact["truth"], truth)
    np.testing.assert_array_equal(result.artifact["iterations"], [0, 1, 2, 3])
    assert result.artifact["rotation_error_deg"] == pytest.approx(rotation)  # nothing has moved
    assert result.artifact["translation_error_m"] == pytest.approx(translation)
    assert len(result.artifact["before"]) == len(result.artifact["after"]) == len(result.artifact["targets"]) == 3
    long = evaluate_pose_refinement(field, truth[:1], targets[:1], camera, Refinement(200, 4))
    np.testing.assert_array_equal(long.artifact["iterations"], range(0, 201, 2))  # 100 intervals
    assert len(long.artifact["trace"]) == 101
    other = evaluate_pose_refinement(field, truth, targets, camera, Refinement(1, 4), seed=4)
    assert not np.allclose(other.artifact["trace"][0], result.artifact["trace"][0])


@pytest.mark.parametrize("interest", [False, True])
def test_the_task_refines_the_first_test_poses(sim, interest, monkeypatch):
    """The poses are test poses, not training poses; iterations, rays and pixels are those of the preset."""
    from autonerf_lab.evaluators import pose_refinement

    settings = []
    real = pose_refinement.refine
    monkeypatch.setattr(pose_refinement, "refine", lambda *a: settings.append(a[4]) or real(*a))
    sizes = replace(preset("smoke"), refine_poses=3, refine_iterations=2, refine_rays=5, refine_interest=interest)
    ticks = []
    context = SimpleNamespace(field=Grey(), sim=sim, preset=sizes, seed=7, tick=lambda: ticks.append(0))
    result = PoseRefinementTask().run(context)
    poses = sample_test_poses(sim, 3, 7)
    np.testing.assert_array_equal(result.artifact["truth"], poses)
    np.testing.assert_array_equal(result.artifact["targets"], [sim.render(c2w).rgb for c2w in poses])
    assert settings == [Refinement(2, 5, interest=interest)]
    assert len(ticks) == PoseRefinementTask().ticks(sizes) == 2


class Pattern:
    """A field whose rays have a smooth colour of origin and direction, with exact gradients."""

    def __init__(self):
        rng = np.random.default_rng(5)
        self.a, self.b = rng.normal(size=(2, 3, 3))

    def colors(self, rays_o, rays_d):
        return 0.5 + 0.4 * np.sin(rays_o @ self.a + rays_d @ self.b)

    def ray_gradients(self, rays_o, rays_d, target):
        rays_o, rays_d = rays_o.astype(np.float64), rays_d.astype(np.float64)
        error = self.colors(rays_o, rays_d) - target
        slope = 2 / 3 * error * 0.4 * np.cos(rays_o @ self.a + rays_d @ self.b)
        return (error**2).mean(axis=1), slope @ self.a.T, slope @ self.b.T

    def render(self, c2w, intrinsics):
        rgb = self.colors(*camera_rays(intrinsics, c2w))
        nothing = np.zeros(rgb.shape[:2])
        return Rendering(rgb, nothing, nothing, nothing)


def test_pose_gradients_match_finite_differences():
    rng = np.random.default_rng(1)
    pattern, directions = Pattern(), rng.normal(size=(2, 40, 3))
    poses = np.stack([np.eye(4), np.eye(4)])
    poses[:, :3, :3] = [so3_exp(v) for v in rng.normal(size=(2, 3))]
    poses[:, :3, 3] = rng.normal(size=(2, 3))
    target = rng.random((2, 40, 3))

    def loss(poses):
        rays_d = directions @ poses[:, :3, :3].transpose(0, 2, 1)
        rays_o = np.broadcast_to(poses[:, None, :3, 3], rays_d.shape)
        flat = (a.reshape(-1, 3) for a in (rays_o, rays_d, target))
        return [a.reshape(2, 40, -1) for a in pattern.ray_gradients(*flat)]

    _, grad_o, grad_d = loss(poses)
    gradient = pose_gradients(directions, poses[:, :3, :3], grad_o, grad_d)
    for axis in range(6):
        step = np.zeros((2, 6))
        step[:, axis] = 1e-5
        difference = (loss(move(poses, step))[0].sum(axis=(1, 2)) - loss(move(poses, -step))[0].sum(axis=(1, 2))) / 2e-5
        np.testing.assert_allclose(gradient[:, axis], difference, rtol=1e-5, atol=1e-7)


def test_perturbation_is_about_the_camera_itself():
    rng = np.random.default_rng(0)
    far = planar_pose(80, -60, 1.0)
    rotation, translation = pose_errors(np.stack([perturb(far, rng) for _ in range(5)]), np.stack([far] * 5))
    np.testing.assert_allclose(rotation, 5, atol=1e-6)
    np.testing.assert_allclose(translation, 0.05, atol=1e-9)


def test_cameras_converge_in_a_smooth_field():
    pattern, intrinsics = Pattern(), Intrinsics.from_fov(16, 16)
    truth = np.stack([planar_pose(0.1 * k, 0.2, k) for k in range(4)])
    targets = np.round(255 * np.stack([pattern.render(c2w, intrinsics).rgb for c2w in truth])).astype(np.uint8)
    result = evaluate_pose_refinement(pattern, truth, targets, intrinsics, Refinement(150, 128))
    assert result.values["rotation_convergence_rate"] == 100.0
    assert result.artifact["losses"][-20:].mean() < 0.1 * result.artifact["losses"][:3].mean()


def test_the_true_geometry_converges(sim):
    field = TrueField(sim.scene, sim, views=1)
    poses = sample_test_poses(sim, 4, seed=0)
    targets = np.stack([sim.render(c2w).rgb for c2w in poses])
    result = evaluate_pose_refinement(field, poses, targets, sim.intrinsics, Refinement(150, 512))
    assert result.values["convergence_rate"] >= 75
    assert result.values["rotation_error_deg"] < 0.5 and result.values["translation_error_m"] < 0.015


def test_pixels_are_drawn_from_interest_regions(sim):
    """Rays are sampled around edges only."""
    targets_seen = []

    class Listening(Grey):
        def ray_gradients(self, rays_o, rays_d, target):
            targets_seen.append(target)
            return super().ray_gradients(rays_o, rays_d, target)

    picture = np.zeros((2, 16, 16, 3), np.uint8)
    picture[0, 4:7, 9:12] = 255
    camera, start = Intrinsics.from_fov(16, 16), np.stack([np.eye(4)] * 2)
    for interest in (True, False):
        refine(Listening(), start, picture, camera, Refinement(1, 2000, interest=interest))
    white = [target.reshape(2, -1, 3).mean(axis=(1, 2)) for target in targets_seen]
    region = interest_regions(picture[0])
    assert region[3:8, 8:13].all() and not region[:, :5].any() and not region[11:].any()
    assert white[0][0] == pytest.approx(9 / region.sum(), abs=0.03) and white[1][0] == pytest.approx(9 / 256, abs=0.02)
    assert interest_regions(picture[1]).all() and white[0][1] == 0


class Grey(Pattern):
    def ray_gradients(self, rays_o, rays_d, target):
        return np.full(len(rays_o), 0.1), np.zeros_like(rays_o), np.zeros_like(rays_d)


def test_an_empty_field_moves_no_camera(sim):
    poses = sample_test_poses(sim, 2, seed=0)
    targets = np.stack([sim.render(c2w).rgb for c2w in poses])
    result = evaluate_pose_refinement(Grey(), poses, targets, sim.intrinsics, Refinement(5, 16))
    assert result.values["convergence_rate"] == 0.0
    assert result.values["rotation_error_deg"] is None and result.status["rotation_error_deg"] == "none converged"


def test_a_nan_gradient_stops_only_its_pose():
    class Broken(Pattern):
        def ray_gradients(self, rays_o, rays_d, target):
            loss, grad_o, grad_d = super().ray_gradients(rays_o, rays_d, target)
            grad_d[: len(grad_d) // 2] = np.nan
            return loss, grad_o, grad_d

    starts = np.stack([np.eye(4), np.eye(4)])
    trace, _ = refine(Broken(), starts, np.zeros((2, 8, 8, 3), np.uint8), Intrinsics.from_fov(8, 8), Refinement(5, 16))
    np.testing.assert_array_equal(trace[-1, 0], np.eye(4))
    assert not np.allclose(trace[-1, 1], np.eye(4))


def test_a_gradient_that_becomes_nan_stops_its_pose():
    """The moments of Adam must not move the pose."""

    class Breaking(Pattern):
        calls = 0

        def ray_gradients(self, rays_o, rays_d, target):
            loss, grad_o, grad_d = super().ray_gradients(rays_o, rays_d, target)
            self.calls += 1
            if self.calls > 3:
                grad_o[:16] = np.nan
            return loss, grad_o, grad_d

    starts, camera = np.stack([np.eye(4), np.eye(4)]), Intrinsics.from_fov(8, 8)
    trace, _ = refine(Breaking(), starts, np.zeros((2, 8, 8, 3), np.uint8), camera, Refinement(8, 16))
    assert not np.allclose(trace[3, 0], np.eye(4)) and not np.allclose(trace[3, 1], trace[-1, 1])
    np.testing.assert_array_equal(trace[3:, 0], np.stack([trace[3, 0]] * 6))
