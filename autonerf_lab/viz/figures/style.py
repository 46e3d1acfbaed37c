"""Colours and helpers that all figures share.

Colours are those of Okabe and Ito (2008), which colour-blind readers can tell apart.
"""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

if TYPE_CHECKING:
    from matplotlib.axis import Axis

BLUE, ORANGE, GREEN, YELLOW, SKY = "#0072B2", "#D55E00", "#009E73", "#F0E442", "#56B4E9"


def plain_log(axis: "Axis") -> None:
    """Label a logarithmic axis with 1, 2 and 5 of each decade, in plain numbers: errors span one decade or two."""
    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def nothing(text: str = "this task could not be computed") -> Figure:
    """What stands in the place of a figure that cannot be drawn."""
    figure = Figure(figsize=(6, 2), layout="constrained")
    figure.subplots().axis("off")  # a notebook does not show a figure without axes
    figure.text(0.5, 0.5, text, ha="center", va="center")
    return figure


def from_best_to_worst(badness: np.ndarray, count: int) -> np.ndarray:
    """Which of (N,) pictures to show: at most so many, evenly spread from the least to the largest.

    Example:
        >>> from_best_to_worst(np.array([3.0, 1.0, 2.0, 5.0, 4.0]), 3).tolist()
        [1, 0, 3]
    """
    order = np.argsort(badness, kind="stable")
    return order[np.unique(np.linspace(0, len(order) - 1, min(count, len(order))).round().astype(int))]
