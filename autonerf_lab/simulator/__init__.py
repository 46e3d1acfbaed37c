"""Simulator of a robot with a camera in a scene: images, rays, motion, collisions and noise."""

from autonerf_lab.simulator.motion_noise import MotionNoise
from autonerf_lab.simulator.navigation import NavigationGrid, build_navigation
from autonerf_lab.simulator.raycast import Hits, RayCaster
from autonerf_lab.simulator.simulator import Frame, Simulator

__all__ = ["Frame", "Hits", "MotionNoise", "NavigationGrid", "RayCaster", "Simulator", "build_navigation"]
