"""The picture of fine-tuning: how the policies practised, and what it was good for."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from autonerf_lab.evaluators.scores import FINETUNED
from autonerf_lab.viz.figures.style import BLUE, GREEN, ORANGE, nothing
from autonerf_lab.viz.figures.training import SMOOTH, running_mean

_COLORS = dict(zip(FINETUNED, (BLUE, ORANGE, GREEN), strict=True))


def practice(artifact: dict[str, Any]) -> Figure:
    """Success while practising, each in its own place, and success and SPL of all in the true scene.

    Args:
        artifact: of the task ``finetuning``.

    Example:
        >>> end = {"success": True, "spl": 0.9}
        >>> stage = {"episodes": [end], "frames": 20, "curve": [{"frames": 10.0 * k, "success": 80.0} for k in (1, 2)]}
        >>> [ax.get_title() for ax in practice({"pretrained": stage, "finetuned": stage}).axes]
        ['while practising', 'in the true scene']
    """
    if not artifact:
        return nothing("nobody practised in this mesh")
    figure = Figure(figsize=(11, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    for k, stage in enumerate(stage for stage in FINETUNED if stage in artifact):
        label, color = FINETUNED[stage], _COLORS[stage]
        curve = artifact[stage]["curve"]
        if stage != "pretrained" and curve:
            frames, success = (np.array([row[name] for row in curve]) for name in ("frames", "success"))
            width = min(SMOOTH, len(success))
            left.plot(frames[width - 1 :], running_mean(success, width), color=color, label=label)
        shares = [100 * np.mean([end[name] for end in artifact[stage]["episodes"]]) for name in ("success", "spl")]
        bars = right.bar(np.arange(2) + 0.27 * (k - 1), shares, 0.25, color=color, label=label)
        right.bar_label(bars, fmt="%.1f", fontsize=8)
    left.set(title="while practising", xlabel="frames", ylabel="success (%)")
    left.grid(alpha=0.3)
    right.set(title="in the true scene", xticks=range(2), xticklabels=("success (%)", "SPL (%)"), ylim=(0, 109))
    figure.legend(*right.get_legend_handles_labels(), frameon=False, fontsize=8, loc="outside lower center", ncols=3)
    return figure
