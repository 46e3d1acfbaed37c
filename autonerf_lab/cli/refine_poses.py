"""``autonerf-lab refine-poses``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from autonerf_lab.cli.options import PresetName, Seed, option


@dataclass(frozen=True)
class RefinePosesCommand:
    """Refine the poses of a trajectory by bundle adjustment, and save it with both, the rough and the refined poses.

    With depth, the surfaces and the brightness that overlapping images measured are aligned, in seconds. Without, a
    field is trained while its poses are refined.
    """

    trajectory: Annotated[Positional[Path], option(help="Trajectory folder, or run folder.")]
    out: Annotated[Path, option(help="Trajectory folder to write.")]
    preset: PresetName = None
    seed: Seed = 0

    def run(self) -> None:
        """Refine and save the poses, and print what changed."""
        from autonerf_lab import pipeline
        from autonerf_lab.bundle_adjustment import describe_refinement, refine_poses

        rough = pipeline.load_finished_trajectory(self.trajectory)
        refined = refine_poses(rough, preset=self.preset, seed=self.seed)
        refined.save(self.out)
        print(f"{describe_refinement(rough, refined)}\ntrajectory: {self.out}")
