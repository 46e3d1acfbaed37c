"""The top-down semantic map."""

from autonerf_lab.mapping.semantic_map import empty_map, update

__all__ = ["empty_map", "update"]
