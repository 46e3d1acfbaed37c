"""How well can one explore at all? A greedy explorer who knows what there is to find: the yardstick from above."""

import numpy as np
from numba import njit

from autonerf_lab.geometry import (
    AGENT_RADIUS,
    FORWARD_STEP,
    TURN_ANGLE,
    cell_to_world,
    planar_from_pose,
    world_to_cell,
)
from autonerf_lab.planning.dilation import dilate
from autonerf_lab.planning.fast_marching import travel_distance
from autonerf_lab.planning.local import LocalPolicy
from autonerf_lab.policies.gain import RAYS
from autonerf_lab.types import Action, MapState, Observation

LATTICE = 0.3  # metres between the places that are compared
LOOK_AROUND = 9  # turns, as modular policies begin
FOLLOW, ARRIVED = 12, 0.35  # steps and metres, as theirs
OVERHEAD = 4  # steps that a place costs beside the way, as frontier exploration counts
NEAR, REACH = 0.5, 5.0  # metres, of the depth sensor
TRIED = 0.5  # metres: what was chosen so near and still promises much cannot be seen from there


class Omniscient:
    """Walks to where the most that is not yet mapped is truly to be seen, for each step.

    Of what is behind the next door it knows everything, of the best order nothing.

    Args:
        quantity: ``area``, ``obstacles``, ``semantics`` or ``viewpoints``.
        visible: all there is to see, from ``visible_map``.
    """

    def __init__(self, quantity: str, visible: MapState) -> None:
        self._quantity, self._visible = quantity, visible
        self.reset(np.random.default_rng(0))

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode."""
        self._local = LocalPolicy()
        self._age, self._turns = 0, LOOK_AROUND
        self._tried: list[np.ndarray] = []
        self.waypoint: np.ndarray | None = None

    def act(self, map: MapState, observation: Observation) -> int:
        """Towards the best place."""
        if self._turns:
            self._turns -= 1
            return Action.TURN_LEFT
        here = map.pose[:2, 3]
        if self.waypoint is None or self._age >= FOLLOW or np.linalg.norm(here - self.waypoint) < ARRIVED:
            self.waypoint, self._age = self._choose(map), 0
            if np.linalg.norm(here - self.waypoint) < FOLLOW * FORWARD_STEP:
                self._tried.append(self.waypoint)
        self._age += 1
        return self._local.act(map, self.waypoint)

    def _choose(self, map: MapState) -> np.ndarray:
        free = (map.explored & ~dilate(map.occupied, round(AGENT_RADIUS / map.cell) + 0.5)) | map.visited
        start = world_to_cell(map.pose[:2, 3], map.origin, map.cell)
        distance = travel_distance(free, start[None], map.cell)
        every = round(LATTICE / map.cell)
        cells = every * np.argwhere(np.isfinite(distance[::every, ::every]))
        cells = cells[(cells != start).any(axis=1)]
        if not len(cells):
            return cell_to_world(start, map.origin, map.cell)
        points = cell_to_world(cells, map.origin, map.cell)
        walls, missing = self._truth(map)
        gains = to_be_seen(walls, missing, cells, NEAR / map.cell, REACH / map.cell)
        if self._tried:
            away = ((points[:, None] - np.array(self._tried)[None]) ** 2).sum(axis=2)
            gains /= (1 + np.exp(-away / (2 * TRIED**2)).sum(axis=1)) ** 2
        x, y, heading = planar_from_pose(map.pose)
        ahead = np.exp(1j * (np.arctan2(points[:, 1] - y, points[:, 0] - x) - heading))
        turns = np.abs(np.angle(ahead)) / TURN_ANGLE
        return points[np.argmax(gains / (distance[tuple(cells.T)] / FORWARD_STEP + turns + OVERHEAD))]

    def _truth(self, map: MapState) -> tuple[np.ndarray, np.ndarray]:
        """(M, M) bool walls, and (B, M, M) what is to be seen there from each of B directions and is not on the map."""
        there = self._visible
        centers = cell_to_world(np.indices(map.explored.shape).reshape(2, -1).T, map.origin, map.cell)
        at = world_to_cell(centers, there.origin, there.cell)
        inside = ((at >= 0) & (at < len(there.explored))).all(axis=1)

        def placed(channels: np.ndarray, outside: bool) -> np.ndarray:
            out = np.full((len(channels), len(centers)), outside)
            out[:, inside] = channels[:, at[inside, 0], at[inside, 1]]
            return out.reshape(-1, *map.explored.shape)

        name = {"area": "explored", "obstacles": "occupied"}.get(self._quantity, self._quantity)
        mapped = np.atleast_3d(getattr(map, name).T).T
        missing = placed(np.atleast_3d(getattr(there, name).T).T, False) & ~mapped
        if self._quantity == "semantics":  # classes are seen from anywhere
            missing = missing.sum(axis=0, keepdims=True)
        return placed(there.occupied[None], True)[0], missing.astype(np.float32)


@njit(cache=True)
def to_be_seen(walls: np.ndarray, worth: np.ndarray, cells: np.ndarray, near: float, reach: float) -> np.ndarray:
    """Sum of what rays from each of K cells meet up to the first wall; a cell counts once.

    Args:
        walls: (M, M) bool.
        worth: (B, M, M) of each cell, seen from each of B directions.
        cells: (K, 2) row and column.
        near: cells; what is nearer is not seen.
        reach: cells.

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
