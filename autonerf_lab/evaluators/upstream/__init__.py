"""Tasks by the definitions of the code that was released with the paper, to show the effect of the definitions.

:func:`autonerf_lab.evaluators.upstream_scores` returns rows with the same names, to be printed beside the standard
ones. Rendering is the same there. The numbers of points, poses, starts and iterations are those of the preset. A mesh
has 256 voxels along its longest side, and connected components under 400 triangles are removed.
"""

from functools import cached_property

import numpy as np

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.evaluators import pose_refinement as standard
from autonerf_lab.evaluators.context import EvaluationContext
from autonerf_lab.evaluators.mesh import extract_mesh, surface_bounds
from autonerf_lab.evaluators.mesh_metrics import MeshTask, evaluate_mesh
from autonerf_lab.evaluators.metrics import metrics_of
from autonerf_lab.evaluators.oracle import TrueField
from autonerf_lab.evaluators.planning import PlanningTask, dilate_obstacles, planning_scores, scene_episodes
from autonerf_lab.evaluators.radiance_field import point_cloud
from autonerf_lab.evaluators.rendering import sample_test_poses
from autonerf_lab.evaluators.semantic_maps import MapsTask
from autonerf_lab.evaluators.task import Task, TaskResult
from autonerf_lab.evaluators.upstream import maps, planning, pose_refinement

MESH_SIDE = 256  # voxels
MIN_TRIANGLES = 400
_MAPS = [f"{kind}_{score}" for kind in ("free", "semantic") for score in ("accuracy", "precision", "recall")]


class UpstreamContext(EvaluationContext):
    """Evaluation context with the maps of the released code."""

    @cached_property
    def occupied(self) -> np.ndarray:
        """(R, C) bool, occupied map cells."""
        return maps.occupied_cells(self.field, self.truth.grid)

    @cached_property
    def class_cells(self) -> np.ndarray:
        """(15, R, C) bool, map cells of each class."""
        return maps.semantic_cells(*point_cloud(self.field), self.truth.grid)


class UpstreamMaps(MapsTask):
    """Task 2, maps, as defined by the released code."""

    metrics = tuple(metric for metric in metrics_of("maps") if metric.name in _MAPS)

    def run(self, context: EvaluationContext) -> TaskResult:
        """Score the maps of the field."""
        assert isinstance(context, UpstreamContext)
        values = maps.map_scores(context.occupied, context.class_cells, context.truth)
        n = {name: context.occupied.size if name.startswith("free") else NUM_CLASSES - 1 for name in values}
        return TaskResult(values, n)


class UpstreamPlanning(PlanningTask):
    """Task 3, planning, as defined by the released code."""

    def run(self, context: EvaluationContext) -> TaskResult:
        """Plan on the maps of the field."""
        assert isinstance(context, UpstreamContext)
        episode_set = scene_episodes(context.truth, context.preset.planning_starts, context.seed)
        free = dilate_obstacles(~context.occupied, planning.DILATION, 1.0)
        points = planning.plan_points(free, episode_set, context.truth.grid.cell)
        objects = planning.plan_objects(free, context.class_cells, context.truth, episode_set)
        return planning_scores(points, objects, context.truth)


class UpstreamPoseRefinement(standard.PoseRefinementTask):
    """Task 4, pose refinement, as defined by the released code."""

    def run(self, context: EvaluationContext) -> TaskResult:
        """Refine disturbed test poses."""
        preset, sim = context.preset, context.sim
        truth = sample_test_poses(sim, preset.refine_poses, context.seed)
        targets = np.stack([sim.render(c2w).rgb for c2w in truth])
        size = (preset.refine_iterations, preset.refine_rays)
        starts = pose_refinement.perturb(truth)
        found = pose_refinement.refine(
            context.field, starts, targets, sim.intrinsics, *size, context.seed, context.tick
        )
        return standard.refinement_result(*pose_refinement.pose_errors(found, truth))


class UpstreamMesh(MeshTask):
    """Task 5, mesh metrics, with the mesh settings of the released code."""

    def run(self, context: EvaluationContext) -> TaskResult:
        """Compare the mesh of the field with the scene."""
        if isinstance(context.field, TrueField):
            return super().run(context)
        bounds = surface_bounds(context.field)
        voxel = float(np.ptp(bounds, axis=0).max()) / MESH_SIDE
        mesh = extract_mesh(context.field, voxel or None, bounds=bounds, min_triangles=MIN_TRIANGLES)
        return evaluate_mesh(mesh, context.field, context.scene, context.seed)


UPSTREAM_TASKS: dict[str, Task] = {
    task.name: task for task in (UpstreamMaps(), UpstreamPlanning(), UpstreamPoseRefinement(), UpstreamMesh())
}
