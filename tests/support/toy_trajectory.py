"""Trajectory of random poses in a test scene."""

import numpy as np

from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.simulator import Simulator


def toy_trajectory(sim: Simulator, count: int, depth: bool = False) -> Trajectory:
    """Return ``count`` views from poses that are uniform over the scene, always the same."""
    rng = np.random.default_rng(0)
    poses = np.stack([sim.sample_pose(rng) for _ in range(count)])
    frames = [sim.render(pose) for pose in poses]
    rgb, depths, semantics = (np.stack([getattr(f, key) for f in frames]) for key in ("rgb", "depth", "semantics"))
    return Trajectory(poses, rgb, depths if depth else None, semantics, sim.intrinsics, {"scene": sim.scene.name})
