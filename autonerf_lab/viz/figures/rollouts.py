"""The rollouts of several policies as a figure for a page: what each knew, and where it had been, by when."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import DataError
from autonerf_lab.exploration.replay import PALETTE, Retraced, retrace
from autonerf_lab.mapping.semantic_map import MAP_CELL
from autonerf_lab.viz.figures.maps import draw_robot
from autonerf_lab.viz.figures.style import BLUE, ORANGE
from autonerf_lab.viz.player.step_image import union_box

_WIDTH = 11.0  # inches


def rollouts(*walks: Trajectory, steps: Sequence[int] = (150, 375, 750, 1500), titles: Sequence[str] = ()) -> Figure:
    """Maps of walks in one scene after so many steps: a row a walk, all in one scale (the paper's figure of rollouts).

    Args:
        walks: with depth, and with semantics where classes are to be drawn.
        steps: images; those after a walk's end show its end.
        titles: of the rows; without, the names of the policies.

    Raises:
        DataError: no walk, a walk without depth, or not a level camera's.
        WrongTypeError: not a trajectory.

    Example:
        >>> from autonerf_lab.geometry import Intrinsics, planar_pose
        >>> depth = np.full((2, 9, 9), 2.01, np.float32)
        >>> poses = np.stack([planar_pose(0, 0, 0), planar_pose(0.25, 0, 0)])
        >>> walk = Trajectory(poses, np.zeros((2, 9, 9, 3), np.uint8), depth, None, Intrinsics.from_fov(9, 9))
        >>> len(rollouts(walk, walk, steps=(1, 2), titles=("one", "another")).axes)
        4
    """
    if not walks:
        raise DataError("rollouts() wants at least one walk")
    shown = np.unique(np.asarray(steps, int)) - 1
    traced = [retrace(walk, shown) for walk in walks]
    if not all(walk.maps for walk in traced):
        raise DataError("a walk that kept no depth has no map to draw; explore() keeps it")
    (x0, y0), (x1, y1) = union_box(traced)
    width = _WIDTH / len(shown)
    figure = Figure(figsize=(_WIDTH, len(walks) * (width * (y1 - y0) / (x1 - x0) + 0.25) + 0.3), layout="constrained")
    axes = figure.subplots(len(walks), len(shown), squeeze=False)
    for row, walk, title in zip(axes, traced, titles or [walk.name for walk in traced], strict=True):
        for k, ax in enumerate(row):
            _draw(ax, walk, k)
            ax.set(xlim=(x0, x1), ylim=(y0, y1), xticks=[], yticks=[], aspect="equal", facecolor="0.91")
        row[0].set_ylabel(title)
    return figure


def _draw(ax, walk: Retraced, k: int) -> None:  # type: ignore[no-untyped-def]
    assert walk.maps is not None and walk.area is not None
    cells, t = walk.maps[k], int(walk.steps[k])
    (x, y), (rows, cols) = walk.corner, cells.shape
    extent = (x, x + cols * MAP_CELL, y, y + rows * MAP_CELL)
    ax.imshow(PALETTE[cells], origin="lower", extent=extent, interpolation="nearest")
    way = walk.planar[: t + 1]
    ax.plot(way[:, 0], way[:, 1], color="white", linewidth=2.4)
    ax.plot(way[:, 0], way[:, 1], color=BLUE, linewidth=1.3)
    ax.plot(*way[0, :2], "o", color="white", markeredgecolor=BLUE, markersize=5)
    draw_robot(ax, walk.trajectory.poses[t], ORANGE)
    ax.set_title(f"step {t + 1}: {walk.area[k]:.0f} m²", fontsize=9)
