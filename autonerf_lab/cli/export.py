"""``autonerf-lab export`` and ``autonerf-lab adopt``: results for other tools, and trajectories as runs."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, subcommand

from autonerf_lab.cli.options import FieldPath, PresetName, option


@dataclass(frozen=True)
class ExportMapCommand:
    """Write the occupancy map of a field for ROS map_server: a .yaml file and a .pgm image."""

    folder: FieldPath
    out: Annotated[Path, option(help="Output .yaml file.")]
    cell: Annotated[float, option(metavar="METRES", help="Side of a cell.")] = 0.05
    floor: Annotated[float, option(metavar="METRES", help="Height of the floor in the frame of the field.")] = 0.0

    def run(self) -> None:
        """Compute and write the map."""
        from autonerf_lab import pipeline
        from autonerf_lab.evaluators.ros_map import export_ros_map

        print(export_ros_map(pipeline.load_finished_field(self.folder), self.out, self.cell, self.floor))


@dataclass(frozen=True)
class ExportMeshCommand:
    """Write the mesh of a field, also of photographs with depth in metres: .glb, .obj or .ply."""

    folder: FieldPath
    out: Annotated[Path, option(help="Output .glb, .obj or .ply file.")]
    voxel: Annotated[float, option(metavar="METRES", help="Voxel size.")] = 0.025

    def run(self) -> None:
        """Extract and write the mesh."""
        from autonerf_lab import pipeline
        from autonerf_lab.evaluators import export_mesh, extract_mesh

        print(export_mesh(extract_mesh(pipeline.load_finished_field(self.folder), self.voxel), self.out))


@dataclass(frozen=True)
class ExportTrajectoryCommand:
    """Write the poses of a run or trajectory folder in the text format of TUM RGB-D."""

    folder: Annotated[Positional[Path], option(help="Run folder or trajectory folder.")]
    out: Annotated[Path, option(help="Output .txt file.")]

    def run(self) -> None:
        """Load the trajectory and write the poses."""
        from autonerf_lab import pipeline
        from autonerf_lab.data.tum_trajectory import export_tum

        print(export_tum(pipeline.load_finished_trajectory(self.folder), self.out))


@dataclass(frozen=True)
class ExportScoresCommand:
    """Write the scores of a run for TensorBoard."""

    folder: Annotated[Positional[Path], option(help="Run folder, or output folder of `autonerf-lab fit --out`.")]
    out: Annotated[Path, option(help="Log folder.")]

    def run(self) -> None:
        """Load the scores and write the scalars."""
        from autonerf_lab.evaluators import Scores

        Scores.load(self.folder / "scores.json").to_tensorboard(self.out)
        print(self.out)


@dataclass(frozen=True)
class ExportCommand:
    """Export the map, mesh, trajectory or scores of a run for other tools."""

    command: (
        Annotated[ExportMapCommand, subcommand("map")]
        | Annotated[ExportMeshCommand, subcommand("mesh")]
        | Annotated[ExportTrajectoryCommand, subcommand("trajectory")]
        | Annotated[ExportScoresCommand, subcommand("scores")]
    )

    def run(self) -> None:
        """Run the subcommand."""
        self.command.run()


@dataclass(frozen=True)
class AdoptCommand:
    """Make a run folder from a saved trajectory, so that fit, evaluate, mesh and report can run."""

    trajectory: Annotated[Positional[Path], option(help="Trajectory folder.")]
    out: Annotated[Path, option(help="Run folder.")]
    scene: Annotated[
        str | None, option(metavar="STR", help="Scene: name or path.", default="that of the trajectory")
    ] = None
    preset: PresetName = None

    def run(self) -> None:
        """Write the run folder."""
        from autonerf_lab.pipeline.adopt import adopt_trajectory

        print(adopt_trajectory(self.trajectory, self.out, self.scene, self.preset))
