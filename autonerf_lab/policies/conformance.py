"""Conformance check of policies: for their tests, and before a plug-in is listed."""

from collections.abc import Callable
from dataclasses import dataclass
from numbers import Integral
from typing import Any

import numpy as np

from autonerf_lab.geometry import AGENT_RADIUS, FORWARD_STEP, TURN_ANGLE, Intrinsics, planar_pose
from autonerf_lab.mapping import empty_map, update
from autonerf_lab.policies.base import Policy, PrivilegedPolicy
from autonerf_lab.types import Action, MapState, Observation
from autonerf_lab.utils.plugins import require

_ROOM = np.array([5.0, 4.0, 2.5])  # metres, from the origin
_CAMERA = Intrinsics.from_fov(32, 32)
_MAP_SIZE = 480  # cells
_ARRAYS = ("occupied", "explored", "visited", "semantics", "viewpoints", "pose", "origin")
_IMAGES = ("rgb", "depth", "semantics", "pose")


@dataclass
class EmptyRoom:
    """Rectangular room without objects, in which a robot without noise starts at (2, 1.5)."""

    x: float = 2.0  # metres
    y: float = 1.5
    heading: float = 0.3  # radians
    step: int = 0
    collided: bool = False

    def observe(self) -> Observation:
        """Render the four walls, the floor and the ceiling: grey values by depth, no classes."""
        pose = planar_pose(self.x, self.y, self.heading)
        across = (np.arange(_CAMERA.width) + 0.5 - _CAMERA.cx) / _CAMERA.fl_x
        up = -(np.arange(_CAMERA.height) + 0.5 - _CAMERA.cy) / _CAMERA.fl_y
        directions = -pose[:3, 2] + across[None, :, None] * pose[:3, 0] + up[:, None, None] * pose[:3, 1]
        with np.errstate(divide="ignore"):
            walls = np.where(directions > 0, _ROOM - pose[:3, 3], -pose[:3, 3]) / directions
        depth = np.where(np.isfinite(walls), walls, np.inf).min(axis=2).astype(np.float32)
        grey = (255 / (1 + depth)).astype(np.uint8)
        rgb = np.repeat(grey[..., None], 3, axis=2)
        return Observation(rgb, depth, np.zeros_like(grey), pose, self.collided, self.step)

    def move(self, action: int) -> None:
        """Apply one action; a wall stops the robot."""
        self.step += 1
        self.collided = False
        if action == Action.FORWARD:
            target = np.array(
                [self.x + FORWARD_STEP * np.cos(self.heading), self.y + FORWARD_STEP * np.sin(self.heading)]
            )
            inside = np.clip(target, AGENT_RADIUS, _ROOM[:2] - AGENT_RADIUS)
            self.collided = bool((inside != target).any())
            self.x, self.y = (float(v) for v in inside)
        else:
            self.heading += TURN_ANGLE if action == Action.TURN_LEFT else -TURN_ANGLE


def check_members(policy: Any) -> None:
    """Check that an object has the members of a policy.

    Raises:
        AssertionError: names the missing member.
    """
    require(not isinstance(policy, type), "it is a class; pass an instance")
    for name in ("reset", "act"):
        require(callable(getattr(policy, name, None)), f"a policy needs a method {name!r}")
    require(hasattr(policy, "waypoint"), "a policy needs an attribute 'waypoint', None for a policy without waypoints")


def check_policy(make: Callable[[], Policy], steps: int = 16, seed: int = 0) -> None:
    """Check a policy in an empty room: valid actions, the same actions for the same seed, inputs unchanged.

    Args:
        make: class or function that makes the policy; called without arguments.
        steps: length of each of the two rollouts.
        seed: random seed of both rollouts.

    Raises:
        AssertionError: names the requirement that is not met.

    Example:
        >>> from autonerf_lab.policies import Frontier
        >>> check_policy(Frontier)
    """
    require(callable(make), f"a policy is registered as a class or function, not a {type(make).__name__}")
    policy = make()
    check_members(policy)
    first, second = (_rollout(policy, steps, seed) for _ in range(2))
    require(first == second, "after reset with the same seed, a policy must choose the same actions")


def _rollout(policy: Policy, steps: int, seed: int) -> list[int]:
    room = EmptyRoom()
    policy.reset(np.random.default_rng(seed))
    state = empty_map(room.observe().pose, _MAP_SIZE)
    if isinstance(policy, PrivilegedPolicy):
        complete = state
        for turn in range(8):
            complete = update(complete, EmptyRoom(heading=turn * np.pi / 4).observe(), _CAMERA)
        policy.set_visible_map(complete)
    actions: list[int] = []
    for _ in range(steps):
        observation = room.observe()
        state = update(state, observation, _CAMERA)
        copies = [array.copy() for array in _arrays(state, observation)]
        action = policy.act(state, observation)
        valid = isinstance(action, Integral) and not isinstance(action, bool) and int(action) in list(Action)
        require(valid, f"act must return an Action (0, 1 or 2), not {action!r}")
        unchanged = all(map(np.array_equal, _arrays(state, observation), copies))
        require(unchanged, "act must not write to the map or the observation")
        if policy.waypoint is not None:
            waypoint = np.asarray(policy.waypoint)
            require(
                waypoint.shape == (2,) and bool(np.isfinite(waypoint).all()), "a waypoint must be two finite numbers"
            )
        actions.append(int(action))
        room.move(actions[-1])
    return actions


def _arrays(state: MapState, observation: Observation) -> list[np.ndarray]:
    return [getattr(state, name) for name in _ARRAYS] + [getattr(observation, name) for name in _IMAGES]
