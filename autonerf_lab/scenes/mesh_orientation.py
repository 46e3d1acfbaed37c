"""Alignment of an imported mesh: the axis that points up, and the floor."""

from pathlib import Path

import numpy as np

from autonerf_lab.errors import SceneError

MIN_FLOOR = 0.5  # m2
HEAD_ROOM = 1.2  # metres; horizontal surfaces with less space above are ceilings or tops of furniture
_LOWEST = 0.5  # metres, least height of a scene whose up axis can be found
_DOMINANCE = 1.5  # ratio of level surfaces from which the up axis differs from that of the format


def to_z_up(vertices: np.ndarray) -> np.ndarray:
    """Rotate (..., 3) positions with y up into a frame with z up; x stays.

    Example:
        >>> to_z_up(np.array([1.0, 2.0, 3.0])).tolist()
        [1.0, -3.0, 2.0]
    """
    return vertices[..., [0, 2, 1]] * np.array([1.0, -1.0, 1.0])


def find_up(path: Path, vertices: np.ndarray, faces: np.ndarray) -> tuple[str, str]:
    """Find the axis that points up in a file: y or z.

    The axis of the format (y for GLB and OBJ, z for PLY) stands unless the other one has clearly more level surface
    and a smaller extent: many datasets store z-up scans in GLB files.

    Returns:
        The axis, and a sentence that says why.
    """
    expected = "z" if path.suffix.lower() == ".ply" else "y"
    other = "y" if expected == "z" else "z"
    corners = vertices[faces]
    normal = np.abs(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])) / 2
    area = np.linalg.norm(normal, axis=1)
    level = {axis: float(area[normal[:, k] > 0.9 * area].sum()) for k, axis in ((1, "y"), (2, "z"))}
    extent = dict(zip("xyz", np.ptp(vertices, axis=0).tolist(), strict=True))
    text = f"{level[expected]:.0f} m2 of surface are level for {expected}, {level[other]:.0f} m2 for {other}"
    if level[other] > _DOMINANCE * level[expected] and _LOWEST < extent[other] < extent[expected]:
        return other, f"{other}, although {path.suffix} files have {expected} up: {text}"
    return expected, f"{expected}, as {path.suffix} files have it; {text}"


def floor_offset(path: Path, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the (3,) position that becomes the origin: the centre of the bounding box, at the height of the floor.

    The floor is the lowest height with a large horizontal area, without ceilings and downward faces.

    Raises:
        SceneError: There is no horizontal surface.
    """
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    area = np.linalg.norm(normal, axis=1)
    flat = np.abs(normal[:, 2]) > 0.9 * np.maximum(area, 1e-12)
    if area[flat].sum() < MIN_FLOOR:
        raise SceneError(
            f"{path} has no floor: no horizontal surface of {MIN_FLOOR} m2; check the up axis (up='y' or up='z')"
        )
    z = corners[..., 2].mean(axis=1)
    top = _quantile(corners[..., 2].max(axis=1), area, 0.99)  # quantile: ignore isolated fragments above
    under = flat & (z < top - HEAD_ROOM)
    flat = under if area[under].sum() >= MIN_FLOOR else flat
    facing = flat & (normal[:, 2] > 0)
    if area[facing].sum() > 0.25 * area[flat].sum():  # else: too many inverted faces to trust their side
        flat = facing
    z, area = z[flat], area[flat]
    low = z.min()
    height = np.bincount(((z - low) / 0.02).astype(int), weights=area)
    window = np.convolve(height, np.ones(7))[3 : 3 + len(height)]  # 14 cm: scanned floors are uneven
    level = int(np.argmax(window > 0.25 * window.max()))
    level += int(np.argmax(window[level : level + 7]))
    near = np.abs(z - (low + 0.02 * (level + 0.5))) < 0.08
    floor = _quantile(z[near], area[near], 0.5)  # median: robust against rugs
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    return np.array([middle[0], middle[1], floor])


def _quantile(values: np.ndarray, weights: np.ndarray, share: float) -> float:
    """Return the weighted quantile of values."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, share * total[-1])])
