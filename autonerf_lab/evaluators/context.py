"""Data that the tasks of one evaluation share."""

from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from autonerf_lab.evaluators.ground_truth import TrueMap, true_map
from autonerf_lab.evaluators.maps import predict_states
from autonerf_lab.evaluators.mesh import extract_mesh
from autonerf_lab.evaluators.navigation import add_floor
from autonerf_lab.evaluators.oracle import TrueField
from autonerf_lab.evaluators.radiance_field import RadianceField
from autonerf_lab.evaluators.semantic_maps import class_votes, semantic_cells
from autonerf_lab.presets import Preset

if TYPE_CHECKING:
    import trimesh

    from autonerf_lab.evaluators.lpips import Lpips
    from autonerf_lab.scenes.scene import Scene
    from autonerf_lab.simulator import Simulator


class EvaluationContext:
    """Field, scene and settings of an evaluation. Derived data are computed at the first access.

    Args:
        field: the radiance field to score.
        scene: the ground truth.
        preset: settings of the tasks.
        seed: random seed.
        tick: called after each unit of work, for a progress bar.
        lpips: LPIPS with its weights; without, LPIPS has no value.
        checkpoint: folder of the training checkpoints of ``finetuning``; without, a temporary one.
    """

    def __init__(
        self,
        field: RadianceField,
        scene: "Scene",
        preset: Preset,
        seed: int = 0,
        tick: Callable[[], Any] = lambda: None,
        lpips: "Lpips | None" = None,
        checkpoint: str | Path | None = None,
    ) -> None:
        self.field, self.scene, self.preset, self.seed, self.tick, self.lpips = field, scene, preset, seed, tick, lpips
        self.checkpoint = checkpoint

    @cached_property
    def sim(self) -> "Simulator":
        """Simulator of the scene, with the camera of the preset."""
        from autonerf_lab.simulator import Simulator

        return Simulator.from_preset(self.scene, self.preset)

    @cached_property
    def truth(self) -> TrueMap:
        """Ground-truth map of the scene."""
        return true_map(self.sim)

    @cached_property
    def states(self) -> np.ndarray:
        """(R, C) predicted :class:`~autonerf_lab.evaluators.maps.CellState` of each map cell."""
        return predict_states(self.field, self.truth.grid)

    @cached_property
    def labels(self) -> np.ndarray:
        """(R, C) predicted class of each map cell, 0 for none."""
        return semantic_cells(class_votes(self.field, self.truth.grid))

    @cached_property
    def surface(self) -> "trimesh.Trimesh":
        """Mesh of the field, world frame, metres."""
        field = self.field
        return field.mesh() if isinstance(field, TrueField) else extract_mesh(field, self.preset.mesh_voxel)

    @cached_property
    def surface_with_floor(self) -> "trimesh.Trimesh":
        """Mesh of the field with a flat floor, for tasks in which a robot moves."""
        return add_floor(self.surface, self.field)
