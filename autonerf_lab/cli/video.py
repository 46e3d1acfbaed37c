"""``autonerf-lab video``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from autonerf_lab.cli.options import FieldPath, option

FRAMES_PER_SECOND = 24


@dataclass(frozen=True)
class VideoCommand:
    """Render a video of a radiance field along its training poses."""

    folder: FieldPath
    out: Annotated[Path, option(help="Output .mp4 or .gif file.")]
    layer: Annotated[
        str, option(metavar="NAME", help="Image layer: rgb, depth, semantics, opacity, or all (the first three).")
    ] = "rgb"
    seconds: Annotated[float, option(help="Duration of the video in seconds.")] = 10.0
    height: Annotated[
        int | None,
        option(metavar="N", help="Image height in pixels.", default="that of the training images"),
    ] = None

    def run(self) -> None:
        """Render the frames and write the video."""
        from autonerf_lab import pipeline
        from autonerf_lab.viz.camera_paths import trajectory_path
        from autonerf_lab.viz.video import save_video

        field, intrinsics = pipeline.load_finished_field(self.folder), None
        if self.height is not None:
            width = max(1, round(self.height * field.intrinsics.width / field.intrinsics.height))
            intrinsics = field.intrinsics.resized(width, self.height)
        path = trajectory_path(field, round(FRAMES_PER_SECOND * self.seconds))
        print(save_video(field, path, self.out, FRAMES_PER_SECOND, self.layer, intrinsics))
