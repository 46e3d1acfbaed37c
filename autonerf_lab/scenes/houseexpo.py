"""Import of floor plans in the JSON format of HouseExpo (Li et al., 2019) as furnished apartments.

A file contains the outline of the free space, ``verts``, in metres, and a bounding box for every room,
``room_category``. If the outline includes the walls between rooms, its passages become doors. Rooms that it does not
separate are connected by as few doors as possible. The imported plan is axis-aligned like the boxes: nearly equal edges
are merged into one wall line, the overlap of two boxes belongs to the smaller one if that lies inside the larger one
(which becomes L-shaped), and free floor without a box becomes a corridor. Rooms too narrow for the robot are left out.
"""

import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from shapely import contains_xy, prepare
from shapely.errors import GEOSException
from shapely.geometry import MultiPolygon, Polygon, box
from shapely.ops import unary_union

from autonerf_lab.errors import DataError, SceneError
from autonerf_lab.scenes.build import build
from autonerf_lab.scenes.floorplan import plan_rooms
from autonerf_lab.scenes.generator import STAGES, to_spec
from autonerf_lab.scenes.layout import DOOR_HEIGHT, LIVING, Layout, Opening, Rect, Room, net_polygon
from autonerf_lab.scenes.openings import add_entrance, add_windows, place_openings, shared_walls
from autonerf_lab.scenes.scene import Scene
from autonerf_lab.utils.storage import parse_json, read_bytes

MAX_BYTES = 8 * 2**20
MAX_VERTS, MAX_ROOMS = 10_000, 64
MAX_SIDE = 60.0  # metres, extent of the plan
JOIN = 0.3  # metres; nearer edges are the two faces of one wall
SHARED = 0.1  # share of the smaller box up to which an overlap is ignored (boxes overlap by their walls)
INSIDE = 0.9  # share of the smaller box above which it lies inside the larger one
NARROWEST = 1.2  # metres, shorter side of the narrowest room
GRID = 0.1  # metres, sampling distance of the outline
PASSAGE = 0.6  # metres, width of free floor across a wall line that makes a door
DOOR = (0.84, 1.5)  # metres, narrowest and widest door

_KIND = {  # room category: parts of HouseExpo labels
    "living": ("living", "lounge", "family", "dining"),
    "kitchen": ("kitchen", "pantry"),
    "bath": ("bath", "toilet", "wc", "shower", "restroom", "laundry"),
    "bedroom": ("bed", "guest", "child", "kid", "nursery", "sleep"),
    "study": ("office", "study", "library", "gym", "hobby", "studio"),
    "corridor": ("hall", "corridor", "entry", "entrance", "lobby", "foyer", "aisle", "passage", "storage", "closet",
                 "wardrobe", "garage", "balcony", "terrace", "stair", "boiler"),
}  # fmt: skip


def import_houseexpo(path: str | Path, seed: int = 0) -> Scene:
    """Import a floor plan and furnish it.

    Args:
        path: HouseExpo file with ``verts`` [[x, y], ...] and ``room_category``
            {"Kitchen": [[x0, y0, x1, y1], ...]}, metres.
        seed: Random seed of furniture, materials and lights.

    Returns:
        Scene like those of :func:`~autonerf_lab.scenes.generate_apartment`, named after the file. The classes it
        contains depend on its rooms.

    Raises:
        SceneError: The file is not a valid floor plan, rooms overlap, a room has no door, or the plan exceeds the
            limits. The message names the file and the room.
    """
    path = Path(path)
    try:
        content = parse_json(read_bytes(path, MAX_BYTES), Any, str(path))
    except DataError as error:
        raise SceneError(str(error)) from error
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
    """Return the room category that a HouseExpo label stands for; ``study`` if it is unknown.

    Example:
        >>> category_of("Living_Room"), category_of("Guest_Room"), category_of("Toilet"), category_of("Room")
        ('living', 'bedroom', 'bath', 'study')
    """
    plain = name.lower()
    return next((kind for kind, words in _KIND.items() if any(word in plain for word in words)), "study")


