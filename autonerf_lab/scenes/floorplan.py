"""Stages one and two: the plan of the rooms, then doors and windows.

Homes are laid out as architects of flats do it: a corridor with a band of rooms on one or either side, the living room
across its end, around its end (an L) or along it; or a corridor that turns a corner, with rooms on all its sides. Bands
of unequal length give L-shaped outlines; the whole is mirrored and turned at random. Small flats have no separate
kitchen.
"""

import numpy as np

from autonerf_lab.scenes.layout import COOKING, DOOR_HEIGHT, LIVING, WALL, Layout, Opening, Rect, Room, net_polygon

# category: smallest and largest area in m2, shortest side in m
PROGRAM = {
    "living": (17.0, 32.0, 3.5),
    "open-plan": (24.0, 38.0, 3.8),
    "studio": (27.0, 40.0, 4.2),
    "kitchen": (8.0, 13.0, 2.45),
    "bath": (4.6, 7.5, 1.85),
    "bedroom": (10.5, 17.0, 2.85),
    "study": (8.0, 12.0, 2.45),
}
# beside corridor and living room: (weight, rooms)
HOMES: list[tuple[float, list[str]]] = [
    (0.06, ["bath"]),
    (0.14, ["bath", "bedroom"]),
    (0.16, ["kitchen", "bath", "bedroom"]),
    (0.22, ["kitchen", "bath", "bedroom", "bedroom"]),
    (0.10, ["kitchen", "bath", "bedroom", "bedroom", "study"]),
    (0.12, ["kitchen", "bath", "bedroom", "bedroom", "bedroom"]),
    (0.12, ["kitchen", "bath", "bedroom", "bedroom", "bedroom", "bath"]),
    (0.08, ["kitchen", "bath", "bedroom", "bedroom", "study", "bath"]),
]
MIN_AREA, MAX_AREA = 40.5, 139.5  # that one can stand on


def plan_rooms(layout: Layout, rng: np.random.Generator) -> None:
    """Fill ``layout.rooms``: 3 to 8 rooms on 40 to 140 m2, every one beside the corridor or the living room.

    The living room and the corridor come last.
    """
    weights = np.array([weight for weight, _ in HOMES])
    others = HOMES[int(rng.choice(len(HOMES), p=weights / weights.sum()))][1]
    living = "living" if "kitchen" in others else "open-plan" if "bedroom" in others else "studio"
    shapes = ["across"] if living != "living" else ["across", "around", "along", *["corner"] * 2 * (len(others) > 3)]
    shape = str(rng.choice(shapes))
    while True:  # most numbers make no home
        roomy = float(rng.uniform(0.95, 1.3))
        rooms = _corner(others, roomy, rng) if shape == "corner" else _bands(shape, living, others, roomy, rng)
        if rooms is None:
            continue
        _turn(rooms, rng)
        for room in rooms:
            room.polygon = net_polygon(room.rects)
        if MIN_AREA <= sum(room.shape.area for room in rooms) <= MAX_AREA:
            layout.rooms = rooms
            return


def _area(category: str, roomy: float, rng: np.random.Generator) -> float:
    return roomy * float(rng.uniform(*PROGRAM[category][:2]))


def _narrow(category: str, rect: Rect) -> bool:
    return min(rect[2] - rect[0], rect[3] - rect[1]) - WALL < PROGRAM[category][2] - 0.25


def _bands(  # noqa: PLR0911  each return names one way in which a plan is no home
    shape: str, living_kind: str, others: list[str], roomy: float, rng: np.random.Generator
) -> list[Room] | None:
    corridor = float(rng.uniform(1.32, 1.75))
    depths = [float(rng.uniform(2.75, 4.3)), float(rng.uniform(3.1, 4.6))]  # lower band, upper band
    others = [str(o) for o in rng.permutation(others)]
    others.sort(key=lambda o: o == "kitchen")  # the kitchen comes last in its band: beside the living room
    area = [_area(o, roomy, rng) for o in others]
    living_area = _area(living_kind, roomy, rng)
    bands: list[list[int]] = [[], []]
    filled = [0.0, 0.0]
    one_sided = len(others) <= 2
    if one_sided:
        depths[1] = 0.0
    if shape == "along":
        filled[1] += living_area / depths[1]
    for k, other in enumerate(others):
        side = int(np.argmin(filled)) if other == "kitchen" or rng.random() < 0.85 else int(rng.integers(2))
        if one_sided or (other == "kitchen" and shape == "around"):
            side = 0
        bands[side].append(k)
        filled[side] += area[k] / depths[side]
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
            if _narrow(others[k], (x, low, x + width, high)) or width > 6.5:
                return None
            rooms.append(Room(others[k], [(x, low, x + width, high)]))
            x += width
        ends[side] = x
    reach = max(ends)
    if shape == "across":  # the living room spans the bands and the corridor at their end
        width = living_area / y3
        shortest = ends[0] if one_sided else min(ends)
        if width < PROGRAM[living_kind][2] or width > 8.5 or shortest < reach - 2.2 or shortest < 1.8:
            return None
        # a shorter band ends at the living room too: its last room is stretched
        for side in (0, 1):
            if bands[side] and ends[side] < reach - 1e-6 and not _stretch_last(rooms, bands, side, reach):
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
    rooms.append(Room(living_kind, living))
    rooms.append(Room("corridor", [(0.0, y1, corridor_end, y2)]))
    # every room of a band must open on the corridor or the living room
    for room in rooms[:-2]:
        x0, _, x1, y = room.rects[0]
        touch = min(x1, reach if shape == "around" and y < y2 else corridor_end) - x0
        if touch < 1.3:
            return None
    return rooms


