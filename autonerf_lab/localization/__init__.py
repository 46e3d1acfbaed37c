"""Localization: calibrated odometry, scan matching, pose graph, and the errors of estimated trajectories."""

from autonerf_lab.localization.estimator import PoseEstimator
from autonerf_lab.localization.odometry import OdometryModel
from autonerf_lab.localization.offline import ESTIMATORS, estimate_poses
from autonerf_lab.localization.trajectory_alignment import align, transformed

__all__ = ["ESTIMATORS", "OdometryModel", "PoseEstimator", "align", "estimate_poses", "transformed"]
