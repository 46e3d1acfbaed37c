"""The same tasks as the code that was released with the paper defines them: what does a definition do to a number?

:func:`autonerf_lab.evaluators.upstream_scores` gives rows of the same names, to stand beside the others. Rendering is
the same there. Sizes (points, poses, starts, iterations) are those of the preset. A mesh has 256 voxels along its
longest side, and pieces under 400 triangles are dropped.
"""

from functools import cached_property

import numpy as np

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.evaluators import pose_refinement as standard
from autonerf_lab.evaluators.mesh import extract_mesh, surface_bounds
from autonerf_lab.evaluators.mesh_metrics import evaluate_mesh
from autonerf_lab.evaluators.oracle import TrueField
from autonerf_lab.evaluators.planning import grow, planning_scores, scene_tasks
from autonerf_lab.evaluators.rendering import sample_test_poses
from autonerf_lab.evaluators.semantic_maps import point_cloud
from autonerf_lab.evaluators.task_result import TaskResult
from autonerf_lab.evaluators.tasks import METRICS, Run
from autonerf_lab.evaluators.upstream import maps, planning, pose_refinement

MESH_SIDE = 256  # voxels
MIN_TRIANGLES = 400
_MAPS = [f"{kind}_{score}" for kind in ("free", "semantic") for score in ("accuracy", "precision", "recall")]


class UpstreamRun(Run):
    """The tasks by the released code's definitions."""

    metrics = {  # noqa: RUF012 - never written to
        "maps": {name: METRICS["maps"][name] for name in _MAPS},
        **{task: METRICS[task] for task in ("planning", "pose_refinement", "mesh")},
    }

    @cached_property
    def occupied(self) -> np.ndarray:
        """(R, C) bool."""
        return maps.occupied_columns(self.field, self.truth.grid)

    @cached_property
    def columns(self) -> np.ndarray:
        """(15, R, C) bool."""
        return maps.semantic_columns(*point_cloud(self.field), self.truth.grid)

    def maps(self) -> TaskResult:
        """Task 2."""
        values = maps.map_scores(self.occupied, self.columns, self.truth)
        n = {name: self.occupied.size if name.startswith("free") else NUM_CLASSES - 1 for name in values}
        return TaskResult(values, n)

    def planning(self) -> TaskResult:
        """Task 3."""
        tasks = scene_tasks(self.truth, self.preset.planning_starts, self.seed)
        free = grow(~self.occupied, planning.DILATION, 1.0)
        points = planning.plan_points(free, tasks, self.truth.grid.cell)
        return planning_scores(points, planning.plan_objects(free, self.columns, self.truth, tasks), self.truth)

    def pose_refinement(self) -> TaskResult:
        """Task 4."""
        truth = sample_test_poses(self.sim, self.preset.refine_poses, self.seed)
        targets = np.stack([self.sim.render(c2w).rgb for c2w in truth])
        size = (self.preset.refine_iterations, self.preset.refine_rays)
        starts = pose_refinement.perturb(truth)
        found = pose_refinement.refine(self.field, starts, targets, self.sim.intrinsics, *size, self.seed, self.tick)
        return standard.refinement_result(*pose_refinement.pose_errors(found, truth))

    def mesh(self) -> TaskResult:
        """Task 5."""
        if isinstance(self.field, TrueField):
            return super().mesh()
        bounds = surface_bounds(self.field)
        voxel = float(np.ptp(bounds, axis=0).max()) / MESH_SIDE
        mesh = extract_mesh(self.field, voxel or None, bounds=bounds, min_triangles=MIN_TRIANGLES)
        return evaluate_mesh(mesh, self.field, self.scene, self.seed)
