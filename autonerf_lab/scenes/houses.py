"""Homes of a given size: the stages of the generator on a floor plan of :mod:`autonerf_lab.scenes.house_plan`."""

from collections.abc import Callable, Sequence

import numpy as np

from autonerf_lab.classes import CLASS_NAMES
from autonerf_lab.scenes.floorplan import plan_rooms
from autonerf_lab.scenes.house_plan import choose_size, plan_house
from autonerf_lab.scenes.layout import Layout
from autonerf_lab.scenes.openings import place_house_openings, place_openings
from autonerf_lab.scenes.stairs import SLAB, place_stairs, stairwell_of

UPPER = "+"  # at the end of the names of the materials of the second floor


def fill_house(
    seed: int,
    height: float,
    stages: Sequence[Callable[[Layout, np.random.Generator], None]],
    size: tuple[float | None, int | None, int],
    rng: np.random.Generator,
) -> list[Layout] | None:
    """Plan a home and run the other stages of the generator on each of its floors.

    Args:
        seed: Random seed of the home.
        height: Of every ceiling above its floor, metres.
        stages: Of :func:`~autonerf_lab.scenes.generate_apartment`.
        size: Area in m2, number of rooms, and number of floors; None is sampled.
        rng: Random generator.

    Returns:
        One layout per floor; None if the first floor does not have all classes.
    """
    area, rooms = choose_size(size[0], size[1], size[2], rng)
    plan = plan_house(area, rooms, size[2], rng)
    layouts = []
    for storey, floor in enumerate(plan.floors):
        layout = Layout(seed, height, floor, storey=storey)
        if plan.stairs is not None:
            layout.stairwell, inward = stairwell_of(floor[-1].polygon, plan.stairs)
            layout.stairs_inward = (float(inward[0]), float(inward[1]))
        for stage in stages:
            if stage is plan_rooms:
                continue
            if stage is place_openings:
                place_house_openings(layout, rng)
                place_stairs(layout)
            else:
                stage(layout, rng)
        if storey == 0 and {t.class_id for t in layout.objects} != set(range(len(CLASS_NAMES))):
            return None
        layouts.append(layout)
    return layouts


def put_on_top(spec: dict, upper: dict) -> dict:
    """Add the second floor of a house to the specification of the first, in place, and return it.

    Args:
        spec: Specification of the first floor.
        upper: Specification of the second floor, with its floor at z = 0.
    """
    lift, first = spec["height"] + SLAB, len(spec["rooms"])
    spec["rooms"] += [{**room, "z": lift} for room in upper["rooms"]]
    for opening in upper["openings"]:
        raised = {key: opening[key] + lift for key in ("low", "high")}
        spec["openings"].append({**opening, **raised, "rooms": [k + first for k in opening["rooms"]]})
    spec["lights"] += [{**light, "at": _raised(light["at"], lift)} for light in upper["lights"]]
    spec["materials"] |= {name + UPPER: material for name, material in upper["materials"].items()}
    building, *others = upper["objects"]
    spec["objects"][0]["parts"] += [{**part, "at": _raised(part["at"], lift)} for part in _renamed(building["parts"])]
    last = spec["objects"][-1]["id"]
    for entry in others:
        moved = {"id": entry["id"] + last, "room": entry["room"] + first, "at": _raised(entry["at"], lift)}
        spec["objects"].append({**entry, **moved, "parts": _renamed(entry["parts"])})
    return spec


def _raised(at: Sequence[float], lift: float) -> list[float]:
    return [at[0], at[1], at[2] + lift]


def _renamed(parts: list[dict]) -> list[dict]:
    return [{**part, "m": part["m"] + UPPER} for part in parts]
