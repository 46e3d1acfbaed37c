"""Placement of objects at windows and on walls: radiators, curtains, clocks, shelves, pictures."""

import numpy as np

from autonerf_lab.scenes import objects
from autonerf_lab.scenes.furniture_model import pick
from autonerf_lab.scenes.layout import LIVING
from autonerf_lab.scenes.placement import SKIRTING_GAP, Placer, yaw_facing


def furnish_windows(placer: Placer, room: int, rng: np.random.Generator) -> None:
    """Place a radiator under and curtains beside each window of a room."""
    category = placer.layout.rooms[room].category
    for o in placer.layout.openings:
        if o.kind != "window" or o.rooms[0] != room:
            continue
        d, at = np.array(o.direction), np.array(o.at)
        inward = np.array([-d[1], d[0]])
        yaw = yaw_facing(inward)
        if o.low > 0.75:
            model = objects.radiator(rng, min(o.width, 1.2))
            placer.put(model, room, at + inward * (0.05 + SKIRTING_GAP), yaw)
        if category in (*LIVING, "bedroom", "study"):
            top = placer.layout.height - 0.1
            bottom = 0.03 if rng.random() < 0.7 or o.low < 0.5 else o.low - 0.12
            for side in (-1, 1):
                w = float(rng.uniform(0.3, 0.5))
                model = objects.curtain(rng, w, top, bottom)
                position = at + d * side * (o.width / 2 + w / 2 - 0.06) + inward * 0.09
                rect = _curtain_footprint(position, d, w)
                below = (bottom, min(top, o.low))  # next to the glass a curtain may cover the window
                clear = placer.fits(room, rect, below) and placer.clear_of_objects(room, rect, (bottom, top))
                if clear and placer.reserve(rect):
                    placer.put(model, room, position, yaw, check=False)


def _curtain_footprint(at: np.ndarray, d: np.ndarray, w: float) -> tuple[float, float, float, float]:
    half = np.abs(d) * w / 2 + np.abs(d[::-1]) * 0.05
    return (float(at[0] - half[0]), float(at[1] - half[1]), float(at[0] + half[0]), float(at[1] + half[1]))


def furnish_walls(placer: Placer, room: int, category: str, rng: np.random.Generator) -> None:
    """Place a clock, a shelf and pictures on the walls of a room, depending on its category."""
    if category in (*LIVING, "kitchen") or (category == "study" and rng.random() < 0.5):
        for _ in range(3):
            model = objects.clock(rng)
            if placer.along_wall(model, room, rng, "free", away=0.002, tries=25, ignore_doors=True) is not None:
                break
    if category in (*LIVING, "kitchen", "study", "bedroom", "utility") and rng.random() < 0.55:
        placer.along_wall(objects.wall_shelf(rng), room, rng, "free", away=0.001, tries=10)
    wanted = {**dict.fromkeys(LIVING, 6), "bedroom": 4, "study": 3, "corridor": 5, "kitchen": 2, "bath": 1,
              "dining": 4, "utility": 0}[category]  # fmt: skip
    for _ in range(int(rng.integers(max(1, wanted - 1), wanted + 1)) if wanted else 0):
        widest = float(pick(rng, 0.4, 0.6, 0.9))
        placer.along_wall(objects.picture(rng, widest), room, rng, "free", away=0.001, tries=8, ignore_doors=True)
