"""Path planning by fast marching, and the local policy that follows waypoints."""

from autonerf_lab.planning.dilation import dilate
from autonerf_lab.planning.fast_marching import descend, path_length, travel_distance, weighted_success
from autonerf_lab.planning.local_policy import LocalPolicy

__all__ = ["LocalPolicy", "descend", "dilate", "path_length", "travel_distance", "weighted_success"]
