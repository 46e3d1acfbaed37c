"""Stage three: furniture, room by room. What does not fit is left out; what must be there is tried first."""

from collections.abc import Callable

import numpy as np

from autonerf_lab.scenes import bathroom, cabinets, objects, seating
from autonerf_lab.scenes.furniture_model import Model, pick
from autonerf_lab.scenes.layout import LIVING, Layout, Thing
from autonerf_lab.scenes.placement import SKIN, Placer, heading
from autonerf_lab.scenes.wall_objects import dress_walls, dress_windows


def place_furniture(layout: Layout, rng: np.random.Generator) -> None:
    """Furnish every room of a plan with doors and windows."""
    placer = Placer(layout)
    order = ["kitchen", "bath", *LIVING, "bedroom", "study", "corridor"]
    for category in order:
        for index, room in enumerate(layout.rooms):
            if room.category == category:
                _ROOMS[category](placer, index, rng)
    for index, room in enumerate(layout.rooms):
        dress_windows(placer, index, rng)
        dress_walls(placer, index, room.category, rng)


def _living(placer: Placer, room: int, rng: np.random.Generator) -> None:
    large = placer.shapes[room].area > 30
    _media(placer, room, rng)
    if not any(t.class_id == 7 for t in placer.layout.things):
        _dining(placer, room, rng, 1.8)
    for _ in range(int(rng.integers(1, 3)) + large):
        placer.along_wall(cabinets.shelf(rng), room, rng)
    if rng.random() < 0.7:
        w = float(rng.uniform(0.9, 1.5))
        placer.along_wall(cabinets.fronted(rng, "sideboard", w, 0.42, 0.78, round(w / 0.5), 2, "cupboard"), room, rng)
    _plant(placer, room, rng)
    for _ in range(int(rng.integers(1, 3)) + large):
        _armchair(placer, room, rng)
    if rng.random() < 0.7:
        placer.along_wall(objects.floor_lamp(rng), room, rng, "corner", away=0.05)
    if rng.random() < 0.5:
        _plant(placer, room, rng)


def _open_plan(placer: Placer, room: int, rng: np.random.Generator) -> None:
    _kitchen(placer, room, rng)
    _living(placer, room, rng)


def _studio(placer: Placer, room: int, rng: np.random.Generator) -> None:
    _kitchen(placer, room, rng)
    _sleep(placer, room, rng, rng.random() < 0.5, "corner")
    _living(placer, room, rng)
    placer.along_wall(_wardrobe(rng, 1.0), room, rng, tries=14)


def _armchair(placer: Placer, room: int, rng: np.random.Generator) -> None:
    """Turned towards the low table, or with its back to a wall."""
    table = next((t for t in placer.layout.things if t.room == room and t.name.startswith("coffee")), None)
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
        if placer.put(model, room, at, heading(-away) + float(rng.uniform(-0.3, 0.3)), front=False) is not None:
            return
    placer.along_wall(model, room, rng, tries=8)


def _plant(placer: Placer, room: int, rng: np.random.Generator) -> Thing | None:
    return placer.along_wall(objects.plant(rng), room, rng, "corner", away=0.04, tries=20)


def _media(placer: Placer, room: int, rng: np.random.Generator) -> bool:
    """TV on its bench, couch opposite, a rug and a low table between."""
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
        far = reach - SKIN - couch.size[1] / 2
        near = 0.42 + float(rng.uniform(1.9, 2.4)) + couch.size[1] / 2
        if far < 0.42 + 1.35 + couch.size[1] / 2:
            continue
        distance = far if far - near < 0.9 else near
        count, zones, free = len(placer.layout.things), len(placer.fronts), placer.free.copy()
        seat = placer.put(couch, room, wall + inward * distance, heading(-inward))
        if seat is None:
            continue
        stand = placer.put(bench, room, wall + inward * (bench.size[1] / 2 + SKIN), heading(inward))
        if stand is None:
            del placer.layout.things[count:], placer.fronts[zones:]
            placer.free = free
            continue
        screen = objects.tv(rng, min(w * 0.82, 1.25))
        placer.put(screen, room, wall + inward * (0.2 + SKIN), heading(inward), bench.size[2], check=False)
        stand.surfaces.clear()
        between = distance - couch.size[1] / 2
        table = cabinets.low_table(rng)
        middle = wall + inward * max(between - 0.42 - table.size[1] / 2, 0.42 + 0.5 + table.size[1] / 2)
        placer.fronts[zones:] = []  # the low table may stand before the couch
        wide = min(2.2, couch.size[0] + 0.3)
        deep = min(1.7, between - 0.5)
        rug = objects.rug(rng, wide, deep)
        placer.put(rug, room, wall + inward * (between - deep / 2 + 0.1), heading(inward), ignore_doors=True)
        placer.put(table, room, middle, heading(inward), front=False)
        return True
    return False


