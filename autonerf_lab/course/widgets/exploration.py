"""Things to play with: drive the robot, plan a route on its map, mix a reward."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from autonerf_lab.course.widgets.live import Live, plain
from autonerf_lab.course.widgets.start_goal import Ends
from autonerf_lab.envs.explore import ExploreEnv
from autonerf_lab.errors import RewardError
from autonerf_lab.geometry import AGENT_RADIUS, world_to_cell
from autonerf_lab.planning import descend, dilate, path_length, travel_distance
from autonerf_lab.rewards import Reward, make_reward, name_of, unit_of
from autonerf_lab.scenes import Scene
from autonerf_lab.types import Action, MapState
from autonerf_lab.viz.figures.maps import draw_map, map_extent
from autonerf_lab.viz.figures.style import BLUE, GREEN, ORANGE, SKY

_COLORS = (BLUE, ORANGE, GREEN, "#CC79A7", SKY, "#999999", "#E69F00")
_BUTTONS = {"turn left": Action.TURN_LEFT, "forward": Action.FORWARD, "turn right": Action.TURN_RIGHT}
_ICONS = {"turn left": "arrow-left", "forward": "arrow-up", "turn right": "arrow-right", "start again": "undo"}


class Drive(Live):
    """Drive the robot with three arrow buttons, and see what a reward pays for it.

    Args:
        scene: a name or a scene.
        reward: a name, a weighted sum, or a reward of one's own. One that fails ends the drive, and says why.
        seed: of the start.
        options: of ``AutoNeRF/Explore-v0``: size, supersample, noise, ...

    Example:
        >>> drive = Drive("dev-0", "cov", size=16)
        >>> drive.buttons["forward"].click()
        >>> len(drive.paid), drive.paid[0] >= 0
        (1, True)
    """

    def __init__(self, scene: str | Scene, reward: str | Reward = "cov", seed: int = 0, **options: Any) -> None:
        super().__init__()
        self._env = ExploreEnv(scene=scene, reward=reward, **options)
        self._name, self._unit, self._seed = name_of(reward), unit_of(make_reward(reward)), seed
        self.buttons = {name: self.widgets.Button(description=name, icon=icon) for name, icon in _ICONS.items()}
        for name, action in _BUTTONS.items():
            self.buttons[name].on_click(partial(self._press, action))
        self.buttons["start again"].on_click(self.start)
        self.start()

    def start(self, button: object = None) -> None:
        """Go back to the start."""
        seen, _ = self._env.reset(seed=self._seed)
        self._rgb, self._over, self._error = seen["rgb"], False, ""
        self.paid: list[float] = []  # the reward of each step
        self._way = [seen["pose"][:2, 3]]
        self.refresh()

    def act(self, *actions: int) -> None:
        """Actions, one after the other, and then a new picture."""
        for action in actions:
            if self._over:
                break
            try:
                seen, reward, _, self._over, _ = self._env.step(np.int64(action))
            except RewardError as error:
                self._over, self._error = True, str(error)
                break
            self._rgb = seen["rgb"]
            self._way.append(seen["pose"][:2, 3])
            self.paid.append(reward)
        self.refresh()

    def controls(self) -> list[Any]:
        """The buttons."""
        return [self.widgets.HBox(list(self.buttons.values()))]

    def figure(self) -> Figure:
        """What the robot sees, its map with its way, and what was paid."""
        figure = Figure(figsize=(12, 4), layout="constrained")
        view, plan, curve = figure.subplots(1, 3, width_ratios=(1, 1.2, 1.3))
        view.imshow(self._rgb)
        view.set(xticks=[], yticks=[], title=f"step {len(self.paid)}")
        draw_map(plan, self._env.map)
        plan.plot(*np.transpose(self._way), color=ORANGE, linewidth=1.5)
        curve.bar(np.arange(len(self.paid)) + 1, self.paid, color=SKY, label="each step")
        curve.plot(np.arange(len(self.paid) + 1), np.cumsum([0.0, *self.paid]), color=BLUE, label="so far")
        curve.set(xlabel="step", ylabel=plain(self._unit))
        curve.set_title(plain(f"{self._name}: {sum(self.paid):.2f} so far"), fontsize=10)
        curve.legend(frameon=False, fontsize=8)
        if self._error:
            figure.supxlabel(plain(self._error), color=ORANGE, fontsize=10, wrap=True)
        return figure

    def _press(self, action: Action, button: object) -> None:
        self.act(action)


class Route(Ends):
    """Choose a start and a goal on a map, and see the shortest way between them with its distance field.

    Args:
        known: the map.
        start: (2,) world x, y.
        goal: (2,) world x, y.

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
        """Of the way, metres; inf without one."""
        return self._plan()[2]

    def controls(self) -> list[Any]:
        """Those of the ends, and a slider for the clearance from obstacles, metres."""
        return [*super().controls(), self.sliders["clearance"]]

    def figure(self) -> Figure:
        """The map with the distance to the goal in steps of half a metre, and the way."""
        field, path, length = self._plan()
        known, (start, goal) = self._known, self.ends
        figure = Figure(figsize=(8, 6), layout="constrained")
        ax = figure.subplots()
        straight = float(np.linalg.norm(start - goal))
        way = f"{length:.2f} m, {straight:.2f} m as the crow flies" if np.isfinite(length) else "there is no way"
        draw_map(ax, known, f"{way} (lines: every half metre from the goal)", robot=False)
        x0, x1, y0, y1 = map_extent(known)
        reached = np.where(np.isfinite(field), field, np.nan)
        if np.nanmax(reached, initial=0) > 0:
            xs = np.linspace(x0, x1, field.shape[1], endpoint=False) + known.cell / 2
            ys = np.linspace(y0, y1, field.shape[0], endpoint=False) + known.cell / 2
            ax.contour(xs, ys, reached, np.arange(0.5, np.nanmax(reached), 0.5), cmap="viridis", linewidths=0.7)
        ax.plot(*(known.origin + (path[:, ::-1] + 0.5) * known.cell).T, color=ORANGE, linewidth=2.5)
        ax.plot(*start, "o", color=BLUE, markeredgecolor="white", markersize=11, label="start")
        ax.plot(*goal, "*", color=ORANGE, markeredgecolor="white", markersize=17, label="goal")
        ax.legend(loc="upper right", fontsize=9)
        return figure

    def _plan(self) -> tuple[np.ndarray, np.ndarray, float]:
        """The distance field, the path in cells and its length."""
        known = self._known
        start, goal = world_to_cell(self.ends, known.origin, known.cell)
        free = known.explored & ~dilate(known.occupied, self.sliders["clearance"].value / known.cell)
        field = travel_distance(free, goal[None], known.cell)
        if not np.isfinite(field[tuple(start)]):
            return field, np.empty((0, 2), np.int64), np.inf
        path = descend(field, start, known.cell)
        return field, path, path_length(path, known.cell)


