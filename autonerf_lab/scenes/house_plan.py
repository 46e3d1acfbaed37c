"""Floor plans of a given area and number of rooms, from 2 rooms on 40 m2 to 14 rooms on 300 m2, on one or two floors.

A plan has the rooms of :data:`ORDER` (one floor) or of :data:`GROUND` and :data:`UPPER` (two floors). Rooms lie on both
sides of a straight corridor with the living room across its end, or on both sides of the two arms of an L-shaped
corridor with the living room at the bend. On two floors, the corridor is straight and the stairs are next to it at the
entrance; the rooms of the second floor have walls of their own above the same corridor.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from autonerf_lab.errors import SceneError
from autonerf_lab.scenes.floorplan import PROGRAM, band_plan, mirror_and_transpose
from autonerf_lab.scenes.layout import LIVING, WALL, Rect, Room, net_polygon

SIZES = {**PROGRAM, "dining": (11.0, 17.0, 2.85), "utility": (4.5, 8.0, 1.85)}  # as PROGRAM, for houses too
GROWTH = {"bath": 0.6, "utility": 0.5, "study": 0.8, "kitchen": 0.9, **dict.fromkeys(LIVING, 1.3)}  # exponents, else 1
# rooms besides corridor and living room in the order in which a larger home has them
ORDER = ("bath", "bedroom", "kitchen", "bedroom", "study", "bath", "bedroom", "dining", "utility", "bath", "bedroom",
         "study")  # fmt: skip
GROUND = ("kitchen", "bath", "bedroom", "study", "dining", "utility")  # on the first of two floors
UPPER = ("bedroom", "bath", "bedroom", "bedroom", "bath", "study")  # on the second floor
EXTRA = (1, 0, 0, 1, 1, 0, 1)  # floor of the 9th, 10th, ... room of a home with two floors: 0 first, 1 second
ROOMS, TWO_FLOORS = (2, 14), 8  # smallest and largest number of rooms; smallest number on two floors
AREA = (40.0, 300.0)  # m2
SMALLEST = (0.92, 1.15)  # smallest area of a home with one and two floors, multiple of the typical area of its rooms
LARGEST = {2: 1.8, 3: 1.3, 4: 1.55}  # largest area by number of rooms, likewise; else 2.2
PLANS = 20_000  # sampled plans before an error
TOLERANCE = 0.06  # a plan of an area within this share is scaled to the exact area
STAIRS_WIDTH, STAIRS_DEPTH = 2.25, 3.3  # metres up to the middle of the walls; smallest depth
NEAR_LIVING = ("dining", "kitchen")  # rooms placed next to the living room


@dataclass
class HousePlan:
    """Rooms of each floor, the corridor last, and the stairs."""

    floors: list[list[Room]]
    stairs: Rect | None = None  # up to the middle of the walls, part of the corridor on both floors


def check_size(area: float | None, rooms: int | None, floors: int) -> None:
    """Validate the size of a home.

    Raises:
        SceneError: A number is out of range, or the rooms do not fit the area; the message names the valid range.
    """
    if floors not in (1, 2):
        raise SceneError(f"floors={floors}: a home has 1 or 2 floors")
    least = ROOMS[0] if floors == 1 else TWO_FLOORS
    if rooms is not None and not least <= rooms <= ROOMS[1]:
        raise SceneError(f"rooms={rooms}: a home with {floors} floor(s) has {least} to {ROOMS[1]} rooms")
    if area is not None and not AREA[0] <= area <= AREA[1]:
        raise SceneError(f"area={area:g}: a home has {AREA[0]:.0f} to {AREA[1]:.0f} m2")
    counts = range(least, ROOMS[1] + 1) if rooms is None else [rooms]
    if area is not None and not any(_fits(area, count, floors) for count in counts):
        low, high = _limits(counts[0], floors)[0], _limits(counts[-1], floors)[1]
        wanted = f"{rooms} rooms" if rooms is not None else f"a home with {floors} floors"
        raise SceneError(f"area={area:g}: {wanted} need {max(AREA[0], low):.0f} to {min(AREA[1], high):.0f} m2")


def choose_size(area: float | None, rooms: int | None, floors: int, rng: np.random.Generator) -> tuple[float, int]:
    """Return area and number of rooms; sample what is not given, such that it fits."""
    least = ROOMS[0] if floors == 1 else TWO_FLOORS
    if rooms is None:
        counts = [count for count in range(least, ROOMS[1] + 1) if area is None or _fits(area, count, floors)]
        usual = [n for n in counts if area is None or area <= 1.5 * _limits(n, floors)[0]] or counts[-1:]
        rooms = int(rng.choice(usual))
    if area is None:
        area = float(np.clip(_limits(rooms, floors)[0] * rng.uniform(1.05, 1.4), *AREA))
    return area, rooms


def _limits(rooms: int, floors: int) -> tuple[float, float]:
    typical = _typical(rooms, floors)
    return SMALLEST[floors - 1] * typical, LARGEST.get(rooms, 2.2) * typical


def _fits(area: float, rooms: int, floors: int) -> bool:
    low, high = _limits(rooms, floors)
    return low <= area <= high


def _typical(rooms: int, floors: int) -> float:
    """Return the typical area of a home, m2: the middle of the range of each room, and a corridor."""
    kinds = [kind for floor in _program(rooms, floors) for kind in floor]
    middle = sum(float(np.mean(SIZES[kind][:2])) for kind in kinds)
    return middle + (0 if rooms == 2 else 4 + 1.6 * rooms) + (0 if floors == 1 else 12)


def _program(rooms: int, floors: int) -> list[list[str]]:
    """Return the categories of the rooms of each floor without the corridor; the living room is the last of floor 1."""
    if floors == 2:
        upper = 2 + sum(EXTRA[: rooms - TWO_FLOORS])
        return [[*GROUND[: rooms - 2 - upper - 1], "living"], list(UPPER[:upper])]
    others = ORDER[: max(1, rooms - 2)]
    return [[*others, "living" if "kitchen" in others else "open-plan" if "bedroom" in others else "studio"]]


def plan_house(area: float, rooms: int, floors: int, rng: np.random.Generator) -> HousePlan:
    """Sample a floor plan; rooms have their rectangles and polygons.

    Args:
        area: Sum of the inner areas of the rooms of all floors, m2; the plan has it within 1 %.
        rooms: Number of rooms of all floors, corridors included.
        floors: 1 or 2.
        rng: Random generator.

    Raises:
        SceneError: No valid plan was found.

    Example:
        >>> plan = plan_house(200, 11, 1, np.random.default_rng(0))
        >>> len(plan.floors[0]), plan.floors[0][-1].category
        (11, 'corridor')
        >>> bool(198 < sum(room.shape.area for room in plan.floors[0]) < 202)
        True
    """
    program = _program(rooms, floors)
    growth = area / _typical(rooms, floors)
    for _ in range(PLANS):
        size = [[_area(kind, growth, rng) for kind in floor] for floor in program]
        if floors == 2:
            plan = _two_floors(program, size, rng)
        elif rooms == 2:
            plan = _pair(program[0], size[0], rng)
        elif len(program[0]) > 6 and (len(program[0]) > 9 or rng.random() < 0.6):
            plan = _branch(program[0], size[0], rng)
        else:
            *others, living = program[0]
            if len(others) < 3 or (len(others) < 7 and rng.random() < 0.5):  # as an apartment
                found = band_plan("across", living, others, growth, rng)
            else:
                found = _spine(program[0], size[0], _frame(size[0], 0.0, rng), rng)
            plan = None if found is None else HousePlan([found])
        if plan is None:
            continue
        share = area / _net_area(plan)
        if abs(share - 1) > TOLERANCE:
            growth *= float(np.clip(share, 0.95, 1.05))
            continue
        _finish(plan, float(np.sqrt(share)), rng)
        if abs(_net_area(plan) / area - 1) < 0.01:
            return plan
    raise SceneError(
        f"no floor plan with {rooms} rooms on {area:.0f} m2 and {floors} floor(s) was found; use another seed or size"
    )


def _area(kind: str, growth: float, rng: np.random.Generator) -> float:
    """Sample the area of a room, m2, walls included; rooms for guests grow more than bathrooms in a larger home."""
    low, high, _ = SIZES[kind]
    return (low + high) / 2 * float(rng.uniform(0.85, 1.15)) * growth ** GROWTH.get(kind, 1.0)


def _net_area(plan: HousePlan) -> float:
    total = sum(room.shape.area for floor in plan.floors for room in _outlined(floor))
    if plan.stairs is not None:
        x0, y0, x1, y1 = plan.stairs
        total -= (x1 - x0 - WALL) * (y1 - y0)
    return float(total)


def _outlined(rooms: list[Room]) -> list[Room]:
    for room in rooms:
        room.polygon = net_polygon(room.rects)
    return rooms


def _finish(plan: HousePlan, scale: float, rng: np.random.Generator) -> None:
    """Scale a plan, mirror and transpose it at random, and compute the outlines of the rooms."""
    stairs = [] if plan.stairs is None else [Room("stairs", [plan.stairs])]
    every = [room for floor in plan.floors for room in floor] + stairs
    for room in every:
        room.rects = [(a * scale, b * scale, c * scale, d * scale) for a, b, c, d in room.rects]
    mirror_and_transpose(every, rng)
    for floor in plan.floors:
        _outlined(floor)
    plan.stairs = stairs[0].rects[0] if stairs else None


def _frame(size: list[float], least_depth: float, rng: np.random.Generator) -> tuple[float, float, float]:
    """Sample the y of the lower and upper edge of a corridor along x and of the outer wall above it."""
    deep = float(np.clip(np.sqrt(np.mean(size) / 13), 0.9, 1.35))
    lower, upper = float(rng.uniform(2.9, 4.3)) * deep, max(least_depth, float(rng.uniform(3.1, 4.6)) * deep)
    wide = float(rng.uniform(1.35, 1.8))
    return lower, lower + wide, lower + wide + upper


def _spine(
    kinds: list[str], size: list[float], frame: tuple[float, float, float], rng: np.random.Generator,
    stairs: float = 0.0, across: bool = True,
) -> list[Room] | None:  # fmt: skip
    """Lay out rooms on both sides of a straight corridor; with ``across``, the last kind lies across its end.

    Args:
        kinds: Categories of the rooms.
        size: Their areas, m2.
        frame: Of :func:`_frame`.
        rng: Random generator of the order.
        stairs: Width kept free for the stairs at the beginning of the upper band, metres.
        across: Place the last room across the end of the corridor.

    Returns:
        The rooms, the corridor last; None if a room is too narrow.
    """
    y1, y2, y3 = frame
    depth = (y1, y3 - y2)
    count = len(kinds) - across
    bands: list[list[int]] = [[], []]
    filled = [0.0, stairs]
    for k in sorted(rng.permutation(count).tolist(), key=lambda k: across and kinds[k] in NEAR_LIVING):
        side = int(np.argmin(filled)) if rng.random() < 0.85 else int(rng.integers(2))
        bands[side].append(k)
        filled[side] += size[k] / depth[side]
    if not bands[0] or (not bands[1] and stairs < 1) or max(filled) > 21 or min(filled) < 0.65 * max(filled):
        return None
    length = sum(filled) / 2
    rooms = {}
    for side, (low, high) in enumerate([(0.0, y1), (y2, y3)]):
        start = stairs * side
        stretch = (length - start) / max(filled[side] - start, 1e-9)
        for k in bands[side]:
            end = start + size[k] / depth[side] * stretch
            rooms[k] = Room(kinds[k], [(start, low, end, high)])
            start = end
        if not bands[side] and length > stairs + 0.01:
            return None
    if across:
        rooms[count] = Room(kinds[count], [(length, 0.0, length + size[count] / y3, y3)])
    ordered = [rooms[k] for k in range(len(kinds))]
    if not all(_plausible(room) for room in ordered):
        return None
    hall: list[Rect] = [(0.0, y1, length, y2)]
    if stairs:
        hall.append((0.0, y2, stairs, y3))
    return [*ordered, Room("corridor", hall)]


def _branch(kinds: list[str], size: list[float], rng: np.random.Generator) -> HousePlan | None:
    """Lay out rooms on both sides of an L-shaped corridor, the living room (last kind) at the outside of the bend.

    Band 0 lies below the first arm, 1 above it inside the bend, 2 right of the second arm, 3 left of it.
    """
    _, first, _ = _frame(size[:-1], 0.0, rng)
    wide = float(rng.uniform(1.35, 1.8))
    below, right = first - wide + 0.3, float(rng.uniform(1.0, 1.3)) * first * 0.85
    count = len(kinds) - 1
    shares = rng.dirichlet([6, 4, 4, 4])
    bands: list[list[int]] = [[], [], [], []]
    filled = np.zeros(4)
    for k in rng.permutation(count).tolist():
        side = int(np.argmin(filled / shares))
        bands[side].append(k)
        filled[side] += size[k]
    if min(len(bands[0]), len(bands[1]), len(bands[2])) == 0:
        return None
    bands[0].sort(key=lambda k: kinds[k] in NEAR_LIVING)
    bands[2].sort(key=lambda k: kinds[k] not in NEAR_LIVING)
    right_x, inner = filled[0] / below, filled[0] / below - wide
    between = filled[1] / max(inner, 0.1)
    y1, y2 = below, below + wide
    y3, bend = y2 + between, size[-1] / right
    top = bend + filled[2] / right
    left = filled[3] / (top - y3) if top > y3 + 2 else np.inf if bands[3] else 0.0
    if bend < y2 or not 2.6 < between < 6 or left > min(6.0, inner) or (not bands[3] and top > y3 + 2.5):
        return None
    rooms = {}
    starts, lengths = (0.0, 0.0, bend, y3), (right_x, inner, top - bend, top - y3)
    for side, band in enumerate(bands):
        ends = starts[side] + lengths[side] * np.cumsum([0.0, *(size[k] for k in band)]) / max(filled[side], 1e-9)
        for k, (a, b) in zip(band, pairwise(ends.tolist()), strict=True):
            rects: list[Rect] = [
                (a, 0.0, b, y1),
                (a, y2, b, y3),
                (right_x, a, right_x + right, b),
                (inner - left, a, inner, b),
            ]
            rooms[k] = Room(kinds[k], [rects[side]])
    rooms[count] = Room(kinds[count], [(right_x, 0.0, right_x + right, bend)])
    ordered = [rooms[k] for k in range(len(kinds))]
    if not all(_plausible(room) for room in ordered):
        return None
    return HousePlan([[*ordered, Room("corridor", [(0.0, y1, right_x, y2), (inner, y2, right_x, top)])]])


def _two_floors(program: list[list[str]], size: list[list[float]], rng: np.random.Generator) -> HousePlan | None:
    """Lay out two floors with one corridor above the other; the second floor covers at most the first."""
    frame = _frame([*size[0][:-1], *size[1]], STAIRS_DEPTH, rng)
    first = _spine(program[0], size[0], frame, rng, STAIRS_WIDTH)
    if first is None:
        return None
    second = _spine(program[1], size[1], frame, rng, STAIRS_WIDTH, across=False)
    if second is None or second[-1].rects[0][2] > first[-2].rects[0][2]:
        return None
    return HousePlan([first, second], first[-1].rects[1])


def _pair(kinds: list[str], size: list[float], rng: np.random.Generator) -> HousePlan | None:
    """Lay out a studio and its bathroom, without a corridor: the studio is the last room."""
    width = float(rng.uniform(0.9, 1.5)) * np.sqrt(size[1])
    bath_width = float(rng.uniform(1.9, 2.8))
    depth = (size[0] + size[1]) / width
    bath, deep = Room(kinds[0], [(0.0, 0.0, bath_width, size[0] / bath_width)]), size[0] / bath_width
    studio = Room(kinds[1], [(0.0, deep, width, depth), (bath_width, 0.0, width, deep)])
    if width - bath_width < 2.2 or depth - deep < 3.2 or not _plausible(bath):
        return None
    return HousePlan([[bath, studio]])


def _plausible(room: Room) -> bool:
    """Return True if a room is wide enough for its category and not a tube."""
    x0, y0, x1, y1 = room.rects[0]
    short, long = sorted((x1 - x0, y1 - y0))
    return short - WALL >= SIZES[room.category][2] - 0.2 and long / short < (2.0 if room.category in LIVING else 1.9)
