"""The command line. Every stage reads and writes one run folder; ``autonerf-lab demo`` runs them all."""

import contextlib
import io
import os
import sys
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from tyro.conf import Positional, arg, subcommand

from autonerf_lab.errors import AutoNerfError, DataError

if TYPE_CHECKING:
    import numpy as np

    from autonerf_lab.scenes import Scene

# Heavy imports wait inside the commands: `--help` answers at once.

SceneName = Annotated[
    str, arg(help="A scene of the library (`autonerf-lab scenes list`), or a file: JSON, GLB, OBJ, PLY.")
]
PolicyName = Annotated[str, arg(help="Who chooses the actions: frontier or random.")]
ModelName = Annotated[str, arg(help="The field: semantic-nerfacto.")]
PresetName = Annotated[
    str | None,
    arg(metavar="NAME", help="Sizes: smoke, fast or paper. Without it, AUTONERF_LAB_PRESET decides, else fast."),
]
Seed = Annotated[int, arg(help="Of the start, the policy, the training and the test poses.")]
Out = Annotated[Path, arg(help="The run folder.")]
Run = Annotated[Positional[Path], arg(help="The run folder.")]
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

    def run(self) -> None:
        """Run all stages and say where the report is."""
        from autonerf_lab import pipeline

        pipeline.begin(self.out, self.scene, self.policy, self.preset, self.seed, self.model, overwrite=self.overwrite)
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
class Fit:
    """Train a field on the walk of a run folder: RUN/nerf."""

    folder: Run
    model: ModelName = "semantic-nerfacto"
    overwrite: Overwrite = False

    def run(self) -> None:
        """Run the stage."""
        from autonerf_lab import pipeline

        pipeline.resume(self.folder, "fit", self.model, self.overwrite)
        print(f"field: {self.folder / 'nerf'}")


@dataclass(frozen=True)
class Evaluate:
    """Score the field of a run folder on every task: RUN/scores.json."""

    folder: Run
    overwrite: Overwrite = False

    def run(self) -> None:
        """Run the stage and print the table."""
        from autonerf_lab import pipeline

        pipeline.resume(self.folder, "evaluate", overwrite=self.overwrite)
        print(f"\n{pipeline.summary(self.folder)}\n\nscores: {self.folder / 'scores.json'}")


@dataclass(frozen=True)
class Mesh:
    """Extract the surface of the field of a run folder, coloured and by class: RUN/mesh."""

    folder: Run
    overwrite: Overwrite = False

    def run(self) -> None:
        """Run the stage."""
        from autonerf_lab import pipeline

        pipeline.resume(self.folder, "mesh", overwrite=self.overwrite)
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
    """Write the field of a run folder as coloured points with classes, for other programs: PLY."""

    folder: Run
    out: Annotated[Path, arg(help="The .ply file.")]

    def run(self) -> None:
        """Render the depth of training cameras, and write."""
        from autonerf_lab import pipeline
        from autonerf_lab.viz.point_cloud import point_cloud

        print(point_cloud(pipeline.finished_field(self.folder)).save(self.out))


@dataclass(frozen=True)
class Video:
    """Film the field of a run folder along the robot's way."""

    folder: Run
    out: Annotated[Path, arg(help="The .mp4 or .gif file.")]
    what: Annotated[str, arg(help="rgb, depth, semantics, opacity, or all: the first three side by side.")] = "rgb"
    seconds: Annotated[float, arg(help="How long the film plays.")] = 10.0
    height: Annotated[int | None, arg(help="Pixels; those of a training camera without.")] = None

    def run(self) -> None:
        """Render frame by frame, and write."""
        from autonerf_lab import pipeline
        from autonerf_lab.viz.paths import walk_path
        from autonerf_lab.viz.video import save_video

        field, camera = pipeline.finished_field(self.folder), None
        if self.height is not None:
            width = max(1, round(self.height * field.intrinsics.width / field.intrinsics.height))
            camera = field.intrinsics.resized(width, self.height)
        path = walk_path(field, round(24 * self.seconds))
        print(save_video(field, path, self.out, 24, self.what, camera))


@dataclass(frozen=True)
class View:
    """Fly through the field of a run folder in a browser on this machine. Ctrl-C ends it."""

    folder: Run
    port: Annotated[int, arg(help="Of the page; 0 takes a free one.")] = 0

    def run(self) -> None:
        """Serve the page until somebody says stop."""
        import time

        from autonerf_lab import pipeline
        from autonerf_lab.viz.viewer import nerf_viewer

        field = pipeline.finished_field(self.folder)
        with contextlib.suppress(KeyboardInterrupt), nerf_viewer(field, self.port) as viewer:
            print(f"{viewer.url} shows the field until Ctrl-C", flush=True)
            while True:
                time.sleep(3600)


@dataclass(frozen=True)
class ScenesList:
    """The scenes of the library."""

    def run(self) -> None:
        """Print a name a line."""
        from autonerf_lab.scenes import scene_names

        print("\n".join(scene_names()))


