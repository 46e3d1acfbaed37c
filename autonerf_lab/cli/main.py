"""The command line. Every stage reads and writes one run folder; ``autonerf-lab demo`` runs them all."""

import contextlib
import os
import sys
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import Positional, arg, subcommand

from autonerf_lab.cli.bench import Bench
from autonerf_lab.cli.options import NO_LPIPS, LpipsFile, names_of
from autonerf_lab.cli.scenes import Scenes
from autonerf_lab.cli.train_policy import TrainPolicy
from autonerf_lab.errors import AutoNerfError, DataError
from autonerf_lab.utils import plugins

# Heavy imports wait inside the commands: `--help` answers at once.

SceneName = Annotated[
    str, arg(help="A scene of the library (`autonerf-lab scenes list`), or a file: JSON, GLB, OBJ, PLY.")
]
PolicyName = Annotated[
    str, arg(help="Who chooses the actions: frontier, random, ..., or the .safetensors of one you trained.")
]
ModelName = Annotated[str, arg(help="The field: semantic-nerfacto.")]
PresetName = Annotated[
    str | None,
    arg(metavar="NAME", help="Sizes: smoke, fast or paper. Without it, AUTONERF_LAB_PRESET decides, else fast."),
]
Seed = Annotated[int, arg(help="Of the start, the policy, the training and the test poses.")]
Out = Annotated[Path, arg(help="The run folder.")]
Run = Annotated[Positional[Path], arg(help="The run folder.")]
Fitted = Annotated[Positional[Path], arg(help="The run folder, or the --out of `autonerf-lab fit`.")]
Overwrite = Annotated[bool, arg(help="Replace what is finished. Only files this package wrote are removed.")]


@dataclass(frozen=True)
class Demo:
    """The main job: explore an apartment, fit a field to the walk, score it, write the report.

    Interrupted, the same command goes on from the last finished stage.
    """

    scene: SceneName = "val-0"
    policy: PolicyName = "frontier"
    model: ModelName = "semantic-nerfacto"
    preset: PresetName = None
    seed: Seed = 0
    out: Out = Path("runs/demo")
    overwrite: Overwrite = False
    lpips: LpipsFile = NO_LPIPS

    def run(self) -> None:
        """Run all stages and say where the report is."""
        from autonerf_lab import pipeline

        pipeline.begin(
            self.out, self.scene, self.policy, self.preset, self.seed, self.model,
            overwrite=self.overwrite, options=pipeline.Options(self.lpips.load()),
        )  # fmt: skip
        print(f"\n{pipeline.summary(self.out)}\n\nreport: {self.out / 'report.html'}")


@dataclass(frozen=True)
class Explore:
    """Walk through a scene and keep the walk as a nerfstudio dataset in OUT/trajectory. Begins a run folder."""

    out: Out
    scene: SceneName = "val-0"
    policy: PolicyName = "frontier"
    preset: PresetName = None
    seed: Seed = 0
    overwrite: Overwrite = False

    def run(self) -> None:
        """Run the first two stages."""
        from autonerf_lab import pipeline

        pipeline.begin(
            self.out, self.scene, self.policy, self.preset, self.seed, last="explore", overwrite=self.overwrite
        )
        print(f"trajectory: {self.out / 'trajectory'}")


@dataclass(frozen=True)
class Play:
    """Make a walk something to watch, or several of one scene beside each other."""

    folders: Annotated[Positional[tuple[Path, ...]], arg(metavar="FOLDER ...", help="Runs, or trajectory folders.")]
    out: Annotated[Path, arg(help="An .html page that needs nothing else, or a film: .mp4, .gif.")]

    def run(self) -> None:
        """Build the maps again, and write."""
        from autonerf_lab import pipeline
        from autonerf_lab.viz.player.player import play

        print(play(*map(pipeline.finished_walk, self.folders)).save(self.out))


