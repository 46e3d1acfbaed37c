"""What the stages of the generator hand on: rooms, openings, things and lights. Metres, world frame, floor at z = 0."""

from dataclasses import dataclass, field

import numpy as np
from shapely.geometry import Polygon, box
from shapely.ops import unary_union

WALL = 0.12  # metres between the two faces of an inner wall
DOOR_HEIGHT = 2.05
LIVING = ("living", "open-plan", "studio")  # open-plan: with the kitchen in it; studio: with kitchen and bed
COOKING = ("kitchen", "open-plan", "studio")

Rect = tuple[float, float, float, float]  # x0, y0, x1, y1


@dataclass
class Room:
    """One room. ``rects`` reach to the middle of the walls; the polygon is what one can stand in."""

    category: str  # corridor, kitchen, bath, bedroom, study, or one of LIVING
    rects: list[Rect]
    polygon: list[tuple[float, float]] = field(default_factory=list)  # counter-clockwise

    @property
    def shape(self) -> Polygon:
        return Polygon(self.polygon)

    def edges(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Walls as (p, q), the room on the left of p -> q."""
        corners = [np.array(c) for c in self.polygon]
        return list(zip(corners, corners[1:] + corners[:1], strict=True))


@dataclass
class Opening:
    """A hole in a wall: a doorway between two rooms, the entrance, or a window (``rooms`` has one entry then)."""

    kind: str  # door, entrance, window
    at: tuple[float, float]  # its middle, on the inner face (windows, entrance) or on the middle of the wall (doors)
    direction: tuple[float, float]  # unit vector along the wall
    width: float
    low: float
    high: float
    rooms: list[int]


@dataclass
class Thing:
    """A piece of furniture or an object. The footprint is in the world; parts are in the thing's own frame."""

    class_id: int
    name: str
    at: tuple[float, float, float]
    yaw: float
    parts: list[dict]
    footprint: Rect
    height: tuple[float, float]  # z of its lowest and of its highest point
    room: int
    surfaces: list[tuple[float, float, float, float, float, float]] = field(default_factory=list)
    #   where small objects can stand, own frame: x0, y0, x1, y1, z, free height


@dataclass
class Layout:
    """An apartment on its way from a plan to a specification. Each stage adds to it."""

    seed: int
    height: float  # of the ceiling
    rooms: list[Room] = field(default_factory=list)
    openings: list[Opening] = field(default_factory=list)
    things: list[Thing] = field(default_factory=list)
    materials: dict[str, dict] = field(default_factory=dict)
    lights: list[dict] = field(default_factory=list)


def net_polygon(rects: list[Rect]) -> list[tuple[float, float]]:
    """Inner outline of a room whose rectangles reach to the middle of the walls.

    Example:
        >>> sorted(net_polygon([(0, 0, 2, 3)]))[0]
        (0.06, 0.06)
    """
    outline = unary_union([box(*r) for r in rects]).buffer(-WALL / 2, join_style="mitre").simplify(1e-6)
    corners = list(outline.exterior.coords)[:-1]
    if not outline.exterior.is_ccw:
        corners.reverse()
    return [(round(x, 3), round(y, 3)) for x, y in corners]
