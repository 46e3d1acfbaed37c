"""Generator stage 1: floor plan of the rooms.

A plan has a corridor with a band of rooms on one or both sides and the living room across the end of the corridor,
around it (L-shaped) or along it; or an L-shaped corridor with rooms on all sides. Bands of unequal length give L-shaped
outlines. The plan is mirrored and transposed at random. Small apartments have no separate kitchen.
"""

import numpy as np

from autonerf_lab.scenes.layout import WALL, Layout, Rect, Room, net_polygon

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
# (sampling weight, rooms besides corridor and living room)
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
MIN_AREA, MAX_AREA = 40.5, 139.5  # m2, sum of the inner areas of the rooms


def plan_rooms(layout: Layout, rng: np.random.Generator) -> None:
    """Fill ``layout.rooms`` with 3 to 8 rooms on 40 to 140 m2, each next to the corridor or the living room.

    The living room is the last but one, the corridor the last room.
    """
    weights = np.array([weight for weight, _ in HOMES])
    others = HOMES[int(rng.choice(len(HOMES), p=weights / weights.sum()))][1]
    living = "living" if "kitchen" in others else "open-plan" if "bedroom" in others else "studio"
    shapes = ["across"] if living != "living" else ["across", "around", "along", *["corner"] * 2 * (len(others) > 3)]
    shape = str(rng.choice(shapes))
    while True:  # rejection sampling: most proportions give no valid plan
        roomy = float(rng.uniform(0.95, 1.3))
        rooms = _corner_plan(others, roomy, rng) if shape == "corner" else band_plan(shape, living, others, roomy, rng)
        if rooms is None:
            continue
        mirror_and_transpose(rooms, rng)
        for room in rooms:
            room.polygon = net_polygon(room.rects)
        if MIN_AREA <= sum(room.shape.area for room in rooms) <= MAX_AREA:
            layout.rooms = rooms
            return


def _area(category: str, roomy: float, rng: np.random.Generator) -> float:
    return roomy * float(rng.uniform(*PROGRAM[category][:2]))


def _narrow(category: str, rect: Rect) -> bool:
    return min(rect[2] - rect[0], rect[3] - rect[1]) - WALL < PROGRAM[category][2] - 0.25


def band_plan(  # noqa: PLR0911  each return is one reason to reject a plan
    shape: str, living_kind: str, others: list[str], roomy: float, rng: np.random.Generator
) -> list[Room] | None:
    """Lay out a straight corridor with bands of rooms; None if the sampled proportions give no valid plan."""
    corridor = float(rng.uniform(1.32, 1.75))
    depths = [float(rng.uniform(2.75, 4.3)), float(rng.uniform(3.1, 4.6))]  # lower band, upper band
    others = [str(o) for o in rng.permutation(others)]
    others.sort(key=lambda o: o == "kitchen")  # the kitchen is last in its band, next to the living room
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
    if rng.random() < 0.6 and shape == "across" and min(filled) > 0:  # bands of equal length
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
        # a shorter band also ends at the living room: its last room is stretched
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
    # every room of a band needs a wall shared with the corridor or the living room
    for room in rooms[:-2]:
        x0, _, x1, y = room.rects[0]
        touch = min(x1, reach if shape == "around" and y < y2 else corridor_end) - x0
        if touch < 1.3:
            return None
    return rooms


def _corner_plan(others: list[str], roomy: float, rng: np.random.Generator) -> list[Room] | None:
    """Lay out an L-shaped corridor: rooms below it, between its arms and right of it, the living room at the bend."""
    wide = float(rng.uniform(1.32, 1.7))
    below, between, right = (float(rng.uniform(*depth)) for depth in ((2.75, 4.2), (2.75, 4.2), (3.6, 5.0)))
    others = [str(o) for o in rng.permutation(others)]
    sides = [int(side) for side in rng.choice(3, size=len(others), p=[0.4, 0.3, 0.3])]
    area = [_area(o, roomy, rng) for o in others]
    total = [sum(a for a, side in zip(area, sides, strict=True) if side == k) for k in range(3)]
    right_x = total[0] / below  # x where the right band begins
    inner = right_x - wide  # x where the rooms between the arms end after stretching
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
        rects: list[Rect] = [(a, 0.0, b, y1), (a, y2, b, y3), (right_x, a, right_x + right, b)]
        if _narrow(kind, rects[side]) or b - a > 6.5 or (side == 2 and b - max(a, y2) < 1.3):
            return None
        rooms.append(Room(kind, [rects[side]]))
    rooms.append(Room("living", [(right_x, 0.0, right_x + right, bend)]))
    rooms.append(Room("corridor", [(0.0, y1, right_x, y2), (inner, y2, right_x, top)]))
    return rooms


def _stretch_last(rooms: list[Room], bands: list[list[int]], side: int, reach: float) -> bool:
    """Stretch the last room of a band to x = ``reach``; False if it would become too large."""
    index = (0 if side == 0 else len(bands[0])) + len(bands[side]) - 1
    x0, y0, _, y1 = rooms[index].rects[0]
    area = (reach - x0) * (y1 - y0)
    if area > PROGRAM[rooms[index].category][1] * 1.35:
        return False
    rooms[index].rects[0] = (x0, y0, reach, y1)
    return True


def mirror_and_transpose(rooms: list[Room], rng: np.random.Generator) -> None:
    """Mirror and transpose at random, then move the lower corner to the origin and round to centimetres."""
    flip_x, flip_y, swap = (bool(v) for v in rng.integers(0, 2, 3))
    for room in rooms:
        mirrored = []
        for x0, y0, x1, y1 in room.rects:
            along = (-x1, -x0) if flip_x else (x0, x1)
            up = (-y1, -y0) if flip_y else (y0, y1)
            first, second = (up, along) if swap else (along, up)
            mirrored.append((first[0], second[0], first[1], second[1]))
        room.rects = mirrored
    low_x = min(r[0] for room in rooms for r in room.rects)
    low_y = min(r[1] for room in rooms for r in room.rects)
    for room in rooms:
        room.rects = [
            (round(a - low_x, 2), round(b - low_y, 2), round(c - low_x, 2), round(d - low_y, 2))
            for a, b, c, d in room.rects
        ]
