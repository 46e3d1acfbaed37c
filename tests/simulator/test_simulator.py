"""Simulator: images against ray casting and OpenGL, motion, collisions, noise and highlights."""

from dataclasses import replace

import numpy as np
import pytest
from toy_scene import closet, empty_room, two_rooms, uneven_floor

from autonerf_lab.errors import SceneError
from autonerf_lab.geometry import Intrinsics, camera_rays, planar_from_pose, planar_pose, so3_exp, world_to_cell
from autonerf_lab.scenes import Scene, generate_apartment
from autonerf_lab.scenes.build import build
from autonerf_lab.simulator import MotionNoise, RayCaster, Simulator
from autonerf_lab.simulator.motion_noise import compose
from autonerf_lab.types import Action


@pytest.fixture(scope="module")
def sim():
    return Simulator(two_rooms(), Intrinsics.from_fov(48, 40))


def _random_poses(count):
    rng = np.random.default_rng(0)
    for _ in range(count):
        pose = planar_pose(*rng.uniform((0.2, 0.2, -3), (7.8, 2.8, 3)))
        pose[:3, :3] = so3_exp(rng.normal(0, 0.4, 3)) @ pose[:3, :3]  # tilted
        yield pose


def test_a_camera_with_lens_distortion_is_refused():
    with pytest.raises(ValueError, match="no lens distortion"):
        Simulator(two_rooms(), replace(Intrinsics.from_fov(8, 8), k1=0.1))


def test_depth_towards_a_wall_is_its_distance_everywhere(sim):
    frame = Simulator(empty_room(), Intrinsics.from_fov(32, 32)).render(planar_pose(1, 1.5, 0.0))
    # The wall x = 4 is 3 m ahead; depth is along the axis, so it does not grow towards the corners of the image.
    np.testing.assert_allclose(frame.depth[16, 12:20], 3.0, rtol=1e-6)
    # Floor: half a pixel under the lower edge's ray looks down 45 degrees, and the camera is 0.88 m up.
    np.testing.assert_allclose(frame.depth[31, 16], 0.88 / (15.5 / 16), rtol=1e-6)


@pytest.mark.parametrize("supersample", [1, 2, 3])
def test_images_agree_with_ray_casting(supersample):
    """Compare the rasteriser with embree, an independent implementation."""
    scene = two_rooms()
    sim = Simulator(scene, Intrinsics.from_fov(48, 40), supersample=supersample)
    wrong = total = 0
    for pose in _random_poses(20):
        frame = sim.render(pose, rgb=False)
        rays_o, rays_d = camera_rays(sim.intrinsics, pose)
        hits = sim.cast(rays_o.reshape(-1, 3), rays_d.reshape(-1, 3))
        assert np.isfinite(hits.t).all()  # the rooms are closed
        depth = hits.t.reshape(frame.depth.shape)
        wrong += int((np.abs(frame.depth - depth) > 1e-4).sum())
        wrong += int((frame.semantics != scene.face_class[hits.face].reshape(depth.shape)).sum())
        wrong += int((frame.instances != scene.face_instance[hits.face].reshape(depth.shape)).sum())
        total += depth.size
    assert wrong <= 2e-4 * total  # rays that graze an edge within rounding


def test_colour_is_the_texel_the_ray_hits(sim):
    scene = sim.scene
    single = Simulator(scene, sim.intrinsics, supersample=1)
    for pose in _random_poses(3):
        rgb = single.render(pose).rgb.reshape(-1, 3)
        rays_o, rays_d = (r.reshape(-1, 3) for r in camera_rays(sim.intrinsics, pose))
        hits = sim.cast(rays_o, rays_d)
        for i in range(0, len(rgb), 37):
            corners = scene.vertices[scene.faces[hits.face[i]]].astype(np.float64)
            point = rays_o[i] + hits.t[i] * rays_d[i]
            weights = np.linalg.lstsq(np.vstack([corners.T, np.ones(3)]), np.append(point, 1), rcond=None)[0]
            u, v = weights @ scene.uv[hits.face[i]]
            height, width = scene.texture.shape[:2]
            x, y = u * width - 0.5, v * height - 0.5
            x0, y0 = int(x), int(y)
            patch = scene.texture[y0 : y0 + 2, x0 : x0 + 2].astype(np.float64)
            fx, fy = x - x0, y - y0
            want = np.einsum("i,j,ijc->c", [1 - fy, fy], [1 - fx, fx], patch)
            np.testing.assert_allclose(rgb[i], want, atol=4)  # embree's t is float32: 4 grey levels of a steep edge


