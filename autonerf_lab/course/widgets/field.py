"""Widgets for a radiance field: watch its training, render it from any pose, plan on its map."""

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.course.widgets.live import BackgroundTask, LiveFigure
from autonerf_lab.course.widgets.start_goal import StartGoal
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.evaluators.ground_truth import TrueMap
from autonerf_lab.evaluators.maps import CellState
from autonerf_lab.evaluators.nearest_view import NearestView
from autonerf_lab.evaluators.planning import (
    PREDICTED_DILATION,
    TRUE_DILATION,
    Episode,
    EpisodeSet,
    dilate_obstacles,
    plan_points,
)
from autonerf_lab.evaluators.radiance_field import RadianceField
from autonerf_lab.evaluators.rendering import flip, psnr
from autonerf_lab.geometry import planar_from_pose, planar_pose, world_to_cell
from autonerf_lab.planning import descend, travel_distance
from autonerf_lab.scenes import plot_scene
from autonerf_lab.simulator import Simulator
from autonerf_lab.viz.figures.maps import draw_robot
from autonerf_lab.viz.figures.style import BLUE, ORANGE, SKY, plain_log
from autonerf_lab.viz.figures.training import running_mean

_STATE_COLORS = np.repeat(np.array([[170], [235], [60]], np.uint8), 3, axis=1)  # unknown, free, occupied
_MEAN = 20  # steps in the running mean


class FieldTraining(BackgroundTask):
    """Loss and PSNR of a radiance field during its training, with a rendering from one pose.

    Args:
        step: performs one training step and returns loss and mean squared error of its batch.
        render: returns the current rendering, (H, W, 3) in [0, 1].
        target: (H, W, 3) uint8 ground truth of the rendering.

    Example:
        >>> training = FieldTraining(lambda: (0.5, 0.01), lambda: np.zeros((2, 2, 3)), np.zeros((2, 2, 3), np.uint8))
        >>> training.run(5)
        >>> training.loss[-1], training.psnr[-1]
        (0.5, 20.0)
    """

    def __init__(
        self, step: Callable[[], tuple[float, float]], render: Callable[[], np.ndarray], target: np.ndarray
    ) -> None:
        super().__init__()
        self._step, self._render, self._target = step, render, target
        self.loss: list[float] = []  # one value per step
        self.psnr: list[float] = []  # dB, batch of each step
        self.refresh()

    def run(self, steps: int) -> None:
        """Train for a number of steps and redraw regularly. After a kernel interrupt, the training can be continued."""
        self.stopped.clear()
        try:
            self._run(steps)
        except KeyboardInterrupt:
            self.refresh()

    def figure(self) -> Figure:
        """Draw PSNR and loss, the rendering and its ground truth."""
        figure = Figure(figsize=(11, 3.4), layout="constrained")
        curve, rendering, target = figure.subplots(1, 3, width_ratios=(1.5, 1, 1))
        steps = np.arange(len(self.psnr)) + 1
        curve.plot(steps, self.psnr, color=SKY, linewidth=0.8)
        loss = curve.twinx()
        loss.plot(steps, self.loss, color=ORANGE, linewidth=0.8, alpha=0.3)
        if steps.size >= _MEAN:
            for ax, values, color in ((curve, self.psnr, BLUE), (loss, self.loss, ORANGE)):
                ax.plot(steps[_MEAN - 1 :], running_mean(np.array(values), _MEAN), color=color)
        curve.set(xlabel="step", title=f"thick lines: mean of {_MEAN} steps")
        curve.set_ylabel("PSNR of the training batch (dB)", color=BLUE)
        curve.grid(alpha=0.3)
        loss.set_ylabel("loss", color=ORANGE)
        if min(self.loss, default=0) > 0:
            loss.set_yscale("log")
            plain_log(loss.yaxis)
        for ax, image, title in (
            (rendering, self._render(), f"rendering, step {len(steps)}"),
            (target, self._target, "ground truth"),
        ):
            ax.imshow(np.clip(image, 0, 1) if image.dtype != np.uint8 else image)
            ax.set(xticks=[], yticks=[], title=title)
        self.draw_error(figure)
        return figure

    def work(self) -> None:
        """Train until "stop" is pressed."""
        self._run(np.inf)

    def _run(self, steps: float) -> None:
        done = 0
        while done < steps and not self.stopped.is_set():
            loss, error = self._step()
            self.loss.append(float(loss))
            self.psnr.append(float(-10 * np.log10(max(error, 1e-10))))
            done += 1
            self.refresh_while_running()
        self.refresh()


