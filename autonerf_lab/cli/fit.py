"""``autonerf-lab fit``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from autonerf_lab.cli.options import NO_LPIPS, LpipsOptions, ModelName, Overwrite
from autonerf_lab.errors import DataError


@dataclass(frozen=True)
class FitCommand:
    """Train a radiance field on the trajectory of a run (RUN/nerf), or on photographs with poses (with --out).

    Photographs are a folder with a transforms.json of nerfstudio or instant-ngp. Every eighth photograph, or the test
    set of the file, is held out. OUT/nerf is the field, OUT/scores.json its scores on the held-out photographs.
    """

    folder: Annotated[Positional[Path], arg(help="Run folder, or folder of photographs.")]
    model: ModelName = "semantic-nerfacto"
    out: Annotated[Path | None, arg(help="Output folder for photographs. Not for a run.")] = None
    preset: Annotated[str | None, arg(metavar="NAME", help="Preset, for photographs only.")] = None
    seed: Annotated[int | None, arg(help="Random seed, for photographs only.")] = None
    overwrite: Overwrite = False
    lpips: LpipsOptions = NO_LPIPS

    def run(self) -> None:
        """Train, and print the scores on photographs."""
        from autonerf_lab import pipeline
        from autonerf_lab.pipeline import photographs

        if self.out is None:
            if self.preset is not None or self.seed is not None:
                raise DataError(
                    f"{self.folder}: a run has its own preset and seed; --preset and --seed need photographs and --out"
                )
            if photographs.is_photograph_folder(self.folder):
                raise DataError(f"{self.folder} holds photographs, not a run: give the output folder with --out")
            if self.lpips != NO_LPIPS:
                raise DataError(f"{self.folder} is a run: give --lpips-weights to `autonerf-lab evaluate`")
            pipeline.run_stage(self.folder, "fit", self.model, self.overwrite)
            print(f"field: {self.folder / 'nerf'}")
            return
        scores = photographs.fit_photographs(
            self.folder, self.out, self.model, self.preset, self.seed or 0,
            overwrite=self.overwrite, lpips=self.lpips.load(),
        )  # fmt: skip
        print(f"\n{scores.table()}\n\nfield: {self.out / 'nerf'}")
