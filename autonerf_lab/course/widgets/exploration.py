"""Widgets for exploration: drive the robot, plan a path on its map, mix rewards."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from autonerf_lab.course.widgets.live import LiveFigure, escape_dollars
from autonerf_lab.course.widgets.start_goal import StartGoal
from autonerf_lab.envs.explore import ExploreEnv
from autonerf_lab.errors import RewardError
from autonerf_lab.exploration.replay import map_image
from autonerf_lab.geometry import AGENT_RADIUS, world_to_cell
from autonerf_lab.planning import descend, dilate, path_length, travel_distance
from autonerf_lab.rewards import Reward, make_reward, name_of, unit_of
from autonerf_lab.scenes import Scene
from autonerf_lab.types import Action, MapState
from autonerf_lab.viz.figures.maps import draw_map, map_extent, map_legend
from autonerf_lab.viz.figures.style import BLUE, GREEN, ORANGE, SKY, YELLOW

_COLORS = (BLUE, GREEN, "#CC79A7", SKY, YELLOW, "#999999", "#882255")  # no orange: it marks new cells and paths
_BUTTONS = {"turn left": Action.TURN_LEFT, "forward": Action.FORWARD, "turn right": Action.TURN_RIGHT}
_ICONS = {"turn left": "arrow-left", "forward": "arrow-up", "turn right": "arrow-right", "restart": "undo"}


class Drive(LiveFigure):
    """Manual control of the robot with three arrow buttons, with its map and the reward of each step.

    Args:
        scene: a scene or its name.
        reward: a name, a weighted sum, or a reward object. If it fails, the episode ends and the error is shown.
        seed: random seed of the start pose.
        options: further options of ``AutoNeRF/Explore-v0``: size, supersample, noise, ...

    Example:
        >>> drive = Drive("dev-0", "cov", size=16)
        >>> drive.buttons["forward"].click()
        >>> len(drive.rewards), drive.rewards[0] >= 0
        (1, True)
    """

    def __init__(self, scene: str | Scene, reward: str | Reward = "cov", seed: int = 0, **options: Any) -> None:
        super().__init__()
        self._env = ExploreEnv(scene=scene, reward=reward, **options)
        self._name, self._unit, self._seed = name_of(reward), unit_of(make_reward(reward)), seed
        self.buttons = {name: self.widgets.Button(description=name, icon=icon) for name, icon in _ICONS.items()}
        for name, action in _BUTTONS.items():
            self.buttons[name].on_click(partial(self._press, action))
        self.buttons["restart"].on_click(self.start)
        self.start()

    def start(self, button: object = None) -> None:
        """Restart the episode from its start pose."""
        observation, _ = self._env.reset(seed=self._seed)
        self._rgb, self._over, self.error = observation["rgb"], False, ""
        self.rewards: list[float] = []  # the reward of each step
        self._path = [observation["pose"][:2, 3]]
        self.refresh()

    def act(self, *actions: int) -> None:
        """Execute actions in order, then redraw the figure."""
        for action in actions:
            if self._over:
                break
            try:
                observation, reward, _, self._over, _ = self._env.step(np.int64(action))
            except RewardError as error:
                self._over, self.error = True, str(error)
                break
            self._rgb = observation["rgb"]
            self._path.append(observation["pose"][:2, 3])
            self.rewards.append(reward)
        self.refresh()

    def controls(self) -> list[Any]:
        """Return the buttons."""
        return [self.widgets.HBox(list(self.buttons.values()))]

    def figure(self) -> Figure:
        """Draw the camera image, the map with the path, and the rewards."""
        figure = Figure(figsize=(12, 4), layout="constrained")
        view, plan, curve = figure.subplots(1, 3, width_ratios=(1, 1.2, 1.3))
        view.imshow(self._rgb)
        view.set(xticks=[], yticks=[], title=f"camera image, step {len(self.rewards)}")
        draw_map(plan, self._env.map)
        plan.plot(*np.transpose(self._path), color=BLUE, linewidth=1.5)
        map_legend(figure, [map_image(self._env.map)])
        curve.bar(np.arange(len(self.rewards)) + 1, self.rewards, color=SKY, label="per step")
        curve.plot(np.arange(len(self.rewards) + 1), np.cumsum([0.0, *self.rewards]), color=BLUE, label="cumulative")
        curve.set(xlabel="step", ylabel=escape_dollars(self._unit))
        curve.set_title(escape_dollars(f"{self._name}: {sum(self.rewards):.2f} in total"), fontsize=10)
        curve.legend(frameon=False, fontsize=8)
        self.draw_error(figure)
        return figure

    def _press(self, action: Action, button: object) -> None:
        self.act(action)


class Route(StartGoal):
    """Shortest path between a chosen start and goal on a map, with the distance field of the goal.

    Args:
        known: map to plan on.
        start: (2,) initial start position, world x, y, metres.
        goal: (2,) initial goal position, world x, y, metres.

    Example:
        >>> from autonerf_lab.rewards.conformance import blank_transition
        >>> known = blank_transition(cell=0.5).after
        >>> known.explored[:] = True
        >>> route = Route(known, (0.25, 0.25), (4.25, 0.25))
        >>> route.length
        4.0
    """

    def __init__(self, known: MapState, start: tuple[float, float], goal: tuple[float, float]) -> None:
        rows, cols = np.nonzero(known.explored)
        low = known.origin + known.cell * (np.array([cols.min(), rows.min()]) + 0.5)
        high = known.origin + known.cell * (np.array([cols.max(), rows.max()]) + 0.5)
        super().__init__(low, high, start, goal)
        self._known = known
        self.sliders["clearance"] = self.slider("clearance", 0.0, 0.5, AGENT_RADIUS)
        self.refresh()

    @property
    def length(self) -> float:
        """Path length, metres; inf if there is no path."""
        return self._plan()[2]

    def controls(self) -> list[Any]:
        """Return the controls of start and goal, and a slider for the clearance from obstacles, metres."""
        return [*super().controls(), self.sliders["clearance"]]

    def figure(self) -> Figure:
        """Draw the map, contours of the distance to the goal every 0.5 m, and the path."""
        field, path, length = self._plan()
        known, (start, goal) = self._known, self.start_goal
        figure = Figure(figsize=(8, 6), layout="constrained")
        ax = figure.subplots()
        straight = float(np.linalg.norm(start - goal))
        summary = f"path {length:.2f} m, straight line {straight:.2f} m" if np.isfinite(length) else "no path"
        draw_map(ax, known, f"{summary} (contours: distance to the goal, every 0.5 m)", robot=False)
        x0, x1, y0, y1 = map_extent(known)
        reached = np.where(np.isfinite(field), field, np.nan)
        if np.nanmax(reached, initial=0) > 0:
            xs = np.linspace(x0, x1, field.shape[1], endpoint=False) + known.cell / 2
            ys = np.linspace(y0, y1, field.shape[0], endpoint=False) + known.cell / 2
            ax.contour(xs, ys, reached, np.arange(0.5, np.nanmax(reached), 0.5), cmap="viridis", linewidths=0.7)
        ax.plot(*(known.origin + (path[:, ::-1] + 0.5) * known.cell).T, color=ORANGE, linewidth=2.5)
        ax.plot(*start, "o", color=BLUE, markeredgecolor="white", markersize=11, label="start")
        ax.plot(*goal, "*", color=BLUE, markeredgecolor="white", markersize=17, label="goal")
        ax.legend(loc="upper right", fontsize=9)
        return figure

    def _plan(self) -> tuple[np.ndarray, np.ndarray, float]:
        """Return the distance field, metres, the path in cells and its length, metres."""
        known = self._known
        start, goal = world_to_cell(self.start_goal, known.origin, known.cell)
        free = known.explored & ~dilate(known.occupied, self.sliders["clearance"].value / known.cell)
        field = travel_distance(free, goal[None], known.cell)
        if not np.isfinite(field[tuple(start)]):
            return field, np.empty((0, 2), np.int64), np.inf
        path = descend(field, start, known.cell)
        return field, path, path_length(path, known.cell)


class RewardMixer(LiveFigure):
    """Weighted sum of rewards with a slider for each weight, compared over several trajectories.

    Args:
        values: trajectory name -> reward name -> (T,) reward at each step.
        weights: reward name -> initial weight; by default 1 for the first reward and 0 for the others.

    Example:
        >>> mixer = RewardMixer({"frontier": {"cov": np.ones(3), "nov": np.zeros(3)}})
        >>> mixer.sliders["nov"].value = 0.5
        >>> mixer.reward
        '1*cov+0.5*nov'
    """

    def __init__(self, values: Mapping[str, Mapping[str, np.ndarray]], weights: Mapping[str, float] | None = None):
        super().__init__()
        self._values = values
        names = list(next(iter(values.values())))
        initial = {names[0]: 1.0} if weights is None else weights
        self.sliders = {name: self.slider(name, 0.0, 2.0, initial.get(name, 0.0), continuous=True) for name in names}
        self.refresh()

    @property
    def reward(self) -> str:
        """Name of the weighted sum, as environments accept it: ``"1*cov+0.5*nov"``; empty if all weights are 0."""
        return "+".join(f"{slider.value:g}*{name}" for name, slider in self.sliders.items() if slider.value)

    def controls(self) -> list[Any]:
        """Return a slider for each weight."""
        return list(self.sliders.values())

    def figure(self) -> Figure:
        """Draw the cumulative weighted sum of each trajectory, and the total of each term."""
        figure = Figure(figsize=(11, 3.4), layout="constrained")
        curve, bars = figure.subplots(1, 2, width_ratios=(1.3, 1))
        for number, (trajectory, values) in enumerate(self._values.items()):
            terms = {name: slider.value * np.cumsum(values[name]) for name, slider in self.sliders.items()}
            style = ("-", "--", ":", "-.")[number % 4]
            curve.plot(np.sum(list(terms.values()), axis=0), style, color="black", label=escape_dollars(trajectory))
            left = 0.0
            for k, (name, curves) in enumerate(terms.items()):
                label = escape_dollars(name) if number == 0 else None
                bars.barh(number, curves[-1], left=left, color=_COLORS[k % 7], edgecolor="white", label=label)
                left += curves[-1]
        curve.set(xlabel="step", ylabel="cumulative reward")
        curve.set_title(escape_dollars(self.reward or "all weights are 0"), fontsize=10)
        curve.legend(frameon=False, fontsize=9)
        curve.grid(alpha=0.3)
        bars.set(
            yticks=range(len(self._values)), yticklabels=[escape_dollars(trajectory) for trajectory in self._values]
        )
        bars.invert_yaxis()
        bars.set_title("total of each weighted term", fontsize=10)
        bars.legend(frameon=False, fontsize=8, ncols=4, loc="upper center", bbox_to_anchor=(0.5, -0.1))
        return figure