class ViewComparison(LiveFigure):
    """Ground truth, rendering and nearest training image at a chosen camera pose.

    Args:
        field: radiance field to render.
        sim: simulator of the scene, for the ground truth.
        trajectory: training data of the field.
        pose: (4, 4) initial camera pose, camera-to-world.

    Example:
        >>> from autonerf_lab.evaluators.oracle import TrueField
        >>> from autonerf_lab.exploration import explore
        >>> from autonerf_lab.geometry import Intrinsics
        >>> from autonerf_lab.scenes import load_scene
        >>> sim = Simulator(load_scene("dev-0"), Intrinsics.from_fov(16, 16))
        >>> trajectory = explore(sim, "random", steps=2, progress=False)
        >>> views = ViewComparison(TrueField(sim.scene, sim), sim, trajectory, trajectory.poses[0])
        >>> sorted(views.sliders), round(views.psnr["rendering"], 1)
        (['heading', 'x', 'y'], 58.9)
    """

    def __init__(self, field: RadianceField, sim: Simulator, trajectory: Trajectory, pose: np.ndarray) -> None:
        super().__init__()
        self._field, self._sim, self._nearest = field, sim, NearestView(trajectory)
        (x0, y0, _), (x1, y1, _) = sim.scene.bounds
        x, y, heading = planar_from_pose(pose)
        self.sliders = {
            "x": self.slider("x", x0, x1, x),
            "y": self.slider("y", y0, y1, y),
            "heading": self.slider("heading", -180.0, 180.0, float(np.degrees(heading)), step=5.0),
        }
        self.psnr: dict[str, float] = {}  # dB, of the two shown images
        self.refresh()

    @property
    def pose(self) -> np.ndarray:
        """(4, 4) camera pose, camera-to-world."""
        x, y, degrees = (slider.value for slider in self.sliders.values())
        return planar_pose(x, y, np.radians(degrees))

    def controls(self) -> list[Any]:
        """Return sliders for x and y, metres, and the heading, degrees."""
        return list(self.sliders.values())

    def figure(self) -> Figure:
        """Draw a plan with all cameras, then ground truth, rendering, nearest training image and FLIP error."""
        pose, camera = self.pose, self._sim.intrinsics
        true = self._sim.render(pose).rgb.astype(np.float32) / 255
        shown = {
            "rendering": self._field.render(pose, camera),
            "nearest training image": self._nearest.render(pose, camera),
        }
        images = {name: np.clip(image.rgb, 0, 1).astype(np.float32) for name, image in shown.items()}
        self.psnr = {name: psnr(image, true) for name, image in images.items()}
        figure = Figure(figsize=(14, 3.2), layout="constrained")
        plan, *axes = figure.subplots(1, 5, width_ratios=(1.3, 1, 1, 1, 1))
        plot_scene(self._sim.scene, plan)
        plan.plot(*self._nearest.poses[:, :2, 3].T, ".", color=SKY, markersize=3)
        draw_robot(plan, self._nearest.poses[self._nearest.nearest(pose)], SKY)
        draw_robot(plan, pose, ORANGE)
        error = flip(images["rendering"], true)[1]
        titles = ["ground truth", *(f"{name}: {value:.1f} dB" for name, value in self.psnr.items())]
        for ax, image, title in zip(axes, (true, *images.values()), titles, strict=False):
            ax.imshow(image)
            ax.set_title(title, fontsize=10)
        axes[3].imshow(error, cmap="magma", vmin=0, vmax=1)
        axes[3].set_title(f"FLIP error of the rendering: {error.mean():.2f}", fontsize=10)
        for ax in axes:
            ax.set(xticks=[], yticks=[])
        return figure