def _parse(content: object) -> tuple[Polygon, list[tuple[str, str, Rect]]]:
    """Return the outline and the (label, category, box) of each room, largest first, moved to the origin."""
    if not isinstance(content, dict):
        raise SceneError("not a floor plan: it must be a JSON object with 'verts' and 'room_category'")
    verts, labels = content.get("verts"), content.get("room_category")
    if not isinstance(verts, list) or not isinstance(labels, dict):
        raise SceneError("not a floor plan: it needs 'verts' (a list) and 'room_category' (an object)")
    if not 3 <= len(verts) <= MAX_VERTS:
        raise SceneError(f"'verts' has {len(verts)} points; 3 to {MAX_VERTS} are allowed")
    for k, point in enumerate(verts):
        _check_numbers(point, 2, f"verts[{k}]")
    boxes: list[tuple[str, str, Rect]] = []
    for label, rows in labels.items():
        if not isinstance(rows, list):
            raise SceneError(f"room_category[{label[:40]!r}] must be a list of boxes")
        if len(boxes) + len(rows) > MAX_ROOMS:
            raise SceneError(f"more than {MAX_ROOMS} rooms, the limit")
        for row in rows:
            _check_numbers(row, 4, f"a box of {label[:40]!r}")
            x0, y0, x1, y1 = (float(v) for v in row)
            boxes.append((label[:40], category_of(label), (min(x0, x1), min(y0, y1), max(x0, x1), max(y0, y1))))
    low, high = np.min(verts, axis=0).astype(float), np.max(verts, axis=0).astype(float)
    if (high - low).max() > MAX_SIDE or (high - low).min() < NARROWEST:
        size = " x ".join(f"{side:.1f}" for side in high - low)
        raise SceneError(
            f"the plan measures {size} m; {NARROWEST} to {MAX_SIDE:.0f} m are allowed; check the unit (metres expected)"
        )
    try:
        outline = _largest(Polygon(np.array(verts, dtype=float) - low).buffer(0))
    except (GEOSException, ValueError) as error:
        raise SceneError(f"'verts' is not a valid outline: {error}") from error
    if outline.area < NARROWEST**2:
        raise SceneError("'verts' encloses no floor area")
    x, y = low.tolist()
    moved = [(label, kind, (b[0] - x, b[1] - y, b[2] - x, b[3] - y)) for label, kind, b in boxes]
    return outline, _resolve_overlaps(moved)


def _check_numbers(value: object, count: int, where: str) -> None:
    if not (
        isinstance(value, list)
        and len(value) == count
        and all(type(v) in (int, float) and abs(v) < 1e6 and math.isfinite(v) for v in value)
    ):
        raise SceneError(f"{where} must be a list of {count} finite numbers")


def _resolve_overlaps(boxes: list[tuple[str, str, Rect]]) -> list[tuple[str, str, Rect]]:
    """Return one entry per room, largest first; merge boxes of the same room and reject partial overlaps."""
    kept: list[tuple[str, str, Rect]] = []
    for label, kind, b in sorted(boxes, key=lambda entry: -_area(entry[2])):
        twin = next((k for k, other in enumerate(kept) if _shared_area(b, other[2]) > INSIDE * _area(other[2])), None)
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
            shared = _shared_area(a, b)
            deep = min(min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])) > JOIN
            if deep and SHARED * _area(b) < shared < INSIDE * _area(b):
                raise SceneError(
                    f"rooms {other!r} and {label!r} overlap by {shared:.1f} m2 around x = {(b[0] + b[2]) / 2:.1f},"
                    f" y = {(b[1] + b[3]) / 2:.1f} (from the corner of the plan)"
                )
    return kept


def _area(b: Rect) -> float:
    return max(0.0, b[2] - b[0]) * max(0.0, b[3] - b[1])


def _shared_area(a: Rect, b: Rect) -> float:
    return _area((max(a[0], b[0]), max(a[1], b[1]), min(a[2], b[2]), min(a[3], b[3])))


def _lines(values: list[float]) -> np.ndarray:
    """Return wall lines: the midpoints of groups of nearly equal coordinates."""
    groups: list[list[float]] = []
    for value in sorted(values):
        if groups and value - groups[-1][0] < JOIN:
            groups[-1].append(value)
        else:
            groups.append([value])
    return np.array([round((group[0] + group[-1]) / 2, 2) for group in groups])