def _clear_distance(shape: object, start: np.ndarray, direction: np.ndarray) -> float:
    """From a wall across the room to the opposite wall."""
    from shapely.geometry import LineString

    begin = start + direction * 0.01
    crossing = LineString([begin, begin + direction * 30]).intersection(shape.boundary)  # type: ignore[attr-defined]
    points = [np.array(g.coords[0]) for g in getattr(crossing, "geoms", [crossing]) if not g.is_empty]
    return min((float((point - start) @ direction) for point in points), default=0.0)


def _dining(placer: Placer, room: int, rng: np.random.Generator, widest: float) -> bool:
    """A table with chairs on its sides, free in the room or with one end or side to a wall."""
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
        turn = np.array([[c, -s], [s, c]])
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
        if attempt % 2 and "round" not in table.name:  # a side to the wall
            wall = int(rng.integers(4))
            half = np.array([abs(c) * w + abs(s) * d, abs(s) * w + abs(c) * d]) / 2 + SKIN
            at = [
                np.array([x0 + half[0], at[1]]), np.array([x1 - half[0], at[1]]),
                np.array([at[0], y0 + half[1]]), np.array([at[0], y1 - half[1]]),
            ][wall]  # fmt: skip
        count, free = len(placer.layout.things), placer.free.copy()
        if placer.put(table, room, at, yaw) is None:
            continue
        seated = 0
        for offset, facing in spots:
            wobble = float(rng.uniform(-0.1, 0.1)) if "round" not in table.name else 0.0
            model = seating.chair(np.random.default_rng(seed), style)
            place = at + turn @ offset
            seated += placer.put(model, room, place, heading(turn @ facing) + wobble, front=False) is not None
        if seated >= (2 if attempt < 55 else 1):
            return True
        del placer.layout.things[count:]
        placer.free = free
    return False


def _kitchen(placer: Placer, room: int, rng: np.random.Generator) -> None:
    made = _counter(placer, room, rng, [3.2, 2.8, 2.4, 2.2, 2.0, 1.7, 1.4, 1.2], True, True)
    if not made:
        _counter(placer, room, rng, [1.6, 1.2, 0.8, 0.6], True, False)
        _counter(placer, room, rng, [1.6, 1.2, 0.6], False, True)
    placer.along_wall(cabinets.fridge(rng), room, rng, "corner", tries=20) or placer.along_wall(
        cabinets.fridge(rng), room, rng, tries=30
    )
    if made and rng.random() < 0.6:
        _counter(placer, room, rng, [1.6, 1.2, 0.9], False, False)
    if placer.layout.rooms[room].category == "kitchen" and rng.random() < 0.55 and placer.shapes[room].area > 8.5:
        _dining(placer, room, rng, 1.25)


def _counter(placer: Placer, room: int, rng: np.random.Generator, widths: list[float], sink: bool, oven: bool) -> bool:
    spans = sorted(placer.spans(room, 0.14), key=lambda s: s[2] - s[3])
    for width in widths:
        for p, along, start, end in spans:
            if end - start < width + 0.02:
                continue
            inward = np.array([-along[1], along[0]])
            for t in rng.permutation([start + width / 2 + 0.01, end - width / 2 - 0.01]).tolist():
                centre = p + along * t + inward * (0.3 + SKIN)
                yaw = heading(inward)
                right = np.array([np.cos(yaw), np.sin(yaw)])
                probe = Model(0, "probe", (width, 0.63, 0.9), [{"box": [1, 1, 1], "at": [0, 0, 0]}], clear=0.6)
                thing = placer.put(probe, room, centre + inward * 0.015, yaw)
                if thing is None:
                    continue
                placer.layout.things.remove(thing)
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


def _bath(placer: Placer, room: int, rng: np.random.Generator) -> None:
    tub = bathroom.bath_tub(rng, float(rng.uniform(1.55, 1.75)))
    bathing = None
    if rng.random() < 0.6:
        bathing = placer.along_wall(tub, room, rng, "corner", tries=16)
    if bathing is None:
        placer.along_wall(bathroom.shower(rng), room, rng, "corner", tries=16)
    for maker in (bathroom.toilet, bathroom.wash_basin):
        for _ in range(4):
            thing = placer.along_wall(maker(rng), room, rng, tries=16)
            if thing is not None:
                break
        if thing is not None and thing.class_id == 9:
            forward = np.array([-np.sin(thing.yaw), np.cos(thing.yaw)])
            depth = (thing.footprint[2] - thing.footprint[0]) * abs(forward[0]) + (
                thing.footprint[3] - thing.footprint[1]
            ) * abs(forward[1])
            at = np.array(thing.at[:2]) - forward * (depth / 2 + SKIN - 0.016)
            placer.put(bathroom.mirror(rng), room, at, thing.yaw)
    if rng.random() < 0.65:
        placer.along_wall(bathroom.washing_machine(rng), room, rng)
    if rng.random() < 0.6:
        tall = cabinets.fronted(rng, "bathroom cupboard", 0.4, 0.32, float(pick(rng, 0.85, 1.7)), 1, 2, "bath_cupboard")
        placer.along_wall(tall, room, rng)
    placer.along_wall(objects.basket(rng), room, rng, away=0.03)
    placer.along_wall(objects.towel_rail(rng), room, rng, "free", away=0.003)
    x0, y0, x1, y1 = placer.shapes[room].bounds
    at = np.array([(x0 + x1) / 2, (y0 + y1) / 2])
    placer.put(objects.rug(rng, 0.75, 0.5), room, at, float(pick(rng, 0.0, np.pi / 2)))


