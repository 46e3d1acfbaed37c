"""Apartment layout that the stages of the generator fill: rooms, openings, objects, materials and lights.

Metres, radians, world frame, floor at z = 0.
"""

from dataclasses import dataclass, field

import numpy as np
from shapely.geometry import Polygon, box
from shapely.ops import unary_union

WALL = 0.12  # metres between the two faces of an inner wall
DOOR_HEIGHT = 2.05  # metres
LIVING = ("living", "open-plan", "studio")  # open-plan: includes a kitchen; studio: includes kitchen and bed
COOKING = ("kitchen", "open-plan", "studio")

Rect = tuple[float, float, float, float]  # x0, y0, x1, y1


@dataclass
class Room:
    """Room of an apartment."""

    category: str  # corridor, kitchen, bath, bedroom, study, dining, utility, or one of LIVING
    rects: list[Rect]  # floor area up to the middle of the walls
    polygon: list[tuple[float, float]] = field(default_factory=list)  # inner outline (wall faces), counter-clockwise

    @property
    def shape(self) -> Polygon:
        """Inner outline as a shapely polygon."""
        return Polygon(self.polygon)

    def edges(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return the walls as (p, q) with the room on the left of p -> q."""
        corners = [np.array(c) for c in self.polygon]
        return list(zip(corners, corners[1:] + corners[:1], strict=True))


@dataclass
class Opening:
    """Opening in a wall: doorway between two rooms, entrance or window."""

    kind: str  # door, entrance, window
    at: tuple[float, float]  # centre; on the inner wall face (window, entrance) or mid-wall (door)
    direction: tuple[float, float]  # unit vector along the wall
    width: float  # metres
    low: float  # z of its lower edge
    high: float  # z of its upper edge
    rooms: list[int]  # two room indices for a door, one for an entrance or a window


@dataclass
class PlacedObject:
    """Furniture model or small object placed in an apartment."""

    class_id: int  # 0..15
    name: str
    at: tuple[float, float, float]  # origin of its own frame in the world
    yaw: float  # rotation about z, counter-clockwise
    parts: list[dict]  # solids in its own frame
    footprint: Rect  # world frame
    height: tuple[float, float]  # z of its lowest and highest point
    room: int  # index of its room
    surfaces: list[tuple[float, float, float, float, float, float]] = field(default_factory=list)
    #   support surfaces for small objects, own frame: x0, y0, x1, y1, z, free height


@dataclass
class Layout:
    """Apartment under construction; each stage of the generator adds to it in place."""

    seed: int  # random seed of the apartment
    height: float  # z of the ceiling
    rooms: list[Room] = field(default_factory=list)
    openings: list[Opening] = field(default_factory=list)
    objects: list[PlacedObject] = field(default_factory=list)
    materials: dict[str, dict] = field(default_factory=dict)  # as in the specification, see ``spec``
    lights: list[dict] = field(default_factory=list)  # as in the specification
    storey: int = 0  # 0: first floor; every floor of a house is a layout of its own with its floor at z = 0
    stairwell: Rect | None = None  # opening in the ceiling of the first and in the floor of the second floor
    stairs_inward: tuple[float, float] = (0.0, 1.0)  # unit vector from the corridor into the stairwell
    kept_free: list[Rect] = field(default_factory=list)  # floor without furniture, besides that at the doors


def net_polygon(rects: list[Rect]) -> list[tuple[float, float]]:
    """Return the inner outline of a room from rectangles that reach to the middle of the walls.

    Example:
        >>> sorted(net_polygon([(0, 0, 2, 3)]))[0]
        (0.06, 0.06)
    """
    outline = unary_union([box(*r) for r in rects]).buffer(-WALL / 2, join_style="mitre").simplify(1e-6)
    corners = list(outline.exterior.coords)[:-1]
    if not outline.exterior.is_ccw:
        corners.reverse()
    return [(round(x, 3), round(y, 3)) for x, y in corners]
