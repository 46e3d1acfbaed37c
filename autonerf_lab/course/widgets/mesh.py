"""Interactive view of a mesh: rotate it and choose its colouring."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from autonerf_lab.course.widgets.live import LiveFigure
from autonerf_lab.viz.figures.evaluation import bird_view

if TYPE_CHECKING:
    import trimesh


class Turntable(LiveFigure):
    """Rotating view of a mesh, with the near walls and the ceiling cut away.

    Args:
        mesh: world frame, metres; the triangles face the free space.
        colors: colour schemes of the vertices, name -> (V, 3) uint8; the first is selected.
        width: of the image, pixels.

    Example:
        >>> import trimesh
        >>> box = trimesh.creation.box()
        >>> room = box.invert()  # seen from inside
        >>> table = Turntable(room, {"grey": np.full((8, 3), 128, np.uint8)}, width=60)
        >>> table.azimuth.value, table.color_scheme.options
        (-60, ('grey',))
    """

    def __init__(self, mesh: "trimesh.Trimesh", colors: Mapping[str, np.ndarray], width: int = 800) -> None:
        super().__init__()
        self._mesh, self._colors, self._width = mesh, colors, width
        self.azimuth = self.slider("azimuth (°)", -180, 180, -60, step=10)
        self.color_scheme = self.widgets.Dropdown(options=tuple(colors), description="colour")
        self.color_scheme.observe(self.refresh, "value")
        self.refresh()

    def controls(self) -> list[Any]:
        """Return a slider for the azimuth of the viewpoint, degrees counter-clockwise from +x, and a colour menu."""
        return [self.widgets.HBox([self.azimuth, self.color_scheme])]

    def figure(self) -> Figure:
        """Draw an oblique view of the mesh from above."""
        image = bird_view(self._mesh, self._colors[self.color_scheme.value], self._width, float(self.azimuth.value))
        figure = Figure(figsize=(10, 10 * image.shape[0] / image.shape[1] + 0.3), layout="constrained")
        ax = figure.subplots()
        ax.imshow(image)
        ax.axis("off")
        ax.set_title(f"{self.color_scheme.value}, {len(self._mesh.faces)} triangles", fontsize=10)
        return figure
