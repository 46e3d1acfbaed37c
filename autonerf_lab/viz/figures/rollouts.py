"""Figure of the rollouts of several policies: their maps after given numbers of steps."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import DataError
from autonerf_lab.exploration.replay import PALETTE, Replay, replay_map, union_box
from autonerf_lab.mapping.semantic_map import MAP_CELL
from autonerf_lab.viz.figures.maps import GROUND, draw_robot, map_legend
from autonerf_lab.viz.figures.style import BLUE, ORANGE, cells_extent

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_WIDTH = 11.0  # inches


def rollouts(
    *trajectories: Trajectory, steps: Sequence[int] = (150, 375, 750, 1500), titles: Sequence[str] = ()
) -> Figure:
    """Draw the maps of trajectories in one scene after given numbers of steps, as in the paper's figure of rollouts.

    Args:
        trajectories: one row each; with depth, and with semantics if classes are to be drawn.
        steps: one column each; a trajectory that is shorter shows its last step.
        titles: of the rows; default: the names of the policies.

    Raises:
        DataError: no trajectory, a trajectory without depth, or a camera that is not level.
        WrongTypeError: an argument is not a trajectory.

    Example:
        >>> from autonerf_lab.geometry import Intrinsics, planar_pose
        >>> depth = np.full((2, 9, 9), 2.01, np.float32)
        >>> poses = np.stack([planar_pose(0, 0, 0), planar_pose(0.25, 0, 0)])
        >>> trajectory = Trajectory(poses, np.zeros((2, 9, 9, 3), np.uint8), depth, None, Intrinsics.from_fov(9, 9))
        >>> len(rollouts(trajectory, trajectory, steps=(1, 2), titles=("one", "another")).axes)
        4
    """
    if not trajectories:
        raise DataError("rollouts() needs at least one trajectory")
    shown = np.unique(np.asarray(steps, int)) - 1
    replays = [replay_map(trajectory, shown) for trajectory in trajectories]
    if not all(replay.maps for replay in replays):
        raise DataError("a trajectory without depth has no map to draw; lab.explore records depth")
    return replay_figure(replays, range(len(shown)), titles, first_step=1)


def replay_figure(
    replays: Sequence[Replay], columns: Sequence[int], titles: Sequence[str] = (), first_step: int = 0
) -> Figure:
    """Draw the maps and paths of replays in one scale.

    Args:
        replays: one row each, of the same number of steps.
        columns: one each; index of a replayed step.
        titles: of the rows; default: the names of the policies.
        first_step: number of the first step: 0 as in a player, 1 for the number of steps so far.
    """
    (x0, y0), (x1, y1) = union_box(replays)
    width = _WIDTH / len(columns)
    figure = Figure(figsize=(_WIDTH, len(replays) * (width * (y1 - y0) / (x1 - x0) + 0.25) + 0.3), layout="constrained")
    axes = figure.subplots(len(replays), len(columns), squeeze=False)
    for row, replay, title in zip(axes, replays, titles or [replay.name for replay in replays], strict=True):
        for ax, k in zip(row, columns, strict=True):
            _draw(ax, replay, k, first_step)
            ax.set(xlim=(x0, x1), ylim=(y0, y1), xticks=[], yticks=[], aspect="equal", facecolor=GROUND)
        row[0].set_ylabel(title, parse_math=False)
    map_legend(figure, [replay.maps[-1] for replay in replays if replay.maps])
    return figure


def _draw(ax: "Axes", replay: Replay, k: int, first_step: int) -> None:
    """Draw the map and the path at the k-th of the replayed steps."""
    t = int(replay.steps[k])
    if replay.maps is not None:
        extent = cells_extent(replay.corner, replay.maps[k].shape, MAP_CELL)
        ax.imshow(PALETTE[replay.maps[k]], origin="lower", extent=extent, interpolation="nearest")
    path = replay.planar[: t + 1]
    ax.plot(path[:, 0], path[:, 1], color="white", linewidth=2.4)
    ax.plot(path[:, 0], path[:, 1], color=BLUE, linewidth=1.3)
    ax.plot(*path[0, :2], "o", color="white", markeredgecolor=BLUE, markersize=5)
    draw_robot(ax, replay.trajectory.poses[t], ORANGE)
    area = "" if replay.area is None else f": {replay.area[k]:.0f} m²"
    ax.set_title(f"step {t + first_step}{area}", fontsize=9)