@dataclass(frozen=True)
class ScenesShow:
    """What is in a scene; with --out also its picture from above, with --page a 3-D page for a browser."""

    name: Annotated[Positional[str], arg(help="A scene of the library, or a file.")]
    out: Annotated[Path | None, arg(help="Where to write the picture (PNG).")] = None
    page: Annotated[
        Path | None, arg(help="Where to write the 3-D page (HTML); it needs neither kernel nor network.")
    ] = None

    def run(self) -> None:
        """Print sizes and objects."""
        from collections import Counter

        from autonerf_lab import pipeline
        from autonerf_lab.classes import CLASS_NAMES

        scene = pipeline.find_scene(self.name)
        print(scene)
        found = Counter(CLASS_NAMES[i.class_id] for i in scene.instances if i.class_id)
        print("\n".join(f"{count:4d} {name}" for name, count in sorted(found.items())))
        if self.out is not None:
            _write_picture(scene.top_view()[0], self.out)
        if self.page is not None:
            print(scene.page(self.page))


@dataclass(frozen=True)
class ScenesGenerate:
    """Make a new apartment from a seed and keep its specification."""

    seed: Annotated[Positional[int], arg(help="Any whole number: the same one makes the same apartment.")]
    out: Annotated[Path, arg(help="A .json file: give its path wherever a scene is asked for. Or a .glb file.")]

    def run(self) -> None:
        """Generate and write."""
        from autonerf_lab.scenes import generate_apartment

        _write_scene(generate_apartment(self.seed), self.out)


@dataclass(frozen=True)
class ScenesImport:
    """Read a scan (GLB, OBJ, PLY) and stand it on its floor, or furnish a floor plan (HouseExpo's JSON)."""

    path: Annotated[Positional[Path], arg(help="The file.")]
    out: Annotated[Path | None, arg(help="Where to write it: GLB, or .json for a furnished plan.")] = None

    def run(self) -> None:
        """Import, and export where asked."""
        from autonerf_lab.scenes import import_scene

        scene = import_scene(self.path)
        print(scene)
        if self.out is not None:
            _write_scene(scene, self.out)


@dataclass(frozen=True)
class ScenesExport:
    """Write a scene as GLB, with its texture or coloured by class, and its semantics beside it (JSON)."""

    name: Annotated[Positional[str], arg(help="A scene of the library, or a file.")]
    out: Annotated[Path, arg(help="The GLB file.")]
    semantic: Annotated[bool, arg(help="Colours are classes.")] = False

    def run(self) -> None:
        """Load and write."""
        from autonerf_lab import pipeline

        print(pipeline.find_scene(self.name).export_glb(self.out, semantic=self.semantic))


@dataclass(frozen=True)
class Scenes:
    """Look at the apartments, make new ones, bring your own."""

    command: (
        Annotated[ScenesList, subcommand("list")]
        | Annotated[ScenesShow, subcommand("show")]
        | Annotated[ScenesGenerate, subcommand("generate")]
        | Annotated[ScenesImport, subcommand("import")]
        | Annotated[ScenesExport, subcommand("export")]
    )

    def run(self) -> None:
        """Run the subcommand."""
        self.command.run()


@dataclass(frozen=True)
class CommandLine:
    """AutoNeRF Lab: a robot explores an apartment, a semantic NeRF learns it, and the field is put to work."""

    command: (
        Annotated[Demo, subcommand("demo")]
        | Annotated[Scenes, subcommand("scenes")]
        | Annotated[Explore, subcommand("explore")]
        | Annotated[Fit, subcommand("fit")]
        | Annotated[Evaluate, subcommand("evaluate")]
        | Annotated[Mesh, subcommand("mesh")]
        | Annotated[Report, subcommand("report")]
        | Annotated[PointCloud, subcommand("point-cloud")]
        | Annotated[Video, subcommand("video")]
        | Annotated[View, subcommand("view")]
    )
    debug: Annotated[bool, arg(help="Show where an error came from.")] = False


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


def _write_scene(scene: "Scene", out: Path) -> None:
    from autonerf_lab import storage
    from autonerf_lab.scenes.spec import dumps

    kind = out.suffix.lower()
    if kind == ".glb":
        scene.export_glb(out)
    elif kind == ".json" and scene.spec is not None:
        storage.write_bytes(out, dumps(scene.spec).encode())
    else:
        raise DataError(f"{out}: a generated scene is written as .json or .glb, an imported one as .glb")
    print(out)


def _write_picture(picture: "np.ndarray", out: Path) -> None:
    from PIL import Image

    from autonerf_lab import storage

    data = io.BytesIO()
    Image.fromarray(picture).save(data, "PNG")
    storage.write_bytes(out, data.getvalue())
    print(out)


if __name__ == "__main__":
    sys.exit(main())
