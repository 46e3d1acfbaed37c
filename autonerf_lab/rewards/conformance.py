"""Conformance checks of rewards: for their tests, and before a plug-in is listed."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from autonerf_lab.geometry import planar_pose
from autonerf_lab.rewards.base import LearnedReward, PrivilegedReward, Reward, instantiate, to_float
from autonerf_lab.types import Action, MapState, Observation, Transition
from autonerf_lab.utils.plugins import require

_SIZE = 16
_CLASSES = 15
_BINS = 12
_MAPS = ("occupied", "explored", "visited", "semantics", "viewpoints")
_IMAGES = ("rgb", "depth", "semantics", "pose")


def blank_transition(cell: float = 0.05) -> Transition:
    """Make a transition in which nothing is observed, with a map of 16 x 16 cells; its arrays may be written to.

    Example:
        >>> bool(blank_transition().after.explored.any())
        False
    """

    def blank() -> MapState:
        flat = [np.zeros((_SIZE, _SIZE), np.bool_) for _ in range(3)]
        deep = [np.zeros((channels, _SIZE, _SIZE), np.bool_) for channels in (_CLASSES, _BINS)]
        return MapState(flat[0], flat[1], flat[2], deep[0], deep[1], planar_pose(0, 0, 0), np.zeros(2), cell)

    image = np.zeros((4, 4), np.uint8)
    observation = Observation(
        np.zeros((4, 4, 3), np.uint8), np.ones((4, 4), np.float32), image, planar_pose(0, 0, 0), step=1
    )
    return Transition(blank(), blank(), observation, Action.FORWARD)


def random_transitions(rng: np.random.Generator, steps: int = 10) -> list[Transition]:
    """Make random transitions: growing maps, images of 16 x 16 pixels, poses within two metres, all three actions.

    Example:
        >>> len(random_transitions(np.random.default_rng(0)))
        10
    """
    transitions: list[Transition] = []
    for k in range(steps):
        step = blank_transition()
        for name in _MAPS:
            before, after = getattr(step.before, name), getattr(step.after, name)
            before[:] = getattr(transitions[-1].after, name) if transitions else False
            after[:] = before | (rng.random(before.shape) < 0.1)
        pose = planar_pose(rng.uniform(0, 2), rng.uniform(0, 2), rng.uniform(-np.pi, np.pi))
        image = rng.integers(0, 256, (_SIZE, _SIZE, 3), np.uint8)
        depth = rng.uniform(0.5, 5, image.shape[:2]).astype(np.float32)
        observation = Observation(image, depth, image[..., 0] % (_CLASSES + 1), pose, k % 4 == 3, k + 1)
        transitions.append(Transition(step.before, step.after, observation, Action(k % len(Action))))
    return transitions


def run_episode(reward: Reward, transitions: list[Transition], seed: int = 0) -> list[float]:
    """Reset a reward as an environment does, and return its value for each transition."""
    rng = np.random.default_rng(seed)
    reset = getattr(reward, "reset", None)
    if reset is not None:
        reset(rng)
    if isinstance(reward, PrivilegedReward):
        reward.set_references([step.observation for step in random_transitions(rng, reward.references)])
    return [reward(step) for step in transitions]


def check_reward(reward: Callable[..., Any], seed: int = 0) -> None:
    """Check a reward: finite numbers, the same values after ``reset``, transitions unchanged.

    Args:
        reward: a reward, or a class or function without arguments that makes one.
        seed: random seed of the transitions.

    Raises:
        AssertionError: names the requirement that is not met.

    Example:
        >>> check_reward(lambda transition: 1.0)
        >>> check_reward(lambda transition: float("nan"))
        Traceback (most recent call last):
        AssertionError: a reward must be finite, not nan
    """
    require(callable(reward), f"a reward must be callable, a {type(reward).__name__} is not")
    made = instantiate(reward)
    require(callable(made), f"a function that makes a reward must not return a {type(made).__name__}")
    require(not isinstance(made, type), "a function that makes a reward must not return a class")
    transitions = random_transitions(np.random.default_rng(seed))
    copies = [array.copy() for array in _arrays(transitions)]
    values = run_episode(made, transitions, seed)
    for value in values:
        number = to_float(value)
        require(number is not None, f"a reward must be a number, not {value!r}")
        require(math.isfinite(number or 0.0), f"a reward must be finite, not {number}")
    again = run_episode(made, transitions, seed)
    same = [to_float(value) for value in values] == [to_float(value) for value in again]
    require(same, "after reset with the same seed, the same steps must have the same reward")
    same = all(np.array_equal(a, b) for a, b in zip(_arrays(transitions), copies, strict=True))
    require(same, "a reward must not change the transition")


def check_learned(make: Callable[[], Any], seed: int = 0) -> None:
    """Check a learned reward: samples are collected once, and the state contains everything learned.

    Args:
        make: makes a :class:`~autonerf_lab.rewards.base.LearnedReward`.
        seed: random seed of the transitions.

    Raises:
        AssertionError: names the requirement that is not met.
    """
    source, copy = make(), make()
    require(isinstance(source, LearnedReward), "a learned reward needs collect, update, state_dict, load_state_dict")
    rng = np.random.default_rng(seed)
    transitions = random_transitions(rng, 40)
    for k in range(4):
        run_episode(source, random_transitions(rng, 40), seed + k)
    source.update(source.collect())
    require(not any(len(v) for v in source.collect().values()), "collect must clear the samples")
    copy.load_state_dict(source.state_dict())
    values = run_episode(source, transitions)
    require(any(values), "after an update, an episode must contain a reward other than 0")
    require(values == run_episode(copy, transitions), "rewards with equal states must return the same values")
    collected = source.collect()
    require(same_arrays(collected, copy.collect()), "the samples must not depend on earlier updates")
    require(all(len(v) for v in collected.values()), "an episode of 40 steps must yield samples")
    copies = {name: array.copy() for name, array in collected.items()}
    losses = [reward.update(collected) for reward in (source, copy)]
    require(bool(losses[0]), "update must return its losses")
    for name, loss in losses[0].items():
        finite = isinstance(loss, float) and math.isfinite(loss)
        require(finite, f"the loss {name!r} must be a finite float, not {loss}")
    require(losses[0] == losses[1], "rewards with equal states must learn the same")
    require(same_arrays(collected, copies), "update must not change its batch")
    require(same_arrays(source.state_dict(), copy.state_dict()), "the state must contain everything learned")
    state = source.state_dict()
    copies = {name: array.copy() for name, array in state.items()}
    source.update(collected)
    require(same_arrays(state, copies), "state_dict must return copies")
    require(not same_arrays(state, source.state_dict()), "update must change the state")


def same_arrays(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> bool:
    """Return True if both contain identical arrays under the same names.

    Example:
        >>> same_arrays({"a": np.zeros(2)}, {"a": np.zeros(2, np.float32)})
        False
    """
    return a.keys() == b.keys() and all(
        a[k].dtype == b[k].dtype and a[k].shape == b[k].shape and a[k].tobytes() == b[k].tobytes() for k in a
    )


def _arrays(transitions: list[Transition]) -> list[np.ndarray]:
    maps = [getattr(state, name) for step in transitions for state in (step.before, step.after) for name in _MAPS]
    return maps + [getattr(step.observation, name) for step in transitions for name in _IMAGES]
