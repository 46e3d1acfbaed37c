"""A baseline for meshes: the walk's true depth, fused by the classical method (Curless and Levoy 1996).

Each image says how far every voxel is from the surface along its ray, cut off at four voxels; the mesh is where the
mean over the images is zero. Poses are those of the walk, depth that of its sensor, up to 5 m. What a field learned
from colours and classes stands beside what could be measured.
"""

import os
from dataclasses import replace
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from autonerf_lab.config import Preset
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import DataError, MissingPackageError
from autonerf_lab.evaluators.mesh import MIN_TRIANGLES, large_pieces
from autonerf_lab.evaluators.mesh_metrics import evaluate_mesh
from autonerf_lab.evaluators.radiance_field import Field
from autonerf_lab.evaluators.scores import Scores
from autonerf_lab.evaluators.task_result import TaskResult
from autonerf_lab.evaluators.tasks import METRICS, Run, run_task
from autonerf_lab.mapping.semantic_map import FAR

if TYPE_CHECKING:
    import trimesh

    from autonerf_lab.scenes.scene import Scene

VIEWS = 500  # at most, evenly spread over the walk
TRUNCATION = 4.0  # voxels
MIN_VIEWS = 3.0  # that have seen a voxel
_STRIDE = 4  # pixels between those that Open3D looks for voxels along
_Y_UP_TO_Y_DOWN = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenGL's camera to OpenCV's


def fuse(walk: Trajectory, voxel: float, min_triangles: int = MIN_TRIANGLES) -> "trimesh.Trimesh":
    """The surface that the depth images of a walk agree on.

    Args:
        walk: with depth.
        voxel: metres.
        min_triangles: connected pieces with fewer are dropped.

    Returns:
        World frame, metres, without colours; empty without any surface.

    Raises:
        DataError: the walk has no depth.
        MissingPackageError: open3d is not installed.
    """
    import trimesh

    if walk.depth is None:
        raise DataError("this walk has no depth to fuse: walk again with `lab.explore`, which keeps it")
    try:
        os.environ.setdefault("OPEN3D_DISABLE_WEB_VISUALIZER", "true")  # which it would announce in a notebook
        o3d: Any = import_module("open3d")  # here, because it takes seconds
    except (ImportError, OSError) as error:  # OSError: a library of the system is missing
        raise MissingPackageError(
            f'open3d cannot be imported ({error}): pip install "autonerf-lab[open3d]", and what apt.txt names'
        ) from error
    k, tensor = walk.intrinsics, o3d.core.Tensor
    # Open3D cuts the fraction off a pixel, so the middle of the first one is at 0.5, as it is here
    camera = tensor([[k.fl_x, 0, k.cx], [0, k.fl_y, k.cy], [0, 0, 1]], o3d.core.float64)
    volume = o3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight"), (o3d.core.float32, o3d.core.float32), ((1,), (1,)), voxel, block_count=1000
    )
    looked = False
    for t in np.unique(np.linspace(0, len(walk) - 1, VIEWS).round().astype(int)):
        c2w, depth = walk.poses[t], walk.depth[t]
        near = depth[::_STRIDE, ::_STRIDE]
        if not ((near > 0) & (near < FAR)).any():
            continue  # Open3D fails on an image that shows nothing
        looked = True
        image = o3d.t.geometry.Image(np.ascontiguousarray(depth, np.float32))
        w2c = tensor(np.linalg.inv(c2w @ _Y_UP_TO_Y_DOWN))
        blocks = volume.compute_unique_block_coordinates(image, camera, w2c, 1.0, FAR, TRUNCATION)
        volume.integrate(blocks, image, camera, w2c, 1.0, FAR, TRUNCATION)
    found = volume.extract_triangle_mesh(MIN_VIEWS) if looked else None
    if found is None or found.is_empty():
        return trimesh.Trimesh(process=False)
    mesh = trimesh.Trimesh(
        found.vertex.positions.numpy().astype(np.float64), found.triangle.indices.numpy(), process=False
    )
    mesh.update_faces(large_pieces(mesh.faces, len(mesh.vertices), min_triangles))
    mesh.remove_unreferenced_vertices()
    return mesh


class FusedRun(Run):
    """The task ``mesh`` for the fused depth of a walk instead of a field, which only says what was seen."""

    metrics = {"mesh": METRICS["mesh"]}  # noqa: RUF012 - never written to

    def __init__(self, field: Field, scene: "Scene", preset: Preset, seed: int, walk: Trajectory) -> None:
        super().__init__(field, scene, preset, seed, lambda: None, None)
        self.walk = walk

    def mesh(self) -> TaskResult:
        """Task 5."""
        try:
            mesh = fuse(self.walk, self.preset.mesh_voxel)
        except MissingPackageError:
            names = self.metrics["mesh"]
            return TaskResult(dict.fromkeys(names), {}, dict.fromkeys(names, "open3d_missing"))
        return evaluate_mesh(mesh, self.field, self.scene, self.seed)


def fused_scores(field: Field, scene: "Scene", preset: Preset, seed: int, walk: Trajectory) -> Scores:
    """What the fused depth of a walk scores as a mesh; without values where open3d is not installed.

    Args:
        field: trained on the walk: it says which parts of the truth were seen, the same for both.
        scene: the truth.
        preset: decides the size of the voxels.
        seed: of the samples.
        walk: with depth.
    """
    rows, result = run_task(FusedRun(field, scene, preset, seed, walk), "mesh")
    return Scores((replace(row, model="tsdf") for row in rows), {"mesh": result.artifact})
