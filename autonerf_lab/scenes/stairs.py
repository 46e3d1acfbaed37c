"""Stairs between two floors: two flights with a landing, the stairwell above them, and a railing on the second floor.

The frame of the stairs has its origin in the middle of the front edge, on the floor; +y leads into the stairwell. The
left flight rises away from the corridor to the landing, the right flight returns to the front edge.
"""

import numpy as np
from shapely.geometry import Point, Polygon

from autonerf_lab.scenes.layout import WALL, Layout, PlacedObject, Rect

SLAB = 0.3  # metres between the ceiling of the first and the floor of the second floor
RISERS = 16  # an even number: half of them lead to the landing
LANDING = 1.0  # metres, smallest depth
TREAD = 0.28  # metres, largest depth of a step
FREE = 0.9  # metres of floor kept free in front of the stairs
_FLIGHT = 0.25  # metres, thickness of the upper flight and of the landing
_RAIL = 0.9  # metres above a step


def stairwell_of(corridor: list[tuple[float, float]], stairs: Rect) -> tuple[Rect, np.ndarray]:
    """Return the inner rectangle of the stairs and the unit vector (2,) from the corridor into them.

    Args:
        corridor: Inner outline of the corridor, which includes the stairs.
        stairs: Rectangle of the stairs up to the middle of the walls.
    """
    outline = Polygon(corridor).exterior
    x0, y0, x1, y1 = stairs
    middle = np.array([(x0 + x1) / 2, (y0 + y1) / 2])
    half = np.array([(x1 - x0) / 2, (y1 - y0) / 2])
    sides = [np.array(s, dtype=float) for s in ((1, 0), (-1, 0), (0, 1), (0, -1))]
    open_side = max(sides, key=lambda s: outline.distance(Point(middle + s * half)))
    low, high = np.array([x0, y0]) + WALL / 2, np.array([x1, y1]) - WALL / 2
    low, high = low - (open_side < -0.5) * WALL, high + (open_side > 0.5) * WALL  # up to the wall face of the corridor
    return (float(low[0]), float(low[1]), float(high[0]), float(high[1])), -open_side


def place_stairs(layout: Layout) -> None:
    """Place the stairs on the first floor, and the railing above them on the second, before any furniture."""
    if layout.stairwell is None:
        return
    x0, y0, x1, y1 = layout.stairwell
    inward = np.array(layout.stairs_inward)
    along = np.array([inward[1], -inward[0]])  # right of a person who looks into the stairwell
    size = np.array([x1 - x0, y1 - y0])
    middle = np.array([(x0 + x1) / 2, (y0 + y1) / 2])
    width, depth = float(abs(along) @ size), float(abs(inward) @ size)
    front = middle - inward * depth / 2
    yaw = float(np.arctan2(along[1], along[0]))
    rise = layout.height + SLAB
    if layout.storey == 0:
        name, parts, top = "stairs", stairs_parts(width, depth, rise), rise
    else:
        name, parts, top = "railing", _railing(width), layout.height
    at = (float(front[0]), float(front[1]), 0.0)
    hall = len(layout.rooms) - 1
    layout.objects.append(PlacedObject(0, name, at, yaw, parts, layout.stairwell, (0.0, top), hall))
    corners = np.stack([front - along * width / 2, front + along * width / 2 - inward * FREE])
    layout.kept_free.append((*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist()))


