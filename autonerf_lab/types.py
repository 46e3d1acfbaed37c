"""The few records that travel between the packages. M: map cells a side. H, W: pixels. All arrays are read-only by
convention: a record is a fact, and a new fact is a new record.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np


class Action(IntEnum):
    """The three actions of the paper's agent."""

    FORWARD = 0  # 0.25 m along the heading
    TURN_LEFT = 1  # 30 degrees, counter-clockwise seen from above
    TURN_RIGHT = 2


@dataclass(frozen=True)
class Observation:
    """What the robot sees and feels at one step."""

    rgb: np.ndarray  # (H, W, 3) uint8
    depth: np.ndarray  # (H, W) float32, metres along the optical axis, 0 = none
    semantics: np.ndarray  # (H, W) uint8, class index
    pose: np.ndarray  # (4, 4) float64, camera-to-world by odometry
    collided: bool = False  # the last action was stopped or bent by an obstacle
    step: int = 0  # actions taken since the start of the episode


@dataclass(frozen=True)
class MapState:
    """The top-down map of section 3.1: everything seen so far. Arrays are indexed [row = y, column = x]."""

    occupied: np.ndarray  # (M, M) bool, an obstacle between 25 cm and the camera
    explored: np.ndarray  # (M, M) bool, has been within the field of view
    visited: np.ndarray  # (M, M) bool, the robot has stood here
    semantics: np.ndarray  # (15, M, M) bool, channel k is class k + 1
    viewpoints: np.ndarray  # (12, M, M) bool, seen from a direction in [30 k, 30 k + 30) degrees
    pose: np.ndarray  # (4, 4) float64, camera-to-world of the last observation
    origin: np.ndarray  # (2,) float64, world x, y of the outer corner of cell [0, 0], metres
    cell: float  # side of a cell, metres


@dataclass(frozen=True)
class Transition:
    """What a reward is called with: the map before and after one step."""

    before: MapState
    after: MapState
    observation: Observation
    action: int


@dataclass(frozen=True)
class Score:
    """One number, with everything needed to make it again."""

    task: str
    metric: str
    value: float | None  # None when it could not be computed: ``status`` says why
    unit: str = ""
    status: str = "ok"
    n: int = 0  # how many samples the value is a mean of
    seconds: float = 0.0
    scene: str = ""
    start: int = 0
    policy: str = ""
    reward: str = ""
    model: str = ""
    preset: str = ""
    seed: int = 0
