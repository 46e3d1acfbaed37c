"""The generator: plan, doors, furniture, objects, materials, light; each stage is a function that can be replaced."""

from collections.abc import Callable, Sequence

import numpy as np

from autonerf_lab.classes import CLASS_NAMES
from autonerf_lab.errors import SceneError
from autonerf_lab.scenes.build import build
from autonerf_lab.scenes.floorplan import place_openings, plan_rooms
from autonerf_lab.scenes.furnishing import place_furniture
from autonerf_lab.scenes.layout import Layout
from autonerf_lab.scenes.materials_and_lights import choose_materials, place_lights
from autonerf_lab.scenes.scene import Scene
from autonerf_lab.scenes.small_objects import place_objects
from autonerf_lab.scenes.spec import FORMAT, VERSION, tidy
from autonerf_lab.scenes.structure import structure_parts

Stage = Callable[[Layout, np.random.Generator], None]
STAGES: tuple[Stage, ...] = (plan_rooms, place_openings, place_furniture, place_objects, choose_materials, place_lights)
ATTEMPTS = 60


def generate_apartment(seed: int, name: str | None = None, stages: Sequence[Stage] = STAGES) -> Scene:
    """A furnished apartment, the same for the same seed: 40 to 140 m2, all 15 classes.

    Args:
        seed: any non-negative integer.
        name: of the scene; without one, ``apartment-SEED``.
        stages: plan, doors, furniture, objects, materials, light: each changes the layout in place.

    Raises:
        SceneError: no plan could be furnished (with the built-in stages: not seen in a thousand seeds).

    Example:
        >>> scene = generate_apartment(7)
        >>> sorted({i.class_id for i in scene.instances} - {0}) == list(range(1, 16))
        True
    """
    return build(generate_spec(seed, name, stages))


def generate_spec(seed: int, name: str | None = None, stages: Sequence[Stage] = STAGES) -> dict:
    """The specification :func:`generate_apartment` builds from: plain JSON, see ``autonerf_lab.scenes.spec``."""
    rng = np.random.default_rng(seed)
    for _ in range(ATTEMPTS):
        layout = Layout(seed, round(float(rng.uniform(2.5, 2.7)), 2))
        complete = True
        for stage in stages:
            stage(layout, rng)
            if stage is place_objects and {t.class_id for t in layout.things} != set(range(len(CLASS_NAMES))):
                complete = False
                break
        if complete:
            return to_spec(layout, name or f"apartment-{seed}")
    raise SceneError(f"no apartment with all {len(CLASS_NAMES) - 1} classes found for seed {seed}")


def to_spec(layout: Layout, name: str) -> dict:
    """Write a finished layout down."""
    structure = {"id": 0, "class": CLASS_NAMES[0], "name": "building", "parts": structure_parts(layout)}
    things = [
        {
            "id": number,
            "class": CLASS_NAMES[thing.class_id],
            "name": thing.name,
            "room": thing.room,
            "at": list(thing.at),
            "yaw": thing.yaw,
            "parts": thing.parts,
        }
        for number, thing in enumerate(layout.things, start=1)
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
            "objects": [structure, *things],
        }
    )
