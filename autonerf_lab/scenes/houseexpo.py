"""Floor plans in the JSON of HouseExpo (Li et al., 2019) become furnished apartments.

Such a file holds the outline of the free space, ``verts``, in metres, and a bounding box for every room,
``room_category``. The walls between rooms are in the outline when it was traced inside them, and the passages it leaves
there are the doors; between rooms that it does not part, as few doors are made as join them. What this makes of it
follows the axes, as the boxes do: nearly equal edges are joined into one wall line, ground that two boxes share belongs
to the smaller one if it lies inside the larger (whose room is an L then), and free ground without a box becomes a
corridor. Rooms too narrow for the robot are left out.
"""

import json
import math
from itertools import pairwise
from pathlib import Path

import numpy as np
from shapely import contains_xy, prepare
from shapely.errors import GEOSException
from shapely.geometry import MultiPolygon, Polygon, box
from shapely.ops import unary_union

from autonerf_lab.errors import SceneError
from autonerf_lab.scenes.build import build
from autonerf_lab.scenes.floorplan import add_entrance, add_windows, place_openings, plan_rooms, shared_walls
from autonerf_lab.scenes.generator import STAGES, to_spec
from autonerf_lab.scenes.layout import DOOR_HEIGHT, LIVING, Layout, Opening, Rect, Room, net_polygon
from autonerf_lab.scenes.scene import Scene

MAX_BYTES = 8 * 2**20
MAX_VERTS, MAX_ROOMS, MAX_SIDE = 10_000, 64, 60.0  # metres: the map of an exploration ends at 32
JOIN = 0.3  # metres: edges nearer than that are the two faces of one wall
SHARED = 0.1  # of the smaller room; boxes in the data overlap by their walls
INSIDE = 0.9  # of the smaller room: a room in the bounding box of an L-shaped one
NARROWEST = 1.2  # metres, a room's shorter side
GRID = 0.1  # metres, at which the outline is sampled
PASSAGE = 0.6  # metres of free ground across a wall that make a door
DOOR = (0.84, 1.5)  # metres, narrowest and widest that is built

_KIND = {
    "living": ("living", "lounge", "family", "dining"),
    "kitchen": ("kitchen", "pantry"),
    "bath": ("bath", "toilet", "wc", "shower", "restroom", "laundry"),
    "bedroom": ("bed", "guest", "child", "kid", "nursery", "sleep"),
    "study": ("office", "study", "library", "gym", "hobby", "studio"),
    "corridor": ("hall", "corridor", "entry", "entrance", "lobby", "foyer", "aisle", "passage", "storage", "closet",
                 "wardrobe", "garage", "balcony", "terrace", "stair", "boiler"),
}  # fmt: skip


def import_houseexpo(path: str | Path, seed: int = 0) -> Scene:
    """Furnish a floor plan.

    Args:
        path: one HouseExpo file: ``verts`` [[x, y], ...] and ``room_category`` {"Kitchen": [[x0, y0, x1, y1], ...]},
            metres.
        seed: of furniture, materials and light.

    Returns:
        A scene as :func:`~autonerf_lab.scenes.generate_apartment` makes them, named after the file. Which of the 15
        classes it has depends on its rooms.

    Raises:
        SceneError: not such a file, rooms that overlap, a room without a door, or a house beyond the limits; the
            message names the file and the room.
    """
    path = Path(path)
    try:
        if path.stat().st_size > MAX_BYTES:
            raise SceneError(f"{path} is larger than {MAX_BYTES >> 20} MB: not a floor plan")
        content = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError) as error:
        if isinstance(error, SceneError):
            raise
        raise SceneError(f"{path} is not a readable floor plan: {error}") from error
    try:
        rng = np.random.default_rng(seed)
        layout = Layout(seed, round(float(rng.uniform(2.5, 2.7)), 2))
        outline, boxes = _parse(content)
        layout.rooms = _rooms(outline, boxes)
        _openings(layout, outline, rng)
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from error
    for stage in STAGES:
        if stage not in (plan_rooms, place_openings):
            stage(layout, rng)
    return build(to_spec(layout, path.stem))


