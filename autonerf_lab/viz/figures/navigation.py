"""Figure of the task ``navigation``."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from autonerf_lab.evaluators.navigation import SUCCESS_RADIUS
from autonerf_lab.viz.figures.style import BLUE, GREEN, ORANGE, cells_extent, empty_figure

_COLORS = {"": GREEN, "stuck": ORANGE, "out of steps": BLUE, "no path": "#CC79A7"}


def navigation_paths(artifact: dict[str, Any], count: int = 40) -> Figure:
    """Draw the paths of the episodes over the navigable area, in the mesh and in the true scene.

    Args:
        artifact: artifact of the task ``navigation``.
        count: maximum number of successful paths per panel; all failures are drawn.
    """
    if not artifact:
        return empty_figure("no episode in this mesh")
    first = artifact["ground_true_mesh"].navigable
    figure = Figure(figsize=(13, 6.5 * first.shape[0] / first.shape[1] + 1), layout="constrained")
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    for ax, suffix, title in zip(axes, ("", "_true_mesh"), ("the reconstructed mesh", "the true scene"), strict=True):
        ground, episodes = artifact[f"ground{suffix}"], artifact[f"episodes{suffix}"]
        extent = cells_extent(ground.origin, ground.navigable.shape, ground.cell)
        image = np.where(ground.navigable, 255, np.where(ground.distance > 0, 225, 120)).astype(np.uint8)
        ax.imshow(image, cmap="gray", vmin=0, vmax=255, origin="lower", extent=extent, interpolation="nearest")
        won = [episode for episode in episodes if episode.success]
        for episode in [*won[:: max(1, -(-len(won) // count))], *(e for e in episodes if not e.success)]:
            color = _COLORS[episode.reason]
            ax.plot(*episode.path.T, color=color, linewidth=1.1, alpha=0.9)
            ax.plot(*episode.path[0], "o", color=color, markersize=3)
            ax.plot(*episode.goal, "*", color=color, markersize=6)
        text = (
            f"In {title}: {len(won)} of {len(episodes)} episodes succeed; navigable area {ground.area:.0f} m² (white)"
        )
        ax.set_title(text, fontsize=10)
        ax.set_aspect("equal")
        ax.set_xlabel("x (m)", fontsize=8)
        ax.set_ylabel("y (m)", fontsize=8)
        ax.tick_params(labelsize=7)
    handles = [Line2D([], [], color=color, label=reason or "success") for reason, color in _COLORS.items()]
    marks = (("o", "start"), ("*", f"goal (radius {SUCCESS_RADIUS:g} m)"))
    handles += [Line2D([], [], color="k", marker=mark, linestyle="", label=label) for mark, label in marks]
    figure.legend(handles=handles, loc="outside lower center", ncols=6, fontsize=8, frameon=False)
    return figure
