"""Exploration (task 8 of the protocol): coverage of the visible scene along a trajectory."""

import numpy as np

from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.geometry import planar_pose
from autonerf_lab.mapping import Mapper, empty_map
from autonerf_lab.mapping.semantic_map import MAP_CELL
from autonerf_lab.simulator import Simulator
from autonerf_lab.types import MapState, Observation

# channel of the map -> name of the curve
QUANTITIES = {"explored": "area", "occupied": "obstacles", "semantics": "semantics", "viewpoints": "viewpoints"}
MARGIN = 1.0  # of the map around the scene, metres


def visible_map(sim: Simulator, poses: int = 2000, seed: int = 0) -> MapState:
    """Build the map of everything that is visible from navigable poses.

    Args:
        sim: simulator of the scene.
        poses: number of poses.
        seed: random seed of the poses.

    Example:
        >>> from autonerf_lab.geometry import Intrinsics
        >>> from autonerf_lab.scenes import load_scene
        >>> sim = Simulator(load_scene("dev-0"), Intrinsics.from_fov(32, 32), rgb=False)
        >>> few, many = (visible_map(sim, poses) for poses in (2, 20))
        >>> int(few.explored.sum()) < int(many.explored.sum())
        True
    """
    rng = np.random.default_rng(seed)
    mapper = Mapper(_blank(sim), sim.intrinsics)
    for _ in range(poses):
        _observe(sim, mapper, sim.sample_pose(rng))
    return mapper.map


def coverage(sim: Simulator, trajectory: Trajectory, visible: MapState) -> dict[str, np.ndarray]:
    """Compute the percentage of the visible cells that are mapped after each step of a trajectory.

    Args:
        sim: simulator of the scene; it renders depth again, from the true poses of the trajectory.
        trajectory: T images.
        visible: result of :func:`visible_map` with the same simulator.

    Returns:
        ``area``, ``obstacles``, ``semantics`` and ``viewpoints``: (T,) percent each, non-decreasing. If the visible map
        has no cell of a channel (a scan without semantics), the value is 100.
    """
    shares: dict[str, list[float]] = {name: [] for name in QUANTITIES.values()}
    totals = {key: int(np.count_nonzero(getattr(visible, key))) for key in QUANTITIES}
    mapper = Mapper(_blank(sim), sim.intrinsics)
    for pose in trajectory.pose_sources.get("true", trajectory.poses):
        known = _observe(sim, mapper, pose)
        for key, name in QUANTITIES.items():
            seen = np.count_nonzero(getattr(known, key) & getattr(visible, key))
            shares[name].append(100.0 * seen / totals[key] if totals[key] else 100.0)
    return {name: np.array(values) for name, values in shares.items()}


def area_under(curve: np.ndarray) -> float:
    """Return the mean of a curve over its steps, which also differs between trajectories with the same final value."""
    return float(np.mean(curve))


def _blank(sim: Simulator) -> MapState:
    low, high = sim.scene.bounds[:, :2]
    x, y = (low + high) / 2
    return empty_map(planar_pose(x, y, 0.0), int(np.ceil((np.max(high - low) + 2 * MARGIN) / MAP_CELL)))


def _observe(sim: Simulator, mapper: Mapper, pose: np.ndarray) -> MapState:
    frame = sim.render(pose, rgb=False)
    return mapper.add(Observation(frame.rgb, frame.depth, frame.semantics, pose))[1]
