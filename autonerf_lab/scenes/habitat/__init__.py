"""Readers of Habitat's files: datasets, stages, objects, scene instances, and semantics of HM3D and Matterport3D."""

from autonerf_lab.scenes.habitat.composite import add_labels, is_habitat_config, load_config

__all__ = ["add_labels", "is_habitat_config", "load_config"]
