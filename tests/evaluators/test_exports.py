"""Exports for other tools: ROS maps, OBJ meshes, TUM trajectories, TensorBoard, and trajectories adopted as runs."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml
from PIL import Image

import autonerf_lab as lab
from autonerf_lab.data.readers.tum import _trajectory
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import DataError
from autonerf_lab.evaluators import Scores, export_mesh
from autonerf_lab.evaluators import ros_map as module
from autonerf_lab.evaluators.ground_truth import MapGrid
from autonerf_lab.evaluators.maps import CellState
from autonerf_lab.evaluators.ros_map import export_ros_map, write_map
from autonerf_lab.geometry import Intrinsics, planar_pose
from autonerf_lab.simulator.motion_noise import MotionNoise
from autonerf_lab.types import Score

FREE, OCCUPIED, UNKNOWN = CellState.FREE, CellState.OCCUPIED, CellState.UNKNOWN


def test_a_map_of_ros(tmp_path: Path) -> None:
    """A 3 x 2 map whose cell [0, 0] is at the lowest x and y: in the image it is at the lower left."""
    states = np.array([[OCCUPIED, FREE, FREE], [UNKNOWN, FREE, OCCUPIED]], np.uint8)
    path = write_map(states, MapGrid(np.array([-1.5, 2.0]), (2, 3), 0.1), tmp_path / "home.yaml")
    content = yaml.safe_load(path.read_text())
    assert content == {"image": "home.pgm", "resolution": 0.1, "origin": [-1.5, 2.0, 0.0], "negate": 0,
                       "occupied_thresh": 0.65, "free_thresh": 0.196}  # fmt: skip
    pixels = np.asarray(Image.open(tmp_path / "home.pgm"))
    np.testing.assert_array_equal(pixels, [[205, 254, 0], [0, 254, 254]])
    occupied = (255 - pixels.astype(float)) / 255  # as map_server reads it
    assert (occupied[pixels == 0] > content["occupied_thresh"]).all()
    assert (occupied[pixels == 254] < content["free_thresh"]).all()
    assert (occupied[pixels == 205] > content["free_thresh"]).all()


class Column:
    """Field that is opaque in a column around the z axis, and seen everywhere, on a floor at z = 3 m."""

    def seen(self, points: np.ndarray) -> np.ndarray:
        return np.ones(len(points), bool)

    def density(self, points: np.ndarray) -> np.ndarray:
        inside = (np.abs(points[:, :2]) < 0.5).all(axis=1) & (points[:, 2] > 3.0) & (points[:, 2] < 4.0)
        return np.where(inside, 1e3, 0.0)


def test_the_band_of_a_map_is_above_the_floor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "surface_bounds", lambda field: np.array([[-1.0, -1, 3], [1, 1, 4]]))
    field: Any = Column()
    for floor, share in ((3.0, 0.25), (0.0, 0.0)):
        export_ros_map(field, tmp_path / "map.yaml", cell=0.1, floor=floor)
        pixels = np.asarray(Image.open(tmp_path / "map.pgm"))
        assert abs((pixels == 0).sum() * 0.01 - 4 * share) < 0.25
    with pytest.raises(DataError, match=r"suffix of a map must be \.yaml"):
        export_ros_map(field, tmp_path / "map.pgm")


def test_an_obj_mesh_is_y_up_and_keeps_its_colours(tmp_path: Path) -> None:
    box = trimesh.creation.box(bounds=[[0, 0, 0], [1, 2, 3]])
    box.visual.vertex_colors = np.tile([250, 10, 20, 255], (8, 1)).astype(np.uint8)
    loaded = trimesh.load(export_mesh(box, tmp_path / "box.obj"), process=False)
    np.testing.assert_allclose(loaded.bounds, [[0, 0, -2], [1, 3, 0]], atol=1e-6)
    assert (loaded.visual.vertex_colors[:, :3] == [250, 10, 20]).all()


def test_a_tum_trajectory_is_read_back(tmp_path: Path) -> None:
    poses = np.stack([planar_pose(0.3 * t, -t, 0.7 * t) for t in range(5)])
    trajectory = Trajectory(poses, np.zeros((5, 4, 4, 3), np.uint8), None, None, Intrinsics.from_fov(4, 4))
    stamps, found = _trajectory(lab.export_tum(trajectory, tmp_path / "poses.txt"))
    np.testing.assert_array_equal(stamps, np.arange(5))
    np.testing.assert_allclose(found, poses, atol=1e-8)


def test_scores_are_written_for_tensorboard(tmp_path: Path) -> None:
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    Scores([Score("rendering", "psnr", 21.5), Score("rendering", "lpips", None)]).to_tensorboard(tmp_path, step=7)
    events = accumulator.EventAccumulator(str(tmp_path)).Reload()
    assert events.Tags()["scalars"] == ["rendering/psnr"]
    (event,) = events.Scalars("rendering/psnr")
    assert (event.step, event.value) == (7, 21.5)


@pytest.mark.slow
def test_a_saved_trajectory_becomes_a_run(tmp_path: Path) -> None:
    from autonerf_lab.errors import RunFolderError
    from autonerf_lab.pipeline import load_finished_trajectory, run_stage
    from autonerf_lab.pipeline.run_folder import load_run

    sim = lab.Simulator(lab.load_scene("train-04"), Intrinsics.from_fov(48, 48, 60), supersample=1)
    trajectory = lab.explore(sim, "random", 12, progress=False)
    trajectory.save(tmp_path / "saved")
    run = lab.adopt_trajectory(tmp_path / "saved", tmp_path / "run", preset_name="smoke", model="instant-ngp")
    assert list(load_run(run).stages) == ["scene", "explore"]
    np.testing.assert_array_equal(load_finished_trajectory(run).rgb, trajectory.rgb)
    config = load_run(run).config
    assert (config.width, config.height, config.hfov_deg) == (48, 48, 60), (
        "test views have the camera of the trajectory"
    )
    run_stage(run, "fit")
    assert (run / "nerf/nerf.json").exists()
    with pytest.raises(RunFolderError, match="holds a finished run"):
        lab.adopt_trajectory(tmp_path / "saved", run, preset_name="smoke", model="instant-ngp")
    noisy = lab.Simulator(sim.scene, sim.intrinsics, 1, noise=MotionNoise(scale=2.0), depth_noise="redwood")
    lab.explore(noisy, "random", 12, poses="true", progress=False).save(tmp_path / "noisy")
    of_noisy = load_run(lab.adopt_trajectory(tmp_path / "noisy", tmp_path / "run_of_noisy", preset_name="smoke")).config
    assert (of_noisy.noise, of_noisy.noise_scale, of_noisy.depth_noise) == ("ans", 2.0, "redwood")
    assert (of_noisy.poses, of_noisy.semantics) == ("true", None)
    assert (config.noise, config.depth_noise, config.poses) == (None, None, None)
    trajectory.meta["scene"] = "scan"
    trajectory.save(tmp_path / "of_a_scan")
    with pytest.raises(DataError, match=r"recorded in 'scan', no scene of the library; give its file with --scene"):
        lab.adopt_trajectory(tmp_path / "of_a_scan", tmp_path / "other")
    with pytest.raises(DataError, match="was recorded in another scene"):
        lab.adopt_trajectory(tmp_path / "saved", tmp_path / "other", scene="train-05")
