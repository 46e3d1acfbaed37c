"""Figures of the training of a policy and of a segmenter."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter

from autonerf_lab.viz.figures.style import BLUE, GREEN, ORANGE, SKY

SMOOTH = 8  # points of the running mean; single episodes differ with the size of the apartment
_LABELS = {
    "reward": ("reward per episode", BLUE),
    "return": ("discounted return", GREEN),
    "explored_m2": ("explored area (m²)", ORANGE),
    "success": ("success (%)", ORANGE),
    "spl": ("SPL (%)", SKY),
}


def running_mean(values: np.ndarray, width: int) -> np.ndarray:
    """Compute the means of ``width`` neighbouring values; the result is ``width - 1`` shorter.

    Example:
        >>> running_mean(np.array([1.0, 3.0, 5.0]), 2).tolist()
        [2.0, 4.0]
    """
    return np.convolve(values, np.full(width, 1 / width), "valid")


def learning_curve(curve: Sequence[dict[str, float]], title: str) -> Figure:
    """Draw reward and discounted return of the training episodes, and explored area or success, over the frames.

    Args:
        curve: rows of :func:`autonerf_lab.training.train_policy` with ``frames``, ``reward`` and other values.
        title: of the figure.

    Example:
        >>> names = ("frames", "reward", "return", "explored_m2")
        >>> rows = [dict.fromkeys(names, float(k)) for k in range(20)]
        >>> [ax.get_ylabel() for ax in learning_curve(rows, "modular-obs").axes]
        ['reward per episode', 'discounted return', 'explored area (m²)']
    """
    figure = Figure(figsize=(9, 2.8), layout="constrained")
    panels = [(key, label, color) for key, (label, color) in _LABELS.items() if key in curve[0]]
    for ax, (key, label, color) in zip(figure.subplots(1, len(panels)), panels, strict=True):
        frames, values = (np.array([row[name] for row in curve]) for name in ("frames", key))
        ax.plot(frames, values, color=color, alpha=0.3)
        if len(values) >= 2 * SMOOTH:
            ax.plot(frames[SMOOTH - 1 :], running_mean(values, SMOOTH), color=color)
        ax.set(xlabel="frames", ylabel=label)
        ax.xaxis.set_major_formatter(EngFormatter(sep=""))
        ax.grid(alpha=0.3)
    figure.suptitle(title)
    return figure


def segmentation_curve(curve: Sequence[dict[str, float]]) -> Figure:
    """Draw the loss of a segmenter's training and its mIoU in other apartments, over the steps.

    Args:
        curve: rows of :func:`autonerf_lab.training.segmentation.train_segmentation`: ``step``, ``loss``, ``miou``.

    Example:
        >>> rows = [{"step": 500.0 * k, "loss": 1.0 / k, "miou": 10.0 * k} for k in range(1, 5)]
        >>> [ax.get_ylabel() for ax in segmentation_curve(rows).axes]
        ['loss', 'mIoU (%)']
    """
    figure = Figure(figsize=(9, 2.8), layout="constrained")
    for ax, (key, label, color) in zip(
        figure.subplots(1, 2), (("loss", "loss", BLUE), ("miou", "mIoU (%)", ORANGE)), strict=True
    ):
        ax.plot([row["step"] for row in curve], [row[key] for row in curve], "o-", markersize=3, color=color)
        ax.set(xlabel="step", ylabel=label)
        ax.grid(alpha=0.3)
    return figure
