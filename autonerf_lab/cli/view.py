"""``autonerf-lab view``."""

import contextlib
import time
from dataclasses import dataclass
from typing import Annotated

from autonerf_lab.cli.options import FieldPath, option


@dataclass(frozen=True)
class ViewCommand:
    """Show a radiance field in a local web browser. Stop with Ctrl-C."""

    folder: FieldPath
    port: Annotated[int, option(help="Port of the web server; 0: any free port.")] = 0

    def run(self) -> None:
        """Serve the page until Ctrl-C."""
        from autonerf_lab import pipeline
        from autonerf_lab.viz.viewer.viewer import nerf_viewer

        field = pipeline.load_finished_field(self.folder)
        with contextlib.suppress(KeyboardInterrupt), nerf_viewer(field, self.port) as viewer:
            print(f"viewer: {viewer.url} (stop with Ctrl-C)", flush=True)
            while True:
                time.sleep(3600)
