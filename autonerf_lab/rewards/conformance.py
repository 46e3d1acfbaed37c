"""What every reward must do: for the tests here and for those of whoever writes one."""

import math

import numpy as np

from autonerf_lab.geometry import planar_pose
from autonerf_lab.rewards.base import Reward
from autonerf_lab.types import Action, MapState, Observation, Transition

_SIZE = 16
_CLASSES = 15
_BINS = 12


def blank_transition(cell: float = 0.05) -> Transition:
    """A step in which nothing was seen, on a map of 16 x 16 cells. Its arrays are fresh: write to them.

    Example:
        >>> bool(blank_transition().after.explored.any())
        False
    """

    def blank() -> MapState:
        flat = [np.zeros((_SIZE, _SIZE), np.bool_) for _ in range(3)]
        deep = [np.zeros((channels, _SIZE, _SIZE), np.bool_) for channels in (_CLASSES, _BINS)]
        return MapState(flat[0], flat[1], flat[2], deep[0], deep[1], planar_pose(0, 0, 0), np.zeros(2), cell)

    image = np.zeros((4, 4), np.uint8)
    seen = Observation(np.zeros((4, 4, 3), np.uint8), np.ones((4, 4), np.float32), image, planar_pose(0, 0, 0), step=1)
    return Transition(blank(), blank(), seen, Action.FORWARD)


def check_reward(reward: Reward, seed: int = 0) -> None:
    """Assert what a trainer relies on: a finite float, repeatable, and a transition left as it was.

    Raises:
        AssertionError: says which promise was broken.

    Example:
        >>> check_reward(lambda transition: 1.0)
        >>> check_reward(lambda transition: float("nan"))
        Traceback (most recent call last):
        AssertionError: a reward must be finite, not nan
    """
    rng = np.random.default_rng(seed)
    step = blank_transition()
    for name in ("occupied", "explored", "visited", "semantics", "viewpoints"):
        before, after = getattr(step.before, name), getattr(step.after, name)
        before[:] = rng.random(before.shape) < 0.2
        after[:] = before | (rng.random(before.shape) < 0.2)
    copies = [array.copy() for array in _arrays(step)]
    values = []
    for _ in range(2):
        reset = getattr(reward, "reset", None)
        if reset is not None:
            reset(np.random.default_rng(seed))
        values.append(reward(step))
    assert isinstance(values[0], float), f"a reward must be a float, not {type(values[0]).__name__}"
    assert math.isfinite(values[0]), f"a reward must be finite, not {values[0]}"
    assert values[0] == values[1], "after reset with the same seed, the same transition must have the same reward"
    for array, copy in zip(_arrays(step), copies, strict=True):
        assert np.array_equal(array, copy), "a reward must not change the transition"


def _arrays(step: Transition) -> list[np.ndarray]:
    maps = (step.before, step.after)
    names = ("occupied", "explored", "visited", "semantics", "viewpoints")
    return [getattr(state, name) for state in maps for name in names] + [step.observation.depth]
