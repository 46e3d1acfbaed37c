"""``autonerf-lab point-cloud``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from autonerf_lab.cli.options import FieldPath, option


@dataclass(frozen=True)
class PointCloudCommand:
    """Export a radiance field as a point cloud (PLY) with colours and, if the field has them, classes."""

    folder: FieldPath
    out: Annotated[Path, option(help="Output .ply file.")]

    def run(self) -> None:
        """Render the depth of training views and write the points."""
        from autonerf_lab import pipeline
        from autonerf_lab.viz.point_cloud import point_cloud

        print(point_cloud(pipeline.load_finished_field(self.folder)).save(self.out))
