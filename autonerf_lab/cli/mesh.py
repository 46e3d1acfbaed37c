"""``autonerf-lab mesh``."""

from dataclasses import dataclass
from typing import Annotated

from autonerf_lab.cli.options import Overwrite, RunPath, option


@dataclass(frozen=True)
class MeshCommand:
    """Extract the mesh of the radiance field of a run, with colours and with classes, and write it to RUN/mesh."""

    folder: RunPath
    overwrite: Overwrite = False
    voxel: Annotated[float | None, option(metavar="METRES", help="Voxel size.", default="from the preset")] = None
    format: Annotated[str, option(metavar="GLB|PLY|OBJ", help="File format: glb or obj (y up), or ply (z up).")] = "glb"

    def run(self) -> None:
        """Run the stage."""
        from autonerf_lab import pipeline

        options = pipeline.StageOptions(voxel=self.voxel, mesh_format=self.format.lower())
        pipeline.run_stage(self.folder, "mesh", overwrite=self.overwrite, options=options)
        print(f"mesh: {self.folder / 'mesh'}")
