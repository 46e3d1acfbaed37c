"""Map of everything that a robot can see in a scene: the ground truth of coverage and of the oracles."""

import numpy as np

from autonerf_lab.geometry import planar_pose
from autonerf_lab.mapping import Mapper, empty_map
from autonerf_lab.mapping.semantic_map import MAP_CELL
from autonerf_lab.simulator import Simulator
from autonerf_lab.types import MapState, Observation

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
    mapper = Mapper(blank_map(sim), sim.intrinsics)
    for _ in range(poses):
        add_view(sim, mapper, sim.sample_pose(rng))
    return mapper.map


def blank_map(sim: Simulator) -> MapState:
    """Return an empty map of the whole scene."""
    low, high = sim.scene.bounds[:, :2]
    x, y = (low + high) / 2
    return empty_map(planar_pose(x, y, 0.0), int(np.ceil((np.max(high - low) + 2 * MARGIN) / MAP_CELL)))


def add_view(sim: Simulator, mapper: Mapper, pose: np.ndarray) -> MapState:
    """Add the depth image and labels at a pose, without noise, to a map; return the map."""
    frame = sim.render(pose, rgb=False)
    return mapper.add(Observation(frame.rgb, frame.depth, frame.semantics, pose))[1]
