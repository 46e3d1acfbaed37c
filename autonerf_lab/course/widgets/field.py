"""Things to play with that need a field: watch it learn, look around in it, plan on its map."""

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from autonerf_lab.classes import NUM_CLASSES
from autonerf_lab.course.widgets.live import Background, Live
from autonerf_lab.course.widgets.start_goal import Ends
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.evaluators.ground_truth import TrueMap
from autonerf_lab.evaluators.maps import CellState
from autonerf_lab.evaluators.nearest_view import NearestView
from autonerf_lab.evaluators.planning import PREDICTED_DILATION, TRUE_DILATION, Episode, Tasks, grow, plan_points
from autonerf_lab.evaluators.radiance_field import Field
from autonerf_lab.evaluators.rendering import flip, psnr
from autonerf_lab.geometry import planar_from_pose, planar_pose, world_to_cell
from autonerf_lab.planning import descend, travel_distance
from autonerf_lab.simulator import Simulator
from autonerf_lab.viz.figures.maps import draw_robot
from autonerf_lab.viz.figures.style import BLUE, ORANGE, SKY, plain_log
from autonerf_lab.viz.figures.training import running_mean

_GROUND = np.repeat(np.array([[170], [235], [60]], np.uint8), 3, axis=1)  # unknown, free, occupied
_DRAWINGS = 12  # of a run
_EVERY = 25  # steps between two drawings in the background
_MEAN = 20  # steps of the running mean


