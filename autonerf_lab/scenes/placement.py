"""Placement of furniture: no overlap, no blocked door or window, and all rooms remain reachable for the robot."""

import numpy as np
from scipy import ndimage
from shapely import prepare
from shapely.geometry import box

from autonerf_lab.geometry import AGENT_RADIUS
from autonerf_lab.scenes.furniture_model import FurnitureModel
from autonerf_lab.scenes.layout import WALL, Layout, PlacedObject, Rect
from autonerf_lab.scenes.structure import openings_on

CELL = 0.05  # metres, grid of the reachability check
DOOR_ZONE = 0.75  # metres of floor kept free on both sides of a doorway
SKIRTING_GAP = 0.014  # metres between the back of furniture and the wall, for the skirting board
HEADROOM = 1.0  # metres; objects that begin above it are no obstacle to the robot


class Placer:
    """Occupancy of a floor plan that accepts or rejects new objects.

    Args:
        layout: Apartment with rooms and openings; accepted objects are added to it.
    """

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self.shapes = [room.shape for room in layout.rooms]
        self.inner = [shape.buffer(1e-3) for shape in self.shapes]  # with tolerance, for containment tests
        for shape in self.inner:
            prepare(shape)
        self.fronts: list[Rect] = []  # floor kept free in front of cupboards and seats
        corners = np.concatenate([np.array(room.polygon) for room in layout.rooms])
        self.origin = corners.min(axis=0) - 0.3
        cols, rows = np.ceil((corners.max(axis=0) + 0.3 - self.origin) / CELL).astype(int)
        self.x = self.origin[0] + (np.arange(cols) + 0.5) * CELL
        self.y = self.origin[1] + (np.arange(rows) + 0.5) * CELL
        self.room_of = np.full((rows, cols), -1)  # room of each cell, -1 = none
        floor = np.zeros((rows, cols), dtype=bool)
        for index, room in enumerate(layout.rooms):
            low, high = np.array(room.polygon).min(axis=0), np.array(room.polygon).max(axis=0)
            rectangular = len(room.polygon) == 4
            inside = self._cells_near((*low, *high), 0.0)
            if not rectangular:
                from shapely import contains_xy

                xx, yy = np.meshgrid(self.x, self.y)
                inside &= contains_xy(self.shapes[index], xx, yy)
            floor |= inside
            self.room_of[inside] = index
        self.doors: list[Rect] = []  # free zones of doors, entrance and stairs
        for o in layout.openings:
            d, at = np.abs(np.array(o.direction)), np.array(o.at)
            across = d[::-1]
            if o.kind != "window":
                reach = d * (o.width / 2 + 0.08) + across * DOOR_ZONE
                self.doors.append((*(at - reach), *(at + reach)))
            if o.kind == "door":
                gap = d * o.width / 2 + across * (WALL / 2 + CELL)
                floor |= self._cells_near((*(at - gap), *(at + gap)), 0.0)
        self.doors += layout.kept_free
        # cells where the centre of the robot can be
        self.free = ndimage.distance_transform_edt(floor) * CELL > AGENT_RADIUS + CELL
        for item in layout.objects:  # stairs
            self.free &= ~self._cells_near(item.footprint, AGENT_RADIUS + CELL)

    def _cells_near(self, rect: Rect, grow: float) -> np.ndarray:
        """Return the cells whose centre is within ``grow`` metres of a rectangle, (rows, cols) bool."""
        dx = np.maximum(np.maximum(rect[0] - self.x, self.x - rect[2]), 0)
        dy = np.maximum(np.maximum(rect[1] - self.y, self.y - rect[3]), 0)
        return dx[None, :] ** 2 + dy[:, None] ** 2 <= grow**2

    def _connected(self, blocked: np.ndarray) -> bool:
        """Return True if the free cells stay connected, up to small pockets, and every room keeps enough of them."""
        free = self.free & ~blocked
        labels, count = ndimage.label(free)
        if count == 0:
            return False
        sizes = np.bincount(labels.ravel())
        sizes[0] = 0
        main = labels == int(sizes.argmax())
        if sizes.sum() - sizes.max() > 0.25 / CELL**2:
            return False
        reachable = np.bincount(self.room_of[main & (self.room_of >= 0)], minlength=len(self.shapes))
        required = [min(0.4 if r.category == "bath" else 1.2, 0.12 * r.shape.area) for r in self.layout.rooms]
        return bool((reachable * CELL**2 >= np.array(required)).all())

    def reserve(self, rect: Rect) -> bool:
        """Mark a rectangle as blocked for the robot; return False if that would disconnect the free floor."""
        mask = self._cells_near(rect, AGENT_RADIUS + CELL)
        if not self._connected(mask):
            return False
        self.free &= ~mask
        return True

    def fits(self, room: int, rect: Rect, z: tuple[float, float], ignore_doors: bool = False) -> bool:
        """Return True if a box is inside a room and clear of other objects, doors and windows.

        Args:
            room: Index of the room.
            rect: Footprint, world frame, metres.
            z: Lower and upper end of the box, metres.
            ignore_doors: Allow the box in the free zones of doors.
        """
        if not self.inner[room].covers(box(*rect)):
            return False
        low = z[0] < 2.0
        if low and not ignore_doors and any(_overlap(rect, zone) for zone in self.doors):
            return False
        return self.clear_of_objects(room, rect, z) and not self._blocks_window(room, rect, z)

    def clear_of_objects(self, room: int, rect: Rect, z: tuple[float, float]) -> bool:
        """Return True if no object except rugs intersects a box."""
        for item in self.layout.objects:
            level = z[0] < item.height[1] - 1e-3 and item.height[0] < z[1] - 1e-3
            if level and item.room == room and item.name != "rug" and _overlap(rect, item.footprint):
                return False
        return True

    def _blocks_window(self, room: int, rect: Rect, z: tuple[float, float]) -> bool:
        """Return True if a box would stand in front of a window pane."""
        for o in self.layout.openings:
            if o.kind == "window" and o.rooms[0] == room and z[1] > o.low + 0.02 and z[0] < o.high:
                d, at = np.array(o.direction), np.array(o.at)
                inward = np.array([-d[1], d[0]])
                a, b = at - d * (o.width / 2 + 0.03), at + d * (o.width / 2 + 0.03) + inward * 0.3
                low, high = np.minimum(a, b), np.maximum(a, b)
                if _overlap(rect, (*low, *high)):
                    return True
        return False

    def put(
        self,
        model: FurnitureModel,
        room: int,
        at: np.ndarray,
        yaw: float,
        z: float = 0.0,
        front: bool = True,
        ignore_doors: bool = False,
        check: bool = True,
    ) -> PlacedObject | None:
        """Place a model in a room if it fits.

        Args:
            model: Model to place.
            room: Index of the room.
            at: (2,) world x, y of the model's origin, metres.
            yaw: Rotation about z, radians; 0 lets the front face +y.
            z: Height of the model's origin, metres.
            front: Keep the floor in front of the model free (``model.clear``).
            ignore_doors: Allow the model in the free zones of doors.
            check: False places the model without any test.

        Returns:
            The placed object, or None if it does not fit.
        """
        c, s = abs(np.cos(yaw)), abs(np.sin(yaw))
        half = np.array([c * model.size[0] + s * model.size[1], s * model.size[0] + c * model.size[1]]) / 2
        rect = (float(at[0] - half[0]), float(at[1] - half[1]), float(at[0] + half[0]), float(at[1] + half[1]))
        bottom = z + min(_lowest(part) for part in model.parts)
        height = (bottom, z + model.size[2])
        if check and not self.fits(room, rect, height, ignore_doors):
            return None
        if check and height[0] < HEADROOM and height[1] > 0.03:
            ahead = self._front(model, at, yaw) if front and model.clear else None
            if any(_overlap(rect, zone) for zone in self.fronts):
                return None
            if ahead is not None:
                others = (t for t in self.layout.objects if t.room == room and t.height[0] < 1 and t.height[1] > 0.03)
                if any(_overlap(ahead, t.footprint) for t in others) or not self.inner[room].covers(box(*ahead)):
                    return None
            if not self.reserve(rect):
                return None
            if ahead is not None:
                self.fronts.append(ahead)
        item = PlacedObject(
            model.class_id,
            model.name,
            (float(at[0]), float(at[1]), float(z)),
            float(yaw),
            model.parts,
            rect,
            height,
            room,
            model.surfaces,
        )
        self.layout.objects.append(item)
        return item

    def _front(self, model: FurnitureModel, at: np.ndarray, yaw: float) -> Rect:
        """Return the floor that must stay free in front of a model."""
        forward = np.array([-np.sin(yaw), np.cos(yaw)])
        side = np.array([forward[1], -forward[0]])
        near = at + forward * model.size[1] / 2
        a = near - side * (model.size[0] / 2 - 0.02)
        b = near + side * (model.size[0] / 2 - 0.02) + forward * model.clear
        low, high = np.minimum(a, b), np.maximum(a, b)
        return (float(low[0]), float(low[1]), float(high[0]), float(high[1]))

    def spans(self, room: int, margin: float = 0.1) -> list[tuple[np.ndarray, np.ndarray, float, float]]:
        """Return the parts of the walls of a room that have no door; windows are allowed.

        Args:
            room: index of the room.
            margin: distance kept from every door, metres.

        Returns:
            One tuple (p, direction, start, end) for each part of more than 15 cm: a corner of the room, (2,) x, y,
            metres; the unit vector along the wall; and start and end of the part, in metres from the corner.
        """
        found = []
        for p, q in self.layout.rooms[room].edges():
            length = float(np.linalg.norm(q - p))
            d = (q - p) / length
            free = 0.0
            for start, end, opening in openings_on(self.layout, room, p, q):
                if opening.kind != "window":
                    found.append((p, d, free, start - margin))
                    free = end + margin
            found.append((p, d, free, length))
        return [span for span in found if span[3] - span[2] > 0.15]

    def along_wall(
        self,
        model: FurnitureModel,
        room: int,
        rng: np.random.Generator,
        where: str = "any",
        z: float = 0.0,
        tries: int = 14,
        away: float | None = None,
        ignore_doors: bool = False,
    ) -> PlacedObject | None:
        """Place a model with its back to a wall, at a sampled position.

        Args:
            model: Model to place.
            room: Index of the room.
            rng: Random generator of the position.
            where: ``corner``, ``middle`` (of a stretch of wall), ``free`` (uniform) or ``any``.
            z: Height of the model's origin, metres.
            tries: Number of sampled positions.
            away: Gap between back and wall, metres; default: the thickness of the skirting board.
            ignore_doors: Allow the model in the free zones of doors.

        Returns:
            The placed object, or None if no sampled position fits.
        """
        w, d, _ = model.size
        spans = [s for s in self.spans(room) if s[3] - s[2] >= w + 0.02]
        if not spans:
            return None
        weights = np.array([s[3] - s[2] for s in spans])
        for _ in range(tries):
            p, along, start, end = spans[int(rng.choice(len(spans), p=weights / weights.sum()))]
            low, high = start + w / 2 + 0.01, end - w / 2 - 0.01
            kind = where if where != "any" else ("corner" if rng.random() < 0.45 else "free")
            corners = np.array(self.layout.rooms[room].polygon)
            whole = (
                float(np.abs(corners - (p + along * end)).sum(axis=1).min()) < 1e-6
            )  # the stretch ends in a corner of the room, not at a door
            ends = [low] * (start == 0.0) + [high] * whole or [low, high]
            t = {"corner": float(rng.choice(ends)), "middle": (low + high) / 2, "free": float(rng.uniform(low, high))}[
                kind
            ]
            inward = np.array([-along[1], along[0]])
            gap = SKIRTING_GAP if away is None else away
            at = p + along * t + inward * (d / 2 + gap)
            item = self.put(model, room, at, yaw_facing(inward), z, ignore_doors=ignore_doors)
            if item is not None:
                return item
        return None


def yaw_facing(direction: np.ndarray) -> float:
    """Return the yaw, radians, that rotates the front of a model (+y) to a direction (2,)."""
    return float(np.arctan2(direction[1], direction[0]) - np.pi / 2)


def _lowest(part: dict) -> float:
    """Return the lowest z of a part in the frame of its model."""
    if "lathe" not in part:
        return float(part["at"][2])
    below = -max(r for r, _ in part["lathe"]) if part.get("tilt") else min(z for _, z in part["lathe"])
    return float(part["at"][2]) + below


def _overlap(a: Rect, b: Rect) -> bool:
    e = 2e-3
    return a[0] < b[2] - e and b[0] < a[2] - e and a[1] < b[3] - e and b[1] < a[3] - e
