"""Readers of Habitat's files: datasets, stages, objects, scene instances, and the semantics of HM3D."""

from autonerf_lab.scenes.habitat.composite import is_habitat_config, load_config

__all__ = ["is_habitat_config", "load_config"]