def test_supersampled_colour_is_the_mean_of_the_fine_image(sim):
    pose = planar_pose(1, 1, 0.3)
    k = sim.intrinsics
    fine = Simulator(sim.scene, k.resized(2 * k.width, 2 * k.height), supersample=1).render(pose).rgb
    mean = fine.reshape(k.height, 2, k.width, 2, 3).mean(axis=(1, 3))
    assert np.abs(sim.render(pose).rgb - mean).max() <= 1


def test_rgb_false_does_not_compute_the_texture(sim):
    class NoTexture:
        def __getattr__(self, name):
            assert name != "texture", "the texture must not be made"
            return getattr(sim.scene, name)

    blind = Simulator(NoTexture(), sim.intrinsics, rgb=False)
    observation = blind.reset(seed=0)
    assert not observation.rgb.any()
    np.testing.assert_array_equal(observation.depth, sim.reset(seed=0).depth)


def test_view_without_surface_is_black_without_label_and_depth(sim):
    pose = planar_pose(20, 20, 0.0)  # outside, looking away
    frame = sim.render(pose)
    assert not frame.rgb.any() and not frame.depth.any() and not frame.semantics.any() and not frame.instances.any()


def test_a_camera_inside_an_object_sees_its_back_faces(sim):
    frame = sim.render(planar_pose(7.7, 0.3, 0.0))
    assert (frame.semantics == 10).all()
    np.testing.assert_allclose(frame.depth[20, 24], 0.28, atol=1e-6)


def test_cast_scales_with_the_direction():
    caster = RayCaster(np.array([[[2, -1, -1], [2, 3, -1], [2, -1, 3]]], np.float32))
    hits = caster.cast(np.zeros((3, 3)), np.array([[1, 0, 0], [0.5, 0, 0], [-1, 0, 0]]))
    np.testing.assert_allclose(hits.t, [2, 4, np.inf], rtol=1e-6)  # rounding of the last bit depends on the processor
    assert hits.face.tolist() == [0, 0, -1]


def test_navigable_floor_respects_the_radius(sim):
    nav = sim.navigation
    assert nav.is_navigable(2, 1.5)
    assert nav.is_navigable(4.05, 1.5)  # in the doorway
    assert not nav.is_navigable(0.7, 2.5)  # in the bed
    assert not nav.is_navigable(-1, 1)
    assert not nav.is_navigable(100, 100)
    assert not nav.is_navigable(2, 0.17)  # closer to the wall than the radius
    assert nav.is_navigable(2, 0.24)  # tolerance: one cell of 2.5 cm
    # The floor between the legs of the table is free, but the slab blocks the robot.
    assert not nav.is_navigable(5.5, 2.55)


def test_navigable_area_of_an_empty_room():
    nav = Simulator(empty_room(4, 3), Intrinsics.from_fov(8, 8)).navigation
    inner = (4 - 2 * 0.18) * (3 - 2 * 0.18)
    assert 0.95 * inner < nav.area <= inner


@pytest.mark.parametrize(
    ("height", "run", "fits"),
    [
        (-0.15, 0.0, True),  # a dip
        (-0.25, 0.0, False),  # a pit
        (0.04, 0.0, True),
        (0.08, 0.0, False),  # a step
        (0.15, 0.30, True),  # a bump, 27 degrees
        (0.15, 0.10, False),  # 56 degrees
        (0.25, 0.60, False),  # a ramp that leads too high
    ],
)
def test_uneven_floors(height, run, fits):
    profile = ((0, 0.0), (1, 0.0), (1 + run, height), (3 - run, height), (3, 0.0), (5, 0.0))
    ground = Simulator(uneven_floor(*profile), Intrinsics.from_fov(8, 8)).navigation
    rows, cols = world_to_cell(np.array([(2, 1), (0.5, 1)]), ground.origin, ground.cell).T
    assert ground.is_navigable(4, 1)
    assert ground.is_navigable(2, 1) == fits
    assert ground.navigable[rows, cols].tolist() == [fits, fits], "the other side is reachable across the obstacle"


@pytest.mark.parametrize(("gap", "fits"), [(0.2, True), (0.3, False)])
def test_gaps_in_the_floor(gap, fits):
    nothing = float("nan")
    profile = ((0, 0.0), (1, 0.0), (1, nothing), (1 + gap, nothing), (1 + gap, 0.0), (5, 0.0))
    ground = Simulator(uneven_floor(*profile), Intrinsics.from_fov(8, 8)).navigation
    rows, cols = world_to_cell(np.array([(1 + gap / 2, 1), (0.5, 1)]), ground.origin, ground.cell).T
    assert ground.is_navigable(4, 1)
    assert ground.navigable[rows, cols].tolist() == [fits, fits]