@dataclass(frozen=True)
class Fit:
    """Train a field: on the walk of a run folder, RUN/nerf; or on photographs with poses, with --out.

    Photographs are a folder with a transforms.json of nerfstudio or instant-ngp. Every eighth of them, or those that
    the file names, are held out: OUT/nerf is the field, OUT/scores.json how it shows what it has not seen.
    """

    folder: Annotated[Positional[Path], arg(help="The run folder, or the folder of photographs.")]
    model: ModelName = "semantic-nerfacto"
    out: Annotated[Path | None, arg(help="Where the field of photographs goes. Without it, FOLDER is a run.")] = None
    preset: Annotated[str | None, arg(metavar="NAME", help="For photographs; a run has its own.")] = None
    seed: Annotated[int | None, arg(help="Of the training, for photographs; a run has its own.")] = None
    overwrite: Overwrite = False
    lpips: LpipsFile = NO_LPIPS

    def run(self) -> None:
        """Run the stage; print the scores where there are any."""
        from autonerf_lab import pipeline
        from autonerf_lab.pipeline import photographs

        if self.out is None:
            if self.preset is not None or self.seed is not None:
                raise DataError(f"{self.folder}: a run has its preset and its seed; for photographs, give --out too")
            if photographs.is_capture(self.folder):
                raise DataError(f"{self.folder} holds photographs, not a run: --out says where their field goes")
            if self.lpips != NO_LPIPS:
                raise DataError(f"{self.folder}: a run is scored by `autonerf-lab evaluate`: give it the LPIPS weights")
            pipeline.resume(self.folder, "fit", self.model, self.overwrite)
            print(f"field: {self.folder / 'nerf'}")
            return
        scores = photographs.fit_capture(
            self.folder, self.out, self.model, self.preset, self.seed or 0,
            overwrite=self.overwrite, lpips=self.lpips.load(),
        )  # fmt: skip
        print(f"\n{scores.table()}\n\nfield: {self.out / 'nerf'}")


@dataclass(frozen=True)
class Evaluate:
    """Score the field of a run folder on every task: RUN/scores.json."""

    folder: Run
    overwrite: Overwrite = False
    upstream: Annotated[bool, arg(help="Beside it, the scores as the paper's released code defines them.")] = False
    optional: Annotated[
        str | None, arg(metavar="A,B", help="Tasks that take long: navigation (minutes), finetuning (hours).")
    ] = None
    interest_regions: Annotated[bool, arg(help="Pose refinement takes its pixels where there is detail.")] = False
    lpips: LpipsFile = NO_LPIPS

    def run(self) -> None:
        """Run the stage and print the table."""
        from autonerf_lab import pipeline

        options = pipeline.Options(
            self.lpips.load(), self.upstream, optional=names_of(self.optional) or (), interest=self.interest_regions
        )
        pipeline.resume(self.folder, "evaluate", overwrite=self.overwrite, options=options)
        print(f"\n{pipeline.summary(self.folder)}\n\nscores: {self.folder / 'scores.json'}")


@dataclass(frozen=True)
class Mesh:
    """Extract the surface of the field of a run folder, coloured and by class: RUN/mesh."""

    folder: Run
    overwrite: Overwrite = False
    voxel: Annotated[float | None, arg(metavar="METRES", help="Side of a marching cube; the preset's without.")] = None
    format: Annotated[str, arg(metavar="GLB|PLY", help="glb (y up, as glTF demands) or ply (z up).")] = "glb"

    def run(self) -> None:
        """Run the stage."""
        from autonerf_lab import pipeline

        options = pipeline.Options(voxel=self.voxel, suffix=self.format.lower())
        pipeline.resume(self.folder, "mesh", overwrite=self.overwrite, options=options)
        print(f"mesh: {self.folder / 'mesh'}")


@dataclass(frozen=True)
class Report:
    """Write the report of a run folder again: RUN/report.html."""

    folder: Run

    def run(self) -> None:
        """Run the stage; a report that is there is replaced."""
        from autonerf_lab import pipeline

        pipeline.resume(self.folder, "report")
        print(f"report: {self.folder / 'report.html'}")


@dataclass(frozen=True)
class PointCloud:
    """Write a field as coloured points, with classes where it knows them, for other programs: PLY."""

    folder: Fitted
    out: Annotated[Path, arg(help="The .ply file.")]

    def run(self) -> None:
        """Render the depth of training cameras, and write."""
        from autonerf_lab import pipeline
        from autonerf_lab.viz.point_cloud import point_cloud

        print(point_cloud(pipeline.finished_field(self.folder)).save(self.out))


