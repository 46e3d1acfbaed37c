"""Furniture groups: pieces that are placed together, such as a TV with a couch or a table with chairs."""

import numpy as np
from shapely.geometry import LineString, Polygon

from autonerf_lab.scenes import cabinets, objects, seating
from autonerf_lab.scenes.furniture_model import FurnitureModel, pick
from autonerf_lab.scenes.placement import SKIRTING_GAP, Placer, yaw_facing


def place_armchair(placer: Placer, room: int, rng: np.random.Generator) -> None:
    """Place an armchair that faces the coffee table, or with its back to a wall."""
    table = next((t for t in placer.layout.objects if t.room == room and t.name.startswith("coffee")), None)
    model = seating.armchair(rng)
    for _ in range(12):
        if table is None:
            break
        away = np.array([np.cos(table.yaw), np.sin(table.yaw)]) * float(pick(rng, -1.0, 1.0))
        reach = 0.5 * (
            abs(away[0]) * (table.footprint[2] - table.footprint[0])
            + abs(away[1]) * (table.footprint[3] - table.footprint[1])
        )
        at = np.array(table.at[:2]) + away * (reach + float(rng.uniform(0.75, 1.1)))
        if placer.put(model, room, at, yaw_facing(-away) + float(rng.uniform(-0.3, 0.3)), front=False) is not None:
            return
    placer.along_wall(model, room, rng, tries=8)


def place_media_group(placer: Placer, room: int, rng: np.random.Generator) -> bool:
    """Place a TV on a bench, a couch opposite, and a rug and a coffee table between them; True if it succeeds."""
    shape = placer.shapes[room]
    spans = sorted(placer.spans(room), key=lambda s: s[2] - s[3])
    for attempt in range(60):
        p, along, start, end = spans[attempt % min(len(spans), 5)]
        w = float(rng.uniform(1.2, 1.7)) if attempt < 30 else 1.05
        if end - start < w + 0.1:
            continue
        bench = cabinets.fronted(rng, "tv bench", w, 0.4, float(rng.uniform(0.42, 0.52)), 2, 1, "cupboard")
        bench.clear = 0
        t = float(rng.uniform(start + w / 2, end - w / 2)) if attempt % 2 else (start + end) / 2
        inward = np.array([-along[1], along[0]])
        wall = p + along * t
        reach = _clear_distance(shape, wall, inward)
        couch = seating.couch(rng, 2.3 if attempt < 35 else 1.65)
        far = reach - SKIRTING_GAP - couch.size[1] / 2
        near = 0.42 + float(rng.uniform(1.9, 2.4)) + couch.size[1] / 2
        if far < 0.42 + 1.35 + couch.size[1] / 2:
            continue
        distance = far if far - near < 0.9 else near
        count, zones, free = len(placer.layout.objects), len(placer.fronts), placer.free.copy()
        seat = placer.put(couch, room, wall + inward * distance, yaw_facing(-inward))
        if seat is None:
            continue
        stand = placer.put(bench, room, wall + inward * (bench.size[1] / 2 + SKIRTING_GAP), yaw_facing(inward))
        if stand is None:
            del placer.layout.objects[count:], placer.fronts[zones:]
            placer.free = free
            continue
        screen = objects.tv(rng, min(w * 0.82, 1.25))
        placer.put(screen, room, wall + inward * (0.2 + SKIRTING_GAP), yaw_facing(inward), bench.size[2], check=False)
        stand.surfaces.clear()
        between = distance - couch.size[1] / 2
        table = cabinets.low_table(rng)
        middle = wall + inward * max(between - 0.42 - table.size[1] / 2, 0.42 + 0.5 + table.size[1] / 2)
        placer.fronts[zones:] = []  # the coffee table may stand in front of the couch
        wide = min(2.2, couch.size[0] + 0.3)
        deep = min(1.7, between - 0.5)
        rug = objects.rug(rng, wide, deep)
        placer.put(rug, room, wall + inward * (between - deep / 2 + 0.1), yaw_facing(inward), ignore_doors=True)
        placer.put(table, room, middle, yaw_facing(inward), front=False)
        return True
    return False


