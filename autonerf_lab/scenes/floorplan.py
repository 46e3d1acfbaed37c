"""Stages one and two: the plan of the rooms, then doors and windows.

Homes are laid out as architects of flats do it: a corridor with a band of rooms on either side, the living room across
its end, around its end (an L) or along it. Bands of unequal length give L-shaped outlines; the whole is mirrored and
turned at random.
"""

import numpy as np

from autonerf_lab.scenes.layout import DOOR_HEIGHT, WALL, Layout, Opening, Rect, Room, net_polygon

# category: smallest and largest area in m2, shortest side in m
PROGRAM = {
    "living": (17.0, 32.0, 3.5),
    "kitchen": (8.0, 13.0, 2.45),
    "bath": (4.6, 7.5, 1.85),
    "bedroom": (10.5, 17.0, 2.85),
    "study": (8.0, 12.0, 2.45),
}
MIN_AREA, MAX_AREA = 45.0, 140.0  # with the walls


def plan_rooms(layout: Layout, rng: np.random.Generator) -> None:
    """Fill ``layout.rooms``: 5 to 8 rooms on 40 to 140 m2, every one beside the corridor or the living room."""
    while True:
        size = int(rng.integers(0, 5))  # beyond living room, kitchen, bath and one bedroom
        extra = [[], ["bedroom"], ["bedroom", "study"], ["bedroom", "bedroom"], ["bedroom", "bedroom", "bath"]][size]
        shape = str(rng.choice(["across", "around", "along"]))
        rooms = _bands(shape, ["kitchen", "bath", "bedroom", *extra], rng)
        if rooms is not None:
            break
    _turn(rooms, rng)
    for room in rooms:
        room.polygon = net_polygon(room.rects)
    layout.rooms = rooms


def _bands(  # noqa: PLR0911  each return names one way in which a plan is no home
    shape: str, others: list[str], rng: np.random.Generator
) -> list[Room] | None:
    corridor = float(rng.uniform(1.32, 1.75))
    depths = [float(rng.uniform(2.75, 4.3)), float(rng.uniform(3.1, 4.6))]  # lower band, upper band
    others = [str(o) for o in rng.permutation(others)]
    others.sort(key=lambda o: o == "kitchen")  # the kitchen comes last in its band: beside the living room
    area = {k: float(rng.uniform(*PROGRAM[o][:2])) for k, o in enumerate(others)}
    bands: list[list[int]] = [[], []]
    filled = [0.0, 0.0]
    lower = [k for k in range(len(others)) if others[k] != "kitchen"]
    kitchen = others.index("kitchen")
    living_area = float(rng.uniform(*PROGRAM["living"][:2]))
    if shape == "along":
        filled[1] += living_area / depths[1]
    for k in lower:
        side = int(np.argmin(filled)) if rng.random() < 0.85 else int(rng.integers(2))
        bands[side].append(k)
        filled[side] += area[k] / depths[side]
    side = 0 if shape == "around" else int(np.argmin(filled))
    bands[side].append(kitchen)
    filled[side] += area[kitchen] / depths[side]
    y1, y2, y3 = depths[0], depths[0] + corridor, depths[0] + corridor + depths[1]
    rooms: list[Room] = []
    ends = [0.0, 0.0]
    stretch = [1.0, 1.0]
    if rng.random() < 0.6 and shape == "across" and min(filled) > 0:  # flush bands
        common = float(np.mean(filled))
        stretch = [common / f for f in filled]
    for side, (low, high) in enumerate([(0.0, y1), (y2, y3)]):
        x = 0.0
        for k in bands[side]:
            width = area[k] / depths[side] * stretch[side]
            if min(width, depths[side]) - WALL < PROGRAM[others[k]][2] - 0.25 or width > 6.5:
                return None
            rooms.append(Room(others[k], [(x, low, x + width, high)]))
            x += width
        ends[side] = x
    reach = max(ends)
    if shape == "across":  # the living room spans both bands and the corridor at their end
        width = living_area / y3
        if width < PROGRAM["living"][2] or min(ends) < reach - 2.2 or min(ends) < 2:
            return None
        # a shorter band ends at the living room too: its last room is stretched
        for side in (0, 1):
            if ends[side] < reach - 1e-6 and not _stretch_last(rooms, bands, side, reach):
                return None
        living: list[Rect] = [(reach, 0.0, reach + width, y3)]
        corridor_end = reach
    elif shape == "around":  # an L: the upper band's end and the corridor's end
        width = living_area / (depths[1] + corridor)
        start = ends[1]
        if width < PROGRAM["living"][2] or start < 1.9 or ends[0] < start + 1.2 or ends[0] > start + width + 0.9:
            return None
        end = max(start + width, ends[0])
        cut = float(rng.uniform(0.3, min(1.5, width / 3)))
        living = [(start, y2, end, y3), (start + cut, y1, end, y2)]
        corridor_end = start + cut
        reach = end
    else:
        width = living_area / depths[1]
        if width < PROGRAM["living"][2] or width > 8.0:
            return None
        living = [(ends[1], y2, ends[1] + width, y3)]
        corridor_end = max(ends[0], ends[1] + min(1.6, width))
        if corridor_end > ends[1] + width:
            return None
    rooms.append(Room("living", living))
    rooms.append(Room("corridor", [(0.0, y1, corridor_end, y2)]))
    total = sum((r[2] - r[0]) * (r[3] - r[1]) for room in rooms for r in room.rects)
    # every room of a band must open on the corridor or the living room
    for room in rooms[:-2]:
        x0, _, x1, y = room.rects[0]
        touch = min(x1, reach if shape == "around" and y < y2 else corridor_end) - x0
        if touch < 1.3:
            return None
    return rooms if MIN_AREA <= total <= MAX_AREA else None


