"""``autonerf-lab refine-poses``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from autonerf_lab.cli.options import PresetName, Seed, option
from autonerf_lab.errors import RunFolderError


@dataclass(frozen=True)
class RefinePosesCommand:
    """Refine the poses of a trajectory by bundle adjustment, and save it with its rough and its refined poses.

    With depth, overlapping images are aligned by their surfaces and brightness; this takes seconds. Without depth, a
    field is trained while its poses are refined; this takes as long as a fit.
    """

    trajectory: Annotated[Positional[Path], option(help="Run folder or trajectory folder.")]
    out: Annotated[Path, option(help="Trajectory folder to write.")]
    preset: PresetName = None
    seed: Seed = 0

    def run(self) -> None:
        """Refine and save the poses, and print what changed."""
        from autonerf_lab import pipeline
        from autonerf_lab.bundle_adjustment import describe_refinement, refine_poses

        if (self.out / "transforms.json").exists():
            raise RunFolderError(f"{self.out} holds a trajectory or another data set; choose another --out")
        rough = pipeline.load_finished_trajectory(self.trajectory)
        refined = refine_poses(rough, preset=self.preset, seed=self.seed)
        refined.save(self.out)
        print(f"{describe_refinement(rough, refined)}\ntrajectory: {self.out}")
