"""Generator stage 2: doors, entrance and windows."""

import numpy as np
from shapely.geometry import Point, box

from autonerf_lab.scenes.layout import COOKING, DOOR_HEIGHT, LIVING, WALL, Layout, Opening, Room


def shared_walls(a: Room, b: Room) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the stretches of wall that two rooms share, as (start, end) in the middle of the wall."""
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
    """Add doors that connect all rooms, an entrance, and windows in the outer walls."""
    corridor = len(layout.rooms) - 1
    living = corridor - 1
    add_door(layout, corridor, living, float(rng.choice([0.95, 1.3, 1.5])), rng)
    baths = [k for k in range(living) if layout.rooms[k].category == "bath"]
    bedrooms = [k for k in range(living) if layout.rooms[k].category == "bedroom"]
    for k in range(living):
        width = float(rng.uniform(0.84, 0.94))
        if k in baths[1:] and any(add_door(layout, k, bedroom, width, rng) for bedroom in bedrooms):
            continue  # en suite
        if not add_door(layout, k, corridor, width, rng):
            add_door(layout, k, living, width, rng)
        elif layout.rooms[k].category == "kitchen" and rng.random() < 0.65:
            add_door(layout, k, living, float(rng.choice([0.9, 1.2, 1.4])), rng)
    add_entrance(layout, corridor)
    for k, room in enumerate(layout.rooms):
        add_windows(layout, k, room, rng)


def place_house_openings(layout: Layout, rng: np.random.Generator) -> None:
    """Add doors that connect all rooms of one floor of a house, an entrance on the first floor, and windows.

    The corridor, or else the living room, is the last room. Every second bathroom belongs to a bedroom, if it has a
    wall with one; kitchen and dining room are also connected to each other or to the living room.
    """
    rooms = layout.rooms
    hall = len(rooms) - 1
    kinds = [room.category for room in rooms]
    baths = [k for k in range(hall) if kinds[k] == "bath"]
    suites: set[int] = set()  # bedrooms that have a bathroom
    for k in range(hall):
        width = float(rng.choice([0.95, 1.3, 1.5])) if kinds[k] in LIVING else float(rng.uniform(0.84, 0.94))
        beds = [b for b in range(hall) if kinds[b] == "bedroom" and b not in suites]
        if k in baths[1::2]:
            suite = next((b for b in beds if add_door(layout, k, b, width, rng)), None)
            if suite is not None:
                suites.add(suite)
                continue
        if not add_door(layout, k, hall, width, rng):
            next(j for j in range(hall) if kinds[j] in LIVING and add_door(layout, k, j, width, rng))
    for a, b in (("dining", "kitchen"), ("dining", "living"), ("kitchen", "living")):
        if a in kinds and b in kinds and rng.random() < 0.75:
            add_door(layout, kinds.index(a), kinds.index(b), float(rng.choice([0.9, 1.2, 1.4])), rng)
    if layout.storey == 0:
        add_entrance(layout, hall)
    for k, room in enumerate(rooms):
        add_windows(layout, k, room, rng)


def add_door(layout: Layout, a: int, b: int, width: float, rng: np.random.Generator) -> bool:
    """Add a door in the longest wall that two rooms share; False if there is none."""
    walls = shared_walls(layout.rooms[a], layout.rooms[b])
    walls = [w for w in walls if np.linalg.norm(w[1] - w[0]) > 0.9 + 0.24]
    if layout.stairwell is not None:
        stairs = box(*layout.stairwell).buffer(WALL)
        walls = [w for w in walls if not stairs.contains(Point((w[0] + w[1]) / 2))]
    if not walls:
        return False
    p, q = max(walls, key=lambda w: float(np.linalg.norm(w[1] - w[0])))
    length = float(np.linalg.norm(q - p))
    d = (q - p) / length
    width = min(width, length - 0.24)
    slack = length - width - 0.24
    # a door near one end leaves the longest wall for furniture
    offset = (
        0.12 + width / 2 + slack * float(rng.choice([rng.uniform(0, 0.12), rng.uniform(0.88, 1), rng.uniform(0, 1)]))
    )
    at = p + d * offset
    layout.openings.append(
        Opening(
            "door", (float(at[0]), float(at[1])), (float(d[0]), float(d[1])), round(width, 3), 0.0, DOOR_HEIGHT, [a, b]
        )
    )
    return True


def outer_edges(layout: Layout, index: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the stretches of a room's walls without another room behind them, as (p, q) with the room on the left."""
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
    """Add the entrance door in an outer wall of a room; False if no outer wall is long enough."""
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
            "entrance",
            (float(at[0]), float(at[1])),
            (float(d[0]), float(d[1])),
            round(width, 3),
            0.0,
            DOOR_HEIGHT,
            [room],
        )
    )
    return True


def add_windows(layout: Layout, index: int, room: Room, rng: np.random.Generator) -> None:
    """Add windows in the longest outer walls of a room; number and height depend on its category."""
    if room.category == "corridor":
        return
    edges = sorted(outer_edges(layout, index), key=lambda e: -float(np.linalg.norm(e[1] - e[0])))
    wanted = (
        3
        if room.category in LIVING
        else {"bedroom": 2, "kitchen": 1, "bath": 1, "study": 1, "dining": 2, "utility": 1}[room.category]
    )
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
