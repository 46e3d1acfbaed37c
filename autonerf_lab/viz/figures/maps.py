"""The robot's map, drawn on an axis in metres."""

from typing import TYPE_CHECKING

import numpy as np

from autonerf_lab.exploration.replay import PALETTE, cells
from autonerf_lab.geometry import planar_from_pose
from autonerf_lab.types import MapState
from autonerf_lab.viz.figures.style import BLUE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

GROUND = "#E9EBEE"  # what nobody has seen
_MARGIN = 0.3  # metres around what is known
_BODY, _LOOK = 0.18, 0.6  # metres


def map_extent(known: MapState) -> tuple[float, float, float, float]:
    """Left, right, bottom and top edge of a map, metres: the ``extent`` of ``imshow`` with ``origin="lower"``."""
    rows, cols = known.explored.shape
    x, y = known.origin
    return x, x + cols * known.cell, y, y + rows * known.cell


def draw_map(ax: "Axes", known: MapState, title: str = "", robot: bool = True) -> None:
    """Draw what a map knows: ground, frontier (light blue), obstacles (grey) and classes, and where the robot is.

    Args:
        ax: what to draw on; it is cropped to what is known.
        known: the map.
        title: of the axis.
        robot: whether the robot is drawn, with an arrow along its heading.

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
    ax.imshow(PALETTE[cells(known)], origin="lower", extent=map_extent(known), interpolation="nearest")
    ax.set(facecolor=GROUND, aspect="equal", xlabel="x (m)", ylabel="y (m)")
    ax.set_title(title, fontsize=10)
    rows, cols = np.nonzero(known.explored)
    if len(rows):
        low, high = np.array([cols.min(), rows.min()]), np.array([cols.max(), rows.max()]) + 1
        (left, bottom), (right, top) = known.origin + known.cell * low, known.origin + known.cell * high
        ax.set(xlim=(left - _MARGIN, right + _MARGIN), ylim=(bottom - _MARGIN, top + _MARGIN))
    if robot:
        draw_robot(ax, known.pose)


def draw_robot(ax: "Axes", pose: np.ndarray, color: str = BLUE) -> None:
    """A disc of the robot's size with an arrow along its heading."""
    from matplotlib.patches import Circle

    x, y, heading = planar_from_pose(pose)
    ax.add_patch(Circle((x, y), _BODY, facecolor=color, edgecolor="white", zorder=4))
    tip = (x + _LOOK * np.cos(heading), y + _LOOK * np.sin(heading))
    ax.annotate("", tip, (x, y), arrowprops={"arrowstyle": "-|>", "color": color, "linewidth": 1.6}, zorder=5)
