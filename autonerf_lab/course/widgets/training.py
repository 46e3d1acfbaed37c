"""Watch a policy learn."""

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from autonerf_lab.course.widgets.live import Background, plain
from autonerf_lab.viz.figures.style import BLUE, ORANGE, SKY
from autonerf_lab.viz.figures.training import running_mean

Row = dict[str, float]
_SMOOTH = 5  # episodes of the running mean


class Learning(Background):
    """The curve of a training while it trains.

    Args:
        train: trains, or goes on; it calls what it is given with a row of its curve after every episode, as
            ``train_policy(..., callback=)`` does, and what that raises ends it.
        label: of the reward.

    Example:
        >>> def train(callback):
        ...     for k in range(4):
        ...         callback({"frames": 100.0 * k, "reward": 2.0 * k, "explored_m2": 50.0})
        >>> learning = Learning(train)
        >>> learning.run(episodes=3)
        >>> [row["reward"] for row in learning.curve]
        [0.0, 2.0, 4.0]
    """

    def __init__(self, train: Callable[[Callable[[Row], None]], Any], label: str = "reward an episode") -> None:
        super().__init__()
        self._train, self._label = train, label
        self.curve: list[Row] = []
        self.starts: list[float] = []  # frames at which a training began or went on
        self._left = np.inf
        self.refresh()

    def run(self, episodes: float = np.inf) -> None:
        """Train until the end, or be stopped after so many episodes, as by an interrupt of the kernel."""
        self.stopped.clear()
        self._go_on(episodes)

    def work(self) -> None:
        """Train until "stop"."""
        self._go_on(np.inf)

    def figure(self) -> Figure:
        """Reward and explored area of the episodes over the robots' actions."""
        figure = Figure(figsize=(11, 3.2), layout="constrained")
        frames = np.array([row["frames"] for row in self.curve])
        panels = (("reward", self._label, BLUE), ("explored_m2", "explored area (m²)", ORANGE))
        for ax, (key, label, color) in zip(figure.subplots(1, 2), panels, strict=True):
            values = np.array([row[key] for row in self.curve])
            ax.plot(frames, values, ".", color=SKY if color == BLUE else color, alpha=0.6)
            if len(values) >= _SMOOTH:
                mean = running_mean(values, _SMOOTH)
                ax.plot(frames[_SMOOTH - 1 :], mean, color=color, label=f"mean of {_SMOOTH} episodes")
                ax.legend(frameon=False, fontsize=8, loc="lower right")
            for start in self.starts[1:]:
                ax.axvline(start, color="0.6", linestyle=":")
            ax.set(xlabel="frames (actions of the robots)", ylabel=plain(label))
            ax.grid(alpha=0.3)
        self.say_error(figure)
        return figure

    def _go_on(self, episodes: float) -> None:
        self._left, before = episodes, len(self.starts)
        with suppress(KeyboardInterrupt):  # what its checkpoint holds is kept
            self._train(lambda row: self._tell(row, before))
        self.refresh()

    def _tell(self, row: Row, before: int) -> None:
        if len(self.starts) == before:
            self.starts.append(row["frames"])
        self.curve = [known for known in self.curve if known["frames"] < row["frames"]]  # what was lost is done again
        self.curve.append(row)
        self.refresh()
        self._left -= 1
        if self._left <= 0 or self.stopped.is_set():
            raise KeyboardInterrupt