class Training(Background):
    """Watch a field learn: its loss, its PSNR, and what it shows from one pose.

    Args:
        step: trains once and returns the loss and the mean squared error of its batch.
        view: what the field shows now, (H, W, 3) in [0, 1].
        truth: (H, W, 3) uint8, what it should show.

    Example:
        >>> training = Training(lambda: (0.5, 0.01), lambda: np.zeros((2, 2, 3)), np.zeros((2, 2, 3), np.uint8))
        >>> training.run(5)
        >>> training.loss[-1], training.psnr[-1]
        (0.5, 20.0)
    """

    def __init__(
        self, step: Callable[[], tuple[float, float]], view: Callable[[], np.ndarray], truth: np.ndarray
    ) -> None:
        super().__init__()
        self._step, self._view, self._truth = step, view, truth
        self.loss: list[float] = []  # of each step
        self.psnr: list[float] = []  # dB, of the batch of each step
        self.refresh()

    def run(self, steps: int) -> None:
        """Train, and draw now and then. Interrupting the kernel ends it early and keeps what was learned."""
        self.stopped.clear()
        try:
            self._run(steps, max(1, steps // _DRAWINGS))
        except KeyboardInterrupt:
            self.refresh()

    def figure(self) -> Figure:
        """PSNR and loss, what the field shows, and what it should show."""
        figure = Figure(figsize=(11, 3.4), layout="constrained")
        curve, shown, true = figure.subplots(1, 3, width_ratios=(1.5, 1, 1))
        steps = np.arange(len(self.psnr)) + 1
        curve.plot(steps, self.psnr, color=SKY, linewidth=0.8)
        loss = curve.twinx()
        loss.plot(steps, self.loss, color=ORANGE, linewidth=0.8, alpha=0.3)
        if steps.size >= _MEAN:
            for ax, values, color in ((curve, self.psnr, BLUE), (loss, self.loss, ORANGE)):
                ax.plot(steps[_MEAN - 1 :], running_mean(np.array(values), _MEAN), color=color)
        curve.set(xlabel="step", title=f"thick: mean of {_MEAN} steps")
        curve.set_ylabel("PSNR of the batch (dB)", color=BLUE)
        curve.grid(alpha=0.3)
        loss.set_ylabel("loss", color=ORANGE)
        if min(self.loss, default=0) > 0:
            loss.set_yscale("log")
            plain_log(loss.yaxis)
        for ax, image, title in ((shown, self._view(), f"step {len(steps)}"), (true, self._truth, "a camera")):
            ax.imshow(np.clip(image, 0, 1) if image.dtype != np.uint8 else image)
            ax.set(xticks=[], yticks=[], title=title)
        self.say_error(figure)
        return figure

    def work(self) -> None:
        """Train until "stop"."""
        self._run(np.inf, _EVERY)

    def _run(self, steps: float, every: int) -> None:
        done = 0
        while done < steps and not self.stopped.is_set():
            loss, error = self._step()
            self.loss.append(float(loss))
            self.psnr.append(float(-10 * np.log10(max(error, 1e-10))))
            done += 1
            if done % every == 0:
                self.refresh()
        self.refresh()


class Views(Live):
    """Put a camera anywhere, and see what it would see, what a field shows there, and the nearest training image.

    Args:
        field: what is looked at.
        sim: of its scene.
        walk: what it was trained on.
        pose: (4, 4) where the camera begins.

    Example:
        >>> from autonerf_lab.evaluators.oracle import TrueField
        >>> from autonerf_lab.exploration import explore
        >>> from autonerf_lab.geometry import Intrinsics
        >>> from autonerf_lab.scenes import load_scene
        >>> sim = Simulator(load_scene("dev-0"), Intrinsics.from_fov(16, 16))
        >>> walk = explore(sim, "random", steps=2, progress=False)
        >>> views = Views(TrueField(sim.scene, sim), sim, walk, walk.poses[0])
        >>> sorted(views.sliders), round(views.psnr["the field"], 1)
        (['heading', 'x', 'y'], 58.9)
    """

    def __init__(self, field: Field, sim: Simulator, walk: Trajectory, pose: np.ndarray) -> None:
        super().__init__()
        self._field, self._sim, self._nearest = field, sim, NearestView(walk)
        (x0, y0, _), (x1, y1, _) = sim.scene.bounds
        x, y, heading = planar_from_pose(pose)
        self.sliders = {
            "x": self.slider("x", x0, x1, x),
            "y": self.slider("y", y0, y1, y),
            "heading": self.slider("heading", -180.0, 180.0, float(np.degrees(heading)), step=5.0),
        }
        self.psnr: dict[str, float] = {}  # dB, of what is shown
        self.refresh()

    @property
    def pose(self) -> np.ndarray:
        """(4, 4) of the camera."""
        x, y, degrees = (slider.value for slider in self.sliders.values())
        return planar_pose(x, y, np.radians(degrees))

    def controls(self) -> list[Any]:
        """Sliders: x and y, metres, and the heading, degrees."""
        return list(self.sliders.values())

    def figure(self) -> Figure:
        """From above: camera and walk; then what is there, what is shown, its error, and the nearest image."""
        pose, camera = self.pose, self._sim.intrinsics
        true = self._sim.render(pose).rgb.astype(np.float32) / 255
        shown = {"the field": self._field.render(pose, camera), "nearest image": self._nearest.render(pose, camera)}
        images = {name: np.clip(image.rgb, 0, 1).astype(np.float32) for name, image in shown.items()}
        self.psnr = {name: psnr(image, true) for name, image in images.items()}
        figure = Figure(figsize=(14, 3.2), layout="constrained")
        plan, *axes = figure.subplots(1, 5, width_ratios=(1.3, 1, 1, 1, 1))
        self._sim.scene.plot(plan)
        plan.plot(*self._nearest.cameras[:, :2, 3].T, ".", color=SKY, markersize=3)
        draw_robot(plan, self._nearest.cameras[self._nearest.nearest(pose)], SKY)
        draw_robot(plan, pose, ORANGE)
        error = flip(images["the field"], true)[1]
        titles = ["a camera", *(f"{name}: {value:.1f} dB" for name, value in self.psnr.items())]
        for ax, image, title in zip(axes, (true, *images.values()), titles, strict=False):
            ax.imshow(image)
            ax.set_title(title, fontsize=10)
        axes[3].imshow(error, cmap="magma", vmin=0, vmax=1)
        axes[3].set_title(f"FLIP of the field: {error.mean():.2f}", fontsize=10)
        for ax in axes:
            ax.set(xticks=[], yticks=[])
        return figure


class Plans(Ends):
    """Choose a start and a goal; a way is planned on a predicted map, and judged on the true one.

    Args:
        states: (R, C) of :class:`~autonerf_lab.evaluators.maps.CellState`, the prediction.
        truth: on the same grid.
        start: (2,) world x, y.
        goal: (2,) world x, y.

    Example:
        >>> from autonerf_lab.evaluators.ground_truth import Grid
        >>> free = np.pad(np.ones((60, 198), bool), 1)
        >>> nothing = np.zeros((15, *free.shape), bool)
        >>> truth = TrueMap(Grid(np.zeros(2), free.shape, 0.02), ~free, ~free, free, nothing)
        >>> plans = Plans(np.where(free, CellState.FREE, CellState.OCCUPIED), truth, (0.5, 0.6), (3.5, 0.6))
        >>> plans.episode.success, round(plans.episode.length, 2)
        (True, 3.0)
    """

    def __init__(
        self, states: np.ndarray, truth: TrueMap, start: tuple[float, float], goal: tuple[float, float]
    ) -> None:
        low, high = truth.grid.centers(np.array([[0, 0], np.array(truth.grid.shape) - 1]))
        super().__init__(low, high, start, goal)
        self._states, self._truth = states, truth
        self._free = grow(states == CellState.FREE, PREDICTED_DILATION, truth.grid.cell)
        self._passable = grow(truth.free, TRUE_DILATION, truth.grid.cell)
        self.refresh()

    @property
    def episode(self) -> Episode:
        """The plan and its judgement, as in the task; ``shortest`` is inf where the robot does not fit or get."""
        return self._plan()[0]

    def figure(self) -> Figure:
        """The way on the predicted map; the same, and the shortest one, on the true map."""
        (episode, field), (start, goal) = self._plan(), self.ends
        grid, truth = self._truth.grid, self._truth
        true_states = np.where(truth.free, CellState.FREE, np.where(truth.occupied, CellState.OCCUPIED, 0))
        rows, cols = grid.shape
        (x0, y0), (x1, y1) = grid.origin, grid.origin + np.array([cols, rows]) * grid.cell
        figure = Figure(figsize=(12, 12 * 0.5 * rows / cols + 1), layout="constrained")
        maps = (
            (self._states, self._free, "planned on the prediction"),
            (true_states, self._passable, "judged on the truth"),
        )
        for ax, (states, free, title) in zip(figure.subplots(1, 2), maps, strict=True):
            ground = _GROUND[states]
            ground[free] = 255
            ax.imshow(ground, origin="lower", extent=(x0, x1, y0, y1), interpolation="nearest")
            ax.set(xlabel="x (m)")
            ax.set_title(title, fontsize=10)
            if episode.path is not None:
                ax.plot(
                    *grid.centers(episode.path).T, color=ORANGE, linewidth=2.5, label=f"planned, {episode.length:.2f} m"
                )
            if ax is figure.axes[1] and np.isfinite(episode.shortest):
                way = grid.centers(descend(field, episode.start, grid.cell))
                ax.plot(*way.T, "--", color=BLUE, linewidth=1.5, label=f"shortest, {episode.shortest:.2f} m")
            ax.plot(*start, "o", color=BLUE, markeredgecolor="white", markersize=10, label="start")
            ax.plot(*goal, "*", color=ORANGE, markeredgecolor="white", markersize=16, label="goal")
            ax.legend(loc="upper right", fontsize=8)
        fits = np.isfinite(episode.shortest)
        verdict = (
            f"success, SPL {100 * episode.spl:.0f} %" if fits and episode.success else f"failure: {episode.reason}"
        )
        figure.suptitle(verdict if fits else "in the true apartment, the robot cannot be at both ends", fontsize=11)
        return figure

    def _plan(self) -> tuple[Episode, np.ndarray]:
        """The episode, and the true distances to its goal."""
        cells = world_to_cell(self.ends, self._truth.grid.origin, self._truth.grid.cell)
        field = travel_distance(self._passable, cells[1:], self._truth.grid.cell)
        shortest = np.array([field[tuple(cells[0])]])
        nobody = np.full((NUM_CLASSES, 1), np.inf)
        tasks = Tasks(self._passable, cells[:1], cells[1:], np.maximum(shortest, 1e-9), (), nobody)
        (episode,) = plan_points(self._free, tasks, self._truth.grid.cell)
        return episode, field
