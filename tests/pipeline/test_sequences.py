"""An RGB-D sequence of another tool from end to end: scored on held-out views, and turned into a mesh and a map."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml
from PIL import Image
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from autonerf_lab import cli
from autonerf_lab.evaluators import Scores
from autonerf_lab.evaluators.rendering import sample_test_poses
from autonerf_lab.geometry import OPENCV_AXES, Intrinsics, cell_to_world
from autonerf_lab.scenes import load_scene
from autonerf_lab.simulator import Simulator

pytestmark = pytest.mark.slow


def write_tum(sim: Simulator, poses: np.ndarray, folder: Path) -> None:
    """Write views of a scene as a sequence of TUM RGB-D."""
    camera, lines = sim.intrinsics, []
    for name in ("rgb", "depth"):
        (folder / name).mkdir(parents=True)
        (folder / f"{name}.txt").write_text("".join(f"{t}.0 {name}/{t}.png\n" for t in range(len(poses))))
    for t, c2w in enumerate(poses):
        frame = sim.render(c2w)
        Image.fromarray(frame.rgb).save(folder / f"rgb/{t}.png")
        Image.fromarray((frame.depth * 5000).round().astype(np.uint16)).save(folder / f"depth/{t}.png")
        pose = c2w @ OPENCV_AXES
        values = (t, *pose[:3, 3], *Rotation.from_matrix(pose[:3, :3]).as_quat())
        lines.append(" ".join(f"{value:.9f}" for value in values))
    (folder / "groundtruth.txt").write_text("\n".join(lines))
    numbers = (camera.width, camera.height, camera.fl_x, camera.fl_y, camera.cx - 0.5, camera.cy - 0.5)
    (folder / "camera.txt").write_text(" ".join(map(str, numbers)))


def test_a_sequence_is_scored_and_becomes_a_mesh_and_a_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sim = Simulator(load_scene("train-04"), Intrinsics.from_fov(64, 48), supersample=1)
    write_tum(sim, sample_test_poses(sim, 48), tmp_path / "office")
    out = tmp_path / "run"
    model = ["--model", "semantic-nerfacto-rgbd", "--preset", "smoke"]
    assert cli.main(["fit", str(tmp_path / "office"), "--out", str(out), *model]) == 0
    assert "42 training photographs, 6 held-out photographs" in capsys.readouterr().out
    scores = Scores.load(out / "scores.json")
    values = {score.metric: score.value or 0.0 for score in scores}
    nearest = {score.metric: score.value or 0.0 for score in Scores.load(out / "baselines/nearest_view.json")}
    assert 0 < values["depth_median_error_m"] < 0.1 and values["psnr"] > nearest["psnr"] + 1

    assert cli.main(["export", "mesh", str(out), "--out", str(tmp_path / "office.ply"), "--voxel", "0.1"]) == 0
    mesh = trimesh.load(tmp_path / "office.ply")  # PLY is z up, like the sequence
    scene = trimesh.Trimesh(sim.scene.vertices, sim.scene.faces, process=False)
    distance = cKDTree(scene.sample(100_000, seed=0)).query(mesh.vertices)[0]
    assert np.abs(mesh.bounds - sim.scene.bounds).max() < 0.4 and np.median(distance) < 0.1

    assert cli.main(["export", "map", str(out), "--out", str(tmp_path / "office.yaml"), "--cell", "0.1"]) == 0
    frame = yaml.safe_load((tmp_path / "office.yaml").read_text())
    image = np.asarray(Image.open(tmp_path / "office.pgm"))[::-1]
    ground = sim.navigation
    where = cell_to_world(np.argwhere(ground.navigable), ground.origin, ground.cell)
    column, row = ((where - frame["origin"][:2]) / frame["resolution"]).astype(int).T
    free, occupied = (float((image[row, column] == value).mean()) for value in (254, 0))
    assert free > 0.6 and occupied < 0.1, "where the robot fits, the map is free or not seen"
    assert (image == 0).mean() > 0.1