def _stretch_last(rooms: list[Room], bands: list[list[int]], side: int, reach: float) -> bool:
    index = (0 if side == 0 else len(bands[0])) + len(bands[side]) - 1
    x0, y0, _, y1 = rooms[index].rects[0]
    area = (reach - x0) * (y1 - y0)
    if area > PROGRAM[rooms[index].category][1] * 1.35:
        return False
    rooms[index].rects[0] = (x0, y0, reach, y1)
    return True


def _turn(rooms: list[Room], rng: np.random.Generator) -> None:
    """Mirror and transpose at random; then move the lower corner to the origin and round to millimetres."""
    flip_x, flip_y, swap = (bool(v) for v in rng.integers(0, 2, 3))
    for room in rooms:
        turned = []
        for x0, y0, x1, y1 in room.rects:
            along = (-x1, -x0) if flip_x else (x0, x1)
            up = (-y1, -y0) if flip_y else (y0, y1)
            first, second = (up, along) if swap else (along, up)
            turned.append((first[0], second[0], first[1], second[1]))
        room.rects = turned
    low_x = min(r[0] for room in rooms for r in room.rects)
    low_y = min(r[1] for room in rooms for r in room.rects)
    for room in rooms:
        room.rects = [
            (round(a - low_x, 2), round(b - low_y, 2), round(c - low_x, 2), round(d - low_y, 2))
            for a, b, c, d in room.rects
        ]


def _walls_between(a: Room, b: Room) -> list[tuple[np.ndarray, np.ndarray]]:
    """Stretches of wall the two rooms share, as (start, end) on the middle of the wall."""
    found = []
    for p, q in a.edges():
        d = (q - p) / np.linalg.norm(q - p)
        outward = np.array([d[1], -d[0]])
        for r, s in b.edges():
            if abs((r - p) @ outward - WALL) > 1e-3 or abs((s - p) @ outward - WALL) > 1e-3:
                continue
            low = max(0.0, min((r - p) @ d, (s - p) @ d))
            high = min(float(np.linalg.norm(q - p)), max((r - p) @ d, (s - p) @ d))
            if high - low > 0.9:
                middle = p + outward * WALL / 2
                found.append((middle + d * low, middle + d * high))
    return found


def place_openings(layout: Layout, rng: np.random.Generator) -> None:
    """Doors that join every room, an entrance, and windows in the outer walls."""
    corridor = len(layout.rooms) - 1
    living = corridor - 1
    _door(layout, corridor, living, float(rng.choice([0.95, 1.3, 1.5])), rng)
    for k in range(living):
        if not _door(layout, k, corridor, float(rng.uniform(0.84, 0.94)), rng):
            _door(layout, k, living, float(rng.uniform(0.84, 0.94)), rng)
        elif layout.rooms[k].category == "kitchen" and rng.random() < 0.65:
            _door(layout, k, living, float(rng.choice([0.9, 1.2, 1.4])), rng)
    _entrance(layout, corridor, rng)
    for k, room in enumerate(layout.rooms):
        _windows(layout, k, room, rng)


