"""Posed images: trajectories, photographs, and the ``transforms.json`` format of both."""
