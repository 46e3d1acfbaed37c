"""How a policy learned."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from autonerf_lab.viz.figures import BLUE, ORANGE

_SMOOTH = 8  # points of the running mean: episodes in large and small apartments differ more than a lesson


def learning_curve(curve: Sequence[dict[str, float]], title: str) -> Figure:
    """Reward and explored area of the training episodes over the frames.

    Args:
        curve: of :func:`autonerf_lab.training.train_policy`: ``frames``, ``reward`` and ``explored_m2`` a row.
        title: over the figure.

    Example:
        >>> rows = [{"frames": 100.0 * k, "reward": float(k), "explored_m2": 2.0 * k} for k in range(20)]
        >>> [ax.get_ylabel() for ax in learning_curve(rows, "modular-obs").axes]
        ['reward an episode', 'explored area (m²)']
    """
    figure = Figure(figsize=(9, 2.8), layout="constrained")
    panels = (("reward", "reward an episode", BLUE), ("explored_m2", "explored area (m²)", ORANGE))
    for ax, (key, label, color) in zip(figure.subplots(1, 2), panels, strict=True):
        frames, values = (np.array([row[name] for row in curve]) for name in ("frames", key))
        ax.plot(frames, values, color=color, alpha=0.3)
        if len(values) >= 2 * _SMOOTH:
            mean = np.convolve(values, np.ones(_SMOOTH) / _SMOOTH, "valid")
            ax.plot(frames[_SMOOTH - 1 :], mean, color=color)
        ax.set(xlabel="frames", ylabel=label)
        ax.grid(alpha=0.3)
    figure.suptitle(title)
    return figure