def category_of(name: str) -> str:
    """Kind of room that a HouseExpo label stands for; a study if it says nothing.

    Example:
        >>> category_of("Living_Room"), category_of("Guest_Room"), category_of("Toilet"), category_of("Room")
        ('living', 'bedroom', 'bath', 'study')
    """
    plain = name.lower()
    return next((kind for kind, words in _KIND.items() if any(word in plain for word in words)), "study")


def _parse(content: object) -> tuple[Polygon, list[tuple[str, str, Rect]]]:
    """The outline, and (label, kind, box) of each room, largest first, moved to the origin."""
    if not isinstance(content, dict):
        raise SceneError("not a floor plan: a JSON object with 'verts' and 'room_category' is expected")
    verts, labels = content.get("verts"), content.get("room_category")
    if not isinstance(verts, list) or not isinstance(labels, dict):
        raise SceneError("not a floor plan: 'verts' (a list) or 'room_category' (an object) is missing")
    if not 3 <= len(verts) <= MAX_VERTS:
        raise SceneError(f"'verts' has {len(verts)} points; 3 to {MAX_VERTS} are possible")
    for k, point in enumerate(verts):
        _check_numbers(point, 2, f"verts[{k}]")
    boxes: list[tuple[str, str, Rect]] = []
    for label, rows in labels.items():
        if not isinstance(rows, list):
            raise SceneError(f"room_category[{label[:40]!r}] is not a list of boxes")
        if len(boxes) + len(rows) > MAX_ROOMS:
            raise SceneError(f"more than {MAX_ROOMS} rooms")
        for row in rows:
            _check_numbers(row, 4, f"a box of {label[:40]!r}")
            x0, y0, x1, y1 = (float(v) for v in row)
            boxes.append((label[:40], category_of(label), (min(x0, x1), min(y0, y1), max(x0, x1), max(y0, y1))))
    low, high = np.min(verts, axis=0).astype(float), np.max(verts, axis=0).astype(float)
    if (high - low).max() > MAX_SIDE or (high - low).min() < NARROWEST:
        size = " x ".join(f"{side:.1f}" for side in high - low)
        raise SceneError(f"the house measures {size} m; {NARROWEST} to {MAX_SIDE:.0f} are possible (are these metres?)")
    try:
        outline = _largest(Polygon(np.array(verts, dtype=float) - low).buffer(0))
    except (GEOSException, ValueError) as error:
        raise SceneError(f"'verts' is no outline: {error}") from error
    if outline.area < NARROWEST**2:
        raise SceneError("'verts' encloses no ground")
    x, y = low.tolist()
    moved = [(label, kind, (b[0] - x, b[1] - y, b[2] - x, b[3] - y)) for label, kind, b in boxes]
    return outline, _settle(moved)


def _check_numbers(value: object, count: int, where: str) -> None:
    if not (
        isinstance(value, list)
        and len(value) == count
        and all(type(v) in (int, float) and abs(v) < 1e6 and math.isfinite(v) for v in value)
    ):
        raise SceneError(f"{where} is not a list of {count} finite numbers")


def _settle(boxes: list[tuple[str, str, Rect]]) -> list[tuple[str, str, Rect]]:
    """One entry a room, largest first; a room with two labels keeps the better one."""
    kept: list[tuple[str, str, Rect]] = []
    for label, kind, b in sorted(boxes, key=lambda entry: -_area(entry[2])):
        twin = next((k for k, other in enumerate(kept) if _meet(b, other[2]) > INSIDE * _area(other[2])), None)
        if twin is None:
            kept.append((label, kind, b))
            continue
        kinds = {kind, kept[twin][1]}
        if kinds == {"kitchen", "living"} or "open-plan" in kinds:
            kept[twin] = (kept[twin][0], "open-plan", kept[twin][2])
        elif kept[twin][1] in ("study", "corridor"):
            kept[twin] = (label, kind, kept[twin][2])
    for k, (label, _, b) in enumerate(kept):
        for other, _, a in kept[:k]:
            shared = _meet(a, b)
            deep = min(min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])) > JOIN
            if deep and SHARED * _area(b) < shared < INSIDE * _area(b):
                raise SceneError(
                    f"rooms {other!r} and {label!r} overlap by {shared:.1f} m2 around x = {(b[0] + b[2]) / 2:.1f},"
                    f" y = {(b[1] + b[3]) / 2:.1f} (from the corner of the house)"
                )
    return kept


