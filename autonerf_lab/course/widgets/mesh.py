"""Something to play with that needs a mesh: turn it, and colour it in different ways."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from autonerf_lab.course.widgets.live import Live
from autonerf_lab.viz.figures.evaluation import bird_view

if TYPE_CHECKING:
    import trimesh


class Turntable(Live):
    """Turn a mesh, with the near walls and the ceiling cut away.

    Args:
        mesh: world frame, metres, triangles facing the free side.
        colors: name -> (V, 3) uint8, the ways to colour its vertices; the first is shown.
        width: pixels.

    Example:
        >>> import trimesh
        >>> box = trimesh.creation.box()
        >>> room = box.invert()  # seen from inside
        >>> table = Turntable(room, {"grey": np.full((8, 3), 128, np.uint8)}, width=60)
        >>> table.side.value, table.choice.options
        (-60, ('grey',))
    """

    def __init__(self, mesh: "trimesh.Trimesh", colors: Mapping[str, np.ndarray], width: int = 800) -> None:
        super().__init__()
        self._mesh, self._colors, self._width = mesh, colors, width
        self.side = self.slider("from", -180, 180, -60, step=10)
        self.choice = self.widgets.Dropdown(options=tuple(colors), description="colour")
        self.choice.observe(self.refresh, "value")
        self.refresh()

    def controls(self) -> list[Any]:
        """A slider for where it is looked at from, degrees counter-clockwise from +x, and what colours it."""
        return [self.widgets.HBox([self.side, self.choice])]

    def figure(self) -> Figure:
        """The mesh from above and from the side."""
        picture = bird_view(self._mesh, self._colors[self.choice.value], self._width, float(self.side.value))
        figure = Figure(figsize=(10, 10 * picture.shape[0] / picture.shape[1] + 0.3), layout="constrained")
        ax = figure.subplots()
        ax.imshow(picture)
        ax.axis("off")
        ax.set_title(f"{self.choice.value}, {len(self._mesh.faces)} triangles", fontsize=10)
        return figure
