"""Bundle adjustment: refinement of rough camera poses."""

from autonerf_lab.bundle_adjustment.refine import describe_refinement, pose_deviations, refine_poses

__all__ = ["describe_refinement", "pose_deviations", "refine_poses"]
