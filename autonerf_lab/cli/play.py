"""``autonerf-lab play``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional

from autonerf_lab.cli.options import option


@dataclass(frozen=True)
class PlayCommand:
    """Write an animation of one trajectory, or of several trajectories in one scene."""

    folders: Annotated[
        Positional[tuple[Path, ...]], option(metavar="FOLDER ...", help="One or more run or trajectory folders.")
    ]
    out: Annotated[Path, option(help="Output file: a self-contained .html page, or a .mp4 or .gif video.")]

    def run(self) -> None:
        """Load the trajectories and write the file."""
        from autonerf_lab import pipeline
        from autonerf_lab.viz.player.player import play

        print(play(*map(pipeline.load_finished_trajectory, self.folders)).save(self.out))
