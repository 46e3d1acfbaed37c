"""Policy interface of the end-to-end policies: the image, and the map in the robot's frame at two scales.

Ramakrishnan et al. 2021, "An Exploration of Embodied Visual Exploration", section 4: RGB, a fine and a coarse
egocentric occupancy map, the last action and its collision flag.
"""

from typing import Any

import numpy as np
from gymnasium import spaces
from numba import njit
from PIL import Image

from autonerf_lab.geometry import planar_from_pose, world_to_cell
from autonerf_lab.policies.interfaces import pooled
from autonerf_lab.types import Action, MapState, Observation


class EgocentricInterface:
    """Interface with an image of 84 x 84 pixels and two egocentric maps of 32 x 32 blocks, 4 m and 16 m wide.

    Observation: ``rgb`` (3, 84, 84) uint8. ``near`` and ``far`` (2, 32, 32) uint8, the occupied and the explored share
    of each block, 255 = all of it; row 0 is ahead of the robot, column 0 to its left. ``felt`` (4,) float32: the last
    action, one-hot, and its collision flag.

    Example:
        >>> from autonerf_lab.geometry import planar_pose
        >>> from autonerf_lab.mapping import empty_map
        >>> pose = planar_pose(0, 0, 0)
        >>> blank = Observation(np.zeros((8, 8, 3), np.uint8), np.zeros((8, 8)), np.zeros((8, 8)), pose)
        >>> obs = EgocentricInterface().observe(empty_map(pose), blank, last=Action.TURN_LEFT)
        >>> obs["near"].shape, obs["felt"].tolist()
        ((2, 32, 32), [0.0, 1.0, 0.0, 0.0])
    """

    follow = 1  # actions per decision
    initial_turns = 0
    cell = 0.1  # metres, cell of the maps that it is trained on; finer maps are pooled
    IMAGE = 84
    GRID = 32
    NEAR = 4.0  # metres, side of the fine map
    FAR = 16.0  # metres, side of the coarse map
    SIDE = 240  # cells around the robot, enough for the coarse map at any heading
    FELT = len(Action) + 1

    observation_space = spaces.Dict(
        {
            "rgb": spaces.Box(0, 255, (3, IMAGE, IMAGE), np.uint8),
            "near": spaces.Box(0, 255, (2, GRID, GRID), np.uint8),
            "far": spaces.Box(0, 255, (2, GRID, GRID), np.uint8),
            "felt": spaces.Box(0, 1, (FELT,), np.float32),
        }
    )
    action_space = spaces.Discrete(len(Action))

    def observe(self, map: MapState, observation: Observation, last: int | None) -> dict[str, Any]:
        """Encode the state of the robot.

        Args:
            map: the map, which already contains the observation.
            observation: the latest one; its image is resized to 84 x 84 pixels.
            last: the action that led to it; None at the start of an episode.

        Returns:
            ``rgb``, ``near``, ``far`` and ``felt`` of the observation space.
        """
        rgb = observation.rgb
        if rgb.shape[:2] != (self.IMAGE, self.IMAGE):
            rgb = np.asarray(Image.fromarray(rgb).resize((self.IMAGE, self.IMAGE), Image.Resampling.BOX))
        felt = np.zeros(self.FELT, np.float32)
        if last is not None:
            felt[last] = 1
        felt[-1] = observation.collided
        factor = max(1, round(self.cell / map.cell))
        cell = factor * map.cell
        x, y, heading = planar_from_pose(map.pose)
        robot = world_to_cell(np.array([x, y]), map.origin, map.cell) // factor
        top, left = (int(i) - self.SIDE // 2 for i in robot)
        known = pooled(np.stack([map.occupied, map.explored]), top * factor, left * factor, self.SIDE, factor)
        at_x, at_y = (np.array([x, y]) - map.origin) / cell - (left, top)
        near, far = (
            egocentric_shares(known, at_x, at_y, heading, self.GRID, width / cell, samples)
            for width, samples in ((self.NEAR, 1), (self.FAR, 5))
        )
        return {"rgb": np.ascontiguousarray(rgb.transpose(2, 0, 1)), "near": near, "far": far, "felt": felt}


@njit(cache=True, nogil=True)
def egocentric_shares(
    channels: np.ndarray, x: float, y: float, heading: float, grid: int, width: float, samples: int
) -> np.ndarray:
    """Resample a square of a map, rotated so that the heading points up.

    Args:
        channels: (C, M, M) bool, rows of growing y.
        x: centre of the square, cells.
        y: centre of the square, cells.
        heading: radians, counter-clockwise from +x.
        grid: G, blocks along each side of the result.
        width: side of the square, cells.
        samples: samples along each side of a block.

    Returns:
        (C, G, G) uint8, the set share of each block, 255 = all of it; cells outside the map are not set.

    Example:
        >>> channels = np.zeros((1, 4, 4), np.bool_)
        >>> channels[0, 2, 3] = True  # x from 3 to 4, y from 2 to 3
        >>> egocentric_shares(channels, 2.0, 2.0, 0.0, 4, 4.0, 1)[0].tolist()  # heading +x: ahead, to the left
        [[0, 255, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]]
    """
    count, size = channels.shape[0], channels.shape[1]
    out = np.zeros((count, grid, grid), np.uint8)
    sums = np.zeros(count, np.int64)
    cos, sin = np.cos(heading), np.sin(heading)
    step = width / grid / samples
    for i in range(grid):
        for j in range(grid):
            sums[:] = 0
            for a in range(samples):
                ahead = width / 2 - (i * samples + a + 0.5) * step
                for b in range(samples):
                    left = width / 2 - (j * samples + b + 0.5) * step
                    col = int(np.floor(x + cos * ahead - sin * left))
                    row = int(np.floor(y + sin * ahead + cos * left))
                    if 0 <= row < size and 0 <= col < size:
                        for k in range(count):
                            sums[k] += channels[k, row, col]
            for k in range(count):
                out[k, i, j] = sums[k] * 255 // samples**2
    return out
