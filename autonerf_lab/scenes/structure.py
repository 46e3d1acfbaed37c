"""Solids of the building (object 0): walls, floors, ceilings, doorways and windows, in the world frame.

Hidden surfaces are omitted: the outer faces of the outer walls and the backs of the skirting boards.
"""

from itertools import pairwise

import numpy as np
from shapely.geometry import Point

from autonerf_lab.scenes.layout import WALL, Layout, Opening
from autonerf_lab.scenes.stairs import cut_out, slab_edges

REVEAL = 0.16  # metres from the inner face of an outer wall to the window pane
TRIM = 0.065  # metres, width of the face of a door frame
TILED = 2.0  # metres, height of the tiles in a bathroom


def structure_parts(layout: Layout) -> list[dict]:
    """Return all parts of the building."""
    parts: list[dict] = []
    for index, room in enumerate(layout.rooms):
        for rect in floor_rects(layout, index):
            for x0, y0, x1, y1 in cut_out([rect], layout.stairwell if layout.storey else None):
                parts.append({"quad": [[x1 - x0, 0, 0], [0, y1 - y0, 0]], "at": [x0, y0, 0], "m": f"floor{index}"})
            for x0, y0, x1, y1 in cut_out([rect], None if layout.storey else layout.stairwell):
                u, v = [0, y1 - y0, 0], [x1 - x0, 0, 0]
                parts.append({"quad": [u, v], "at": [x0, y0, layout.height], "m": "ceiling"})
        for p, q in room.edges():
            parts += _wall(layout, index, p, q)
    for number, opening in enumerate(layout.openings):
        if opening.kind == "door":
            parts += _doorway(layout, opening)
        elif opening.kind == "window":
            parts += _window(layout, opening, number)
        else:
            parts += _entrance(opening)
    return parts + slab_edges(layout)


def floor_rects(layout: Layout, index: int) -> list[tuple[float, float, float, float]]:
    """Return rectangles that cover the polygon of a room exactly."""
    polygon = layout.rooms[index].shape
    xs = sorted({x for x, _ in layout.rooms[index].polygon})
    found = []
    for x0, x1 in pairwise(xs):
        ys = sorted({y for _, y in layout.rooms[index].polygon})
        run: list[float] = []
        for y0, y1 in pairwise(ys):
            middle = ((x0 + x1) / 2, (y0 + y1) / 2)
            if polygon.contains(Point(middle)):
                run = [run[0], y1] if run else [y0, y1]
            elif run:
                found.append((x0, run[0], x1, run[1]))
                run = []
        if run:
            found.append((x0, run[0], x1, run[1]))
    return found


def openings_on(layout: Layout, index: int, p: np.ndarray, q: np.ndarray) -> list[tuple[float, float, Opening]]:
    """Return the openings in the wall p -> q of a room as (start, end, opening), metres from p, in order."""
    length = float(np.linalg.norm(q - p))
    d = (q - p) / length
    outward = np.array([d[1], -d[0]])
    found = []
    for opening in layout.openings:
        offset = np.array(opening.at) - p
        along = float(offset @ d)
        parallel = abs(float(np.array(opening.direction) @ d)) > 0.99
        if index in opening.rooms and parallel and abs(float(offset @ outward)) < WALL and 0 < along < length:
            found.append((along - opening.width / 2, along + opening.width / 2, opening))
    return sorted(found, key=lambda item: item[0])


def _wall(layout: Layout, index: int, p: np.ndarray, q: np.ndarray) -> list[dict]:
    """Return the parts of one wall around its openings, with skirting boards."""
    length = float(np.linalg.norm(q - p))
    d = (q - p) / length
    parts: list[dict] = []
    tiled = layout.rooms[index].category == "bath"

    def piece(start: float, end: float, low: float, high: float) -> None:
        for z0, z1, material in [(low, min(high, TILED), f"tiles{index}"), (max(low, TILED), high, f"wall{index}")]:
            z_low, z_high = (z0, z1) if tiled else (low, high)
            if end - start > 1e-3 and z_high - z_low > 1e-3:
                at = p + d * end
                u = -d * (end - start)
                name = material if tiled else f"wall{index}"
                parts.append(
                    {"quad": [[u[0], u[1], 0], [0, 0, z_high - z_low]], "at": [at[0], at[1], z_low], "m": name}
                )
            if not tiled:
                break

    def skirting(start: float, end: float) -> None:
        if end - start > 0.03:
            middle = p + d * (start + end) / 2 + np.array([-d[1], d[0]]) * 0.006
            yaw = float(np.arctan2(d[1], d[0]))
            parts.append(
                {"box": [end - start, 0.012, 0.08], "at": [*middle, 0], "yaw": yaw, "m": "skirting", "omit": "yz"}
            )

    free = 0.0
    run = 0.0
    for start, end, opening in openings_on(layout, index, p, q):
        piece(free, start, 0.0, layout.height)
        piece(start, end, 0.0, opening.low)
        if opening.kind == "entrance":
            piece(start, end, 0.0, layout.height)
        else:
            piece(start, end, opening.high, layout.height)
        if opening.kind != "window":
            skirting(run, start - TRIM)
            run = end + TRIM
        free = end
    piece(free, length, 0.0, layout.height)
    skirting(run, length)
    return parts


