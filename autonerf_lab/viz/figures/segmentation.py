"""Figures of the task ``segmentation``."""

from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from autonerf_lab.classes import CLASS_NAMES, colorize
from autonerf_lab.evaluators.segmentation import BINS, DISTANCES, SIZES
from autonerf_lab.viz.figures.style import BLUE, ORANGE, class_legend, empty_figure

_FEW = 20  # pixels; an accuracy of fewer is not drawn


def segmentation_views(artifact: dict[str, Any]) -> Figure:
    """Draw images, predicted labels, labels of the field and true labels, one row per view.

    Args:
        artifact: artifact of the task ``segmentation``.
    """
    views = artifact.get("views")
    if not views:
        return empty_figure()
    titles = {"rgb": "image", "predicted": "predicted", "field": "field", "truth": "ground truth"}
    figure = Figure(figsize=(2 * len(titles), 2 * len(views) + 0.8), layout="constrained")
    axes = figure.subplots(len(views), len(titles), squeeze=False)
    for row, view in zip(axes, views, strict=True):
        for ax, name in zip(row, titles, strict=True):
            ax.axis("off")
            if view[name] is not None:
                ax.imshow(view[name] if name == "rgb" else colorize(view[name]))
    for ax, title in zip(axes[0], titles.values(), strict=True):
        ax.set_title(title, fontsize=9)
    layers = [view[name] for view in views for name in ("predicted", "field", "truth") if view[name] is not None]
    class_legend(figure, np.unique(np.stack(layers)))
    return figure


def segmentation_failures(artifact: dict[str, Any]) -> Figure:
    """Draw the share of right labels of each object class, by distance and by visible size.

    Args:
        artifact: artifact of the task ``segmentation``.
    """
    if "errors" not in artifact:
        return empty_figure()
    errors = artifact["errors"]
    figure = Figure(figsize=(9, 4.8), layout="constrained")
    for ax, table, edges, unit in zip(
        figure.subplots(1, 2, sharey=True),
        (errors.by_distance, errors.by_size),
        (DISTANCES, SIZES),
        ("distance (m)", "visible size of the object (pixels)"),
        strict=True,
    ):
        pixels, hits = table[1:, :, 0], table[1:, :, 1]
        share = np.where(pixels >= _FEW, 100 * hits / np.maximum(pixels, 1), np.nan)
        shown = ax.imshow(share, cmap="viridis", vmin=0, vmax=100, aspect="auto")
        for r, c in np.argwhere(np.isfinite(share)):
            color = "black" if share[r, c] > 60 else "white"
            ax.text(c, r, f"{share[r, c]:.0f}", ha="center", va="center", color=color, fontsize=7)
        ends = [f"{a:g}–{b:g}" if np.isfinite(b) else f"over {a:g}" for a, b in pairwise(edges)]
        ax.set_xticks(range(len(ends)), ends, fontsize=8)
        ax.set_yticks(range(len(CLASS_NAMES) - 1), CLASS_NAMES[1:], fontsize=8)
        ax.set_xlabel(unit)
    figure.colorbar(shown, ax=figure.axes, label="% of the pixels with the right label", shrink=0.8)
    return figure


def reliability_diagram(artifact: dict[str, Any]) -> Figure:
    """Draw the share of right labels over the confidence, and the number of pixels.

    Args:
        artifact: artifact of the task ``segmentation``.
    """
    if "errors" not in artifact:
        return empty_figure()
    errors = artifact["errors"]
    pixels, confidence, hits = errors.reliability.T
    known = pixels >= _FEW
    figure = Figure(figsize=(4.4, 4.8), layout="constrained")
    ax, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    ax.plot([0, 1], [0, 1], color="0.6", linestyle="--", label="calibrated")
    ax.plot(confidence[known] / pixels[known], hits[known] / pixels[known], "o-", color=BLUE, label="measured")
    ax.set(ylabel="share of right labels", xlim=(0, 1), ylim=(0, 1))
    ax.set_title(f"expected calibration error {100 * errors.calibration_error:.1f} %", fontsize=9)
    ax.legend()
    ax.grid(alpha=0.3)
    below.bar((np.arange(BINS) + 0.5) / BINS, 100 * pixels / max(pixels.sum(), 1), 0.9 / BINS, color=ORANGE)
    below.set(xlabel="confidence", ylabel="% of pixels", yscale="log")
    return figure
