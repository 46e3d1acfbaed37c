"""Fused depth of a trajectory: accurate surfaces, and baseline scores beside those of a field."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import toy_scene
from toy_trajectory import toy_trajectory

from autonerf_lab.errors import DataError, MissingPackageError
from autonerf_lab.evaluators import TrueField, evaluate
from autonerf_lab.evaluators.mesh_metrics import evaluate_mesh
from autonerf_lab.evaluators.tsdf import fuse
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.simulator import Simulator

pytest.importorskip("open3d")


@pytest.fixture(scope="module")
def sim():
    return Simulator(toy_scene.empty_room(), Intrinsics.from_fov(64, 64), supersample=1)


@pytest.fixture(scope="module")
def trajectory(sim):
    return toy_trajectory(sim, 80, depth=True)


def test_a_room_of_four_by_three_metres(sim, trajectory):
    mesh = fuse(trajectory, 0.05)
    np.testing.assert_allclose(mesh.bounds, [[0, 0, 0], [4, 3, 2.5]], atol=0.04)
    values = evaluate_mesh(mesh, TrueField(sim.scene, sim, views=1), sim.scene).values
    assert values["accuracy_m"] < 0.01 and values["completion_ratio"] > 90 and values["normal_consistency"] > 0.95
    level = np.abs(mesh.face_normals[:, 2]) > 0.9
    up, low = mesh.face_normals[level, 2] > 0, mesh.triangles_center[level, 2] < 1
    assert (up == low).mean() > 0.99, "the floor faces up and the ceiling down"


def test_two_processes_give_the_same_bytes(trajectory, tmp_path):
    k = slice(20)  # frames
    parts = {name: getattr(trajectory, name)[k] for name in ("poses", "rgb", "depth", "semantics")}
    replace(trajectory, **parts).save(tmp_path / "trajectory")
    code = (
        "import sys, hashlib; from autonerf_lab.data.trajectory import load_trajectory;"
        "from autonerf_lab.evaluators.tsdf import fuse; mesh = fuse(load_trajectory(sys.argv[1]), 0.1, 1);"
        "print(len(mesh.faces), hashlib.sha256(mesh.vertices.tobytes() + mesh.faces.tobytes()).hexdigest())"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "trajectory")]
    first, second = (subprocess.run(command, check=True, capture_output=True, text=True).stdout for _ in range(2))
    assert first == second and int(first.split()[0]) > 1000


def test_half_a_pixel_shift_is_worse(sim, trajectory):
    """The centre of a pixel has different conventions in different libraries."""
    field = TrueField(sim.scene, sim, views=1)
    accuracy = []
    for shift in (-0.5, 0.0, 0.5):
        k = replace(trajectory.intrinsics, cx=trajectory.intrinsics.cx + shift, cy=trajectory.intrinsics.cy + shift)
        mesh = fuse(replace(trajectory, intrinsics=k), 0.05)
        accuracy.append(evaluate_mesh(mesh, field, sim.scene, samples=5000).values["accuracy_m"])
    assert accuracy[1] < 0.5 * min(accuracy[0], accuracy[2])


def test_a_trajectory_without_surfaces_gives_an_empty_mesh(trajectory):
    blind = replace(
        trajectory, depth=np.zeros_like(trajectory.depth[:3]), poses=trajectory.poses[:3], rgb=trajectory.rgb[:3]
    )
    assert len(fuse(blind, 0.05).faces) == 0
    with pytest.raises(DataError, match="no depth"):
        fuse(replace(trajectory, depth=None), 0.05)


def test_fused_depth_is_a_baseline_of_the_mesh(sim, trajectory, monkeypatch):
    field = TrueField(sim.scene, sim, views=1)
    baseline = evaluate(field, sim.scene, "smoke", tasks=["mesh"], progress=False, trajectory=trajectory).baselines[
        "tsdf"
    ]
    assert baseline["mesh", "completion_ratio"] > 90 and {row.model for row in baseline} == {"tsdf"}
    without = evaluate(
        field, sim.scene, "smoke", tasks=["mesh"], progress=False, trajectory=replace(trajectory, depth=None)
    )
    assert without.baselines == {}

    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(MissingPackageError, match=r"autonerf-lab\[open3d\]"):
        fuse(trajectory, 0.05)
    baseline = evaluate(field, sim.scene, "smoke", tasks=["mesh"], progress=False, trajectory=trajectory).baselines[
        "tsdf"
    ]
    assert {row.status for row in baseline} == {"open3d_missing"} and {row.value for row in baseline} == {None}


def test_kernels_run_without_a_warning_after_open3d_has_been_loaded():
    code = "import autonerf_lab as lab, open3d; print(lab.generate_apartment(1).texture.shape)"
    done = subprocess.run(
        [sys.executable, "-W", "error::numba.NumbaWarning", "-c", code], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
