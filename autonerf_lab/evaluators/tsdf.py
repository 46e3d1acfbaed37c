"""Baseline for meshes: the depth images of the trajectory, fused by a truncated signed distance function (TSDF).

The method is that of Curless and Levoy (1996). Each depth image gives the signed distance of every voxel to the surface
along its ray, truncated at four voxels. The mesh is the zero level set of the mean over the images. Poses and depth, up
to 5 m, are those of the trajectory.
"""

import os
from dataclasses import replace
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import DataError, MissingPackageError
from autonerf_lab.evaluators.context import EvaluationContext
from autonerf_lab.evaluators.mesh import MIN_TRIANGLES, large_components
from autonerf_lab.evaluators.mesh_metrics import MeshTask, evaluate_mesh
from autonerf_lab.evaluators.radiance_field import RadianceField
from autonerf_lab.evaluators.scores import Scores
from autonerf_lab.evaluators.task import TaskResult
from autonerf_lab.evaluators.tasks import run_task
from autonerf_lab.geometry import OPENCV_AXES
from autonerf_lab.mapping.semantic_map import FAR
from autonerf_lab.presets import Preset

if TYPE_CHECKING:
    import trimesh

    from autonerf_lab.scenes.scene import Scene

VIEWS = 500  # maximum number of images, evenly spaced along the trajectory
TRUNCATION = 4.0  # voxels
MIN_VIEWS = 3.0  # minimum weight of a voxel on the surface
_STRIDE = 4  # Open3D selects voxels along every fourth pixel


def fuse(trajectory: Trajectory, voxel: float, min_triangles: int = MIN_TRIANGLES) -> "trimesh.Trimesh":
    """Fuse the depth images of a trajectory into a mesh.

    Args:
        trajectory: with depth.
        voxel: side of a voxel, metres.
        min_triangles: smaller connected components are removed.

    Returns:
        The mesh in the world frame, metres, without colours; empty if there is no surface.

    Raises:
        DataError: the trajectory has no depth.
        MissingPackageError: open3d is not installed.
    """
    import trimesh

    if trajectory.depth is None:
        raise DataError("this trajectory has no depth to fuse; record one with `lab.explore`, which stores depth")
    try:
        os.environ.setdefault("OPEN3D_DISABLE_WEB_VISUALIZER", "true")  # avoids a message in notebooks
        o3d: Any = import_module("open3d")  # imported here because it takes seconds
    except (ImportError, OSError) as error:  # OSError: a system library is missing
        raise MissingPackageError(
            f'open3d cannot be imported ({error}): run pip install "autonerf-lab[open3d]" and install the packages in '
            "apt.txt"
        ) from error
    k, tensor = trajectory.intrinsics, o3d.core.Tensor
    # Open3D truncates pixel coordinates, so the centre of the first pixel is at 0.5, as here.
    camera = tensor([[k.fl_x, 0, k.cx], [0, k.fl_y, k.cy], [0, 0, 1]], o3d.core.float64)
    volume = o3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight"), (o3d.core.float32, o3d.core.float32), ((1,), (1,)), voxel, block_count=1000
    )
    found_surface = False
    for t in np.unique(np.linspace(0, len(trajectory) - 1, VIEWS).round().astype(int)):
        c2w, depth = trajectory.poses[t], trajectory.depth[t]
        near = depth[::_STRIDE, ::_STRIDE]
        if not ((near > 0) & (near < FAR)).any():
            continue  # Open3D fails on an image without surfaces
        found_surface = True
        image = o3d.t.geometry.Image(np.ascontiguousarray(depth, np.float32))
        w2c = tensor(np.linalg.inv(c2w @ OPENCV_AXES))
        blocks = volume.compute_unique_block_coordinates(image, camera, w2c, 1.0, FAR, TRUNCATION)
        volume.integrate(blocks, image, camera, w2c, 1.0, FAR, TRUNCATION)
    found = volume.extract_triangle_mesh(MIN_VIEWS) if found_surface else None
    if found is None or found.is_empty():
        return trimesh.Trimesh(process=False)
    vertices, faces = _sorted(found.vertex.positions.numpy().astype(np.float64), found.triangle.indices.numpy())
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.update_faces(large_components(mesh.faces, len(mesh.vertices), min_triangles))
    mesh.remove_unreferenced_vertices()
    return mesh


def _sorted(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sort the vertices and faces of a mesh; Open3D returns them in another order in every run."""
    order = np.lexsort(vertices.T)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    faces = rank[faces]
    first = faces.argmin(axis=1)[:, None]  # a face begins with its smallest vertex; its orientation is kept
    faces = np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)
    return vertices[order], faces[np.lexsort(faces.T)]


class FusedDepthMesh(MeshTask):
    """Task 5 for the fused depth of a trajectory; the field only decides which parts of the scene were seen."""

    def __init__(self, trajectory: Trajectory) -> None:
        self.trajectory = trajectory

    def run(self, context: EvaluationContext) -> TaskResult:
        """Compare the fused depth with the scene."""
        try:
            mesh = fuse(self.trajectory, context.preset.mesh_voxel)
        except MissingPackageError:
            names = [metric.name for metric in self.metrics]
            return TaskResult(dict.fromkeys(names), {}, dict.fromkeys(names, "open3d_missing"))
        return evaluate_mesh(mesh, context.field, context.scene, context.seed)


def fused_scores(field: RadianceField, scene: "Scene", preset: Preset, seed: int, trajectory: Trajectory) -> Scores:
    """Score the fused depth of a trajectory as a mesh; no values if open3d is not installed.

    Args:
        field: trained on the trajectory; its method ``seen`` restricts the ground truth, as for the mesh of the field.
        scene: the ground truth.
        preset: gives the size of the voxels.
        seed: random seed of the samples.
        trajectory: with depth.
    """
    rows, result = run_task(EvaluationContext(field, scene, preset, seed), FusedDepthMesh(trajectory))
    return Scores((replace(row, model="tsdf") for row in rows), {"mesh": result.artifact})