def _door(layout: Layout, a: int, b: int, width: float, rng: np.random.Generator) -> bool:
    walls = _walls_between(layout.rooms[a], layout.rooms[b])
    walls = [w for w in walls if np.linalg.norm(w[1] - w[0]) > 0.9 + 0.24]
    if not walls:
        return False
    p, q = max(walls, key=lambda w: float(np.linalg.norm(w[1] - w[0])))
    length = float(np.linalg.norm(q - p))
    d = (q - p) / length
    width = min(width, length - 0.24)
    slack = length - width - 0.24
    # near one end leaves the longest wall for furniture
    place = (
        0.12 + width / 2 + slack * float(rng.choice([rng.uniform(0, 0.12), rng.uniform(0.88, 1), rng.uniform(0, 1)]))
    )
    at = p + d * place
    layout.openings.append(
        Opening(
            "door", (float(at[0]), float(at[1])), (float(d[0]), float(d[1])), round(width, 3), 0.0, DOOR_HEIGHT, [a, b]
        )
    )
    return True


def outer_edges(layout: Layout, index: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Stretches of a room's walls with no other room behind them, as (p, q) with the room on the left."""
    room = layout.rooms[index]
    found = []
    for p, q in room.edges():
        length = float(np.linalg.norm(q - p))
        d = (q - p) / length
        outward = np.array([d[1], -d[0]])
        hidden = []
        for k, other in enumerate(layout.rooms):
            if k == index:
                continue
            for x0, y0, x1, y1 in other.rects:
                corners = np.array([[x0, y0], [x1, y1]]) - p
                along, off = np.sort(corners @ d), np.sort(corners @ outward)
                if off[0] < 0.2 < off[1] and along[1] > 0 and along[0] < length:
                    hidden.append((along[0] - WALL, along[1] + WALL))
        free = 0.0
        for low, high in sorted(hidden):
            if low - free > 0.5:
                found.append((p + d * free, p + d * min(low, length)))
            free = max(free, high)
        if length - free > 0.5:
            found.append((p + d * free, q))
    return found


def _entrance(layout: Layout, corridor: int, rng: np.random.Generator) -> None:
    edges = outer_edges(layout, corridor)
    p, q = min(edges, key=lambda e: abs(float(np.linalg.norm(e[1] - e[0])) - 1.3))
    length = float(np.linalg.norm(q - p))
    d = (q - p) / length
    width = min(0.95, length - 0.2)
    at = p + d * (length / 2 if length < 2 else 0.2 + width / 2)
    layout.openings.append(
        Opening(
            "entrance", (float(at[0]), float(at[1])), (float(d[0]), float(d[1])), round(width, 3), 0.0, 2.05, [corridor]
        )
    )


def _windows(layout: Layout, index: int, room: Room, rng: np.random.Generator) -> None:
    if room.category == "corridor":
        return
    edges = sorted(outer_edges(layout, index), key=lambda e: -float(np.linalg.norm(e[1] - e[0])))
    wanted = {"living": 3, "bedroom": 2, "kitchen": 1, "bath": 1, "study": 1}[room.category]
    for p, q in edges[:2]:
        length = float(np.linalg.norm(q - p))
        d = (q - p) / length
        small = room.category == "bath"
        count = 1 if length < 4.4 or small else 2
        for k in range(min(count, wanted)):
            width = (
                float(rng.uniform(0.55, 0.8))
                if small
                else float(rng.uniform(1.0, min(1.9, max(1.05, length / count - 0.8))))
            )
            if length < width + 0.4:
                continue
            at = p + d * (length * (k + 0.5) / count)
            tall = room.category == "living" and rng.random() < 0.45
            low = 1.3 if small else (0.12 if tall else float(rng.choice([0.85, 0.95, 1.0])))
            if room.category == "kitchen":
                low = 1.12  # above the worktop
            high = min(layout.height - 0.22, 2.2)
            layout.openings.append(
                Opening(
                    "window",
                    (float(at[0]), float(at[1])),
                    (float(d[0]), float(d[1])),
                    round(width, 2),
                    low,
                    round(high, 2),
                    [index],
                )
            )
            wanted -= 1
        if wanted <= 0:
            return