def _corner(others: list[str], roomy: float, rng: np.random.Generator) -> list[Room] | None:
    """A corridor that turns left: rooms below it, between its arms and right of it, the living room at the bend."""
    wide = float(rng.uniform(1.32, 1.7))
    below, between, right = (float(rng.uniform(*depth)) for depth in ((2.75, 4.2), (2.75, 4.2), (3.6, 5.0)))
    others = [str(o) for o in rng.permutation(others)]
    sides = [int(side) for side in rng.choice(3, size=len(others), p=[0.4, 0.3, 0.3])]
    area = [_area(o, roomy, rng) for o in others]
    total = [sum(a for a, side in zip(area, sides, strict=True) if side == k) for k in range(3)]
    turn = total[0] / below  # x where the right band begins
    inner = turn - wide  # x where the rooms between the arms end: they are stretched to get there
    bend = _area("living", roomy, rng) / right  # y where the living room ends
    top = bend + total[2] / right
    y1, y2, y3 = below, below + wide, below + wide + between
    if min(total[:2]) == 0 or inner < 1.9 or not 0.75 < total[1] / between / inner < 1.35:
        return None
    if not max(PROGRAM["living"][2], y1 + 1.3) < bend < 9 or not y3 - 1 < top < y3 + 2.5:
        return None
    per_metre = [below, total[1] / inner, right]
    at = [0.0, 0.0, bend]
    rooms = []
    for kind, side, size in zip(others, sides, area, strict=True):
        a, b = at[side], at[side] + size / per_metre[side]
        at[side] = b
        rects: list[Rect] = [(a, 0.0, b, y1), (a, y2, b, y3), (turn, a, turn + right, b)]
        if _narrow(kind, rects[side]) or b - a > 6.5 or (side == 2 and b - max(a, y2) < 1.3):
            return None
        rooms.append(Room(kind, [rects[side]]))
    rooms.append(Room("living", [(turn, 0.0, turn + right, bend)]))
    rooms.append(Room("corridor", [(0.0, y1, turn, y2), (inner, y2, turn, top)]))
    return rooms


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


def shared_walls(a: Room, b: Room) -> list[tuple[np.ndarray, np.ndarray]]:
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
    baths = [k for k in range(living) if layout.rooms[k].category == "bath"]
    bedrooms = [k for k in range(living) if layout.rooms[k].category == "bedroom"]
    for k in range(living):
        width = float(rng.uniform(0.84, 0.94))
        if k in baths[1:] and any(_door(layout, k, bedroom, width, rng) for bedroom in bedrooms):
            continue  # en suite
        if not _door(layout, k, corridor, width, rng):
            _door(layout, k, living, width, rng)
        elif layout.rooms[k].category == "kitchen" and rng.random() < 0.65:
            _door(layout, k, living, float(rng.choice([0.9, 1.2, 1.4])), rng)
    add_entrance(layout, corridor)
    for k, room in enumerate(layout.rooms):
        add_windows(layout, k, room, rng)


def _door(layout: Layout, a: int, b: int, width: float, rng: np.random.Generator) -> bool:
    walls = shared_walls(layout.rooms[a], layout.rooms[b])
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


def add_entrance(layout: Layout, room: int) -> bool:
    """The door of the home, in an outer wall of that room; False if it has none for it."""
    edges = [e for e in outer_edges(layout, room) if np.linalg.norm(e[1] - e[0]) > 1.0]
    if not edges:
        return False
    p, q = min(edges, key=lambda e: abs(float(np.linalg.norm(e[1] - e[0])) - 1.3))
    length = float(np.linalg.norm(q - p))
    d = (q - p) / length
    width = min(0.95, length - 0.2)
    at = p + d * (length / 2 if length < 2 else 0.2 + width / 2)
    layout.openings.append(
        Opening(
            "entrance", (float(at[0]), float(at[1])), (float(d[0]), float(d[1])), round(width, 3), 0.0, 2.05, [room]
        )
    )
    return True


def add_windows(layout: Layout, index: int, room: Room, rng: np.random.Generator) -> None:
    """Windows in the longest outer walls of a room, as many and as high as its use asks for."""
    if room.category == "corridor":
        return
    edges = sorted(outer_edges(layout, index), key=lambda e: -float(np.linalg.norm(e[1] - e[0])))
    wanted = 3 if room.category in LIVING else {"bedroom": 2, "kitchen": 1, "bath": 1, "study": 1}[room.category]
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
            tall = room.category in LIVING and rng.random() < 0.45
            low = 1.3 if small else (0.12 if tall else float(rng.choice([0.85, 0.95, 1.0])))
            if room.category in COOKING:
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
