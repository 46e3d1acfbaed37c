"""Figures of a results table."""

import textwrap
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from autonerf_lab.benchmark.grid import label
from autonerf_lab.benchmark.paper import HEADLINES, published_scores
from autonerf_lab.benchmark.results_table import ResultsTable
from autonerf_lab.evaluators.metrics import Metric

CURVES = {"coverage": "area", "obstacle_coverage": "obstacles", "semantic_coverage": "classes",
          "viewpoint_coverage": "viewpoints"}  # fmt: skip
COLORS = ("#0b5e8e", "#d1662a", "#3c8d53", "#8a4f9e", "#b8922a", "#c23b5c", "#4ba3a8", "#6b6b6b", "#7a86d1", "#a0522d")
MOST_CURVES = 6  # in a row of panels, besides the first policy


def scores_over_policies(found: ResultsTable, metrics: Sequence[Metric] = HEADLINES) -> Figure:
    """Plot the scores, one panel each: mean and interval by policy, scene means (dots), paper (diamonds).

    Intervals that are much wider than the range of the scores, as those of two scenes, are cut at the axes.
    """
    rows = found.rows
    parts = [[policy, *variant.partition(", ")[::2]] for policy, variant in rows]  # policy, model, conditions
    policies, models = ({part[k] for part in parts} for k in (0, 1))
    # a name that all rows share is left out, except that of the only policy with the only model
    told = len(policies) > 1 or len(models) == 1, len(models) > 1, True
    names = [", ".join(text for text, show in zip(part, told, strict=True) if show and text) for part in parts]
    width = 11 + 0.08 * max(map(len, names))
    figure = Figure(figsize=(width, 0.9 + 2 * (0.9 + 0.28 * len(rows))), layout="constrained")
    axes = figure.subplots(2, (len(metrics) + 1) // 2, squeeze=False, sharey=True).ravel()
    for ax, metric in zip(axes, metrics, strict=False):
        shown: list[float] = []  # scores of scenes, and the paper's
        for y, row in enumerate(rows):
            color = COLORS[y % len(COLORS)]
            means = [float(np.mean(values)) * metric.scale for values in found.runs(row, metric.key).values()]
            shown += means
            mean = found.interval(row, metric.key)
            if mean is not None:
                half = 0.0 if mean.scenes == 1 else mean.half_width * metric.scale
                ax.errorbar(mean.mean * metric.scale, y, xerr=half, fmt="o", color=color, capsize=3, zorder=3)
                ax.plot(means, np.full(len(means), y), ".", color=color, alpha=0.4)
            published = published_scores(row, rows).get(metric.key)
            if published is not None:
                ax.plot(published * metric.scale, y, "D", markerfacecolor="none", color="#888888", markersize=5)
                shown.append(published * metric.scale)
        if shown:
            (left, right), margin = ax.get_xlim(), 0.3 * (max(shown) - min(shown))
            if margin > 0:
                ax.set_xlim(max(left, min(shown) - margin), min(right, max(shown) + margin))
        ax.set_title(textwrap.fill(metric.heading + (" ↓" if metric.better < 0 else ""), 32), fontsize=10)
        ax.grid(axis="x", alpha=0.3)
    axes[0].set_yticks(range(len(rows)), names)
    axes[0].set_ylim(len(rows) - 0.5, -0.5)
    for ax in axes[len(metrics) :]:
        ax.axis("off")
    return figure


def coverage_curves(found: ResultsTable) -> Figure:
    """Plot the coverage over the episode by policy: mean over scenes, and a band from worst to best scene.

    Each row of panels has a few policies, and the first policy of the results for comparison.
    """
    # Models share a curve, because they have the same trajectories; noise and pose sources do not.
    curves: dict[str, dict[str, list[Mapping[str, Sequence[float]]]]] = {}  # by policy and scene
    for outcome in found.outcomes:
        if outcome.curves:
            cell = outcome.cell
            name = label(cell.policy) + (f", {cell.condition}" if cell.condition else "")
            curves.setdefault(name, {}).setdefault(cell.scene, []).append(outcome.curves)
    first, *others = list(curves) or [""]
    count = max(1, -(-len(others) // MOST_CURVES))  # rows of panels, with about equally many policies
    figure = Figure(figsize=(13, 0.4 + 2.7 * count), layout="constrained")
    panels = figure.subplots(count, len(CURVES) + 1, sharex=True, sharey=True, squeeze=False)
    for row, part in zip(panels, np.array_split(np.array(others, dtype=object), count), strict=True):
        for ax, key in zip(row, CURVES, strict=False):
            for name, color in zip((first, *part), COLORS, strict=False):
                scenes = curves.get(name, {}).values()
                means = np.array([np.mean([run[key] for run in runs], axis=0) for runs in scenes])
                if len(means):
                    share = 100 * (np.arange(means.shape[1]) + 1) / means.shape[1]
                    text = textwrap.fill(name, 30, subsequent_indent="  ")
                    ax.plot(share, means.mean(axis=0), "--" if name == first else "-", color=color, label=text)
                    ax.fill_between(share, means.min(axis=0), means.max(axis=0), color=color, alpha=0.1, linewidth=0)
            ax.set(xlim=(0, 100), ylim=(0, 100))
            ax.grid(alpha=0.3)
        row[-1].axis("off")
        row[-1].legend(*row[0].get_legend_handles_labels(), loc="center left", frameon=False)
    for title, top, bottom in zip(CURVES.values(), panels[0], panels[-1], strict=False):
        top.set_title(title)
        bottom.set_xlabel("% of the episode")
    figure.supylabel("coverage, % of the visible total", fontsize="medium")
    return figure


def cell_curves(curves: Mapping[str, Sequence[float]]) -> Figure:
    """Plot the coverage of one cell over the episode, % of the visible total."""
    figure = Figure(figsize=(6.5, 3.2), layout="constrained")
    ax = figure.subplots()
    for (key, title), color in zip(CURVES.items(), COLORS, strict=False):
        if key in curves:
            share = 100 * (np.arange(len(curves[key])) + 1) / len(curves[key])
            ax.plot(share, curves[key], color=color, label=title)
    ax.set(xlabel="% of the episode", ylabel="coverage, % of the visible total", xlim=(0, 100), ylim=(0, 100))
    ax.grid(alpha=0.3)
    ax.legend(frameon=False)
    return figure
