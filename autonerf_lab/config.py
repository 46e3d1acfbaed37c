"""Presets: one frozen dataclass holds every number that depends on how much time there is.

``smoke`` is for tests, ``fast`` for a two-core laptop, ``paper`` for the hyper-parameters of the paper. A preset fixes
steps, never seconds, so that results are the same bits under any load.
"""

import os
from dataclasses import dataclass, fields

from autonerf_lab.errors import UnknownNameError

PRESET_VARIABLE = "AUTONERF_LAB_PRESET"


@dataclass(frozen=True)
class Preset:
    """Sizes of every stage (the table of the benchmark protocol)."""

    name: str
    width: int  # pixels of a training and of a test image
    height: int
    supersample: int  # rays a pixel side: 2 means 2x2
    walk_steps: int
    test_poses: int
    planning_starts: int
    refine_poses: int
    refine_iterations: int
    refine_rays: int
    mesh_voxel: float  # metres
    visible_poses: int  # from which what there is to see in a scene is found out
    finetuning_frames: int
    finetuning_episodes: int
    finetuning_lr: float  # of PPO in the reconstruction
    finetuning_lr_true_mesh: float  # and in the true scene
    refine_interest: bool = False  # pixels of pose refinement from interest regions

    @property
    def label(self) -> str:
        """The name, and what was changed since: what a row of scores says.

        Example:
            >>> from dataclasses import replace
            >>> preset("fast").label, replace(preset("fast"), test_poses=8).label
            ('fast', 'fast, test_poses=8')
        """
        known = PRESETS.get(self.name, self)
        changed = [f.name for f in fields(self) if getattr(self, f.name) != getattr(known, f.name)]
        return ", ".join([self.name, *(f"{name}={getattr(self, name)}" for name in changed)])


PRESETS: dict[str, Preset] = {
    preset.name: preset
    for preset in (
        Preset("smoke", 48, 48, 1, 60, 8, 10, 4, 50, 512, 0.05, 100, 2048, 4, 1e-4, 1e-4),
        # A tenth of the paper's frames of fine-tuning, and larger steps
        Preset("fast", 128, 128, 2, 1500, 100, 100, 20, 200, 1024, 0.025, 2000, 1_000_000, 200, 1e-4, 1e-4),
        # The paper's mesh has 256 voxels a side, 3 to 5 cm in these apartments: coarser than what a tolerance of 5 cm
        # can tell apart. `upstream_scores` does it that way.
        Preset("paper", 320, 240, 2, 1500, 100, 100, 100, 300, 4096, 0.02, 2000, 10_000_000, 1000, 2.5e-6, 2.5e-5),
    )
}


def preset(name: str | Preset | None = None) -> Preset:
    """The preset of that name; without one, the environment's ``AUTONERF_LAB_PRESET``, else ``fast``.

    Raises:
        UnknownNameError: lists the valid names.

    Example:
        >>> preset("smoke").walk_steps
        60
    """
    if isinstance(name, Preset):
        return name
    name = name or os.environ.get(PRESET_VARIABLE) or "fast"
    if name not in PRESETS:
        raise UnknownNameError("preset", name, PRESETS)
    return PRESETS[name]