class PlanComparison(StartGoal):
    """Path between a chosen start and goal, planned on a predicted map and evaluated on the true one.

    Args:
        states: (R, C) predicted :class:`~autonerf_lab.evaluators.maps.CellState` of each cell.
        truth: true map on the same grid.
        start: (2,) initial start position, world x, y, metres.
        goal: (2,) initial goal position, world x, y, metres.

    Example:
        >>> from autonerf_lab.evaluators.ground_truth import MapGrid
        >>> free = np.pad(np.ones((60, 198), bool), 1)
        >>> nothing = np.zeros((15, *free.shape), bool)
        >>> truth = TrueMap(MapGrid(np.zeros(2), free.shape, 0.02), ~free, ~free, free, nothing)
        >>> plans = PlanComparison(np.where(free, CellState.FREE, CellState.OCCUPIED), truth, (0.5, 0.6), (3.5, 0.6))
        >>> plans.episode.success, round(plans.episode.length, 2)
        (True, 3.0)
    """

    def __init__(
        self, states: np.ndarray, truth: TrueMap, start: tuple[float, float], goal: tuple[float, float]
    ) -> None:
        low, high = truth.grid.centers(np.array([[0, 0], np.array(truth.grid.shape) - 1]))
        super().__init__(low, high, start, goal)
        self._states, self._truth = states, truth
        self._free = dilate_obstacles(states == CellState.FREE, PREDICTED_DILATION, truth.grid.cell)
        self._passable = dilate_obstacles(truth.free, TRUE_DILATION, truth.grid.cell)
        self.refresh()

    @property
    def episode(self) -> Episode:
        """Planning episode with its scores; ``shortest`` is inf if the true map has no path."""
        return self._plan()[0]

    def figure(self) -> Figure:
        """Draw the planned path on the predicted map, and with the true shortest path on the true map."""
        (episode, field), (start, goal) = self._plan(), self.start_goal
        grid, truth = self._truth.grid, self._truth
        true_states = np.where(truth.free, CellState.FREE, np.where(truth.occupied, CellState.OCCUPIED, 0))
        rows, cols = grid.shape
        (x0, y0), (x1, y1) = grid.origin, grid.origin + np.array([cols, rows]) * grid.cell
        figure = Figure(figsize=(12, 12 * 0.5 * rows / cols + 1), layout="constrained")
        maps = (
            (self._states, self._free, "planned on the predicted map"),
            (true_states, self._passable, "evaluated on the true map"),
        )
        for ax, (states, free, title) in zip(figure.subplots(1, 2), maps, strict=True):
            colors = _STATE_COLORS[states]
            colors[free] = 255
            ax.imshow(colors, origin="lower", extent=(x0, x1, y0, y1), interpolation="nearest")
            ax.set(xlabel="x (m)")
            ax.set_title(title, fontsize=10)
            if episode.path is not None:
                ax.plot(
                    *grid.centers(episode.path).T, color=ORANGE, linewidth=2.5, label=f"planned, {episode.length:.2f} m"
                )
            if ax is figure.axes[1] and np.isfinite(episode.shortest):
                shortest = grid.centers(descend(field, episode.start, grid.cell))
                ax.plot(*shortest.T, "--", color=BLUE, linewidth=1.5, label=f"shortest, {episode.shortest:.2f} m")
            ax.plot(*start, "o", color=BLUE, markeredgecolor="white", markersize=10, label="start")
            ax.plot(*goal, "*", color=BLUE, markeredgecolor="white", markersize=16, label="goal")
            ax.legend(loc="upper right", fontsize=8)
        fits = np.isfinite(episode.shortest)
        verdict = (
            f"success, SPL {100 * episode.spl:.0f} %" if fits and episode.success else f"failure: {episode.reason}"
        )
        figure.suptitle(verdict if fits else "the true map has no path between start and goal", fontsize=11)
        return figure

    def _plan(self) -> tuple[Episode, np.ndarray]:
        """Return the episode and the distance field of the goal on the true map, metres."""
        cells = world_to_cell(self.start_goal, self._truth.grid.origin, self._truth.grid.cell)
        field = travel_distance(self._passable, cells[1:], self._truth.grid.cell)
        shortest = np.array([field[tuple(cells[0])]])
        no_class = np.full((NUM_CLASSES, 1), np.inf)
        tasks = EpisodeSet(self._passable, cells[:1], cells[1:], np.maximum(shortest, 1e-9), (), no_class)
        (episode,) = plan_points(self._free, tasks, self._truth.grid.cell)
        return episode, field