def test_scenes_without_navigable_floor_are_refused():
    with pytest.raises(SceneError, match="no floor area for a robot"):
        Simulator(closet())
    scene = two_rooms()
    lifted = type(scene)(
        "lifted",
        scene.vertices + np.float32(1),
        scene.faces,
        scene.face_class,
        scene.face_instance,
        scene.uv,
        scene.texture,
    )
    with pytest.raises(SceneError, match="no floor"):
        Simulator(lifted)
    huge = type(scene)(
        "huge", scene.vertices * 1000, scene.faces, scene.face_class, scene.face_instance, scene.uv, scene.texture
    )
    with pytest.raises(SceneError, match="to metres"):
        Simulator(huge)


def test_start_pose_in_furniture_is_refused(sim):
    with pytest.raises(SceneError, match=r"cannot stand at x = 0\.70, y = 2\.50"):
        sim.reset(pose=planar_pose(0.7, 2.5, 0))


def test_actions_move_as_the_paper_says(sim):
    sim.reset(pose=planar_pose(2, 1.5, 0.0))
    observation = sim.step(Action.FORWARD)
    np.testing.assert_allclose(planar_from_pose(observation.pose), (2.25, 1.5, 0), atol=1e-9)
    assert not observation.collided and observation.step == 1
    observation = sim.step(Action.TURN_LEFT)
    np.testing.assert_allclose(planar_from_pose(observation.pose), (2.25, 1.5, np.pi / 6), atol=1e-9)
    for _ in range(2):
        observation = sim.step(Action.TURN_RIGHT)
    np.testing.assert_allclose(planar_from_pose(observation.pose), (2.25, 1.5, -np.pi / 6), atol=1e-9)
    with pytest.raises(ValueError):
        sim.step(3)


def test_a_wall_stops_the_robot_or_lets_it_slide(sim):
    sim.reset(pose=planar_pose(2, 0.3, -np.pi / 2))
    assert sim.step(Action.FORWARD).collided
    x, y, _ = planar_from_pose(sim.pose)
    assert x == pytest.approx(2, abs=1e-6) and 0.18 <= y < 0.22
    sim.reset(pose=planar_pose(2, 0.22, -np.pi / 6))
    observation = sim.step(Action.FORWARD)
    x, y, _ = planar_from_pose(sim.pose)
    assert x == pytest.approx(2 + 0.25 * np.cos(np.pi / 6), abs=0.01) and 0.18 <= y <= 0.22  # slides along the wall
    assert not observation.collided  # it still moved more than 20 cm
    sim.reset(pose=planar_pose(2, 0.22, -np.pi / 3))
    assert sim.step(Action.FORWARD).collided


def test_the_robot_never_ends_in_collision(sim):
    rng = np.random.default_rng(3)
    sim.reset(seed=5)
    for _ in range(3000):
        sim.move(rng.choice(3, p=[0.6, 0.2, 0.2]))
        x, y, _ = planar_from_pose(sim.pose)
        assert sim.navigation.is_navigable(x, y)


def test_the_seed_determines_the_start_pose(sim):
    first = sim.reset(seed=7)
    again = sim.reset(seed=7)
    np.testing.assert_array_equal(first.pose, again.pose)
    np.testing.assert_array_equal(first.rgb, again.rgb)
    starts = np.array([planar_from_pose(sim.reset(seed=s).pose) for s in range(200)])
    assert (starts[:, 0] < 4).mean() == pytest.approx(0.5, abs=0.12)  # both rooms
    assert np.abs(np.cos(starts[:, 2]).mean()) < 0.2  # all headings


def test_odometry_drifts_only_with_odometry_noise():
    scene = empty_room(20, 20)
    camera = Intrinsics.from_fov(4, 4)
    exact = Simulator(scene, camera, rgb=False, noise=MotionNoise(odometry=False))
    drifting = Simulator(scene, camera, rgb=False, noise=MotionNoise(actuation=False))
    for sim, drift in ((exact, False), (drifting, True)):
        observation = sim.reset(seed=0, pose=planar_pose(10, 10, 0))
        for action in [0, 0, 1, 0, 2] * 4:
            observation = sim.step(action)
        error = np.abs(observation.pose - sim.pose).max()
        assert (error > 1e-3) == drift
    np.testing.assert_allclose(compose(0, 0, np.pi / 2, (1, 0.5, 0)), (-0.5, 1, np.pi / 2), atol=1e-12)


def test_noisy_motion_is_reproducible():
    sim = Simulator(two_rooms(), Intrinsics.from_fov(8, 8), rgb=False, noise=MotionNoise())
    trajectories = []
    for _ in range(2):
        sim.reset(seed=11)
        trajectories.append([sim.step(a).pose for a in [0, 1, 0, 2, 0]])
    np.testing.assert_array_equal(trajectories[0], trajectories[1])


