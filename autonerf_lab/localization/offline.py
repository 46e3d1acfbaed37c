"""Pose estimation on a recorded trajectory, as it would have run on the robot."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import DataError, UnknownNameError
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.localization.estimator import PoseEstimator
from autonerf_lab.localization.odometry import OdometryModel
from autonerf_lab.simulator.motion_noise import MotionNoise
from autonerf_lab.types import Observation


def _learned(intrinsics: Intrinsics, model: OdometryModel) -> PoseEstimator:
    from autonerf_lab.localization.learned import LearnedOdometry

    return PoseEstimator(intrinsics, model, scans=False, learned=LearnedOdometry())


ESTIMATORS: dict[str, Callable[[Intrinsics, OdometryModel], PoseEstimator]] = {
    "calibrated": partial(PoseEstimator, scans=False),
    "learned": _learned,
    "scan-matching": partial(PoseEstimator, loops=False),
    "pose-graph": PoseEstimator,
}


def estimate_poses(trajectory: Trajectory, estimator: str = "pose-graph") -> Trajectory:
    """Estimate the poses of a recorded trajectory from its odometry and depth images, and make them active.

    Args:
        trajectory: recorded with noise by :func:`autonerf_lab.explore`, which records odometry, depth and actions.
        estimator: ``calibrated`` (odometry without its mean error), ``learned`` (each motion corrected by a network),
            ``scan-matching`` (with recent keyframes) or ``pose-graph`` (with loop closures).

    Returns:
        The trajectory with the poses ``estimated``; ``meta`` contains ``pose_std``, the standard deviations of x, y
        (metres) and heading (radians) after each step.

    Raises:
        UnknownNameError: there is no estimator of that name.
        DataError: the trajectory has no poses by odometry, no depth or no actions.

    Example::

        better = lab.estimate_poses(lab.explore(noisy_simulator, "frontier"))
    """
    if estimator not in ESTIMATORS:
        raise UnknownNameError("pose estimator", estimator, ESTIMATORS)
    odometry, depth, meta = trajectory.with_poses("odometry").poses, trajectory.depth, trajectory.meta
    if depth is None:
        raise DataError("poses cannot be estimated without depth images")
    actions, noise = meta.get("actions"), meta.get("noise")
    if not isinstance(actions, list) or len(actions) < len(trajectory) - 1 or not isinstance(noise, dict):
        raise DataError("poses can be estimated only for trajectories of lab.explore: 'actions' or 'noise' is missing")
    try:
        model = OdometryModel.from_noise(MotionNoise(**noise))
    except TypeError as error:
        raise DataError(f"the noise of the trajectory has other keys than those of this version: {error}") from error
    chosen = ESTIMATORS[estimator](trajectory.intrinsics, model)
    blank = np.zeros(depth.shape[1:], np.uint8)
    observations = (Observation(blank, image, blank, pose) for image, pose in zip(depth, odometry, strict=True))
    chosen.start(next(observations))
    spread = [chosen.standard_deviations]
    for observation, action in zip(observations, actions, strict=False):
        chosen.update(observation, action)
        spread.append(chosen.standard_deviations)
    chosen.finish()
    found: dict[str, Any] = {**meta, "pose_std": spread}
    return replace(trajectory.with_poses("estimated", chosen.trajectory), meta=found)
