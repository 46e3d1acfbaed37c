"""How well can one explore at all? A greedy explorer who knows what there is to find: the baseline from above."""

import numpy as np
import torch
from numba import njit

from autonerf_lab.geometry import FORWARD_STEP, TURN_ANGLE, cell_to_world, planar_from_pose, world_to_cell
from autonerf_lab.policies.frontier import travel_from_robot
from autonerf_lab.policies.information_gain import RAYS
from autonerf_lab.policies.interfaces import CompactView, pooled
from autonerf_lab.policies.modular import Modular
from autonerf_lab.types import MapState

LATTICE = 0.3  # metres between the places that are compared
OVERHEAD = 4  # steps that a place costs beside the way, as frontier exploration counts
NEAR, REACH = 0.5, 5.0  # metres, of the depth sensor
TRIED = 0.5  # metres: what was chosen so near and still promises much cannot be seen from there


class Omniscient(Modular):
    """Goes as a modular policy does, to where the most that is not yet mapped is truly to be seen, for each step.

    Of what is behind the next door it knows everything, of the best order nothing.

    Args:
        quantity: ``area``, ``obstacles``, ``semantics`` or ``viewpoints``.
        visible: all there is to see, from ``visible_map``.
    """

    def __init__(self, quantity: str, visible: MapState) -> None:
        self._quantity, self._visible = quantity, visible
        super().__init__(CompactView(), torch.nn.Identity())  # whose timing it has; the network is never asked

    def reset(self, rng: np.random.Generator) -> None:
        """Begin an episode."""
        super().reset(rng)
        self._tried: list[np.ndarray] = []

    def _choose(self, map: MapState) -> np.ndarray:
        distance = travel_from_robot(map)
        start = world_to_cell(map.pose[:2, 3], map.origin, map.cell)
        every = round(LATTICE / map.cell)
        cells = every * np.argwhere(np.isfinite(distance[::every, ::every]))
        cells = cells[(cells != start).any(axis=1)]
        if not len(cells):
            return cell_to_world(start, map.origin, map.cell)
        points = cell_to_world(cells, map.origin, map.cell)
        gains = to_be_seen(*self._truth(map), cells, NEAR / map.cell, REACH / map.cell)
        if self._tried:
            away = ((points[:, None] - np.array(self._tried)[None]) ** 2).sum(axis=2)
            gains /= (1 + np.exp(-away / (2 * TRIED**2)).sum(axis=1)) ** 2
        x, y, heading = planar_from_pose(map.pose)
        ahead = np.exp(1j * (np.arctan2(points[:, 1] - y, points[:, 0] - x) - heading))
        turns = np.abs(np.angle(ahead)) / TURN_ANGLE
        best = points[np.argmax(gains / (distance[tuple(cells.T)] / FORWARD_STEP + turns + OVERHEAD))]
        if np.linalg.norm(map.pose[:2, 3] - best) < self.view.follow * FORWARD_STEP:
            self._tried.append(best)
        return best

    def _truth(self, map: MapState) -> tuple[np.ndarray, np.ndarray]:
        """(M, M) bool walls, and (B, M, M) what is to be seen there from each of B directions and is not on the map."""
        there, size = self._visible, len(map.explored)
        coarser = round(map.cell / there.cell)
        top, left = (int(i) for i in world_to_cell(map.origin + there.cell / 2, there.origin, there.cell))
        name = {"area": "explored", "obstacles": "occupied"}.get(self._quantity, self._quantity)
        mapped, all_of_it = (np.atleast_3d(getattr(known, name).T).T for known in (map, there))
        missing = pooled(all_of_it, top, left, size, coarser) & ~mapped
        if self._quantity == "semantics":  # classes are seen from anywhere
            missing = missing.sum(axis=0, keepdims=True)
        inside, walls = pooled(np.stack([np.ones_like(there.occupied), there.occupied]), top, left, size, coarser)
        return walls | ~inside, missing.astype(np.float32)


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