def _area(b: Rect) -> float:
    return max(0.0, b[2] - b[0]) * max(0.0, b[3] - b[1])


def _meet(a: Rect, b: Rect) -> float:
    return _area((max(a[0], b[0]), max(a[1], b[1]), min(a[2], b[2]), min(a[3], b[3])))


def _lines(values: list[float]) -> np.ndarray:
    """Wall lines: the middles of groups of nearly equal coordinates."""
    groups: list[list[float]] = []
    for value in sorted(values):
        if groups and value - groups[-1][0] < JOIN:
            groups[-1].append(value)
        else:
            groups.append([value])
    return np.array([round((group[0] + group[-1]) / 2, 2) for group in groups])


def _rooms(outline: Polygon, boxes: list[tuple[str, str, Rect]]) -> list[Room]:
    """Cells between the wall lines, each given to the smallest room that claims it, put together to rooms."""
    corners = np.array(outline.exterior.coords)
    steps = np.diff(corners, axis=0)
    walls = [  # an outer wall that no box knows; what is traced between rooms runs along their boxes
        [c[axis] for c, d in zip(corners[:-1], steps, strict=True) if abs(d[axis]) < 0.02 and abs(d[1 - axis]) > 1.0]
        for axis in (0, 1)
    ]
    x = _lines([v for _, _, b in boxes for v in (b[0], b[2])] + walls[0] + list(outline.bounds[::2]))
    y = _lines([v for _, _, b in boxes for v in (b[1], b[3])] + walls[1] + list(outline.bounds[1::2]))
    free = _free_share(outline, x, y)
    owner = np.where(free > 0.5, -1, -2)  # -1: free ground without a room, -2: outside
    for k, (_, _, b) in enumerate(boxes):  # from the largest on
        middle_x, middle_y = (x[:-1] + x[1:]) / 2, (y[:-1] + y[1:]) / 2
        inside = ((middle_y > b[1]) & (middle_y < b[3]))[:, None] & ((middle_x > b[0]) & (middle_x < b[2]))[None, :]
        owner[inside & (owner > -2)] = k
    rooms = []
    for k in range(-1, len(boxes)):
        rects: list[Rect] = [
            (float(x[c]), float(y[r]), float(x[c + 1]), float(y[r + 1])) for r, c in np.argwhere(owner == k)
        ]
        ground = unary_union([box(*rect) for rect in rects])
        pieces = list(ground.geoms) if isinstance(ground, MultiPolygon) else [ground]
        if k >= 0:
            pieces = [max(pieces, key=lambda piece: piece.area)]
        for piece in pieces:
            # what a robot could not enter is no room, and narrow tongues of one are no part of it
            if piece.is_empty or piece.buffer(-NARROWEST / 2 + 0.01, join_style="mitre").is_empty:
                continue
            if piece.interiors:
                raise SceneError(f"room {boxes[k][0] if k >= 0 else 'corridor'!r} goes all around another one")
            own = [rect for rect in rects if piece.contains(box(*rect).centroid)]
            polygon = net_polygon(own)
            rooms.append(Room("corridor" if k < 0 else boxes[k][1], own, polygon))
    if not rooms:
        raise SceneError("no room of it is wide enough for the robot")
    if not any(room.category in LIVING for room in rooms):
        largest = max(rooms, key=lambda room: room.shape.area)
        largest.category = "open-plan" if largest.category == "kitchen" else "living"
    return rooms


