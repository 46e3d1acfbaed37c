"""Exploration (task 8 of the protocol): coverage of the visible scene along a trajectory."""

import numpy as np

from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.exploration.visibility import add_view, blank_map
from autonerf_lab.mapping import Mapper
from autonerf_lab.simulator import Simulator
from autonerf_lab.types import MapState

# channel of the map -> name of the curve
QUANTITIES = {"explored": "area", "occupied": "obstacles", "semantics": "semantics", "viewpoints": "viewpoints"}


def coverage(sim: Simulator, trajectory: Trajectory, visible: MapState) -> dict[str, np.ndarray]:
    """Compute the percentage of the visible cells that are mapped after each step of a trajectory.

    Args:
        sim: simulator of the scene; it renders depth again, from the true poses of the trajectory.
        trajectory: T images.
        visible: result of :func:`~autonerf_lab.exploration.visible_map` with the same simulator.

    Returns:
        ``area``, ``obstacles``, ``semantics`` and ``viewpoints``: (T,) percent each, non-decreasing. If the visible map
        has no cell of a channel (a scan without semantics), the value is 100.
    """
    shares: dict[str, list[float]] = {name: [] for name in QUANTITIES.values()}
    totals = {key: int(np.count_nonzero(getattr(visible, key))) for key in QUANTITIES}
    mapper = Mapper(blank_map(sim), sim.intrinsics)
    for pose in trajectory.pose_sources.get("true", trajectory.poses):
        known = add_view(sim, mapper, pose)
        for key, name in QUANTITIES.items():
            seen = np.count_nonzero(getattr(known, key) & getattr(visible, key))
            shares[name].append(100.0 * seen / totals[key] if totals[key] else 100.0)
    return {name: np.array(values) for name, values in shares.items()}


def area_under(curve: np.ndarray) -> float:
    """Return the mean of a curve over its steps, which also differs between trajectories with the same final value."""
    return float(np.mean(curve))
