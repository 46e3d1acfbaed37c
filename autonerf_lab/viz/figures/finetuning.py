"""Figure of the task ``finetuning``."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from autonerf_lab.evaluators.metrics import FINETUNING_STAGES
from autonerf_lab.viz.figures.style import BLUE, GREEN, ORANGE, empty_figure
from autonerf_lab.viz.figures.training import SMOOTH, running_mean

_COLORS = dict(zip(FINETUNING_STAGES, (BLUE, ORANGE, GREEN), strict=True))


def finetuning_results(artifact: dict[str, Any]) -> Figure:
    """Draw the success rate during the training, and success rate and SPL in the true scene.

    Args:
        artifact: artifact of the task ``finetuning``.

    Example:
        >>> episode = {"success": True, "spl": 0.9}
        >>> curve = [{"frames": 10.0 * k, "success": 80.0} for k in (1, 2)]
        >>> stage = {"episodes": [episode], "frames": 20, "curve": curve}
        >>> [ax.get_title() for ax in finetuning_results({"pretrained": stage, "finetuned": stage}).axes]
        ['during fine-tuning', 'in the true scene']
    """
    if not artifact:
        return empty_figure("no fine-tuning in this run")
    figure = Figure(figsize=(11, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    for k, stage in enumerate(stage for stage in FINETUNING_STAGES if stage in artifact):
        label, color = FINETUNING_STAGES[stage], _COLORS[stage]
        curve = artifact[stage]["curve"]
        if stage != "pretrained" and curve:
            frames, success = (np.array([row[name] for row in curve]) for name in ("frames", "success"))
            width = min(SMOOTH, len(success))
            left.plot(frames[width - 1 :], running_mean(success, width), color=color, label=label)
        episodes = artifact[stage]["episodes"]
        values = [100 * np.mean([episode[name] for episode in episodes]) for name in ("success", "spl")]
        bars = right.bar(np.arange(2) + 0.27 * (k - 1), values, 0.25, color=color, label=label)
        right.bar_label(bars, fmt="%.1f", fontsize=8)
    left.set(title="during fine-tuning", xlabel="frames", ylabel="success rate (%)")
    left.grid(alpha=0.3)
    right.set(title="in the true scene", xticks=range(2), xticklabels=("success rate (%)", "SPL (%)"), ylim=(0, 109))
    figure.legend(*right.get_legend_handles_labels(), frameon=False, fontsize=8, loc="outside lower center", ncols=3)
    return figure