class Mixer(Live):
    """Weigh rewards against each other, and see which of several walks the sum likes best.

    Args:
        walks: name of a walk -> name of a reward -> (T,) its value at each step.
        weights: name of a reward -> its weight; without it, 1 for the first and 0 for the others.

    Example:
        >>> mixer = Mixer({"there": {"cov": np.ones(3), "nov": np.zeros(3)}})
        >>> mixer.sliders["nov"].value = 0.5
        >>> mixer.reward
        '1*cov+0.5*nov'
    """

    def __init__(self, walks: Mapping[str, Mapping[str, np.ndarray]], weights: Mapping[str, float] | None = None):
        super().__init__()
        self._walks = walks
        names = list(next(iter(walks.values())))
        chosen = {names[0]: 1.0} if weights is None else weights
        self.sliders = {name: self.slider(name, 0.0, 2.0, chosen.get(name, 0.0), while_dragged=True) for name in names}
        self.refresh()

    @property
    def reward(self) -> str:
        """The sum by its name, for any environment: ``reward="1*cov+0.5*nov"``; empty when all weights are 0."""
        return "+".join(f"{slider.value:g}*{name}" for name, slider in self.sliders.items() if slider.value)

    def controls(self) -> list[Any]:
        """A slider for each weight."""
        return list(self.sliders.values())

    def figure(self) -> Figure:
        """The weighted sum along each walk, and what each term has brought in the end."""
        figure = Figure(figsize=(11, 3.4), layout="constrained")
        curve, bars = figure.subplots(1, 2, width_ratios=(1.3, 1))
        for number, (walk, values) in enumerate(self._walks.items()):
            terms = {name: slider.value * np.cumsum(values[name]) for name, slider in self.sliders.items()}
            style = ("-", "--", ":", "-.")[number % 4]
            curve.plot(np.sum(list(terms.values()), axis=0), style, color="black", label=plain(walk))
            left = 0.0
            for k, (name, curves) in enumerate(terms.items()):
                label = plain(name) if number == 0 else None
                bars.barh(number, curves[-1], left=left, color=_COLORS[k % 7], edgecolor="white", label=label)
                left += curves[-1]
        curve.set(xlabel="step")
        curve.set_title(plain(self.reward or "all weights are 0"), fontsize=10)
        curve.legend(frameon=False, fontsize=9)
        curve.grid(alpha=0.3)
        bars.set(yticks=range(len(self._walks)), yticklabels=[plain(walk) for walk in self._walks])
        bars.invert_yaxis()
        bars.set_title("what each term has brought", fontsize=10)
        bars.legend(frameon=False, fontsize=8, ncols=4, loc="upper center", bbox_to_anchor=(0.5, -0.1))
        return figure
