"""Invariants of generated apartments, checked on the finished mesh, independently of the generator."""

import numpy as np
from scipy import ndimage
from shapely import contains_xy
from shapely.geometry import Point, Polygon
from shapely.ops import unary_union
from shapely.strtree import STRtree

from autonerf_lab.classes import CLASS_NAMES
from autonerf_lab.geometry import AGENT_RADIUS, CAMERA_HEIGHT
from autonerf_lab.scenes.height_band import occupied_cells
from autonerf_lab.scenes.scene import Scene
from autonerf_lab.scenes.tessellation import rotation

CELL = 0.025  # metres
TOUCH = 0.012  # metres, largest gap between objects that rest on each other
SLACK = 0.015  # metres by which footprints may overlap (handles, leaves)
LAMPS = ("ceiling lamp", "pendant lamp")


def problems(scene: Scene) -> list[str]:
    """Return a description of every violated invariant of a generated apartment; empty if it is valid.

    Example:
        >>> from autonerf_lab.scenes import generate_apartment
        >>> problems(generate_apartment(3))
        []
    """
    assert scene.spec is not None
    return [
        *_mesh_problems(scene),
        *_plan_problems(scene.spec),
        *_missing_classes(scene),
        *_placement_problems(scene),
        *_reachability_problems(scene),
    ]


def _mesh_problems(scene: Scene) -> list[str]:
    found = []
    corner = scene.vertices[scene.faces].astype(np.float64)
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) / 2
    if not np.isfinite(scene.vertices).all():
        found.append("a vertex is not finite")
    if (area <= 1e-9).any():
        found.append(f"{int((area <= 1e-9).sum())} triangles have no area")
    if scene.uv.min() < 0 or scene.uv.max() > 1:
        found.append("texture coordinates are outside [0, 1]")
    return found


def _plan_problems(spec: dict) -> list[str]:
    found = []
    area = sum(Polygon(room["polygon"]).area for room in spec["rooms"])
    if not 39.5 <= area <= 315:  # with the stairwell of the second floor
        found.append(f"floor area {area:.0f} m2 is not between 40 and 300 m2")
    if not 2 <= len(spec["rooms"]) <= 14:
        found.append(f"{len(spec['rooms'])} rooms; there must be 2 to 14")
    doors = [o["width"] for o in spec["openings"] if o["kind"] == "door"]
    if min(doors, default=0) < 0.8:
        found.append(f"a door is {min(doors, default=0):.2f} m wide")
    return found


def _missing_classes(scene: Scene) -> list[str]:
    present = {instance.class_id for instance in scene.instances}
    return [f"no object of class {name}" for k, name in enumerate(CLASS_NAMES) if k and k not in present]


def _boxes(scene: Scene) -> list[tuple[str, int, Polygon, float, float, np.ndarray]]:
    """Return name, id, oriented footprint, lowest and highest z, and points of every object except the building."""
    assert scene.spec is not None
    order = np.argsort(scene.face_instance, kind="stable")
    ids, starts = np.unique(scene.face_instance[order], return_index=True)
    groups = dict(zip(ids.tolist(), np.split(order, starts[1:]), strict=True))
    found = []
    for entry in scene.spec["objects"]:
        if entry["id"] == 0:
            continue
        points = scene.vertices[np.unique(scene.faces[groups[entry["id"]]])].astype(np.float64)
        to_world = rotation(entry["yaw"])
        local = (points - entry["at"]) @ to_world
        low, high = local.min(axis=0), local.max(axis=0)
        corners = np.array([[low[0], low[1], 0], [high[0], low[1], 0], [high[0], high[1], 0], [low[0], high[1], 0]])
        footprint = Polygon((corners @ to_world.T + entry["at"])[:, :2])
        found.append((entry["name"], entry["id"], footprint, points[:, 2].min(), points[:, 2].max(), points))
    return found


def _placement_problems(scene: Scene) -> list[str]:
    assert scene.spec is not None
    boxes = _boxes(scene)
    shapes = [b[2].buffer(-SLACK) for b in boxes]
    tree = STRtree([b[2] for b in boxes])
    rooms = scene.spec["rooms"]
    interiors = {z: unary_union([Polygon(r["polygon"]) for r in rooms if _level(r) == z]) for z in map(_level, rooms)}
    levels = {entry["id"]: _level(rooms[entry.get("room", 0)]) for entry in scene.spec["objects"]}
    found = []
    for k, (name, object_id, footprint, low, high, _) in enumerate(boxes):
        interior = interiors[levels[object_id]]
        near = [int(j) for j in tree.query(footprint) if j != k]
        for j in near:
            other = boxes[j]
            # furniture stands on rugs, books stand inside the box of a shelf, and stairs end at their railing
            lenient = any(n in ("rug", "railing") or n.endswith("shelf") for n in (name, other[0]))
            if (
                j > k
                and not lenient
                and min(high, other[4]) - max(low, other[3]) > TOUCH
                and shapes[k].intersects(shapes[j])
            ):
                found.append(f"{name} {object_id} overlaps {other[0]} {other[1]}")
        if footprint.difference(interior.buffer(0.02)).area > 1e-6:
            found.append(f"{name} {object_id} is outside the rooms")
        level = levels[object_id]
        on_floor = abs(low - level) < TOUCH
        hangs = name in LAMPS and abs(high - level - scene.spec["height"]) < TOUCH
        at_wall = interior.boundary.distance(footprint) < 0.06
        middle = Point(footprint.centroid)
        rests = any(boxes[j][2].covers(middle) and (np.abs(boxes[j][5][:, 2] - low) < TOUCH).any() for j in near)
        if not (on_floor or hangs or at_wall or rests):
            found.append(f"{name} {object_id} floats {low - level:.2f} m above the floor")
    return found


def _level(room: dict) -> float:
    """Return the z of the floor of a room."""
    return float(room.get("z", 0.0))


def _reachability_problems(scene: Scene) -> list[str]:
    """Check that the robot, a disc, can reach every room and every door of a floor of the building."""
    assert scene.spec is not None
    origin = scene.bounds[0, :2] - 0.1
    cols, rows = np.ceil((scene.bounds[1, :2] + 0.1 - origin) / CELL).astype(int).tolist()
    x, y = np.meshgrid(origin[0] + (np.arange(cols) + 0.5) * CELL, origin[1] + (np.arange(rows) + 0.5) * CELL)
    found = []
    for level in sorted({_level(room) for room in scene.spec["rooms"]}):

        def between(low: float, high: float, z: float = level) -> np.ndarray:
            return occupied_cells(scene.vertices, scene.faces, z + low, z + high, origin, CELL, (rows, cols))

        clear = ndimage.distance_transform_edt(between(-0.01, 0.02) & ~between(0.03, CAMERA_HEIGHT))
        labels, _ = ndimage.label(clear * CELL > AGENT_RADIUS + CELL / 2)
        sizes = np.bincount(labels.ravel())
        sizes[0] = 0
        main = labels == int(sizes.argmax())
        for room in scene.spec["rooms"]:
            area = (main & contains_xy(Polygon(room["polygon"]), x, y)).sum() * CELL**2
            if _level(room) == level and area < 0.3:
                found.append(f"{room['category']}: only {area:.2f} m2 are reachable")
        for opening in scene.spec["openings"]:
            if opening["kind"] == "door" and _level(scene.spec["rooms"][opening["rooms"][0]]) == level:
                near = np.hypot(x - opening["at"][0], y - opening["at"][1]) < 0.3
                if not (main & near).any():
                    found.append("a door is blocked")
    return found