def _oriented(opening: Opening) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the direction of an opening along its wall, the normal on its left, and its yaw."""
    d = np.array(opening.direction)
    return d, np.array([-d[1], d[0]]), float(np.arctan2(d[1], d[0]))


def _frame(opening: Opening, side: np.ndarray, yaw: float, material: str) -> list[dict]:
    """Return a door frame of three boards; ``side`` leads from the opening's centre to the wall face, +y is outward."""
    d = np.array([np.cos(yaw), np.sin(yaw)])
    out = np.array([-d[1], d[0]])
    base = np.array(opening.at) + side + out * 0.009
    half = opening.width / 2 + TRIM / 2
    parts = []
    for sign in (-1, 1):
        at = base + d * sign * half
        parts.append({"box": [TRIM, 0.018, opening.high], "at": [*at, 0], "yaw": yaw, "m": material, "omit": "yzZ"})
    wide = opening.width + 2 * TRIM
    parts.append({"box": [wide, 0.018, TRIM], "at": [*base, opening.high], "yaw": yaw, "m": material, "omit": "y"})
    return parts


def _doorway(layout: Layout, opening: Opening) -> list[dict]:
    """Return jambs, threshold, lintel and frames of a doorway."""
    d, left, yaw = _oriented(opening)
    at, half, h = np.array(opening.at), opening.width / 2, opening.high
    parts = []
    for sign in (-1, 1):  # the jambs face each other
        foot = at + d * sign * half + left * sign * WALL / 2
        along = -left * sign * WALL
        parts.append({"quad": [[along[0], along[1], 0], [0, 0, h]], "at": [*foot, 0], "m": "frame"})
    corner = at - d * half - left * WALL / 2
    u, v = d * opening.width, left * WALL
    parts.append({"quad": [[u[0], u[1], 0], [v[0], v[1], 0]], "at": [*corner, 0], "m": "threshold"})
    parts.append({"quad": [[v[0], v[1], 0], [u[0], u[1], 0]], "at": [*corner, h], "m": "frame"})
    parts += _frame(opening, left * WALL / 2, yaw, "frame")
    parts += _frame(opening, -left * WALL / 2, yaw + np.pi, "frame")
    return parts


def _entrance(opening: Opening) -> list[dict]:
    """Return a closed entrance door with two panels, a handle and a frame."""
    d, left, yaw = _oriented(opening)
    at = np.array(opening.at)
    parts = _frame(opening, np.zeros(2), yaw, "frame")

    def board(x: float, z: float, size: list[float], out: float, material: str) -> dict:
        position = at + d * x + left * (out + size[1] / 2)
        return {"box": size, "at": [*position, z], "yaw": yaw, "m": material, "omit": "y"}

    w = opening.width
    parts.append(board(0, 0.008, [w, 0.012, opening.high - 0.008], 0, "door"))
    for z, h in [(0.18, 0.72), (1.12, 0.78)]:
        parts.append(board(0, z, [w - 0.3, 0.012, h], 0.012, "door"))
    parts.append(board(w / 2 - 0.08, 0.98, [0.04, 0.012, 0.18], 0.012, "metal"))
    parts.append(board(w / 2 - 0.12, 1.06, [0.13, 0.018, 0.02], 0.05, "metal"))
    return parts


def _window(layout: Layout, opening: Opening, number: int) -> list[dict]:
    """Return reveal, pane, bars and sill of a window."""
    d, left, yaw = _oriented(opening)  # left points into the room
    at, half, low, high = np.array(opening.at), opening.width / 2, opening.low, opening.high
    parts: list[dict] = []
    back = -left * REVEAL
    for sign in (-1, 1):
        foot = at + d * sign * half + (0 if sign > 0 else 1) * back
        along = back * sign
        parts.append({"quad": [[along[0], along[1], 0], [0, 0, high - low]], "at": [*foot, low], "m": "reveal"})
    corner, u = at - d * half, d * opening.width
    parts.append({"quad": [[back[0], back[1], 0], [u[0], u[1], 0]], "at": [*corner, low], "m": "reveal"})
    parts.append({"quad": [[u[0], u[1], 0], [back[0], back[1], 0]], "at": [*corner, high], "m": "reveal"})
    pane = at + d * half + back
    parts.append({"quad": [[-u[0], -u[1], 0], [0, 0, high - low]], "at": [*pane, low], "m": f"outdoors{number}"})

    def bar(x: float, z: float, size: list[float]) -> dict:
        position = at + d * x + back + left * size[1] / 2
        return {"box": size, "at": [*position, z], "yaw": yaw, "m": "window_frame", "omit": "y"}

    w, h = opening.width, high - low
    parts += [bar(s * (half - 0.03), low, [0.06, 0.05, h]) for s in (-1, 1)]
    parts += [bar(0, z, [w - 0.12, 0.05, 0.06]) for z in (low, high - 0.06)]
    if w > 0.9:
        parts.append(bar(0, low + 0.06, [0.08, 0.05, h - 0.12]))
    if 0.3 < low < 1.2:  # a sill that projects slightly
        position = at + left * 0.03
        size = [w + 0.1, 0.06, 0.03]
        parts.append({"box": size, "at": [*position, low - 0.03], "yaw": yaw, "m": "sill", "omit": "y"})
    return parts
