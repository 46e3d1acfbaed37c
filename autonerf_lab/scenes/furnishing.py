"""Generator stage 3: furniture, room by room, required pieces first; pieces that do not fit are left out."""

from collections.abc import Callable

import numpy as np

from autonerf_lab.scenes import bathroom, cabinets, objects, seating
from autonerf_lab.scenes.furniture_groups import (
    place_armchair,
    place_bed_group,
    place_desk_group,
    place_dining_group,
    place_kitchen_row,
    place_media_group,
)
from autonerf_lab.scenes.furniture_model import FurnitureModel, pick
from autonerf_lab.scenes.layout import LIVING, Layout, PlacedObject
from autonerf_lab.scenes.placement import SKIRTING_GAP, Placer
from autonerf_lab.scenes.wall_objects import furnish_walls, furnish_windows


def place_furniture(layout: Layout, rng: np.random.Generator) -> None:
    """Furnish all rooms of a layout that has doors and windows."""
    placer = Placer(layout)
    order = ["kitchen", "bath", "dining", *LIVING, "bedroom", "study", "utility", "corridor"]
    for category in order:
        for index, room in enumerate(layout.rooms):
            if room.category == category:
                _ROOMS[category](placer, index, rng)
    for index, room in enumerate(layout.rooms):
        furnish_windows(placer, index, rng)
        furnish_walls(placer, index, room.category, rng)


def _living(placer: Placer, room: int, rng: np.random.Generator) -> None:
    large = placer.shapes[room].area > 30
    place_media_group(placer, room, rng)
    if not any(t.class_id == 7 for t in placer.layout.objects):
        place_dining_group(placer, room, rng, 1.8)
    for _ in range(int(rng.integers(1, 3)) + large):
        placer.along_wall(cabinets.shelf(rng), room, rng)
    if rng.random() < 0.7:
        w = float(rng.uniform(0.9, 1.5))
        placer.along_wall(cabinets.fronted(rng, "sideboard", w, 0.42, 0.78, round(w / 0.5), 2, "cupboard"), room, rng)
    _plant(placer, room, rng)
    for _ in range(int(rng.integers(1, 3)) + large):
        place_armchair(placer, room, rng)
    if rng.random() < 0.7:
        placer.along_wall(objects.floor_lamp(rng), room, rng, "corner", away=0.05)
    if rng.random() < 0.5:
        _plant(placer, room, rng)


def _open_plan(placer: Placer, room: int, rng: np.random.Generator) -> None:
    _kitchen(placer, room, rng)
    _living(placer, room, rng)


def _studio(placer: Placer, room: int, rng: np.random.Generator) -> None:
    _kitchen(placer, room, rng)
    place_bed_group(placer, room, rng, rng.random() < 0.5, "corner")
    _living(placer, room, rng)
    placer.along_wall(_wardrobe(rng, 1.0), room, rng, tries=14)


def _plant(placer: Placer, room: int, rng: np.random.Generator) -> PlacedObject | None:
    return placer.along_wall(objects.plant(rng), room, rng, "corner", away=0.04, tries=20)


def _kitchen(placer: Placer, room: int, rng: np.random.Generator) -> None:
    made = place_kitchen_row(placer, room, rng, [3.2, 2.8, 2.4, 2.2, 2.0, 1.7, 1.4, 1.2], True, True)
    if not made:
        place_kitchen_row(placer, room, rng, [1.6, 1.2, 0.8, 0.6], True, False)
        place_kitchen_row(placer, room, rng, [1.6, 1.2, 0.6], False, True)
    placer.along_wall(cabinets.fridge(rng), room, rng, "corner", tries=20) or placer.along_wall(
        cabinets.fridge(rng), room, rng, tries=30
    )
    if made and rng.random() < 0.6:
        place_kitchen_row(placer, room, rng, [1.6, 1.2, 0.9], False, False)
    if placer.layout.rooms[room].category == "kitchen" and rng.random() < 0.55 and placer.shapes[room].area > 8.5:
        place_dining_group(placer, room, rng, 1.25)


