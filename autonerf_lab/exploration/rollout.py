"""Rollout of a policy in a scene, recorded as a trajectory."""

from dataclasses import asdict
from typing import Any

import numpy as np
from tqdm import tqdm

from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import PolicyError, SceneError
from autonerf_lab.mapping import Mapper, empty_map
from autonerf_lab.policies import Policy, make_policy
from autonerf_lab.simulator import Simulator
from autonerf_lab.types import Action, MapState, read_only
from autonerf_lab.utils.plugins import named_errors

MAP_SIZE = 640  # cells; 32 m contain an apartment of 15 m for any start pose
_POLICY_STREAM = 1  # second word of the policy's seed, so that its random numbers differ from those of the start pose


def explore(
    sim: Simulator,
    policy: str | Policy = "frontier",
    steps: int = 1500,
    seed: int = 0,
    progress: bool = True,
    pose: np.ndarray | None = None,
    map_size: int = MAP_SIZE,
) -> Trajectory:
    """Explore a scene with a policy and record the observation before each action.

    Args:
        sim: simulator with the scene, the camera and the noise.
        policy: name or path for :func:`autonerf_lab.policies.make_policy`, or a policy.
        steps: number of actions and of recorded frames.
        seed: random seed of the start pose, the noise and the policy.
        progress: show a progress bar.
        pose: start pose, (4, 4) camera-to-world; None for a random one.
        map_size: size of the robot's map, cells of 5 cm a side; the map is centred on the start.

    Returns:
        The trajectory, with poses by odometry; with noise, it has the true poses too. ``meta`` contains ``actions`` and
        their ``collided`` flags, and for each frame ``explored_m2``, ``path_m`` (distance travelled) and ``waypoints``
        (x, y or None).

    Raises:
        UnknownNameError: unknown policy.
        PolicyError: the policy raised, or returned something else than an action; names policy and step.
        SceneError: ``pose`` is not navigable, or the robot reached the border of its map.

    Example:
        >>> from autonerf_lab.geometry import Intrinsics
        >>> from autonerf_lab.scenes import load_scene
        >>> sim = Simulator(load_scene("train-00"), Intrinsics.from_fov(32, 32), rgb=False)
        >>> trajectory = explore(sim, "frontier", steps=5, progress=False)
        >>> len(trajectory), trajectory.meta["actions"]
        (5, [1, 1, 1, 1, 1])
    """
    if steps < 1:
        raise ValueError(f"steps must be at least 1, not {steps}")
    name = policy if isinstance(policy, str) else type(policy).__name__
    chosen = make_policy(policy)
    with named_errors(f"policy {name!r}", "in reset", PolicyError):
        chosen.reset(np.random.default_rng([seed, _POLICY_STREAM]))
    observation = sim.reset(seed=seed, pose=pose)
    mapper = Mapper(empty_map(observation.pose, map_size), sim.intrinsics)
    shape = (steps, *observation.depth.shape)
    poses, true_poses = np.empty((steps, 4, 4)), np.empty((steps, 4, 4))
    rgb, depth, semantics = np.empty((*shape, 3), np.uint8), np.empty(shape, np.float32), np.empty(shape, np.uint8)
    actions: list[int] = []
    collided: list[bool] = []
    explored: list[float] = []
    path: list[float] = []
    waypoints: list[list[float] | None] = []
    length = 0.0
    for t in tqdm(range(steps), desc=f"explore {sim.scene.name} ({name})", disable=not progress, unit="step"):
        _check_inside(observation.pose, mapper.map)
        _, map = mapper.add(observation)
        poses[t], rgb[t], depth[t], semantics[t] = (
            observation.pose,
            observation.rgb,
            observation.depth,
            observation.semantics,
        )
        true_poses[t] = sim.pose
        explored.append(round(float(np.count_nonzero(map.explored)) * map.cell**2, 4))
        path.append(round(length, 4))
        with named_errors(f"policy {name!r}", f"at step {t}", PolicyError):
            actions.append(int(Action(chosen.act(map, read_only(observation)))))
            waypoints.append(None if chosen.waypoint is None else [round(float(v), 2) for v in chosen.waypoint])
        collided.append(sim.move(actions[-1]))
        length += float(np.linalg.norm(sim.pose[:2, 3] - true_poses[t, :2, 3]))
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
        "depth_noise": sim.depth_noise,
        "actions": actions,
        "collided": collided,
        "explored_m2": explored,
        "path_m": path,
        "waypoints": waypoints,
    }
    noisy = sim.noise.actuation or sim.noise.odometry
    source, others = ("odometry", {"true": true_poses}) if noisy else ("true", {})
    return Trajectory(poses, rgb, depth, semantics, sim.intrinsics, meta, source, others)


def _check_inside(pose: np.ndarray, map: MapState) -> None:
    """Raise an error if the robot is within 1 m of the border of its map, outside of which it could not plan."""
    half = map.occupied.shape[0] * map.cell / 2
    distance = np.abs(pose[:2, 3] - map.origin - half).max()
    if distance > half - 1.0:
        raise SceneError(
            f"the robot is {distance:.1f} m from its start and its map ends at {half:.1f} m; "
            f"use a larger map (map_size=, --map-size; now {map.occupied.shape[0]} cells)"
        )
