"""Exploration (task 8 of the protocol): how much of what can be seen in a scene a walk has seen, step by step."""

import numpy as np

from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.geometry import planar_pose
from autonerf_lab.mapping import Mapper, empty_map
from autonerf_lab.mapping.semantic_map import MAP_CELL
from autonerf_lab.simulator import Simulator
from autonerf_lab.types import MapState, Observation

QUANTITIES = {"explored": "area", "occupied": "obstacles", "semantics": "semantics", "viewpoints": "viewpoints"}
MARGIN = 1.0  # metres of map around the scene


def visible_map(sim: Simulator, poses: int = 2000, seed: int = 0) -> MapState:
    """The map of a robot that has been everywhere: what is visible from ``poses`` seeded navigable poses.

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
        _look(sim, mapper, sim.sample_pose(rng))
    return mapper.map


def coverage(sim: Simulator, walk: Trajectory, visible: MapState) -> dict[str, np.ndarray]:
    """Share of the visible cells that a walk has mapped after each of its T steps.

    Args:
        sim: of the scene; its camera looks again from the poses of the walk, where the robot really was.
        walk: T images.
        visible: what there is to see, from :func:`visible_map` of the same simulator.

    Returns:
        ``area``, ``obstacles``, ``semantics`` and ``viewpoints``: (T,) percent each; never falling. A quantity that the
        scene does not have (a scan without semantics) is 100 throughout.
    """
    shares: dict[str, list[float]] = {name: [] for name in QUANTITIES.values()}
    totals = {key: int(np.count_nonzero(getattr(visible, key))) for key in QUANTITIES}
    truth = walk.meta.get("true_poses")
    poses = walk.poses if truth is None else [planar_pose(*pose) for pose in truth]
    mapper = Mapper(_blank(sim), sim.intrinsics)
    for pose in poses:
        known = _look(sim, mapper, np.asarray(pose))
        for key, name in QUANTITIES.items():
            seen = np.count_nonzero(getattr(known, key) & getattr(visible, key))
            shares[name].append(100.0 * seen / totals[key] if totals[key] else 100.0)
    return {name: np.array(values) for name, values in shares.items()}


def area_under(curve: np.ndarray) -> float:
    """Mean of a curve over its steps: what tells walks apart when their ends are all alike."""
    return float(np.mean(curve))


def _blank(sim: Simulator) -> MapState:
    low, high = sim.scene.bounds[:, :2]
    x, y = (low + high) / 2
    return empty_map(planar_pose(x, y, 0.0), int(np.ceil((np.max(high - low) + 2 * MARGIN) / MAP_CELL)))


def _look(sim: Simulator, mapper: Mapper, pose: np.ndarray) -> MapState:
    frame = sim.render(pose, rgb=False)
    return mapper.add(Observation(frame.rgb, frame.depth, frame.semantics, pose))[1]
