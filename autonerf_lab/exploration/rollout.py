"""Rollout of a policy in a scene, recorded as a trajectory."""

from dataclasses import asdict, replace
from typing import Any

import numpy as np
from tqdm import tqdm

from autonerf_lab.data.pose_sources import check_source
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import PolicyError
from autonerf_lab.exploration.visibility import visible_map
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.localization import OdometryModel, PoseEstimator
from autonerf_lab.mapping import Mapper, empty_map
from autonerf_lab.policies import Policy, PrivilegedPolicy, make_policy
from autonerf_lab.segmentation import TRUE
from autonerf_lab.simulator import Simulator
from autonerf_lab.types import Action, Observation, read_only
from autonerf_lab.utils.arguments import refuse_name
from autonerf_lab.utils.plugins import named_errors

MAP_SIZE = 640  # cells; 32 m contain most apartments for any start pose, larger maps grow
POSES = ("true", "odometry", "estimated")  # pose sources that exist during an episode
_MOVED = 0.025  # metres, half a cell: correction of earlier poses after which the map is drawn again
_POLICY_STREAM = 1  # second word of the policy's seed, so that its random numbers differ from those of the start pose


def explore(
    sim: Simulator,
    policy: str | Policy = "frontier",
    steps: int = 1500,
    seed: int = 0,
    progress: bool = True,
    pose: np.ndarray | None = None,
    map_size: int = MAP_SIZE,
    poses: str = "odometry",
) -> Trajectory:
    """Explore a scene with a policy and record the observation before each action.

    The policy sees one pose source only, and the map that is made with it. With ``estimated``, the poses are estimated
    online from odometry and depth (:class:`~autonerf_lab.localization.PoseEstimator`); when a loop closure corrects
    earlier poses, the map is drawn again from all depth images.

    Args:
        sim: simulator with the scene, the camera and the noise.
        policy: name or path for :func:`autonerf_lab.policies.make_policy`, or a policy. A privileged one also gets the
            complete map of the scene.
        steps: number of actions and of recorded frames.
        seed: random seed of the start pose, the noise and the policy.
        progress: show a progress bar.
        pose: start pose, (4, 4) camera-to-world; None for a random one.
        map_size: initial size of the robot's map, cells of 5 cm a side; the map is centred on the start and grows with
            the scene (:class:`~autonerf_lab.mapping.Mapper`).
        poses: pose source: ``odometry``, ``estimated`` or ``true``. Without noise, odometry is exact.

    Returns:
        The trajectory, with the poses of this source; with noise, it has the other ones too. ``estimated`` are those of
        the end of the episode. ``meta`` contains ``actions`` and their ``collided`` flags, and for each frame
        ``explored_m2``, ``path_m`` (distance travelled) and ``waypoints`` (x, y or None); with estimated poses also
        ``pose_std``, standard deviations of x, y and heading. The classes are those that the robot saw; predicted ones
        have confidences, and ``meta["semantics"]`` names their source.

    Raises:
        UnknownNameError: unknown policy or pose source.
        WrongTypeError: ``sim`` is a name.
        PolicyError: the policy raised, or returned something else than an action; names policy and step.
        SceneError: ``pose`` is not navigable, or the map would exceed 400 m a side.

    Example:
        >>> from autonerf_lab.geometry import Intrinsics
        >>> from autonerf_lab.scenes import load_scene
        >>> sim = Simulator(load_scene("train-00"), Intrinsics.from_fov(32, 32), rgb=False)
        >>> trajectory = explore(sim, "frontier", steps=5, progress=False)
        >>> len(trajectory), trajectory.meta["actions"]
        (5, [1, 1, 1, 1, 1])
    """
    refuse_name(sim, "the simulator", "lab.Simulator(lab.load_scene({}))")
    if steps < 1:
        raise ValueError(f"steps must be at least 1, not {steps}")
    check_source(poses, POSES)
    name = policy if isinstance(policy, str) else type(policy).__name__
    chosen = make_policy(policy)
    with named_errors(f"policy {name!r}", "in reset", PolicyError):
        chosen.reset(np.random.default_rng([seed, _POLICY_STREAM]))
    if isinstance(chosen, PrivilegedPolicy):
        visible = visible_map(sim)  # an error here is not one of the policy
        with named_errors(f"policy {name!r}", "in set_visible_map", PolicyError):
            chosen.set_visible_map(visible)
    observation = sim.reset(seed=seed, pose=pose)
    estimator = PoseEstimator(sim.intrinsics, OdometryModel.from_noise(sim.noise)) if poses == "estimated" else None
    if estimator is not None:
        estimator.start(observation)
    mapper = Mapper(empty_map(observation.pose, map_size), sim.intrinsics, grows=True)
    shape = (steps, *observation.depth.shape)
    measured, true_poses, used = (np.empty((steps, 4, 4)) for _ in range(3))
    rgb, depth, semantics = np.empty((*shape, 3), np.uint8), np.empty(shape, np.float32), np.empty(shape, np.uint8)
    confidence = None if sim.semantics == TRUE else np.empty(shape, np.uint8)
    actions: list[int] = []
    collided: list[bool] = []
    explored: list[float] = []
    path: list[float] = []
    waypoints: list[list[float] | None] = []
    spread: list[list[float]] = []
    length, revision = 0.0, 0
    for t in tqdm(range(steps), desc=f"explore {sim.scene.name} ({name})", disable=not progress, unit="step"):
        measured[t], true_poses[t] = observation.pose, sim.pose
        rgb[t], depth[t], semantics[t] = observation.rgb, observation.depth, observation.semantics
        if confidence is not None and observation.confidence is not None:
            confidence[t] = np.rint(255 * observation.confidence)
        if estimator is not None:
            observation = replace(observation, pose=estimator.c2w)
            spread.append(estimator.standard_deviations)
            if estimator.revision > revision:
                revision, corrected = estimator.revision, estimator.trajectory[:t]
                if np.linalg.norm((corrected - used[:t])[:, :2, 3], axis=1).max() > _MOVED:
                    used[:t] = corrected
                    mapper = _redrawn(len(mapper.map.explored), sim.intrinsics, corrected, depth, semantics)
        elif poses == "true":
            observation = replace(observation, pose=sim.pose)
        used[t] = observation.pose
        _, map = mapper.add(observation)
        explored.append(round(float(np.count_nonzero(map.explored)) * map.cell**2, 4))
        path.append(round(length, 4))
        with named_errors(f"policy {name!r}", f"at step {t}", PolicyError):
            actions.append(int(Action(chosen.act(map, read_only(observation)))))
            waypoints.append(None if chosen.waypoint is None else [round(float(v), 2) for v in chosen.waypoint])
        collided.append(sim.move(actions[-1]))
        length += float(np.linalg.norm(sim.pose[:2, 3] - true_poses[t, :2, 3]))
        if t + 1 < steps:
            observation = sim.observe()
            if estimator is not None:
                estimator.update(observation, actions[-1])
    meta: dict[str, Any] = {
        "scene": sim.scene.name,
        "scene_sha256": sim.scene.sha256,
        "policy": name,
        "seed": seed,
        "steps": steps,
        "supersample": sim.supersample,
        "noise": asdict(sim.noise),
        "depth_noise": sim.depth_noise,
        **({} if sim.semantics == TRUE else {"semantics": sim.semantics}),
        "actions": actions,
        "collided": collided,
        "explored_m2": explored,
        "path_m": path,
        "waypoints": waypoints,
    }
    noisy = sim.noise.actuation or sim.noise.odometry
    trajectory = Trajectory(measured, rgb, depth, semantics, sim.intrinsics, meta, confidence=confidence)
    if noisy:
        trajectory = replace(trajectory, pose_source="odometry", other_poses={"true": true_poses})
    if estimator is not None:
        estimator.finish()
        meta["pose_std"] = spread
        return trajectory.with_poses("estimated", estimator.trajectory)
    return trajectory.with_poses("true") if poses == "true" else trajectory


def _redrawn(size: int, intrinsics: Intrinsics, poses: np.ndarray, depth: np.ndarray, semantics: np.ndarray) -> Mapper:
    """Return a mapper with the map of recorded images at corrected poses."""
    mapper = Mapper(empty_map(poses[0], size), intrinsics, grows=True)
    for pose, image, labels in zip(poses, depth, semantics, strict=False):
        mapper.add(Observation(labels, image, labels, pose))
    return mapper
