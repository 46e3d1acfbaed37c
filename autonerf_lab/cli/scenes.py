"""``autonerf-lab scenes``: look at the apartments, make new ones, bring your own."""

import io
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg, subcommand

from autonerf_lab.errors import DataError

if TYPE_CHECKING:
    import numpy as np

    from autonerf_lab.scenes import Scene

# Heavy imports wait inside the commands: `--help` answers at once.


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


def _write_scene(scene: "Scene", out: Path) -> None:
    from autonerf_lab.scenes.spec import dumps
    from autonerf_lab.utils import storage

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

    from autonerf_lab.utils import storage

    data = io.BytesIO()
    Image.fromarray(picture).save(data, "PNG")
    storage.write_bytes(out, data.getvalue())
    print(out)
