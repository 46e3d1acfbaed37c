"""Records exchanged between the packages.

M is the side of the map in cells, H and W the image size in pixels. Arrays are read-only by convention: a change
makes a new record. Rewards and policies get read-only views, see :func:`read_only`.
"""

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any, TypeVar

import numpy as np


class Action(IntEnum):
    """Discrete actions of the paper's agent."""

    FORWARD = 0  # 0.25 m along the heading
    TURN_LEFT = 1  # 30 degrees, counter-clockwise seen from above
    TURN_RIGHT = 2


@dataclass(frozen=True)
class Observation:
    """Sensor readings of one step."""

    rgb: np.ndarray  # (H, W, 3) uint8
    depth: np.ndarray  # (H, W) float32, metres along the optical axis, 0 = none
    semantics: np.ndarray  # (H, W) uint8, class index
    pose: np.ndarray  # (4, 4) float64, camera-to-world by odometry; for a policy, of the pose source it acts on
    collided: bool = False  # an obstacle stopped or deflected the last action
    step: int = 0  # actions taken since the start of the episode
    confidence: np.ndarray | None = None  # (H, W) float32 in [0, 1], of predicted semantics; None: they are true


@dataclass(frozen=True)
class MapState:
    """Top-down semantic map of section 3.1. Arrays are indexed [row = y, column = x]."""

    occupied: np.ndarray  # (M, M) bool, obstacle between 25 cm and the camera height
    explored: np.ndarray  # (M, M) bool, has been in the field of view
    visited: np.ndarray  # (M, M) bool, the robot has been here
    semantics: np.ndarray  # (15, M, M) bool, channel k is class k + 1
    viewpoints: np.ndarray  # (12, M, M) bool, channel k: seen from a direction in [30 k, 30 k + 30) degrees
    pose: np.ndarray  # (4, 4) float64, camera-to-world of the last observation
    origin: np.ndarray  # (2,) float64, world x, y of the outer corner of cell [0, 0], metres
    cell: float  # side of a cell, metres


Record = TypeVar("Record", Observation, MapState)


def read_only(record: Record) -> Record:
    """Return the record with read-only views of its arrays, so that a reward or policy cannot change them.

    Example:
        >>> image = np.zeros((4, 4))
        >>> read_only(Observation(image, image, image, np.eye(4))).depth.flags.writeable, image.flags.writeable
        (False, True)
    """
    views: dict[str, Any] = {k: array.view() for k, array in vars(record).items() if isinstance(array, np.ndarray)}
    for view in views.values():
        view.flags.writeable = False
    return replace(record, **views)


@dataclass(frozen=True)
class Transition:
    """Input of a reward: the map before and after one step. The arrays are read-only."""

    before: MapState  # map before the action
    after: MapState  # map after the action, updated with ``observation``
    observation: Observation  # made after the action
    action: int  # a member of ``Action``


@dataclass(frozen=True)
class Rendering:
    """Rendered view of a radiance field from one camera pose."""

    rgb: np.ndarray  # (H, W, 3) float32 in [0, 1]
    depth: np.ndarray  # (H, W) float32 along the optical axis, median of the weights; metres (or units of the poses)
    semantics: np.ndarray | None  # (H, W) uint8, class index; None if the field has no classes
    opacity: np.ndarray  # (H, W) float32 in [0, 1], sum of the weights


@dataclass(frozen=True)
class Score:
    """One value of a metric, with everything needed to reproduce it."""

    task: str
    metric: str
    value: float | None  # None if it could not be computed; ``status`` says why
    unit: str = ""
    status: str = "ok"
    n: int = 0  # number of samples averaged
    seconds: float = 0.0  # wall time of the task
    scene: str = ""
    start: int = 0
    policy: str = ""
    reward: str = ""
    model: str = ""
    preset: str = ""
    seed: int = 0
