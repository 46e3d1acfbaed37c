"""Top-down semantic map."""

from autonerf_lab.mapping.semantic_map import Mapper, empty_map, enlarged, update

__all__ = ["Mapper", "empty_map", "enlarged", "update"]
