"""Exercises of notebook 04: write a reward, and repair one."""

from dataclasses import replace
from typing import Any

import numpy as np

from autonerf_lab.course.checker import Case, Exercise, Mistake
from autonerf_lab.geometry import planar_pose
from autonerf_lab.rewards import sem
from autonerf_lab.rewards.base import evaluate, fresh, name_of
from autonerf_lab.rewards.conformance import blank_transition
from autonerf_lab.types import Transition


def obs(transition: Transition) -> float:
    before, after = transition.before, transition.after
    new_cells = np.count_nonzero(after.occupied) - np.count_nonzero(before.occupied)
    return float(new_cells * after.cell**2)


def new_classes(transition: Transition) -> float:
    known_before = transition.before.semantics.any(axis=(1, 2))  # (15,) one flag a class
    known_after = transition.after.semantics.any(axis=(1, 2))
    return float(np.count_nonzero(known_after & ~known_before))


class Diary:
    """Squares of one metre that are entered for the first time, squares."""

    def reset(self, rng: np.random.Generator) -> None:
        self.entered: set[tuple[int, int]] = set()

    def __call__(self, transition: Transition) -> float:
        x, y = np.floor(transition.observation.pose[:2, 3])
        new = (int(x), int(y)) not in self.entered
        self.entered.add((int(x), int(y)))
        return float(new)


def _ask(reward: Any, args: tuple[Any, ...]) -> Any:
    """A reward at one step, which must be a finite float."""
    value = reward(*args)
    return value if value is None or value is ... else evaluate(lambda _: value, args[0], name_of(reward))


def _two_environments(reward: Any, args: tuple[list[list[Transition]]]) -> Any:
    """Two environments, each with its reward, walk the same episodes in step; what the two are paid at each step."""
    pair, values = [fresh(reward), fresh(reward)], []
    if None in pair or ... in pair:
        return None
    for number, episode in enumerate(args[0]):
        for made in pair:
            if hasattr(made, "reset"):
                made.reset(np.random.default_rng(number))
        values += [[_ask(made, (step,)) for made in pair] for step in episode]
    flat = [value for both in values for value in both]
    return None if all(value is None or value is ... for value in flat) else values


def _occupied(before: int, after: int) -> Transition:
    """Cells of half a metre: so many obstacles before and after, and twice as much explored ground."""
    step = blank_transition(cell=0.5)
    for known, count in ((step.before, before), (step.after, after)):
        known.occupied[0, :count] = True
        known.explored[0:2, :count] = True
        known.explored[4, 4 : 4 + count] = True
    return step


def _classes(before: dict[int, int], after: dict[int, int]) -> Transition:
    """Cells of half a metre: how many hold each class."""
    step = blank_transition(cell=0.5)
    for known, cells in ((step.before, before), (step.after, after)):
        for label, count in cells.items():
            known.semantics[label - 1, 0, :count] = True
    return step


def _way(*places: tuple[float, float]) -> list[Transition]:
    step = blank_transition()
    return [replace(step, observation=replace(step.observation, pose=planar_pose(x, y, 0.0))) for x, y in places]


_ONE = _way((0.5, 0.5))
_OVER_THREE = _way((0.5, 0.5), (0.7, 0.5), (1.2, 0.5), (0.8, 1.1))

OBS = Exercise(
    "04-obs",
    "The area of the obstacles that a step adds to the map, square metres.",
    (
        Case("a step in which nothing was seen", (_occupied(1, 1),), 0.0),
        Case("two new cells of 0.5 m beside one that was known", (_occupied(1, 3),), 0.5),
    ),
    obs,
    (
        Mistake(
            "NumPy does not subtract booleans: count each map with np.count_nonzero, and subtract the counts.",
            lambda t: float((t.after.occupied - t.before.occupied).sum() * t.after.cell**2),
        ),
        Mistake(
            "These are cells. A cell is transition.after.cell wide, and the unit is square metres.",
            lambda t: float(t.after.occupied.sum()) - float(t.before.occupied.sum()),
        ),
        Mistake(
            "An area is the square of a length: cells times cell width squared.",
            lambda t: obs(t) / t.after.cell,
        ),
        Mistake(
            "This is everything that is known. A reward pays for what the step has added.",
            lambda t: float(t.after.occupied.sum() * t.after.cell**2),
        ),
        Mistake(
            "This is `cov`: it counts explored ground, not obstacles.",
            lambda t: float((t.after.explored.sum() - float(t.before.explored.sum())) * t.after.cell**2),
        ),
        Mistake("The sign: after less before.", lambda t: -obs(t)),
    ),
    _ask,
)

