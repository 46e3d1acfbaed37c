"""Generator of furnished apartments: a sequence of stages that fill a layout, each a replaceable function."""

from collections.abc import Callable, Sequence

import numpy as np

from autonerf_lab.classes import CLASS_NAMES
from autonerf_lab.errors import SceneError
from autonerf_lab.scenes.build import build
from autonerf_lab.scenes.floorplan import plan_rooms
from autonerf_lab.scenes.furnishing import place_furniture
from autonerf_lab.scenes.house_plan import check_size
from autonerf_lab.scenes.houses import fill_house, put_on_top
from autonerf_lab.scenes.layout import Layout
from autonerf_lab.scenes.lights import place_lights
from autonerf_lab.scenes.materials import choose_materials
from autonerf_lab.scenes.openings import place_openings
from autonerf_lab.scenes.scene import Scene
from autonerf_lab.scenes.small_objects import place_objects
from autonerf_lab.scenes.spec import FORMAT, VERSION, tidy
from autonerf_lab.scenes.structure import structure_parts

Stage = Callable[[Layout, np.random.Generator], None]
STAGES: tuple[Stage, ...] = (plan_rooms, place_openings, place_furniture, place_objects, choose_materials, place_lights)
ATTEMPTS = 60  # layouts tried per seed


def generate_apartment(
    seed: int,
    name: str | None = None,
    stages: Sequence[Stage] = STAGES,
    *,
    area: float | None = None,
    rooms: int | None = None,
    floors: int | None = None,
) -> Scene:
    """Generate a furnished home with all 15 classes, reproducible by its seed.

    Without ``area``, ``rooms`` and ``floors``: an apartment of 40 to 140 m2 with 3 to 8 rooms. With any of them: a home
    of that size, up to a house of 300 m2 with 14 rooms on two floors. The robot stays on the first floor, which has all
    classes; the second is furnished and visible through the stairwell.

    Args:
        seed: Random seed, any non-negative integer.
        name: Name of the scene; default: ``apartment-SEED``, with a size ``home-SEED``.
        stages: Functions that fill the layout in place: plan, openings, furniture, small objects, materials, lights.
        area: Inner area of the rooms of all floors, 40 to 300 m2; kept within 1 %.
        rooms: Number of rooms of all floors, corridors included, 2 to 14 (8 to 14 on two floors).
        floors: 1 or 2.

    Raises:
        SceneError: A size is out of range, or no attempt produced a home with all classes (not in 1000 seeds).

    Example:
        >>> scene = generate_apartment(7)
        >>> sorted({i.class_id for i in scene.instances} - {0}) == list(range(1, 16))
        True
        >>> house = generate_apartment(7, area=200, floors=2)
        >>> sorted({room.get("z", 0) for room in house.spec["rooms"]})[0], house.spec["objects"][1]["name"]
        (0, 'stairs')
    """
    return build(generate_spec(seed, name, stages, area=area, rooms=rooms, floors=floors))


def generate_spec(
    seed: int,
    name: str | None = None,
    stages: Sequence[Stage] = STAGES,
    *,
    area: float | None = None,
    rooms: int | None = None,
    floors: int | None = None,
) -> dict:
    """Generate the specification of an apartment: plain JSON, see :mod:`autonerf_lab.scenes.spec`.

    Arguments and errors are those of :func:`generate_apartment`.
    """
    rng = np.random.default_rng(seed)
    if area is not None or rooms is not None or floors is not None:
        floors = 1 if floors is None else floors
        check_size(area, rooms, floors)
        for _ in range(ATTEMPTS):
            height = round(float(rng.uniform(2.5, 2.7)), 2)
            layouts = fill_house(seed, height, stages, (area, rooms, floors), rng)
            if layouts is not None:
                first, *upper = (to_spec(layout, name or f"home-{seed}") for layout in layouts)
                return tidy(put_on_top(first, upper[0])) if upper else first
        raise _no_home(seed)
    for _ in range(ATTEMPTS):
        layout = Layout(seed, round(float(rng.uniform(2.5, 2.7)), 2))
        complete = True
        for stage in stages:
            stage(layout, rng)
            if stage is place_objects and {t.class_id for t in layout.objects} != set(range(len(CLASS_NAMES))):
                complete = False
                break
        if complete:
            return to_spec(layout, name or f"apartment-{seed}")
    raise _no_home(seed)


def _no_home(seed: int) -> SceneError:
    return SceneError(
        f"seed {seed}: no home with all {len(CLASS_NAMES) - 1} classes in {ATTEMPTS} attempts; use another seed"
    )


def to_spec(layout: Layout, name: str) -> dict:
    """Convert a finished layout to a specification; numbers are rounded to 4 decimals."""
    structure = {"id": 0, "class": CLASS_NAMES[0], "name": "building", "parts": structure_parts(layout)}
    objects = [
        {
            "id": number,
            "class": CLASS_NAMES[item.class_id],
            "name": item.name,
            "room": item.room,
            "at": list(item.at),
            "yaw": item.yaw,
            "parts": item.parts,
        }
        for number, item in enumerate(layout.objects, start=1)
    ]
    return tidy(
        {
            "format": FORMAT,
            "version": VERSION,
            "name": name,
            "seed": layout.seed,
            "height": layout.height,
            "rooms": [{"category": room.category, "polygon": [list(c) for c in room.polygon]} for room in layout.rooms],
            "openings": [
                {
                    "kind": o.kind,
                    "at": list(o.at),
                    "direction": list(o.direction),
                    "width": o.width,
                    "low": o.low,
                    "high": o.high,
                    "rooms": o.rooms,
                }
                for o in layout.openings
            ],
            "lights": layout.lights,
            "materials": layout.materials,
            "objects": [structure, *objects],
        }
    )