def _rooms(outline: Polygon, boxes: list[tuple[str, str, Rect]]) -> list[Room]:
    """Build rooms from the cells between the wall lines; a cell belongs to the smallest box that contains it."""
    corners = np.array(outline.exterior.coords)
    steps = np.diff(corners, axis=0)
    walls = [  # outer walls that are no edge of a box
        [c[axis] for c, d in zip(corners[:-1], steps, strict=True) if abs(d[axis]) < 0.02 and abs(d[1 - axis]) > 1.0]
        for axis in (0, 1)
    ]
    x = _lines([v for _, _, b in boxes for v in (b[0], b[2])] + walls[0] + list(outline.bounds[::2]))
    y = _lines([v for _, _, b in boxes for v in (b[1], b[3])] + walls[1] + list(outline.bounds[1::2]))
    free = _free_share(outline, x, y)
    owner = np.where(free > 0.5, -1, -2)  # -1: free floor without a box, -2: outside
    for k, (_, _, b) in enumerate(boxes):  # largest first: smaller boxes overwrite
        middle_x, middle_y = (x[:-1] + x[1:]) / 2, (y[:-1] + y[1:]) / 2
        inside = ((middle_y > b[1]) & (middle_y < b[3]))[:, None] & ((middle_x > b[0]) & (middle_x < b[2]))[None, :]
        owner[inside & (owner > -2)] = k
    rooms = []
    for k in range(-1, len(boxes)):
        rects: list[Rect] = [
            (float(x[c]), float(y[r]), float(x[c + 1]), float(y[r + 1])) for r, c in np.argwhere(owner == k)
        ]
        floor = unary_union([box(*rect) for rect in rects])
        pieces = list(floor.geoms) if isinstance(floor, MultiPolygon) else [floor]
        if k >= 0:
            pieces = [max(pieces, key=lambda piece: piece.area)]
        for piece in pieces:
            # skip pieces too narrow for the robot
            if piece.is_empty or piece.buffer(-NARROWEST / 2 + 0.01, join_style="mitre").is_empty:
                continue
            if piece.interiors:
                raise SceneError(
                    f"room {boxes[k][0] if k >= 0 else 'corridor'!r} encloses another room, which is not supported"
                )
            own = [rect for rect in rects if piece.contains(box(*rect).centroid)]
            polygon = net_polygon(own)
            rooms.append(Room("corridor" if k < 0 else boxes[k][1], own, polygon))
    if not rooms:
        raise SceneError("no room is wide enough for the robot")
    if not any(room.category in LIVING for room in rooms):
        largest = max(rooms, key=lambda room: room.shape.area)
        largest.category = "open-plan" if largest.category == "kitchen" else "living"
    return rooms


def _free_share(outline: Polygon, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the share of each cell inside the outline, (rows, cols)."""
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
    """Add doors, an entrance and windows.

    Every passage in a wall becomes a door. Rooms without a wall between them get only the doors that connect them.

    Raises:
        SceneError: A room has no door to the others.
    """
    candidates = []
    for b in range(len(layout.rooms)):
        for a in range(b):
            passages = [p for wall in shared_walls(layout.rooms[a], layout.rooms[b]) for p in _passages(outline, *wall)]
            if passages:
                candidates.append((a, b, *max(passages, key=lambda passage: passage[2])))

    def rank(candidate: tuple) -> tuple[bool, int]:  # passages first; then from corridors, then from living rooms
        kinds = {layout.rooms[k].category for k in candidate[:2]}
        return candidate[5], 0 if "corridor" in kinds else 1 if kinds & set(LIVING) else 2

    reached: list[set[int]] = [{k} for k in range(len(layout.rooms))]
    for a, b, at, d, width, open_ in sorted(candidates, key=rank):
        if open_ and reached[a] is reached[b]:
            continue
        position, direction = (float(at[0]), float(at[1])), (float(d[0]), float(d[1]))
        layout.openings.append(Opening("door", position, direction, round(width, 3), 0.0, DOOR_HEIGHT, [a, b]))
        if reached[a] is not reached[b]:
            reached[a] |= reached[b]
            for k in reached[a]:
                reached[k] = reached[a]
    main = max(reached, key=len)
    for k, room in enumerate(layout.rooms):
        if k not in main:
            x, y = np.mean(room.polygon, axis=0)
            raise SceneError(
                f"the {room.category} around x = {x:.1f}, y = {y:.1f} has no door to the other rooms;"
                f" a wall needs a passage of at least {PASSAGE} m"
            )
    halls = [k for k, room in enumerate(layout.rooms) if room.category == "corridor"]
    for k in [*halls, *sorted(range(len(layout.rooms)), key=lambda k: layout.rooms[k].category not in LIVING)]:
        if add_entrance(layout, k):
            break
    for k, room in enumerate(layout.rooms):
        add_windows(layout, k, room, rng)


def _passages(outline: Polygon, p: np.ndarray, q: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, float, bool]]:
    """Return the passages across a wall line as (centre, direction, width, open): open if there is no wall at all."""
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
    """Return the largest polygon of a shape without its holes."""
    pieces = getattr(shape, "geoms", [shape])
    return Polygon(max(pieces, key=lambda piece: piece.area).exterior)
