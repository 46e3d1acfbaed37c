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
LINE_STYLES = ("-", "--", ":")  # one after another, when the colours have been used


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
    """Plot the coverage over the episode by policy: mean over scenes, and a band from worst to best scene."""
    # Models share a curve, because they have the same trajectories; noise and pose sources do not.
    names = [f"{label(o.cell.policy)}{', ' * bool(o.cell.condition)}{o.cell.condition}" for o in found.outcomes]
    policies = list(dict.fromkeys(names))
    columns = max(1, min(6, 160 // (8 + max(map(len, policies), default=0))))  # 160 characters fill the width
    figure = Figure(figsize=(13, 3.2 + 0.22 * -(-len(policies) // columns)), layout="constrained")
    axes = figure.subplots(1, len(CURVES), sharey=True)
    for ax, (key, title) in zip(axes, CURVES.items(), strict=True):
        for k, policy in enumerate(policies):
            color, style = COLORS[k % len(COLORS)], LINE_STYLES[k // len(COLORS) % len(LINE_STYLES)]
            scenes: dict[str, list[list[float]]] = {}
            for name, outcome in zip(names, found.outcomes, strict=True):
                if name == policy and outcome.curves:
                    scenes.setdefault(outcome.cell.scene, []).append(outcome.curves[key])
            if scenes:
                means = np.array([np.mean(curves, axis=0) for curves in scenes.values()])
                share = 100 * (np.arange(means.shape[1]) + 1) / means.shape[1]
                ax.plot(share, means.mean(axis=0), color=color, linestyle=style, label=policy)
                ax.fill_between(share, means.min(axis=0), means.max(axis=0), color=color, alpha=0.1, linewidth=0)
        ax.set(title=title, xlabel="% of the episode", xlim=(0, 100), ylim=(0, 100))
        ax.grid(alpha=0.3)
    axes[0].set_ylabel("coverage, % of the visible total")
    handles, labels = axes[0].get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False)
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
