"""The lens: OpenCV's model, worked by hand, and its inverse."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from autonerf_lab.geometry import Intrinsics

LENSES = {
    "phone": (0.0578, -0.0806, 0.0, -0.0004, 0.0007),  # k1, k2, k3, p1, p2
    "action camera": (-0.2735, 0.0966, -0.0163, 0.00016, -0.00012),
    "webcam": (-0.42, 0.19, -0.04, 0.0011, -0.0018),
    "pincushion": (0.12, 0.03, 0.004, 0.0, 0.0),
    "decentred": (-0.05, 0.01, 0.0, 0.008, -0.006),
}


def _pixels(camera: Intrinsics) -> np.ndarray:
    u, v = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    return np.stack([u, v], axis=-1)


def _back(camera: Intrinsics) -> np.ndarray:
    return camera.project(camera.directions().reshape(-1, 3)).reshape(camera.height, camera.width, 2)


def test_project_is_opencv_worked_by_hand():
    camera = Intrinsics(640, 480, 500.0, 400.0, 320.0, 240.0, -0.25, 0.08, 0.0, 0.001, -0.002)
    # x = 0.3, y = -0.2 (up), r^2 = 0.13: radial 1 - 0.25 * 0.13 + 0.08 * 0.13^2 = 0.968852
    # x' = 0.3 * 0.968852 + 2 * 0.001 * (-0.06) - 0.002 * (0.13 + 2 * 0.09) = 0.2899156
    # y' = -0.2 * 0.968852 + 2 * -0.002 * (-0.06) + 0.001 * (0.13 + 2 * 0.04) = -0.1933204
    uv = camera.project(np.array([[0.6, 0.4, -2.0]]))
    np.testing.assert_allclose(uv, [[320 + 500 * 0.2899156, 240 - 400 * 0.1933204]], rtol=0, atol=1e-9)
    # k3 alone, x = 1: x' = 1 + 0.5
    assert Intrinsics(8, 8, 2.0, 2.0, 4.0, 4.0, k3=0.5).project(np.array([[1.0, 0, -1]])).tolist() == [[7.0, 4.0]]


def test_what_is_behind_the_camera_has_no_pixel():
    uv = Intrinsics.from_fov(8, 8).project(np.array([[0, 0, -1.0], [0, 0, 1.0], [1, 0, 0]]))
    assert np.isfinite(uv).all(axis=1).tolist() == [True, False, False]


@pytest.mark.parametrize("name", LENSES)
def test_directions_come_back_to_their_pixels(name):
    camera = Intrinsics(190, 130, 140.0, 143.0, 97.3, 61.8, *LENSES[name])
    assert np.abs(_back(camera) - _pixels(camera)).max() < 1e-6
    assert np.abs(camera.directions() - replace(camera, k1=0, k2=0, k3=0, p1=0, p2=0).directions()).max() > 1e-3


@pytest.mark.parametrize("name", LENSES)
def test_one_direction_worked_backwards(name):
    """The pixel centre is put where the model sees a known point, so the direction must be that point's."""
    k1, k2, k3, p1, p2 = LENSES[name]
    x, y = 0.41, 0.27
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = 3.0 * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x))
    v = 2.0 * (y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y * y))
    camera = Intrinsics(1, 1, 3.0, 2.0, 0.5 - u, 0.5 - v, k1, k2, k3, p1, p2)
    np.testing.assert_allclose(camera.directions()[0, 0], [x, -y, -1], rtol=0, atol=1e-8)


@pytest.mark.parametrize("p1", [0.0, 0.004])
def test_pixels_beyond_the_fold_get_the_direction_at_the_fold(p1):
    # r (1 - r^2 / 2) grows up to r = sqrt(2 / 3), where it is 0.5443
    camera = Intrinsics(200, 200, 100.0, 100.0, 100.0, 100.0, k1=-0.5, p1=p1)
    with pytest.warns(UserWarning, match="cannot be inverted"):
        directions = camera.directions()
    assert np.isfinite(directions).all()
    away = np.linalg.norm(_pixels(camera) - 100, axis=-1) / 100
    radius = np.linalg.norm(directions[..., :2], axis=-1)
    miss = np.linalg.norm(camera.project(directions.reshape(-1, 3)).reshape(200, 200, 2) - _pixels(camera), axis=-1)
    slack = 5 * p1  # a tangential term moves the fold a little
    inside = away < 0.5443 - slack
    assert miss[inside].max() < 1e-6
    assert miss[away > 0.5444 + slack].min() > 1e-3
    np.testing.assert_allclose(radius[away > 0.5444 + slack], np.sqrt(2 / 3), rtol=5 * slack, atol=1e-6)
    assert radius.max() == pytest.approx(np.sqrt(2 / 3), rel=max(1e-6, 5 * slack))


@pytest.mark.parametrize("lens", [(-1e9, 0, 0, 0, 0), (0, 0, 1e-320, 0, 0), (0, 0, 0, 1, 1), (9, -99, 99, 0.3, 0)])
@pytest.mark.filterwarnings("ignore:the lens distortion cannot be inverted")
def test_no_lens_makes_nan(lens):
    assert np.isfinite(Intrinsics(20, 16, 10.0, 10.0, 10.0, 8.0, *lens).directions()).all()


def test_points_that_the_lens_does_not_reach_have_no_pixel():
    # beyond the fold the polynomial turns back, and would put them among what is really seen
    camera = Intrinsics(200, 200, 100.0, 100.0, 100.0, 100.0, k1=-0.5)
    assert np.isfinite(camera.project(np.array([[0.8, 0, -1.0], [0.9, 0, -1.0]]))).all(axis=1).tolist() == [True, False]


def test_a_pinhole_keeps_its_bits():
    camera = Intrinsics(7, 5, 4.3, 4.1, 3.3, 2.9)
    u, v = np.arange(7) + 0.5, np.arange(5) + 0.5
    directions = camera.directions()
    np.testing.assert_array_equal(directions[..., 0], np.broadcast_to((u - 3.3) / 4.3, (5, 7)))
    np.testing.assert_array_equal(directions[..., 1], np.broadcast_to((-(v - 2.9) / 4.1)[:, None], (5, 7)))
    assert (directions[..., 2] == -1).all()


def test_resized_keeps_the_lens_and_the_view():
    camera = Intrinsics(40, 30, 30.0, 31.0, 19.0, 16.0, *LENSES["webcam"])
    small = camera.resized(20, 15)
    assert small == Intrinsics(20, 15, 15.0, 15.5, 9.5, 8.0, *LENSES["webcam"])
    points = np.array([[0.3, -0.2, -1], [-0.5, 0.1, -1]])
    np.testing.assert_allclose(small.project(points), camera.project(points) / 2, rtol=0, atol=1e-12)


def test_saved_cameras_can_be_read_before_and_after_there_were_lenses():
    camera = Intrinsics(8, 6, 4.0, 4.0, 4.0, 3.0, k1=0.1)
    assert Intrinsics(**asdict(camera)) == camera
    old = {"width": 8, "height": 6, "fl_x": 4.0, "fl_y": 4.0, "cx": 4.0, "cy": 3.0}
    assert Intrinsics(**old).lens == (0, 0, 0, 0, 0)
