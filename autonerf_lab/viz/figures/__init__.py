"""Figures of evaluations, trajectories and trainings; each function returns a matplotlib Figure."""

from autonerf_lab.viz.figures.drift import pose_drift, pose_maps, trajectory_drift
from autonerf_lab.viz.figures.evaluation import (
    bird_view,
    confusion,
    map_overlay,
    mesh_view,
    planned_paths,
    refinement_trace,
    render_comparison,
    trajectory_view,
)
from autonerf_lab.viz.figures.finetuning import finetuning_results
from autonerf_lab.viz.figures.geometry import cross_section, density_sections, depth_errors
from autonerf_lab.viz.figures.maps import draw_map, draw_robot, map_extent
from autonerf_lab.viz.figures.navigation import navigation_paths
from autonerf_lab.viz.figures.rollouts import rollouts
from autonerf_lab.viz.figures.segmentation import reliability_diagram, segmentation_failures, segmentation_views
from autonerf_lab.viz.figures.style import BLUE, GREEN, ORANGE, SKY, YELLOW, class_legend, empty_figure, plain_log
from autonerf_lab.viz.figures.training import learning_curve, running_mean
from autonerf_lab.viz.figures.trajectory import explored_area, refinement_frames, shown_pose, trajectory_frames

__all__ = [
    "BLUE",
    "GREEN",
    "ORANGE",
    "SKY",
    "YELLOW",
    "bird_view",
    "class_legend",
    "confusion",
    "cross_section",
    "density_sections",
    "depth_errors",
    "draw_map",
    "draw_robot",
    "empty_figure",
    "explored_area",
    "finetuning_results",
    "learning_curve",
    "map_extent",
    "map_overlay",
    "mesh_view",
    "navigation_paths",
    "plain_log",
    "planned_paths",
    "pose_drift",
    "pose_maps",
    "refinement_frames",
    "refinement_trace",
    "reliability_diagram",
    "render_comparison",
    "rollouts",
    "running_mean",
    "segmentation_failures",
    "segmentation_views",
    "shown_pose",
    "trajectory_drift",
    "trajectory_frames",
    "trajectory_view",
]