def _bedroom(placer: Placer, room: int, rng: np.random.Generator) -> None:
    _sleep(placer, room, rng, placer.shapes[room].area > 10.5, "middle")
    w = float(pick(rng, 1.0, 1.5, 1.9))
    for width in (w, 1.0, 0.8):
        if placer.along_wall(_wardrobe(rng, width), room, rng, "corner", tries=14) is not None:
            break
    if rng.random() < 0.6:
        _desk(placer, room, rng)
    if rng.random() < 0.5:
        chest = cabinets.fronted(rng, "chest of drawers", float(rng.uniform(0.75, 1.0)), 0.45, 0.85, 2, 4, "cupboard")
        placer.along_wall(chest, room, rng)
    if rng.random() < 0.5:
        placer.along_wall(cabinets.shelf(rng, 0.7), room, rng)
    if rng.random() < 0.35:
        _armchair(placer, room, rng)
    if rng.random() < 0.5:
        _plant(placer, room, rng)
    if rng.random() < 0.5:
        placer.along_wall(objects.basket(rng), room, rng, away=0.03)


def _sleep(placer: Placer, room: int, rng: np.random.Generator, double: bool, where: str) -> None:
    """A bed with small tables at its head and a rug under it."""
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


def _wardrobe(rng: np.random.Generator, width: float) -> Model:
    height = float(rng.uniform(1.95, 2.2))
    return cabinets.fronted(rng, "wardrobe", width, 0.6, height, max(2, round(width / 0.5)), 1, "wardrobe")


def _desk(placer: Placer, room: int, rng: np.random.Generator) -> None:
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
    placer.put(office, room, at, heading(-forward) + float(rng.uniform(-0.3, 0.3)), front=False)


def _study(placer: Placer, room: int, rng: np.random.Generator) -> None:
    _desk(placer, room, rng)
    for _ in range(int(rng.integers(1, 4))):
        placer.along_wall(cabinets.shelf(rng), room, rng)
    if rng.random() < 0.5:
        placer.along_wall(seating.couch(rng, 1.6), room, rng)
    elif rng.random() < 0.5:
        placer.along_wall(seating.bed(rng, False), room, rng, "corner")
    _plant(placer, room, rng)
    x0, y0, x1, y1 = placer.shapes[room].bounds
    placer.put(objects.rug(rng, 1.5, 1.0), room, np.array([(x0 + x1) / 2, (y0 + y1) / 2]), 0.0)


def _corridor(placer: Placer, room: int, rng: np.random.Generator) -> None:
    w = float(rng.uniform(0.7, 1.1))
    shoes = cabinets.fronted(rng, "shoe cupboard", w, 0.24, float(rng.uniform(0.8, 1.05)), 2, 2, "cupboard")
    shoes.clear = 0.4
    placer.along_wall(shoes, room, rng, tries=20)
    if rng.random() < 0.7:
        placer.along_wall(objects.coat_rack(rng), room, rng)
    if rng.random() < 0.5:
        placer.along_wall(objects.plant(rng), room, rng, "corner", away=0.04)
    x0, y0, x1, y1 = placer.layout.rooms[room].rects[0]  # of the first arm
    long, short = max(x1 - x0, y1 - y0), min(x1 - x0, y1 - y0)
    runner = objects.rug(rng, min(3.0, long * 0.55), min(0.8, short - 0.5))
    yaw = 0.0 if x1 - x0 > y1 - y0 else np.pi / 2
    placer.put(runner, room, np.array([(x0 + x1) / 2, (y0 + y1) / 2]), yaw, ignore_doors=True)


_ROOMS: dict[str, Callable[[Placer, int, np.random.Generator], None]] = {
    "kitchen": _kitchen,
    "bath": _bath,
    "living": _living,
    "open-plan": _open_plan,
    "studio": _studio,
    "bedroom": _bedroom,
    "study": _study,
    "corridor": _corridor,
}
