"""Where a thing may stand: no overlap, no door or window blocked, and the robot still gets everywhere."""

import numpy as np
from scipy import ndimage
from shapely import prepare
from shapely.geometry import box

from autonerf_lab.geometry import AGENT_RADIUS
from autonerf_lab.scenes.furniture_model import Model
from autonerf_lab.scenes.layout import WALL, Layout, Rect, Thing
from autonerf_lab.scenes.structure import openings_on

CELL = 0.05  # metres, grid of the reachability check
DOOR_ZONE = 0.75  # metres kept free on both sides of a doorway
SKIN = 0.014  # between a back and the wall: the skirting board
HEADROOM = 1.0  # what starts above is no obstacle to the robot


class Placer:
    """Keeps the floor plan of what stands where, and refuses what does not fit."""

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self.shapes = [room.shape for room in layout.rooms]
        self.inner = [shape.buffer(1e-3) for shape in self.shapes]
        for shape in self.inner:
            prepare(shape)
        self.fronts: list[Rect] = []  # floor kept free before cupboards and seats
        corners = np.concatenate([np.array(room.polygon) for room in layout.rooms])
        self.origin = corners.min(axis=0) - 0.3
        cols, rows = np.ceil((corners.max(axis=0) + 0.3 - self.origin) / CELL).astype(int)
        self.x = self.origin[0] + (np.arange(cols) + 0.5) * CELL
        self.y = self.origin[1] + (np.arange(rows) + 0.5) * CELL
        self.free = np.zeros((rows, cols), dtype=bool)
        self.room_of = np.full((rows, cols), -1)
        floor = np.zeros((rows, cols), dtype=bool)
        for index, room in enumerate(layout.rooms):
            low, high = np.array(room.polygon).min(axis=0), np.array(room.polygon).max(axis=0)
            hole = len(room.polygon) > 4
            inside = self._mask((*low, *high), 0.0)
            if hole:
                from shapely import contains_xy

                xx, yy = np.meshgrid(self.x, self.y)
                inside &= contains_xy(self.shapes[index], xx, yy)
            floor |= inside
            self.room_of[inside] = index
        self.doors: list[Rect] = []
        for o in layout.openings:
            d, at = np.abs(np.array(o.direction)), np.array(o.at)
            across = d[::-1]
            if o.kind != "window":
                reach = d * (o.width / 2 + 0.08) + across * DOOR_ZONE
                self.doors.append((*(at - reach), *(at + reach)))
            if o.kind == "door":
                gap = d * o.width / 2 + across * (WALL / 2 + CELL)
                floor |= self._mask((*(at - gap), *(at + gap)), 0.0)
        self.free = ndimage.distance_transform_edt(floor) * CELL > AGENT_RADIUS + CELL

    def _mask(self, rect: Rect, grow: float) -> np.ndarray:
        """Cells whose middle is within ``grow`` of the rectangle."""
        dx = np.maximum(np.maximum(rect[0] - self.x, self.x - rect[2]), 0)
        dy = np.maximum(np.maximum(rect[1] - self.y, self.y - rect[3]), 0)
        return dx[None, :] ** 2 + dy[:, None] ** 2 <= grow**2

    def _connected(self, blocked: np.ndarray) -> bool:
        """All that is free hangs together, small pockets apart, and every room keeps some of it."""
        free = self.free & ~blocked
        labels, count = ndimage.label(free)
        if count == 0:
            return False
        sizes = np.bincount(labels.ravel())
        sizes[0] = 0
        main = labels == int(sizes.argmax())
        if sizes.sum() - sizes.max() > 0.25 / CELL**2:
            return False
        kept = np.bincount(self.room_of[main & (self.room_of >= 0)], minlength=len(self.shapes))
        wanted = [min(0.4 if r.category == "bath" else 1.2, 0.12 * r.shape.area) for r in self.layout.rooms]
        return bool((kept * CELL**2 >= np.array(wanted)).all())

    def reserve(self, rect: Rect) -> bool:
        """Take this floor from the robot, unless that would cut its ways."""
        mask = self._mask(rect, AGENT_RADIUS + CELL)
        if not self._connected(mask):
            return False
        self.free &= ~mask
        return True

    def fits(self, room: int, rect: Rect, z: tuple[float, float], ignore_doors: bool = False) -> bool:
        """Inside the room, beside everything else, clear of doors and windows."""
        if not self.inner[room].covers(box(*rect)):
            return False
        low = z[0] < 2.0
        if low and not ignore_doors and any(_overlap(rect, zone) for zone in self.doors):
            return False
        return self.clear_of_things(room, rect, z) and not self._before_window(room, rect, z)

    def clear_of_things(self, room: int, rect: Rect, z: tuple[float, float]) -> bool:
        """Nothing but a rug stands or hangs in that box."""
        for thing in self.layout.things:
            level = z[0] < thing.height[1] - 1e-3 and thing.height[0] < z[1] - 1e-3
            if level and thing.room == room and thing.name != "rug" and _overlap(rect, thing.footprint):
                return False
        return True

    def _before_window(self, room: int, rect: Rect, z: tuple[float, float]) -> bool:
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
        model: Model,
        room: int,
        at: np.ndarray,
        yaw: float,
        z: float = 0.0,
        front: bool = True,
        ignore_doors: bool = False,
        check: bool = True,
    ) -> Thing | None:
        """Stand the model there if it fits; None if it does not."""
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
                others = (t for t in self.layout.things if t.room == room and t.height[0] < 1 and t.height[1] > 0.03)
                if any(_overlap(ahead, t.footprint) for t in others) or not self.inner[room].covers(box(*ahead)):
                    return None
            if not self.reserve(rect):
                return None
            if ahead is not None:
                self.fronts.append(ahead)
        thing = Thing(
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
        self.layout.things.append(thing)
        return thing

    def _front(self, model: Model, at: np.ndarray, yaw: float) -> Rect:
        forward = np.array([-np.sin(yaw), np.cos(yaw)])
        side = np.array([forward[1], -forward[0]])
        near = at + forward * model.size[1] / 2
        a = near - side * (model.size[0] / 2 - 0.02)
        b = near + side * (model.size[0] / 2 - 0.02) + forward * model.clear
        low, high = np.minimum(a, b), np.maximum(a, b)
        return (float(low[0]), float(low[1]), float(high[0]), float(high[1]))

    def spans(self, room: int, margin: float = 0.1) -> list[tuple[np.ndarray, np.ndarray, float, float]]:
        """Stretches of wall without a door: (p, direction, start, end), metres from p."""
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
        model: Model,
        room: int,
        rng: np.random.Generator,
        where: str = "any",
        z: float = 0.0,
        tries: int = 14,
        away: float | None = None,
        ignore_doors: bool = False,
    ) -> Thing | None:
        """Back to a wall: in a corner, in the middle of a wall, or anywhere."""
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
            whole = float(np.abs(corners - (p + along * end)).sum(axis=1).min()) < 1e-6  # no door ends this stretch
            ends = [low] * (start == 0.0) + [high] * whole or [low, high]
            t = {"corner": float(rng.choice(ends)), "middle": (low + high) / 2, "free": float(rng.uniform(low, high))}[
                kind
            ]
            inward = np.array([-along[1], along[0]])
            gap = SKIN if away is None else away
            at = p + along * t + inward * (d / 2 + gap)
            thing = self.put(
                model, room, at, float(np.arctan2(inward[1], inward[0]) - np.pi / 2), z, ignore_doors=ignore_doors
            )
            if thing is not None:
                return thing
        return None


def heading(direction: np.ndarray) -> float:
    """Yaw that turns a model's front (+y) to the direction."""
    return float(np.arctan2(direction[1], direction[0]) - np.pi / 2)


def _lowest(part: dict) -> float:
    if "lathe" not in part:
        return float(part["at"][2])
    below = -max(r for r, _ in part["lathe"]) if part.get("tilt") else min(z for _, z in part["lathe"])
    return float(part["at"][2]) + below


def _overlap(a: Rect, b: Rect) -> bool:
    e = 2e-3
    return a[0] < b[2] - e and b[0] < a[2] - e and a[1] < b[3] - e and b[1] < a[3] - e
