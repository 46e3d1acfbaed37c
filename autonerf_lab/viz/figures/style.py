"""Colours and helper functions of all figures.

The colours are those of Okabe and Ito (2008), which colour-blind readers can distinguish.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, NullFormatter

from autonerf_lab.classes import CLASS_COLORS, CLASS_NAMES

if TYPE_CHECKING:
    from matplotlib.axis import Axis

BLUE, ORANGE, GREEN, YELLOW, SKY = "#0072B2", "#D55E00", "#009E73", "#F0E442", "#56B4E9"
SOURCE_COLORS = {"true": "#000000", "odometry": ORANGE, "estimated": BLUE, "refined": GREEN}  # paths of pose sources


def cells_extent(origin: np.ndarray, shape: tuple[int, ...], cell: float) -> tuple[float, float, float, float]:
    """Return the left, right, bottom and top edge of an array of cells, as ``extent`` of ``imshow(origin="lower")``.

    Args:
        origin: (2,) x, y of the outer corner of cell [0, 0], metres.
        shape: of the array, [row = y, column = x].
        cell: side of a cell, metres.

    Example:
        >>> cells_extent(np.array([-1.0, 2.0]), (2, 4), 0.5)
        (-1.0, 1.0, 2.0, 3.0)
    """
    x, y = origin.tolist()
    return x, x + shape[1] * cell, y, y + shape[0] * cell


def plain_log(axis: "Axis") -> None:
    """Label a logarithmic axis with 1, 2 and 5 in each decade, as plain numbers."""
    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def empty_figure(text: str = "this task could not be computed") -> Figure:
    """Return a figure that shows a text only, in place of a figure that cannot be drawn."""
    figure = Figure(figsize=(6, 2), layout="constrained")
    figure.subplots().axis("off")  # notebooks do not show a figure without axes
    figure.text(0.5, 0.5, text, ha="center", va="center")
    return figure


def from_best_to_worst(errors: np.ndarray, count: int) -> np.ndarray:
    """Select items of (N,) errors, evenly spread from the smallest to the largest.

    Args:
        errors: (N,) errors.
        count: maximum number of items.

    Returns:
        Indices, from the smallest to the largest error.

    Example:
        >>> from_best_to_worst(np.array([3.0, 1.0, 2.0, 5.0, 4.0]), 3).tolist()
        [1, 0, 3]
    """
    order = np.argsort(errors, kind="stable")
    return order[np.unique(np.linspace(0, len(order) - 1, min(count, len(order))).round().astype(int))]


def class_legend(figure: Figure, classes: np.ndarray, loc: Any = "outside lower center", columns: int = 8) -> None:
    """Add a legend of object classes to a figure.

    Args:
        figure: the figure.
        classes: (N,) class indices.
        loc: location, as in ``Figure.legend``.
        columns: number of columns.
    """
    handles = [
        Patch(facecolor=CLASS_COLORS[k] / 255, edgecolor="#808080", label=CLASS_NAMES[k]) for k in classes.astype(int)
    ]
    figure.legend(handles=handles, loc=loc, ncols=columns, fontsize=7, frameon=False)
