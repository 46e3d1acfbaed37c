"""Playback of recorded trajectories: in a notebook, as a page, as a video."""

from autonerf_lab.viz.player.player import Player, play

__all__ = ["Player", "play"]
