"""What every reward must do: for the tests here, for those of whoever writes one, and before a plug-in is listed."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from autonerf_lab.geometry import planar_pose
from autonerf_lab.rewards.base import LearnedReward, PrivilegedReward, Reward, fresh
from autonerf_lab.types import Action, MapState, Observation, Transition

_SIZE = 16
_CLASSES = 15
_BINS = 12
_MAPS = ("occupied", "explored", "visited", "semantics", "viewpoints")
_IMAGES = ("rgb", "depth", "semantics", "pose")


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


def random_walk(rng: np.random.Generator, steps: int = 10) -> list[Transition]:
    """Steps of noise: maps that grow, images of 16 x 16 pixels, poses within two metres, all three actions.

    Example:
        >>> len(random_walk(np.random.default_rng(0)))
        10
    """
    walk: list[Transition] = []
    for k in range(steps):
        step = blank_transition()
        for name in _MAPS:
            before, after = getattr(step.before, name), getattr(step.after, name)
            before[:] = getattr(walk[-1].after, name) if walk else False
            after[:] = before | (rng.random(before.shape) < 0.1)
        pose = planar_pose(rng.uniform(0, 2), rng.uniform(0, 2), rng.uniform(-np.pi, np.pi))
        image = rng.integers(0, 256, (_SIZE, _SIZE, 3), np.uint8)
        depth = rng.uniform(0.5, 5, image.shape[:2]).astype(np.float32)
        seen = Observation(image, depth, image[..., 0] % (_CLASSES + 1), pose, k % 4 == 3, k + 1)
        walk.append(Transition(step.before, step.after, seen, Action(k % len(Action))))
    return walk


def play(reward: Reward, walk: list[Transition], seed: int = 0) -> list[float]:
    """The rewards of an episode, which begins as an environment begins one."""
    rng = np.random.default_rng(seed)
    forget = getattr(reward, "reset", None)
    if forget is not None:
        forget(rng)
    if isinstance(reward, PrivilegedReward):
        reward.show([step.observation for step in random_walk(rng, reward.references)])
    return [reward(step) for step in walk]


def check_reward(reward: Callable[..., Any], seed: int = 0) -> None:
    """What an environment relies on: finite floats, the same again after ``reset``, and steps left as they were.

    Args:
        reward: a reward, or what makes one when it is called with nothing.
        seed: of the steps.

    Raises:
        AssertionError: says which promise was broken.

    Example:
        >>> check_reward(lambda transition: 1.0)
        >>> check_reward(lambda transition: float("nan"))
        Traceback (most recent call last):
        AssertionError: a reward must be finite, not nan
    """
    _require(callable(reward), f"a reward can be called with a transition; {type(reward).__name__} cannot")
    made = fresh(reward)
    _require(callable(made), f"what makes a reward must not make a {type(made).__name__}")
    _require(not isinstance(made, type), "what makes a reward must not make a class")
    walk = random_walk(np.random.default_rng(seed))
    copies = [array.copy() for array in _arrays(walk)]
    values = play(made, walk, seed)
    for value in values:
        _require(isinstance(value, float), f"a reward must be a float, not {type(value).__name__}")
        _require(math.isfinite(value), f"a reward must be finite, not {value}")
    again = play(made, walk, seed)
    _require(values == again, "after reset with the same seed, the same steps must have the same reward")
    same = all(np.array_equal(a, b) for a, b in zip(_arrays(walk), copies, strict=True))
    _require(same, "a reward must not change the transition")


def check_learned(make: Callable[[], Any], seed: int = 0) -> None:
    """What a trainer relies on: what is collected is handed over once, and the state is all that was learned.

    Args:
        make: makes a reward that is a :class:`~autonerf_lab.rewards.base.LearnedReward`.
        seed: of the steps.

    Raises:
        AssertionError: says which promise was broken.
    """
    teacher, pupil = make(), make()
    _require(isinstance(teacher, LearnedReward), "a learned reward has collect, update, state_dict and load_state_dict")
    rng = np.random.default_rng(seed)
    walk = random_walk(rng, 40)
    for k in range(4):
        play(teacher, random_walk(rng, 40), seed + k)
    teacher.update(teacher.collect())
    _require(not any(len(v) for v in teacher.collect().values()), "what was collected must be forgotten")
    pupil.load_state_dict(teacher.state_dict())
    values = play(teacher, walk)
    _require(any(values), "after learning, something in an episode must be worth a reward")
    _require(values == play(pupil, walk), "with the state of another, a reward must give the same values")
    collected = teacher.collect()
    _require(same_arrays(collected, pupil.collect()), "what is collected must not depend on who has learned before")
    _require(all(len(v) for v in collected.values()), "an episode of 40 steps must leave something to collect")
    copies = {name: array.copy() for name, array in collected.items()}
    losses = [reward.update(collected) for reward in (teacher, pupil)]
    _require(bool(losses[0]), "update must return what it has measured")
    for name, loss in losses[0].items():
        finite = isinstance(loss, float) and math.isfinite(loss)
        _require(finite, f"the loss {name!r} must be a finite float, not {loss}")
    _require(losses[0] == losses[1], "with the state of another, a reward must learn the same")
    _require(same_arrays(collected, copies), "update must not change its batch")
    _require(same_arrays(teacher.state_dict(), pupil.state_dict()), "the state must be all that was learned")
    kept = teacher.state_dict()
    copies = {name: array.copy() for name, array in kept.items()}
    teacher.update(collected)
    _require(same_arrays(kept, copies), "state_dict must return copies")
    _require(not same_arrays(kept, teacher.state_dict()), "update must change the state")


def same_arrays(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> bool:
    """Whether both hold the same bits under the same names.

    Example:
        >>> same_arrays({"a": np.zeros(2)}, {"a": np.zeros(2, np.float32)})
        False
    """
    return a.keys() == b.keys() and all(
        a[k].dtype == b[k].dtype and a[k].shape == b[k].shape and a[k].tobytes() == b[k].tobytes() for k in a
    )


def _require(kept: bool, promise: str) -> None:
    if not kept:  # an assertion that stays under ``python -O``: plug-ins are judged by it
        raise AssertionError(promise)


def _arrays(walk: list[Transition]) -> list[np.ndarray]:
    maps = [getattr(state, name) for step in walk for state in (step.before, step.after) for name in _MAPS]
    return maps + [getattr(step.observation, name) for step in walk for name in _IMAGES]
