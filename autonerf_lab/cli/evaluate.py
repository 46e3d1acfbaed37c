"""``autonerf-lab evaluate``."""

from dataclasses import dataclass
from typing import Annotated

from autonerf_lab.cli.options import (
    NO_LPIPS,
    Device,
    LpipsOptions,
    OptionalTasks,
    Overwrite,
    RunPath,
    option,
    split_names,
)


@dataclass(frozen=True)
class EvaluateCommand:
    """Evaluate the radiance field of a run on all tasks that are not optional, and write RUN/scores.json."""

    folder: RunPath
    overwrite: Overwrite = False
    device: Device = None
    upstream: Annotated[bool, option(help="Also compute the scores as defined by the paper's released code.")] = False
    optional: OptionalTasks = None
    interest_regions: Annotated[bool, option(help="Sample the pixels of pose refinement in interest regions.")] = False
    lpips: LpipsOptions = NO_LPIPS

    def run(self) -> None:
        """Run the stage and print the scores."""
        from autonerf_lab import pipeline

        options = pipeline.StageOptions(
            self.lpips.load(),
            self.device,
            self.upstream,
            optional_tasks=split_names(self.optional) or (),
            interest_regions=self.interest_regions,
        )
        pipeline.run_stage(self.folder, "evaluate", overwrite=self.overwrite, options=options)
        print(f"\n{pipeline.score_table(self.folder)}\n\nscores: {self.folder / 'scores.json'}")