NEW_CLASSES = Exercise(
    "04-new-classes",
    "How many of the 15 classes are on the map for the first time.",
    (
        Case("nothing new", (_classes({1: 3}, {1: 3}),), 0.0),
        Case("the first chair, in two cells", (_classes({}, {1: 2}),), 1.0),
        Case("more of a chair that was known", (_classes({1: 1}, {1: 4}),), 0.0),
        Case("a known chair, the first cup and the first bottle", (_classes({1: 1}, {1: 1, 14: 1, 15: 2}),), 2.0),
    ),
    new_classes,
    (
        Mistake(
            "These are new cells. A class counts once, however large it is: reduce each channel with any(axis=(1, 2)).",
            lambda t: float(t.after.semantics.sum()) - float(t.before.semantics.sum()),
        ),
        Mistake(
            "These are all classes on the map; only those that were not there before are new.",
            lambda t: float(t.after.semantics.any(axis=(1, 2)).sum()),
        ),
        Mistake(
            "A reward is a float, and this is an integer or a boolean: wrap it in float(...).",
            lambda t: int(new_classes(t)),
        ),
        Mistake(
            "Two at once are worth two: count the new classes.",
            lambda t: float(new_classes(t) > 0),
        ),
        Mistake("This is `sem`, the new area of all classes.", sem),
    ),
    _ask,
)


class _Forever(Diary):
    """No reset."""

    def __init__(self) -> None:
        self.entered = set()

    def reset(self, rng: np.random.Generator) -> None:
        pass


class _Truncating(Diary):
    def __call__(self, transition: Transition) -> float:
        x, y = (int(v) for v in transition.observation.pose[:2, 3])
        new = (x, y) not in self.entered
        self.entered.add((x, y))
        return float(new)


class _Boolean(Diary):
    def __call__(self, transition: Transition) -> float:
        return bool(super().__call__(transition))


class _Shared(Diary):
    common: set[tuple[int, int]] = set()  # noqa: RUF012 - the mistake

    def reset(self, rng: np.random.Generator) -> None:
        self.entered = self.common
        self.entered.clear()


DIARY = Exercise(
    "04-diary",
    "A reward class: 1.0 for each square metre that is entered for the first time in an episode, else 0.0.",
    (
        Case("two environments, the same walk over three squares", ([_OVER_THREE],), [[1, 1], [0, 0], [1, 1], [1, 1]]),
        Case("two environments, a walk from x = -0.5 to x = 0.5", ([_way((-0.5, 0.5), (0.5, 0.5))],), [[1, 1], [1, 1]]),
        Case("two environments, the same step in two episodes", ([_ONE, _ONE],), [[1, 1], [1, 1]]),
    ),
    Diary,
    (
        Mistake("A reward is a float, and a boolean is none: wrap what is returned in float(...).", _Boolean),
        Mistake(
            "The squares on both sides of zero have become one: int() cuts towards zero. Use np.floor.", _Truncating
        ),
        Mistake(
            "The second episode is paid for nothing: a reward that remembers has a reset(rng), which forgets.", _Forever
        ),
        Mistake(
            "Two environments share one memory: make the set in reset (not in the class), and hand over the class, "
            "not an object.",
            _Shared,
        ),
    ),
    _two_environments,
)

EXERCISES = (OBS, NEW_CLASSES, DIARY)
