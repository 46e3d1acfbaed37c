"""``autonerf-lab scenes``: list, show, generate, import and export scenes."""

import io
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, subcommand

from autonerf_lab.cli.options import option
from autonerf_lab.errors import DataError

if TYPE_CHECKING:
    import numpy as np

    from autonerf_lab.scenes import Scene


@dataclass(frozen=True)
class ScenesListCommand:
    """List the names of the scene library."""

    def run(self) -> None:
        """Print one name per line."""
        from autonerf_lab.scenes import scene_names

        print("\n".join(scene_names()))


@dataclass(frozen=True)
class ScenesShowCommand:
    """Print the size and the objects of a scene; with --out, write its top view; with --page, a 3-D page."""

    name: Annotated[Positional[str], option(help="Name in the scene library, or path of a scene file.")]
    out: Annotated[Path | None, option(metavar="FILE", help="Output .png file of the top view.")] = None
    page: Annotated[Path | None, option(metavar="FILE", help="Output .html file of the self-contained 3-D page.")] = (
        None
    )

    def run(self) -> None:
        """Print size and objects."""
        from collections import Counter

        from autonerf_lab import pipeline
        from autonerf_lab.classes import CLASS_NAMES
        from autonerf_lab.scenes import top_view, write_page

        scene = pipeline.find_scene(self.name)
        print(scene)
        found = Counter(CLASS_NAMES[i.class_id] for i in scene.instances if i.class_id)
        print("\n".join(f"{count:4d} {name}" for name, count in sorted(found.items())))
        if self.out is not None:
            _write_image(top_view(scene)[0], self.out)
        if self.page is not None:
            print(write_page(scene, self.page))


@dataclass(frozen=True)
class ScenesGenerateCommand:
    """Generate an apartment, or a home of a given size, from a random seed and write its specification."""

    seed: Annotated[Positional[int], option(help="Random seed.")]
    out: Annotated[Path, option(help="Output file: .json (specification, usable as --scene) or .glb (mesh).")]
    area: Annotated[float | None, option(metavar="M2", help="Area of all floors, 40 to 300 m².", default="sampled")] = (
        None
    )
    rooms: Annotated[
        int | None, option(metavar="N", help="Number of rooms, corridors included, 2 to 14.", default="sampled")
    ] = None
    floors: Annotated[
        int | None, option(metavar="N", help="Number of floors, 1 or 2; two need 8 to 14 rooms.", default="1")
    ] = None

    def run(self) -> None:
        """Generate and write the scene."""
        from autonerf_lab.scenes import generate_apartment

        scene = generate_apartment(self.seed, area=self.area, rooms=self.rooms, floors=self.floors)
        _write_scene(scene, self.out)


@dataclass(frozen=True)
class ScenesImportCommand:
    """Import a scan (GLB, OBJ, PLY) or a scene of a Habitat dataset, or furnish a floor plan (HouseExpo JSON).

    Prints what was found: the up axis and why, floors, classes, and what was left out or is doubtful.
    """

    path: Annotated[
        Positional[Path], option(help="Input file: mesh, *.scene_instance.json, *.stage_config.json, or floor plan.")
    ]
    up: Annotated[
        Literal["y", "z"] | None,
        option(metavar="y|z", help="Axis that points up in the file.", default="found from the level surfaces"),
    ] = None
    aliases: Annotated[
        Path | None,
        option(metavar="FILE", help='JSON file of object names and their classes, such as {"wing chair": "chair"}.'),
    ] = None
    out: Annotated[
        Path | None, option(metavar="FILE", help="Output file: .glb, or .json for a furnished floor plan.")
    ] = None

    def run(self) -> None:
        """Import the scene and, with --out, write it."""
        from autonerf_lab.scenes import import_scene

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # the report shows them
            scene = import_scene(self.path, self.up, self.aliases)
        print(scene)
        if scene.import_report is not None:
            print(scene.import_report)
        if self.out is not None:
            _write_scene(scene, self.out)


@dataclass(frozen=True)
class ScenesExportCommand:
    """Export a scene as GLB, with its texture or class colours, and its semantics as JSON."""

    name: Annotated[Positional[str], option(help="Name in the scene library, or path of a scene file.")]
    out: Annotated[Path, option(help="Output .glb file.")]
    semantic: Annotated[bool, option(help="Use the class colours instead of the texture.")] = False

    def run(self) -> None:
        """Load and export the scene."""
        from autonerf_lab import pipeline
        from autonerf_lab.scenes import export_glb

        print(export_glb(pipeline.find_scene(self.name), self.out, semantic=self.semantic))


@dataclass(frozen=True)
class ScenesCommand:
    """List, show, generate, import and export scenes."""

    command: (
        Annotated[ScenesListCommand, subcommand("list")]
        | Annotated[ScenesShowCommand, subcommand("show")]
        | Annotated[ScenesGenerateCommand, subcommand("generate")]
        | Annotated[ScenesImportCommand, subcommand("import")]
        | Annotated[ScenesExportCommand, subcommand("export")]
    )

    def run(self) -> None:
        """Run the subcommand."""
        self.command.run()


def _write_scene(scene: "Scene", out: Path) -> None:
    from autonerf_lab.scenes import export_glb
    from autonerf_lab.scenes.spec import dumps
    from autonerf_lab.utils import storage

    kind = out.suffix.lower()
    if kind == ".glb":
        export_glb(scene, out)
    elif kind == ".json" and scene.spec is not None:
        storage.write_bytes(out, dumps(scene.spec).encode())
    else:
        raise DataError(f"{out}: unknown format; write a generated scene as .json or .glb, an imported one as .glb")
    print(out)


def _write_image(image: "np.ndarray", out: Path) -> None:
    from PIL import Image

    from autonerf_lab.utils import storage

    data = io.BytesIO()
    Image.fromarray(image).save(data, "PNG")
    storage.write_bytes(out, data.getvalue())
    print(out)
