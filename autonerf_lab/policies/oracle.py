"""Oracles: greedy policies that know the complete map of the scene, as references of exploration."""

import numpy as np
from numba import njit

from autonerf_lab.errors import PolicyError
from autonerf_lab.geometry import FORWARD_STEP, TURN_ANGLE, cell_to_world, planar_from_pose, world_to_cell
from autonerf_lab.policies.frontier import path_lengths_from_robot
from autonerf_lab.policies.information_gain import RAYS
from autonerf_lab.policies.interfaces import pooled
from autonerf_lab.policies.waypoints import WaypointPolicy
from autonerf_lab.types import MapState

# reward -> channel of the map that it counts
COUNTED = {"cov": "explored", "obs": "occupied", "sem": "semantics", "view": "viewpoints"}
_LATTICE = 0.3  # spacing of the candidate goals, metres
_OVERHEAD = 4  # steps that a goal costs besides its path, as in frontier exploration
_NEAR, _REACH = 0.5, 5.0  # range of the depth sensor, metres
_TRIED = 0.5  # metres; candidates around a reached goal lose gain: the missing content is not visible from there


class Oracle(WaypointPolicy):
    """Policy whose goal maximises the true, not yet mapped gain per step.

    It knows the complete map, but plans one goal at a time: it is not an optimal tour.

    Args:
        reward: ``cov``, ``obs``, ``sem`` or ``view``: the reward whose cells are the gain.

    Example:
        >>> from autonerf_lab.exploration import explore
        >>> from autonerf_lab.geometry import Intrinsics
        >>> from autonerf_lab.scenes import load_scene
        >>> from autonerf_lab.simulator import Simulator
        >>> sim = Simulator(load_scene("train-00"), Intrinsics.from_fov(32, 32), rgb=False)
        >>> len(explore(sim, Oracle("obs"), steps=12, progress=False).meta["actions"])
        12
    """

    follow, arrival, initial_turns = 12, 0.35, 9

    def __init__(self, reward: str) -> None:
        self._channel = COUNTED[reward]
        self._visible: MapState | None = None
        self.reset(np.random.default_rng(0))

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode."""
        super().reset(rng)
        self._tried: list[np.ndarray] = []

    def set_visible_map(self, map: MapState) -> None:
        """Receive the complete map of the scene."""
        self._visible = map

    def choose(self, map: MapState) -> np.ndarray:
        """Return the position with the largest true gain per step."""
        distance = path_lengths_from_robot(map)
        start = world_to_cell(map.pose[:2, 3], map.origin, map.cell)
        every = round(_LATTICE / map.cell)
        cells = every * np.argwhere(np.isfinite(distance[::every, ::every]))
        cells = cells[(cells != start).any(axis=1)]
        if not len(cells):
            return cell_to_world(start, map.origin, map.cell)
        points = cell_to_world(cells, map.origin, map.cell)
        gains = visible_gain(*self._truth(map), cells, _NEAR / map.cell, _REACH / map.cell)
        if self._tried:
            away = ((points[:, None] - np.array(self._tried)[None]) ** 2).sum(axis=2)
            gains /= (1 + np.exp(-away / (2 * _TRIED**2)).sum(axis=1)) ** 2
        x, y, heading = planar_from_pose(map.pose)
        ahead = np.exp(1j * (np.arctan2(points[:, 1] - y, points[:, 0] - x) - heading))
        turns = np.abs(np.angle(ahead)) / TURN_ANGLE
        best = points[np.argmax(gains / (distance[tuple(cells.T)] / FORWARD_STEP + turns + _OVERHEAD))]
        if np.linalg.norm(map.pose[:2, 3] - best) < self.follow * FORWARD_STEP:
            self._tried.append(best)
        return best

    def _truth(self, map: MapState) -> tuple[np.ndarray, np.ndarray]:
        """Return (M, M) bool walls, and (B, M, M) float32 unmapped content of cells for B viewing directions."""
        if self._visible is None:
            raise PolicyError("an oracle needs the map of the scene: call set_visible_map, as lab.explore does")
        there, size = self._visible, len(map.explored)
        coarser = round(map.cell / there.cell)
        top, left = (int(i) for i in world_to_cell(map.origin + there.cell / 2, there.origin, there.cell))
        mapped, complete = (np.atleast_3d(getattr(source, self._channel).T).T for source in (map, there))
        missing = pooled(complete, top, left, size, coarser) & ~mapped
        if self._channel == "semantics":  # classes do not depend on the direction
            missing = missing.sum(axis=0, keepdims=True)
        inside, walls = pooled(np.stack([np.ones_like(there.occupied), there.occupied]), top, left, size, coarser)
        return walls | ~inside, missing.astype(np.float32)


@njit(cache=True)
def visible_gain(walls: np.ndarray, worth: np.ndarray, cells: np.ndarray, near: float, reach: float) -> np.ndarray:
    """Return the sum of the gains that rays from each of K cells meet up to the first wall; a cell counts once.

    Args:
        walls: (M, M) bool.
        worth: (B, M, M) float32 gain of each cell, seen from each of B directions.
        cells: (K, 2) row and column.
        near: minimum range of the sensor, cells.
        reach: maximum range of the sensor, cells.

    Returns:
        (K,) float64; 0 in a wall.
    """
    size, bins, rays = len(walls), len(worth), 2 * RAYS
    out = np.zeros(len(cells))
    seen = np.full(walls.shape, -1)
    for i in range(len(cells)):
        row, col = cells[i]
        if walls[row, col]:
            continue
        for k in range(rays):
            turn = (k + 0.5) / rays
            dr, dc = np.sin(2 * np.pi * turn), np.cos(2 * np.pi * turn)
            seen_from = int((turn + 0.5) % 1.0 * bins)
            distance = 1.0
            while distance <= reach:
                r, c = int(np.floor(row + 0.5 + dr * distance)), int(np.floor(col + 0.5 + dc * distance))
                if r < 0 or c < 0 or r >= size or c >= size:
                    break
                if distance >= near and seen[r, c] != i:
                    seen[r, c] = i
                    out[i] += worth[seen_from, r, c]
                if walls[r, c]:
                    break
                distance += 1.0
    return out