def _free_share(outline: Polygon, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Share of each cell that lies in the outline, (rows, cols)."""
    prepare(outline)
    share = np.zeros((len(y) - 1, len(x) - 1))
    for r, (y0, y1) in enumerate(pairwise(y)):
        for c, (x0, x1) in enumerate(pairwise(x)):
            count_x, count_y = (max(2, math.ceil((b - a) / GRID)) for a, b in ((x0, x1), (y0, y1)))
            xx, yy = np.meshgrid(
                x0 + (np.arange(count_x) + 0.5) * (x1 - x0) / count_x,
                y0 + (np.arange(count_y) + 0.5) * (y1 - y0) / count_y,
            )
            share[r, c] = contains_xy(outline, xx, yy).mean()
    return share


def _openings(layout: Layout, outline: Polygon, rng: np.random.Generator) -> None:
    """A door for every passage, an entrance, windows; every room must be reached."""
    ways = []
    for b in range(len(layout.rooms)):
        for a in range(b):
            passages = [p for wall in shared_walls(layout.rooms[a], layout.rooms[b]) for p in _passages(outline, *wall)]
            if passages:
                ways.append((a, b, *max(passages, key=lambda passage: passage[2])))

    def rank(way: tuple) -> tuple[bool, int]:  # doors that are there, then those from halls, then from living rooms
        kinds = {layout.rooms[k].category for k in way[:2]}
        return way[5], 0 if "corridor" in kinds else 1 if kinds & set(LIVING) else 2

    reached: list[set[int]] = [{k} for k in range(len(layout.rooms))]
    for a, b, at, d, width, open_ in sorted(ways, key=rank):
        if open_ and reached[a] is reached[b]:
            continue
        place, direction = (float(at[0]), float(at[1])), (float(d[0]), float(d[1]))
        layout.openings.append(Opening("door", place, direction, round(width, 3), 0.0, DOOR_HEIGHT, [a, b]))
        if reached[a] is not reached[b]:
            reached[a] |= reached[b]
            for k in reached[a]:
                reached[k] = reached[a]
    main = max(reached, key=len)
    for k, room in enumerate(layout.rooms):
        if k not in main:
            x, y = np.mean(room.polygon, axis=0)
            raise SceneError(
                f"the {room.category} around x = {x:.1f}, y = {y:.1f} has no door to the rest of the house"
            )
    halls = [k for k, room in enumerate(layout.rooms) if room.category == "corridor"]
    for k in [*halls, *sorted(range(len(layout.rooms)), key=lambda k: layout.rooms[k].category not in LIVING)]:
        if add_entrance(layout, k):
            break
    for k, room in enumerate(layout.rooms):
        add_windows(layout, k, room, rng)


def _passages(outline: Polygon, p: np.ndarray, q: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, float, bool]]:
    """Where the outline leaves a way across a wall line: (middle, direction, width, no wall at all)."""
    length = float(np.linalg.norm(q - p))
    if length < DOOR[0] + 0.24:
        return []
    d = (q - p) / length
    across = np.array([d[1], -d[0]])
    along = np.arange(0.02, length, 0.04)
    points = p + along[:, None, None] * d + np.linspace(-JOIN, JOIN, 7)[None, :, None] * across
    open_ = contains_xy(outline, points[..., 0], points[..., 1]).all(axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], open_, [False]]).astype(int)))
    found = []
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        free = float(end - start) * 0.04
        if free < PASSAGE:
            continue
        width = min(max(free, DOOR[0]), DOOR[1], length - 0.24)
        middle = float(np.clip((start + end) * 0.02, width / 2 + 0.12, length - width / 2 - 0.12))
        found.append((p + d * middle, d, width, free > 0.8 * length))
    return found


def _largest(shape: Polygon | MultiPolygon) -> Polygon:
    pieces = getattr(shape, "geoms", [shape])
    return Polygon(max(pieces, key=lambda piece: piece.area).exterior)
