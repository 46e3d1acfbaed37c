"""Fast marching, and the local policy that follows it with the robot's three actions."""

from autonerf_lab.planning.dilation import dilate
from autonerf_lab.planning.fast_marching import descend, path_length, travel_distance, weighted_success
from autonerf_lab.planning.local_policy import LocalPolicy

__all__ = ["LocalPolicy", "descend", "dilate", "path_length", "travel_distance", "weighted_success"]
