"""Exercises of notebook 04: write two rewards and repair one.

Students read the solutions.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from autonerf_lab.course.checker import Case, Exercise, Mistake
from autonerf_lab.geometry import planar_pose
from autonerf_lab.rewards import sem
from autonerf_lab.rewards.base import evaluate, instantiate, name_of
from autonerf_lab.rewards.conformance import blank_transition
from autonerf_lab.types import Transition


def obs(transition: Transition) -> float:
    """Area of newly mapped obstacles, square metres."""
    before, after = transition.before, transition.after
    added = np.count_nonzero(after.occupied) - np.count_nonzero(before.occupied)
    return float(added * after.cell**2)


def new_classes(transition: Transition) -> float:
    """Classes on the map for the first time, classes."""
    known_before = transition.before.semantics.any(axis=(1, 2))  # (15,) one flag per class
    known_after = transition.after.semantics.any(axis=(1, 2))
    return float(np.count_nonzero(known_after & ~known_before))


class NewSquares:
    """Number of 1 m squares entered for the first time, squares."""

    def reset(self, rng: np.random.Generator) -> None:
        """Forget the squares of the last episode."""
        self.entered: set[tuple[int, int]] = set()

    def __call__(self, transition: Transition) -> float:
        """Return 1.0 if the square of the robot is new, else 0.0."""
        x, y = np.floor(transition.observation.pose[:2, 3])
        new = (int(x), int(y)) not in self.entered
        self.entered.add((int(x), int(y)))
        return float(new)


def _evaluate(reward: Any, args: tuple[Any, ...]) -> Any:
    """Return the reward of one step after checking that it is a finite number."""
    value = reward(*args)
    return value if value is None or value is ... else evaluate(lambda _: value, args[0], name_of(reward))


def _two_environments(reward: Any, args: tuple[list[list[Transition]]]) -> Any:
    """Run the same episodes in two environments with their own rewards; return both rewards of each step."""
    pair, values = [instantiate(reward), instantiate(reward)], []
    if None in pair or ... in pair:
        return None
    for number, episode in enumerate(args[0]):
        for instance in pair:
            if hasattr(instance, "reset"):
                instance.reset(np.random.default_rng(number))
        values += [[_evaluate(instance, (step,)) for instance in pair] for step in episode]
    flat = [value for both in values for value in both]
    return None if all(value is None or value is ... for value in flat) else values


def _occupied(before: int, after: int) -> Transition:
    """Return a step with given numbers of occupied cells of 0.5 m before and after, and more explored cells."""
    step = blank_transition(cell=0.5)
    for known, count in ((step.before, before), (step.after, after)):
        known.occupied[0, :count] = True
        known.explored[0:2, :count] = True
        known.explored[4, 4 : 4 + count] = True
    return step


def _classes(before: dict[int, int], after: dict[int, int]) -> Transition:
    """Return a step with given numbers of cells of 0.5 m per class before and after."""
    step = blank_transition(cell=0.5)
    for known, cells in ((step.before, before), (step.after, after)):
        for label, count in cells.items():
            known.semantics[label - 1, 0, :count] = True
    return step


def _steps_at(*positions: tuple[float, float]) -> list[Transition]:
    step = blank_transition()
    return [replace(step, observation=replace(step.observation, pose=planar_pose(x, y, 0.0))) for x, y in positions]


_ONE = _steps_at((0.5, 0.5))
_THREE_SQUARES = _steps_at((0.5, 0.5), (0.7, 0.5), (1.2, 0.5), (0.8, 1.1))

OBS = Exercise(
    "04-obs",
    "Return the area of the obstacles that a step adds to the map, square metres.",
    (
        Case("a step without new cells", (_occupied(1, 1),), 0.0),
        Case("two new cells of 0.5 m next to a known one", (_occupied(1, 3),), 0.5),
    ),
    obs,
    (
        Mistake(
            "NumPy cannot subtract booleans: count each map with np.count_nonzero, then subtract the counts.",
            lambda t: float((t.after.occupied - t.before.occupied).sum() * t.after.cell**2),
        ),
        Mistake(
            "This is a number of cells. Multiply it by the cell area, transition.after.cell ** 2.",
            lambda t: float(t.after.occupied.sum()) - float(t.before.occupied.sum()),
        ),
        Mistake(
            "Multiply by the square of the cell size to get an area.",
            lambda t: obs(t) / t.after.cell,
        ),
        Mistake(
            "This is the whole known area. The reward counts only what the step added.",
            lambda t: float(t.after.occupied.sum() * t.after.cell**2),
        ),
        Mistake(
            "This is `cov`, which counts explored cells. Count occupied cells.",
            lambda t: float((t.after.explored.sum() - float(t.before.explored.sum())) * t.after.cell**2),
        ),
        Mistake("The sign is wrong: after minus before.", lambda t: -obs(t)),
    ),
    _evaluate,
)

NEW_CLASSES = Exercise(
    "04-new-classes",
    "Return the number of classes, of 15, that are on the map for the first time.",
    (
        Case("nothing new", (_classes({1: 3}, {1: 3}),), 0.0),
        Case("the first chair, in two cells", (_classes({}, {1: 2}),), 1.0),
        Case("more cells of a known chair", (_classes({1: 1}, {1: 4}),), 0.0),
        Case("a known chair, the first cup and the first bottle", (_classes({1: 1}, {1: 1, 14: 1, 15: 2}),), 2.0),
    ),
    new_classes,
    (
        Mistake(
            "This counts new cells. A class counts once, whatever its area: reduce each channel with any(axis=(1, 2)).",
            lambda t: float(t.after.semantics.sum()) - float(t.before.semantics.sum()),
        ),
        Mistake(
            "This counts all classes on the map. Count only classes that were not on it before.",
            lambda t: float(t.after.semantics.any(axis=(1, 2)).sum()),
        ),
        Mistake(
            "Two new classes in one step count as two.",
            lambda t: float(new_classes(t) > 0),
        ),
        Mistake("This is `sem`, the new area of all classes. Count classes instead.", sem),
    ),
    _evaluate,
)


class _WithoutReset(NewSquares):
    def __init__(self) -> None:
        self.entered = set()

    def reset(self, rng: np.random.Generator) -> None:
        pass


class _Truncating(NewSquares):
    def __call__(self, transition: Transition) -> float:
        x, y = (int(v) for v in transition.observation.pose[:2, 3])
        new = (x, y) not in self.entered
        self.entered.add((x, y))
        return float(new)


class _NeverAdding(NewSquares):
    def __call__(self, transition: Transition) -> float:
        self.entered.clear()
        return super().__call__(transition)


class _Rounding(NewSquares):
    def __call__(self, transition: Transition) -> float:
        x, y = (int(v) for v in np.round(transition.observation.pose[:2, 3]))
        new = (x, y) not in self.entered
        self.entered.add((x, y))
        return float(new)


class _Shared(NewSquares):
    common: set[tuple[int, int]] = set()  # noqa: RUF012 - the mistake

    def reset(self, rng: np.random.Generator) -> None:
        self.entered = self.common
        self.entered.clear()


NEW_SQUARES = Exercise(
    "04-new-squares",
    "Write a reward class: 1.0 if a square of 1 m is entered for the first time in the episode, else 0.0.",
    (
        Case(
            "two environments, the same trajectory over three squares",
            ([_THREE_SQUARES],),
            [[1, 1], [0, 0], [1, 1], [1, 1]],
        ),
        Case(
            "two environments, a trajectory from x = -0.5 to x = 0.5",
            ([_steps_at((-0.5, 0.5), (0.5, 0.5))],),
            [[1, 1], [1, 1]],
        ),
        Case("two environments, the same step in two episodes", ([_ONE, _ONE],), [[1, 1], [1, 1]]),
    ),
    NewSquares,
    (
        Mistake("Every step gets a reward: add the square to the set.", _NeverAdding),
        Mistake(
            "int() rounds towards zero, so the squares on both sides of zero become one. Use np.floor.", _Truncating
        ),
        Mistake("round() puts the border between two squares into the middle of a square. Use np.floor.", _Rounding),
        Mistake("The second episode gets no reward: clear the memory in reset(rng).", _WithoutReset),
        Mistake(
            "Two environments share one memory: create the set in reset, not in the class, and pass the class, "
            "not an object.",
            _Shared,
        ),
    ),
    _two_environments,
)

EXERCISES = (OBS, NEW_CLASSES, NEW_SQUARES)