def stairs_parts(width: float, depth: float, rise: float) -> list[dict]:
    """Return the solids of the stairs in their own frame.

    Args:
        width: Of the stairwell, metres.
        depth: Of the stairwell, metres.
        rise: Height from floor to floor, metres.

    Example:
        >>> parts = stairs_parts(2.1, 3.2, 2.88)
        >>> max(round(part["at"][2] + part["box"][2], 2) for part in parts if part["box"][0] > 0.9)  # of the steps
        2.88
    """
    half, height = RISERS // 2, rise / RISERS
    wide = width / 2 - 0.06
    start = 0.22  # metres of the front edge that belong to the second floor
    tread = min(TREAD, (depth - LANDING - start) / (half - 1))
    end = start + tread * (half - 1)
    left, right = -(width - wide) / 2, (width - wide) / 2
    parts: list[dict] = []

    def step(x: float, y: float, deep: float, top: float, thick: float) -> None:
        box = [wide, deep, thick]
        parts.append({"box": box, "at": [x, y + deep / 2, top - thick], "m": "wood_table"})

    for k in range(1, half):
        step(left, start + (k - 1) * tread, tread, k * height, k * height)
        step(right, end - k * tread, tread, (half + k) * height, _FLIGHT)
    step(right, 0.0, start, rise, _FLIGHT)
    landing = {"box": [width, depth - end, _FLIGHT], "at": [0, (end + depth) / 2, half * height - _FLIGHT]}
    parts.append({**landing, "m": "wood_table"})
    slope, length = float(np.arctan2(height, tread)), float(np.hypot(height, tread) * (half - 2))
    inner = width / 2 - wide
    for x, first, sign in ((-inner + 0.03, height, 1), (inner - 0.03, rise - height, -1)):
        for k in range(half - 1):
            post = [x, start + (k + 0.5) * tread, first + sign * k * height]
            parts.append({"box": [0.03, 0.03, _RAIL], "at": post, "m": "metal"})
        middle = [x, start + (half - 1) * tread / 2, first + sign * (half - 2) * height / 2 + _RAIL]
        rail: dict = {"box": [0.05, length, 0.05], "at": middle, "tilt": sign * slope, "m": "wood_table"}
        parts.append(rail)
    return parts


def _railing(width: float) -> list[dict]:
    """Return the railing of the second floor along the front edge above the lower flight."""
    left = -width / 2
    parts = [{"box": [width / 2, 0.05, 0.05], "at": [left / 2, 0.03, _RAIL], "m": "wood_table"}]
    count = round(width / 2 / 0.12)
    for k in range(count + 1):
        x = left + 0.02 + (width / 2 - 0.04) * k / count
        parts.append({"box": [0.025, 0.025, _RAIL], "at": [x, 0.03, 0], "m": "metal"})
    return parts


def slab_edges(layout: Layout) -> list[dict]:
    """Return the four faces of the slab around the stairwell, in the frame of the first floor."""
    if layout.stairwell is None or layout.storey:
        return []
    x0, y0, x1, y1 = layout.stairwell
    corners = [np.array(c) for c in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))]
    parts = []
    for p, q in zip(corners, corners[1:] + corners[:1], strict=True):
        u = p - q
        edge = [[float(u[0]), float(u[1]), 0], [0, 0, SLAB]]
        parts.append({"quad": edge, "at": [*q.tolist(), layout.height], "m": "ceiling"})
    return parts


def cut_out(rects: list[Rect], hole: Rect | None) -> list[Rect]:
    """Return rectangles that cover the given ones without a hole.

    Example:
        >>> cut_out([(0, 0, 3, 3)], (1, 0, 2, 2))
        [(0, 0, 1, 3), (2, 0, 3, 3), (1, 2, 2, 3)]
    """
    if hole is None:
        return rects
    found: list[Rect] = []
    for x0, y0, x1, y1 in rects:
        a, b = max(x0, min(x1, hole[0])), max(x0, min(x1, hole[2]))
        c, d = max(y0, min(y1, hole[1])), max(y0, min(y1, hole[3]))
        if b - a < 1e-6 or d - c < 1e-6:
            found.append((x0, y0, x1, y1))
            continue
        pieces = [(x0, y0, a, y1), (b, y0, x1, y1), (a, y0, b, c), (a, d, b, y1)]
        found += [r for r in pieces if r[2] - r[0] > 1e-6 and r[3] - r[1] > 1e-6]
    return found