def _clear_distance(shape: Polygon, start: np.ndarray, direction: np.ndarray) -> float:
    """Return the distance from a point on a wall to the opposite wall, metres."""
    begin = start + direction * 0.01
    crossing = LineString([begin, begin + direction * 30]).intersection(shape.boundary)
    points = [np.array(g.coords[0]) for g in getattr(crossing, "geoms", [crossing]) if not g.is_empty]
    return min((float((point - start) @ direction) for point in points), default=0.0)


def place_dining_group(placer: Placer, room: int, rng: np.random.Generator, widest: float) -> bool:
    """Place a dining table with chairs, free-standing or against a wall.

    Args:
        placer: Occupancy of the apartment.
        room: Index of the room.
        rng: Random generator of positions and variants.
        widest: Largest length of the table, metres.

    Returns:
        True if table and enough chairs fit.
    """
    x0, y0, x1, y1 = placer.shapes[room].bounds
    style = str(pick(rng, "slats", "upholstered", "shell"))
    seed = int(rng.integers(2**31))
    for attempt in range(70):
        limit = widest if attempt < 35 else 1.1
        table = cabinets.dining_table(rng, limit)
        chair = seating.chair(np.random.default_rng(seed), style)
        w, d, _ = table.size
        yaw = float(pick(rng, 0.0, np.pi / 2))
        c, s = np.cos(yaw), np.sin(yaw)
        rotation = np.array([[c, -s], [s, c]])
        if "round" in table.name:
            count = int(rng.integers(3, 5))
            spots = [
                (
                    np.array([np.cos(a), np.sin(a)]) * (w / 2 + chair.size[1] / 2 + 0.04),
                    -np.array([np.cos(a), np.sin(a)]),
                )
                for a in 2 * np.pi * np.arange(count) / count + (0 if count == 4 else np.pi / 2)
            ]
        else:
            per_side = 2 if w >= 1.15 else 1
            out = d / 2 + chair.size[1] / 2 + 0.03
            spots = []
            for k in range(per_side):
                x = (k - (per_side - 1) / 2) * w / per_side
                spots += [(np.array([x, y * out]), np.array([0.0, -y])) for y in (-1, 1)]
            if w > 1.5:
                spots += [
                    (np.array([v * (w / 2 + chair.size[1] / 2 + 0.03), 0]), np.array([-float(v), 0])) for v in (-1, 1)
                ]
        at = np.array([rng.uniform(x0 + 0.5, x1 - 0.5), rng.uniform(y0 + 0.5, y1 - 0.5)])
        if attempt % 2 and "round" not in table.name:  # against a wall
            wall = int(rng.integers(4))
            half = np.array([abs(c) * w + abs(s) * d, abs(s) * w + abs(c) * d]) / 2 + SKIRTING_GAP
            at = [
                np.array([x0 + half[0], at[1]]), np.array([x1 - half[0], at[1]]),
                np.array([at[0], y0 + half[1]]), np.array([at[0], y1 - half[1]]),
            ][wall]  # fmt: skip
        count, free = len(placer.layout.objects), placer.free.copy()
        if placer.put(table, room, at, yaw) is None:
            continue
        seated = 0
        for offset, facing in spots:
            wobble = float(rng.uniform(-0.1, 0.1)) if "round" not in table.name else 0.0
            model = seating.chair(np.random.default_rng(seed), style)
            position = at + rotation @ offset
            seated += placer.put(model, room, position, yaw_facing(rotation @ facing) + wobble, front=False) is not None
        if seated >= (2 if attempt < 55 else 1):
            return True
        del placer.layout.objects[count:]
        placer.free = free
    return False


