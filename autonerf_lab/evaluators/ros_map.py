"""Occupancy map of a radiance field in the format of ROS ``map_server``: a PGM image and a YAML file with its frame."""

from pathlib import Path
from typing import Any

import numpy as np

from autonerf_lab.errors import DataError
from autonerf_lab.evaluators.ground_truth import MapGrid
from autonerf_lab.evaluators.maps import CellState, predict_states
from autonerf_lab.evaluators.mesh import surface_bounds
from autonerf_lab.evaluators.radiance_field import RadianceField
from autonerf_lab.utils.storage import write_bytes

_GREY = {CellState.FREE: 254, CellState.OCCUPIED: 0, CellState.UNKNOWN: 205}  # as map_saver writes them


class _Lowered:
    """Field whose floor is at z = 0."""

    def __init__(self, field: RadianceField, floor: float) -> None:
        self._field, self._shift = field, np.array([0.0, 0.0, floor], np.float32)

    def seen(self, points: np.ndarray) -> np.ndarray:
        """Return whether training views saw (N, 3) points."""
        return self._field.seen(points + self._shift)

    def density(self, points: np.ndarray) -> np.ndarray:
        """Return the density at (N, 3) points."""
        return self._field.density(points + self._shift)


def export_ros_map(field: RadianceField, path: str | Path, cell: float = 0.05, floor: float = 0.0) -> Path:
    """Write the occupancy map of a field for ``map_server``.

    A cell is occupied if the field is opaque between 0.10 and 0.88 m above the floor, unknown if no training view saw
    it, else free.

    Args:
        field: a trained field in metres, z up.
        path: the ``.yaml`` file; the image gets the same name and the suffix ``.pgm``.
        cell: side of a cell, metres.
        floor: height of the floor, metres; 0 in fields of this package's trajectories.

    Returns:
        The path of the YAML file. Its ``origin`` is the lower left corner of the image in the world frame of the field.

    Raises:
        DataError: another suffix, or a file that cannot be written.
    """
    path = Path(path)
    if path.suffix != ".yaml":
        raise DataError(f"{path}: the suffix of a map must be .yaml; the image is written beside it as .pgm")
    bounds = surface_bounds(field)
    if not np.ptp(bounds):
        raise DataError(f"{path}: the field has no surface that a training view has seen")
    grid = MapGrid.over(bounds, cell)
    lowered: Any = _Lowered(field, floor)
    return write_map(predict_states(lowered, grid), grid, path)


def write_map(states: np.ndarray, grid: MapGrid, path: Path) -> Path:
    """Write the image and the YAML file of a map.

    Args:
        states: (R, C) of :class:`~autonerf_lab.evaluators.maps.CellState`, row = y.
        grid: its frame.
        path: the ``.yaml`` file.
    """
    grey = np.full(states.shape, _GREY[CellState.UNKNOWN], np.uint8)
    for state, value in _GREY.items():
        grey[states == state] = value
    image, (rows, columns) = path.with_suffix(".pgm"), grid.shape
    write_bytes(image, f"P5\n{columns} {rows}\n255\n".encode() + grey[::-1].tobytes())  # row 0: largest y
    x, y = (float(value) for value in grid.origin)
    text = (
        "# Frame: world of the radiance field (ROS: map), metres, z up.\n"
        f"image: {image.name}\nresolution: {grid.cell:g}\norigin: [{x:.6f}, {y:.6f}, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    write_bytes(path, text.encode())
    return path
