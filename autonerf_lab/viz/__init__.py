"""Visualisation: figures, trajectory player, field viewer, videos and point clouds."""

from autonerf_lab.viz.alt_text import register

register()  # in a notebook: figures get text alternatives as soon as anything here is imported