def place_kitchen_row(
    placer: Placer, room: int, rng: np.random.Generator, widths: list[float], sink: bool, oven: bool
) -> bool:
    """Place a row of kitchen units with wall cupboards along a wall.

    Args:
        placer: Occupancy of the apartment.
        room: Index of the room.
        rng: Random generator of positions and variants.
        widths: Widths to try in this order, metres.
        sink: Include a sink unit.
        oven: Include an oven.

    Returns:
        True if a row of one of the widths fits.
    """
    spans = sorted(placer.spans(room, 0.14), key=lambda s: s[2] - s[3])
    for width in widths:
        for p, along, start, end in spans:
            if end - start < width + 0.02:
                continue
            inward = np.array([-along[1], along[0]])
            for t in rng.permutation([start + width / 2 + 0.01, end - width / 2 - 0.01]).tolist():
                centre = p + along * t + inward * (0.3 + SKIRTING_GAP)
                yaw = yaw_facing(inward)
                right = np.array([np.cos(yaw), np.sin(yaw)])
                probe = FurnitureModel(0, "probe", (width, 0.63, 0.9), [{"box": [1, 1, 1], "at": [0, 0, 0]}], clear=0.6)
                item = placer.put(probe, room, centre + inward * 0.015, yaw)
                if item is None:
                    continue
                placer.layout.objects.remove(item)
                for model, x in cabinets.kitchen_run(rng, width, sink, oven):
                    at = centre + right * x
                    placer.put(model, room, at, yaw, check=False)
                    if "oven" in model.name:
                        top = cabinets.hood(rng, model.size[0])
                        placer.put(top, room, at - inward * 0.075, yaw)
                    else:
                        placer.put(cabinets.wall_cupboards(rng, model.size[0]), room, at - inward * 0.135, yaw)
                return True
    return False


def place_bed_group(placer: Placer, room: int, rng: np.random.Generator, double: bool, where: str) -> None:
    """Place a single or double bed along a wall (``where`` as in ``Placer.along_wall``), bedside tables and a rug."""
    sleeping = None
    for attempt in range(5):
        model = seating.bed(rng, double and attempt < 3)
        sleeping = placer.along_wall(model, room, rng, where if attempt == 0 else "any", tries=16)
        if sleeping is not None:
            break
    if sleeping is not None:
        yaw = sleeping.yaw
        right, forward = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
        for side in (-1, 1):
            w = float(rng.uniform(0.4, 0.5))
            small = cabinets.fronted(rng, "bedside table", w, 0.38, float(rng.uniform(0.46, 0.56)), 1, 2, "cupboard")
            small.clear = 0
            at = np.array(sleeping.at[:2]) + right * side * (model.size[0] / 2 + 0.05 + w / 2)
            at = at - forward * (model.size[1] / 2 - 0.2)
            placer.put(small, room, at, yaw)
        for offset in (0.35, 0.1):
            rug = objects.rug(rng, model.size[0] + 0.9, 1.3)
            if placer.put(rug, room, np.array(sleeping.at[:2]) + forward * offset * model.size[1], yaw) is not None:
                break


def place_desk_group(placer: Placer, room: int, rng: np.random.Generator) -> None:
    """Place a desk along a wall and a chair in front of it."""
    table = placer.along_wall(cabinets.desk(rng), room, rng, tries=18)
    if table is None:
        return
    forward = np.array([-np.sin(table.yaw), np.cos(table.yaw)])
    right = np.array([forward[1], -forward[0]])
    office = seating.chair(rng, str(pick(rng, "office", "shell")))
    depth = (table.footprint[2] - table.footprint[0]) * abs(forward[0]) + (
        table.footprint[3] - table.footprint[1]
    ) * abs(forward[1])
    at = np.array(table.at[:2]) + forward * (depth / 2 + office.size[1] / 2 + 0.05) - right * 0.15
    placer.fronts[-1:] = []
    placer.put(office, room, at, yaw_facing(-forward) + float(rng.uniform(-0.3, 0.3)), front=False)
