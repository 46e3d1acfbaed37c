"""Rollouts of a policy in a scene, and replay of their maps."""

from autonerf_lab.exploration.rollout import MAP_SIZE, explore
from autonerf_lab.exploration.visibility import visible_map

__all__ = ["MAP_SIZE", "explore", "visible_map"]
