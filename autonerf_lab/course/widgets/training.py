"""Live training curve of a policy."""

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from autonerf_lab.course.widgets.live import BackgroundTask, escape_dollars
from autonerf_lab.viz.figures.style import BLUE, ORANGE, SKY
from autonerf_lab.viz.figures.training import running_mean

Row = dict[str, float]
_SMOOTH = 5  # episodes in the running mean


class PolicyTraining(BackgroundTask):
    """Training curve that is updated while a policy is trained.

    Args:
        train: starts or resumes a training. It is called with a callback, which it calls with one row of the curve
            after every episode, as ``train_policy(..., callback=)`` does. An exception of the callback ends it.
        label: axis label of the reward.

    Example:
        >>> def train(callback):
        ...     for k in range(4):
        ...         callback({"frames": 100.0 * k, "reward": 2.0 * k, "explored_m2": 50.0})
        >>> training = PolicyTraining(train)
        >>> training.run(episodes=3)
        >>> [row["reward"] for row in training.curve]
        [0.0, 2.0, 4.0]
    """

    def __init__(self, train: Callable[[Callable[[Row], None]], Any], label: str = "reward per episode") -> None:
        super().__init__()
        self._train, self._label = train, label
        self.curve: list[Row] = []
        self.starts: list[float] = []  # frames at which the training was started or resumed
        self._episodes_left = np.inf
        self.refresh()

    def run(self, episodes: float = np.inf) -> None:
        """Train to the end, or stop after ``episodes`` episodes as if the kernel were interrupted."""
        self.stopped.clear()
        self._train_until(episodes)

    def work(self) -> None:
        """Train until "stop" is pressed."""
        self._train_until(np.inf)

    def figure(self) -> Figure:
        """Draw reward and explored area per episode over the number of frames."""
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
            ax.set(xlabel="frames (simulation steps)", ylabel=escape_dollars(label))
            ax.grid(alpha=0.3)
        self.draw_error(figure)
        return figure

    def _train_until(self, episodes: float) -> None:
        self._episodes_left, before = episodes, len(self.starts)
        with suppress(KeyboardInterrupt):  # the last checkpoint stays valid
            self._train(lambda row: self._record(row, before))
        self.refresh()

    def _record(self, row: Row, before: int) -> None:
        if len(self.starts) == before:
            self.starts.append(row["frames"])
        self.curve = [old for old in self.curve if old["frames"] < row["frames"]]  # drop episodes that are repeated
        self.curve.append(row)
        self.refresh_while_running()
        self._episodes_left -= 1
        if self._episodes_left <= 0 or self.stopped.is_set():
            raise KeyboardInterrupt
