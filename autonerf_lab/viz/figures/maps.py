"""Drawing of the map of the robot, in metres."""

from typing import TYPE_CHECKING

import numpy as np

from autonerf_lab.exploration.replay import OCCUPIED, PALETTE, map_image
from autonerf_lab.geometry import planar_from_pose
from autonerf_lab.types import MapState
from autonerf_lab.viz.figures.style import BLUE, cells_extent, class_legend

if TYPE_CHECKING:
    from collections.abc import Iterable

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

GROUND = "#E9EBEE"  # colour of unseen cells
_MARGIN = 0.3  # around the explored cells, metres
_BODY, _LOOK = 0.18, 0.6  # radius of the robot and length of its arrow, metres


def map_extent(known: MapState) -> tuple[float, float, float, float]:
    """Return the left, right, bottom and top edge of a map, metres, as ``extent`` of ``imshow(origin="lower")``."""
    return cells_extent(known.origin, known.explored.shape, known.cell)


def draw_map(ax: "Axes", known: MapState, title: str = "", robot: bool = True) -> None:
    """Draw a map: explored cells, frontier (light blue), obstacles (grey), object classes, and the robot.

    Args:
        ax: axes; they are cropped to the explored cells.
        known: the map.
        title: of the axes.
        robot: if True, draw the robot with an arrow along its heading.

    Example:
        >>> from matplotlib.figure import Figure
        >>> from autonerf_lab.rewards.conformance import blank_transition
        >>> known = blank_transition(cell=0.5).after
        >>> known.explored[2:6, 4:12] = True
        >>> ax = Figure().subplots()
        >>> draw_map(ax, known)
        >>> [round(float(x), 2) for x in ax.get_xlim()]
        [1.7, 6.3]
    """
    ax.imshow(PALETTE[map_image(known)], origin="lower", extent=map_extent(known), interpolation="nearest")
    ax.set(facecolor=GROUND, aspect="equal", xlabel="x (m)", ylabel="y (m)")
    ax.set_title(title, fontsize=10)
    rows, cols = np.nonzero(known.explored)
    if len(rows):
        low, high = np.array([cols.min(), rows.min()]), np.array([cols.max(), rows.max()]) + 1
        (left, bottom), (right, top) = known.origin + known.cell * low, known.origin + known.cell * high
        ax.set(xlim=(left - _MARGIN, right + _MARGIN), ylim=(bottom - _MARGIN, top + _MARGIN))
    if robot:
        draw_robot(ax, known.pose)


def map_legend(figure: "Figure", images: "Iterable[np.ndarray]") -> None:
    """Add a legend of the object classes that occur in map images; without any, do nothing.

    Args:
        figure: the figure.
        images: map images, arrays of indices of ``autonerf_lab.exploration.replay.PALETTE``.
    """
    values = {int(value) for image in images for value in np.unique(image) if value > OCCUPIED}
    if values:
        class_legend(figure, np.array(sorted(values)) - OCCUPIED)


def draw_robot(ax: "Axes", pose: np.ndarray, color: str = BLUE) -> None:
    """Draw a disc with the radius of the robot and an arrow along its heading."""
    from matplotlib.patches import Circle

    x, y, heading = planar_from_pose(pose)
    ax.add_patch(Circle((x, y), _BODY, facecolor=color, edgecolor="white", zorder=4))
    tip = (x + _LOOK * np.cos(heading), y + _LOOK * np.sin(heading))
    ax.annotate("", tip, (x, y), arrowprops={"arrowstyle": "-|>", "color": color, "linewidth": 1.6}, zorder=5)
