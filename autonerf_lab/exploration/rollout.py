"""Let a policy walk through a scene and keep what it saw."""

from dataclasses import asdict
from typing import Any

import numpy as np
from tqdm import tqdm

from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import SceneError
from autonerf_lab.geometry import planar_from_pose
from autonerf_lab.mapping import empty_map, update
from autonerf_lab.policies import Policy, make_policy
from autonerf_lab.simulator import Simulator
from autonerf_lab.types import MapState

MAP_SIZE = 640  # 32 m: an apartment of 15 m fits, wherever in it the robot starts
_POLICY_STREAM = 1  # second word of the policy's seed: its draws must not repeat those of the start pose


def explore(
    sim: Simulator,
    policy: str | Policy = "frontier",
    steps: int = 1500,
    seed: int = 0,
    progress: bool = True,
    pose: np.ndarray | None = None,
    map_size: int = MAP_SIZE,
) -> Trajectory:
    """Walk ``steps`` actions and keep the image before each.

    Args:
        sim: where, and with which camera and noise.
        policy: a name of :data:`autonerf_lab.policies.POLICIES`, or a policy.
        steps: actions, and images.
        seed: of the start pose, the noise and the policy.
        progress: show a bar.
        pose: (4, 4) start, instead of one drawn from the seed.
        map_size: cells of 5 cm a side of the robot's map, which is centred on the start.

    Returns:
        The trajectory. Its poses are those of odometry, as a robot has them. ``meta`` holds ``actions`` and whether
        each ``collided``, and at each image ``explored_m2`` (area explored so far), ``path_m`` (length of the way so
        far) and ``waypoints`` (x, y the policy is heading for, or None); with noise also ``true_poses``, (T, 3) x, y,
        heading.

    Raises:
        UnknownNameError: no such policy.
        SceneError: the robot cannot stand at ``pose``, or it came to the edge of its map.

    Example:
        >>> from autonerf_lab.geometry import Intrinsics
        >>> from autonerf_lab.scenes import load_scene
        >>> sim = Simulator(load_scene("train-00"), Intrinsics.from_fov(32, 32), rgb=False)
        >>> walk = explore(sim, "frontier", steps=5, progress=False)
        >>> len(walk), walk.meta["actions"]
        (5, [1, 1, 1, 1, 1])
    """
    if steps < 1:
        raise ValueError(f"steps must be at least 1, not {steps}")
    name = policy if isinstance(policy, str) else type(policy).__name__
    chosen: Policy = make_policy(policy) if isinstance(policy, str) else policy
    chosen.reset(np.random.default_rng([seed, _POLICY_STREAM]))
    observation = sim.reset(seed=seed, pose=pose)
    known = empty_map(observation.pose, map_size)
    shape = (steps, *observation.depth.shape)
    poses, true_poses = np.empty((steps, 4, 4)), np.empty((steps, 3))
    rgb, depth, semantics = np.empty((*shape, 3), np.uint8), np.empty(shape, np.float32), np.empty(shape, np.uint8)
    actions: list[int] = []
    collided: list[bool] = []
    explored: list[float] = []
    path: list[float] = []
    waypoints: list[list[float] | None] = []
    length = 0.0
    for t in tqdm(range(steps), desc=f"explore {sim.scene.name} ({name})", disable=not progress, unit="step"):
        _check_inside(observation.pose, known)
        known = update(known, observation, sim.intrinsics)
        poses[t], rgb[t], depth[t], semantics[t] = (
            observation.pose,
            observation.rgb,
            observation.depth,
            observation.semantics,
        )
        true_poses[t] = planar_from_pose(sim.pose)
        explored.append(round(float(np.count_nonzero(known.explored)) * known.cell**2, 4))
        path.append(round(length, 4))
        actions.append(int(chosen.act(known, observation)))
        waypoints.append(None if chosen.waypoint is None else [round(float(v), 2) for v in chosen.waypoint])
        collided.append(sim.move(actions[-1]))
        length += float(np.linalg.norm(sim.pose[:2, 3] - true_poses[t, :2]))
        if t + 1 < steps:
            observation = sim.observe()
    meta: dict[str, Any] = {
        "scene": sim.scene.name,
        "scene_sha256": sim.scene.sha256,
        "policy": name,
        "seed": seed,
        "steps": steps,
        "supersample": sim.supersample,
        "noise": asdict(sim.noise),
        "actions": actions,
        "collided": collided,
        "explored_m2": explored,
        "path_m": path,
        "waypoints": waypoints,
    }
    if sim.noise.actuation or sim.noise.odometry:
        meta["true_poses"] = true_poses.tolist()
    return Trajectory(poses, rgb, depth, semantics, sim.intrinsics, meta)


def _check_inside(pose: np.ndarray, known: MapState) -> None:
    """A robot that walks off its map would plan on nothing."""
    reach = known.occupied.shape[0] * known.cell / 2
    away = np.abs(pose[:2, 3] - known.origin - reach).max()
    if away > reach - 1.0:
        raise SceneError(
            f"the robot is {away:.1f} m from its start and its map ends at {reach:.1f} m; "
            f"explore with a larger map_size (now {known.occupied.shape[0]} cells)"
        )
