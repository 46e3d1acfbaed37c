"""``autonerf-lab fit``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional

from autonerf_lab.cli.options import NO_LPIPS, Device, LpipsOptions, Overwrite, option
from autonerf_lab.errors import DataError

DEFAULT_MODEL = "semantic-nerfacto"


@dataclass(frozen=True)
class FitCommand:
    """Train a radiance field on the trajectory of a run, or on photographs with poses (needs --out).

    For a run, the field is written to RUN/nerf. A folder of photographs has the format of nerfstudio, instant-ngp,
    Blender, COLMAP, Polycam or Record3D, or is an RGB-D sequence of TUM, ScanNet or Replica. For images without poses,
    --poses colmap estimates them. The test set of the folder is held out, or else every eighth photograph. The field
    is written to OUT/nerf, and its scores on the held-out photographs to OUT/scores.json.
    """

    folder: Annotated[Positional[Path], option(help="Run folder, or folder of photographs.")]
    model: Annotated[
        str | None,
        option(
            metavar="NAME",
            help="Model of the radiance field, such as semantic-nerfacto or instant-ngp.",
            default="that of the run, else semantic-nerfacto",
        ),
    ] = None
    out: Annotated[Path | None, option(metavar="PATH", help="Output folder, for photographs only.")] = None
    preset: Annotated[
        str | None,
        option(metavar="NAME", help="Preset, for photographs only.", default="AUTONERF_LAB_PRESET, else fast"),
    ] = None
    seed: Annotated[int | None, option(metavar="INT", help="Random seed, for photographs only.", default="0")] = None
    poses: Annotated[
        Literal["true", "odometry", "estimated", "refined", "colmap"] | None,
        option(
            metavar="NAME",
            help="Pose source. For a run: true, odometry, estimated or refined, if its trajectory has them. For "
            "photographs: colmap, which estimates the poses with COLMAP.",
            default="those of the exploration, or in the folder",
        ),
    ] = None
    overwrite: Overwrite = False
    device: Device = None
    lpips: LpipsOptions = NO_LPIPS

    def run(self) -> None:
        """Train, and print the scores on photographs."""
        from autonerf_lab import pipeline
        from autonerf_lab.pipeline import photographs
        from autonerf_lab.pipeline.run_folder import load_run

        if self.out is None:
            if self.preset is not None or self.seed is not None or self.poses == "colmap":
                raise DataError(
                    f"{self.folder}: a run has its own preset, seed and poses; --preset, --seed and --poses colmap "
                    "need photographs and --out"
                )
            if photographs.is_photograph_folder(self.folder):
                raise DataError(f"{self.folder} holds photographs, not a run: give the output folder with --out")
            if self.lpips != NO_LPIPS:
                raise DataError(f"{self.folder} is a run: give --lpips-weights to `autonerf-lab evaluate`")
            options = pipeline.StageOptions(device=self.device)
            model = self.model or load_run(self.folder).config.model or DEFAULT_MODEL
            pipeline.run_stage(self.folder, "fit", model, self.overwrite, options, self.poses)
            print(f"field: {self.folder / 'nerf'}")
            return
        if self.poses not in (None, "colmap"):
            raise DataError(f"{self.folder}: photographs have no {self.poses} poses; --poses {self.poses} needs a run")
        scores = photographs.fit_photographs(
            self.folder, self.out, self.model or DEFAULT_MODEL, self.preset, self.seed or 0,
            overwrite=self.overwrite, lpips=self.lpips.load(), poses=self.poses, device=self.device,
        )  # fmt: skip
        print(f"\n{scores.table()}\n\nfield: {self.out / 'nerf'}")