def test_opengl_agrees():
    """Compare with an independent OpenGL renderer, if it is installed."""
    from autonerf_lab.errors import AutoNerfError
    from autonerf_lab.simulator.opengl import GLRenderer

    scene = two_rooms()
    ours = Simulator(scene, Intrinsics.from_fov(64, 48), supersample=1)
    try:
        theirs = GLRenderer(scene, ours.intrinsics)
    except AutoNerfError as error:
        pytest.skip(str(error))
    far = different = total = 0
    with theirs:
        for pose in _random_poses(10):
            frame = ours.render(pose)
            rgb, depth = theirs.render(pose)
            far += int((np.abs(depth - frame.depth) > 0.01).sum())
            different += int((np.abs(rgb.astype(int) - frame.rgb).max(axis=-1) > 12).sum())
            total += depth.size
    assert far <= 0.01 * total
    assert different <= 0.02 * total


def test_ray_casting_and_rasterisation_give_the_same_images(monkeypatch):
    scene = generate_apartment(11)
    camera = Intrinsics.from_fov(48, 48)
    sim = Simulator(scene, camera)
    poses = [sim.sample_pose(np.random.default_rng(k)) for k in range(4)]
    expected = [sim.render(pose) for pose in poses]
    monkeypatch.setattr("autonerf_lab.simulator.simulator.CAST_FROM", 0)
    for pose, frame in zip(poses, expected, strict=True):
        cast = sim.render(pose)
        same = np.abs(cast.depth - frame.depth) < 1e-3
        assert same.mean() > 0.995 and (cast.instances == frame.instances)[same].mean() > 0.999
        assert np.abs(cast.rgb.astype(int) - frame.rgb).mean() < 0.5


def polished_floor() -> tuple[Scene, np.ndarray]:
    """Return a glossy black floor of 8 x 8 m with one lamp 2 m above its centre, and the position of the lamp."""
    floor = {"id": 0, "class": "background", "name": "floor", "parts": [
        {"quad": [[8, 0, 0], [0, 8, 0]], "at": [-4, -4, 0], "m": "slate"}]}  # fmt: skip
    lamp = {"kind": "lamp", "at": [0, 0, 2], "color": [1, 1, 1], "power": 4}
    spec = {"name": "floor", "lights": [lamp], "materials": {"slate": {"kind": "tile"}}, "objects": [floor]}
    spec["rooms"] = [{"category": "living", "polygon": [[-4, -4], [4, -4], [4, 4], [-4, 4]]}]
    scene = replace(build(spec), bake=lambda: np.zeros((8, 8, 3), np.uint8))
    return scene, np.array(lamp["at"], dtype=float)


def test_a_highlight_is_at_the_mirror_image_of_the_lamp():
    scene, lamp = polished_floor()
    sim = Simulator(scene, Intrinsics.from_fov(129, 129), supersample=1, gloss=True)
    for x in (-3.8, -3.0):
        pose = planar_pose(x, 0.5, 0.0)
        rgb = sim.render(pose).rgb.astype(float).sum(axis=2)
        eye = pose[:3, 3]
        mirrored = lamp * [1, 1, -1]
        t = eye[2] / (eye[2] - mirrored[2])
        expected = eye + t * (mirrored - eye)  # on the floor
        k = sim.intrinsics
        ahead, left, down = expected[0] - eye[0], expected[1] - eye[1], eye[2]
        column, row = k.cx - k.fl_x * left / ahead, k.cy + k.fl_y * down / ahead
        brightest = np.argwhere(rgb == rgb.max()).mean(axis=0)
        assert abs(brightest[1] + 0.5 - column) < 4 and abs(brightest[0] + 0.5 - row) < 8, (x, brightest, row, column)
        assert rgb.max() > 100 and rgb[64:].min() < 5


def test_gloss_adds_highlights_only_on_glossy_surfaces():
    scene = generate_apartment(11)
    camera = Intrinsics.from_fov(48, 48)
    plain, glossy = Simulator(scene, camera), Simulator(scene, camera, gloss=True)
    dull = Simulator(replace(scene, gloss=np.zeros(len(scene.faces), np.float32)), camera, gloss=True)
    rng = np.random.default_rng(0)
    brighter = 0
    for _ in range(6):
        pose = plain.sample_pose(rng)
        without, with_ = plain.render(pose), glossy.render(pose)
        assert np.array_equal(dull.render(pose).rgb, without.rgb)
        assert (with_.rgb >= without.rgb).all() and np.array_equal(with_.depth, without.depth)
        brighter += int((with_.rgb.astype(int) - without.rgb).max() > 20)
    assert brighter >= 4


def test_gloss_needs_a_generated_scene():
    toy = two_rooms()
    scan = Scene("scan", toy.vertices, toy.faces, toy.face_class, toy.face_instance, toy.uv, bake=lambda: toy.texture)
    with pytest.raises(SceneError, match="gloss=False"):
        Simulator(scan, gloss=True)