def _bath(placer: Placer, room: int, rng: np.random.Generator) -> None:
    tub = bathroom.bath_tub(rng, float(rng.uniform(1.55, 1.75)))
    bathing = None
    if rng.random() < 0.6:
        bathing = placer.along_wall(tub, room, rng, "corner", tries=16)
    if bathing is None:
        placer.along_wall(bathroom.shower(rng), room, rng, "corner", tries=16)
    for maker in (bathroom.toilet, bathroom.wash_basin):
        for _ in range(4):
            item = placer.along_wall(maker(rng), room, rng, tries=16)
            if item is not None:
                break
        if item is not None and item.class_id == 9:
            forward = np.array([-np.sin(item.yaw), np.cos(item.yaw)])
            depth = (item.footprint[2] - item.footprint[0]) * abs(forward[0]) + (
                item.footprint[3] - item.footprint[1]
            ) * abs(forward[1])
            at = np.array(item.at[:2]) - forward * (depth / 2 + SKIRTING_GAP - 0.016)
            placer.put(bathroom.mirror(rng), room, at, item.yaw)
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
    place_bed_group(placer, room, rng, placer.shapes[room].area > 10.5, "middle")
    w = float(pick(rng, 1.0, 1.5, 1.9))
    for width in (w, 1.0, 0.8):
        if placer.along_wall(_wardrobe(rng, width), room, rng, "corner", tries=14) is not None:
            break
    if rng.random() < 0.6:
        place_desk_group(placer, room, rng)
    if rng.random() < 0.5:
        chest = cabinets.fronted(rng, "chest of drawers", float(rng.uniform(0.75, 1.0)), 0.45, 0.85, 2, 4, "cupboard")
        placer.along_wall(chest, room, rng)
    if rng.random() < 0.5:
        placer.along_wall(cabinets.shelf(rng, 0.7), room, rng)
    if rng.random() < 0.35:
        place_armchair(placer, room, rng)
    if rng.random() < 0.5:
        _plant(placer, room, rng)
    if rng.random() < 0.5:
        placer.along_wall(objects.basket(rng), room, rng, away=0.03)


def _wardrobe(rng: np.random.Generator, width: float) -> FurnitureModel:
    height = float(rng.uniform(1.95, 2.2))
    return cabinets.fronted(rng, "wardrobe", width, 0.6, height, max(2, round(width / 0.5)), 1, "wardrobe")


def _study(placer: Placer, room: int, rng: np.random.Generator) -> None:
    place_desk_group(placer, room, rng)
    for _ in range(int(rng.integers(1, 4))):
        placer.along_wall(cabinets.shelf(rng), room, rng)
    if rng.random() < 0.5:
        placer.along_wall(seating.couch(rng, 1.6), room, rng)
    elif rng.random() < 0.5:
        placer.along_wall(seating.bed(rng, False), room, rng, "corner")
    _plant(placer, room, rng)
    x0, y0, x1, y1 = placer.shapes[room].bounds
    placer.put(objects.rug(rng, 1.5, 1.0), room, np.array([(x0 + x1) / 2, (y0 + y1) / 2]), 0.0)


def _dining(placer: Placer, room: int, rng: np.random.Generator) -> None:
    place_dining_group(placer, room, rng, 1.8)
    for _ in range(2):
        w = float(rng.uniform(0.9, 1.5))
        placer.along_wall(cabinets.fronted(rng, "sideboard", w, 0.42, 0.78, round(w / 0.5), 2, "cupboard"), room, rng)
    placer.along_wall(cabinets.shelf(rng), room, rng)
    _plant(placer, room, rng)


def _utility(placer: Placer, room: int, rng: np.random.Generator) -> None:
    placer.along_wall(bathroom.washing_machine(rng), room, rng)
    for _ in range(2):
        placer.along_wall(cabinets.shelf(rng, 0.7), room, rng)
    placer.along_wall(_wardrobe(rng, 0.8), room, rng, "corner")
    placer.along_wall(objects.basket(rng), room, rng, away=0.03)


def _corridor(placer: Placer, room: int, rng: np.random.Generator) -> None:
    w = float(rng.uniform(0.7, 1.1))
    shoes = cabinets.fronted(rng, "shoe cupboard", w, 0.24, float(rng.uniform(0.8, 1.05)), 2, 2, "cupboard")
    shoes.clear = 0.4
    placer.along_wall(shoes, room, rng, tries=20)
    if rng.random() < 0.7:
        placer.along_wall(objects.coat_rack(rng), room, rng)
    if rng.random() < 0.5:
        placer.along_wall(objects.plant(rng), room, rng, "corner", away=0.04)
    x0, y0, x1, y1 = placer.layout.rooms[room].rects[0]  # first arm of an L-shaped corridor
    long, short = max(x1 - x0, y1 - y0), min(x1 - x0, y1 - y0)
    if (width := min(0.8, short - 0.5)) <= 0:  # a closet of a floor plan
        return
    runner = objects.rug(rng, min(3.0, long * 0.55), width)
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
    "dining": _dining,
    "utility": _utility,
    "corridor": _corridor,
}