@dataclass(frozen=True)
class Video:
    """Film a field along the robot's way, or from one photograph to the next."""

    folder: Fitted
    out: Annotated[Path, arg(help="The .mp4 or .gif file.")]
    what: Annotated[str, arg(help="rgb, depth, semantics, opacity, or all: the first three side by side.")] = "rgb"
    seconds: Annotated[float, arg(help="How long the film plays.")] = 10.0
    height: Annotated[int | None, arg(help="Pixels; those of a training camera without.")] = None

    def run(self) -> None:
        """Render frame by frame, and write."""
        from autonerf_lab import pipeline
        from autonerf_lab.viz.camera_paths import walk_path
        from autonerf_lab.viz.video import save_video

        field, camera = pipeline.finished_field(self.folder), None
        if self.height is not None:
            width = max(1, round(self.height * field.intrinsics.width / field.intrinsics.height))
            camera = field.intrinsics.resized(width, self.height)
        path = walk_path(field, round(24 * self.seconds))
        print(save_video(field, path, self.out, 24, self.what, camera))


@dataclass(frozen=True)
class View:
    """Fly through a field in a browser on this machine. Ctrl-C ends it."""

    folder: Fitted
    port: Annotated[int, arg(help="Of the page; 0 takes a free one.")] = 0

    def run(self) -> None:
        """Serve the page until somebody says stop."""
        import time

        from autonerf_lab import pipeline
        from autonerf_lab.viz.viewer.viewer import nerf_viewer

        field = pipeline.finished_field(self.folder)
        with contextlib.suppress(KeyboardInterrupt), nerf_viewer(field, self.port) as viewer:
            print(f"{viewer.url} shows the field until Ctrl-C", flush=True)
            while True:
                time.sleep(3600)


@dataclass(frozen=True)
class Rewards:
    """The rewards that exist, their units, and the packages they come from."""

    def run(self) -> None:
        """Print a line a reward; broken plug-ins are warned about on stderr."""
        from autonerf_lab import rewards

        for name, entry in rewards.available().items():
            package = "autonerf-lab" if name in rewards.REWARDS else plugins.package_of("rewards", name)
            print(f"{name:16} {rewards.unit_of(rewards.make_reward(entry)) or '?':36} {package}")


@dataclass(frozen=True)
class CommandLine:
    """AutoNeRF Lab: a robot explores an apartment, a semantic NeRF learns it, and the field is put to work."""

    command: (
        Annotated[Demo, subcommand("demo")]
        | Annotated[Scenes, subcommand("scenes")]
        | Annotated[Explore, subcommand("explore")]
        | Annotated[Play, subcommand("play")]
        | Annotated[Fit, subcommand("fit")]
        | Annotated[Evaluate, subcommand("evaluate")]
        | Annotated[Mesh, subcommand("mesh")]
        | Annotated[Report, subcommand("report")]
        | Annotated[PointCloud, subcommand("point-cloud")]
        | Annotated[Video, subcommand("video")]
        | Annotated[View, subcommand("view")]
        | Annotated[TrainPolicy, subcommand("train-policy")]
        | Annotated[Bench, subcommand("bench")]
        | Annotated[Rewards, subcommand("rewards")]
    )
    debug: Annotated[bool, arg(help="Show where an error came from.")] = False
    strict_plugins: Annotated[bool, arg(help="A broken plug-in is an error instead of a warning.")] = False


_STYLE = (
    tyro.conf.OmitSubcommandPrefixes,
    tyro.conf.OmitArgPrefixes,
    tyro.conf.CascadeSubcommandArgs,
    tyro.conf.FlagCreatePairsOff,
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command.

    Args:
        arguments: without the program's name; those of the process by default.

    Returns:
        0, or 1 after an error that was said in one line, or 130 after Ctrl-C.
    """
    parsed = tyro.cli(CommandLine, prog="autonerf-lab", args=arguments, config=_STYLE)
    try:
        with plugins.strict() if parsed.strict_plugins else contextlib.nullcontext():
            parsed.command.run()
    except AutoNerfError as error:
        if parsed.debug:
            traceback.print_exc()
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        if parsed.debug:
            traceback.print_exc()
        print("\ninterrupted: the same command goes on from the last finished stage", file=sys.stderr)
        return 130
    except BrokenPipeError:  # `| head` has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0
