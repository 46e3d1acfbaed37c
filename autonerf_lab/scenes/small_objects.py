"""Generator stage 4: small objects on the support surfaces of furniture."""

import numpy as np

from autonerf_lab.scenes import objects
from autonerf_lab.scenes.furniture_model import FurnitureModel
from autonerf_lab.scenes.layout import Layout, PlacedObject

# sampling weight of each kind of small object, by the furniture that supports it
_WEIGHTS: dict[str, dict[str, float]] = {
    "shelf": {"books": 6, "stack": 1, "vase": 1, "plant": 0.6, "cup": 0.3},
    "dining table": {"cup": 3, "vase": 1.5, "bottle": 2, "stack": 0.7},
    "coffee table": {"stack": 2.5, "cup": 2, "vase": 1, "bottle": 0.5},
    "kitchen unit": {"bottle": 2.5, "cup": 2.5, "vase": 0.5, "plant": 0.7},
    "sideboard": {"vase": 2, "plant": 1, "lamp": 1, "books": 1.5, "stack": 1},
    "chest of drawers": {"vase": 1.2, "lamp": 1, "books": 1.5, "plant": 1},
    "bedside table": {"lamp": 3, "stack": 2, "cup": 1},
    "desk": {"stack": 2, "cup": 1.5, "lamp": 1.2, "books": 1.5, "bottle": 0.5},
    "shoe cupboard": {"vase": 1, "plant": 1, "stack": 0.5},
    "wall shelf": {"books": 3, "vase": 1, "cup": 1.5, "plant": 1, "bottle": 0.6},
    "bathroom cupboard": {"bottle": 3, "vase": 1, "cup": 1},
    "washing machine": {"bottle": 2},
}
_COUNT = {  # largest number of objects per surface; 2 if not listed
    "shelf": 2,
    "dining table": 4,
    "kitchen unit": 2,
    "bedside table": 2,
    "coffee table": 3,
    "desk": 3,
    "washing machine": 1,
}
REQUIRED = {11: "stack", 13: "vase", 14: "cup", 15: "bottle"}  # kind by class id


def _build(kind: str, width: float, free: float, rng: np.random.Generator) -> FurnitureModel:
    """Build a small object for a surface of some width and free height, metres."""
    if kind == "books":
        return objects.books(rng, width, free)
    makers = {
        "stack": objects.book_stack,
        "vase": objects.vase,
        "cup": objects.cup,
        "bottle": objects.bottle,
        "lamp": objects.table_lamp,
    }
    return objects.plant(rng, tall=False) if kind == "plant" else makers[kind](rng)


def place_objects(layout: Layout, rng: np.random.Generator) -> None:
    """Place small objects on tables, shelves and worktops, and retry the classes that are still missing."""
    hosts = [item for item in layout.objects if item.surfaces]
    occupied: dict[tuple[int, int], list[tuple[float, float, float, float]]] = {}
    for index, host in enumerate(hosts):
        name = next((key for key in _WEIGHTS if host.name.startswith(key)), None)
        if name is None:
            continue
        kinds, weights = list(_WEIGHTS[name]), np.array(list(_WEIGHTS[name].values()))
        for level in range(len(host.surfaces)):
            for _ in range(int(rng.integers(1, _COUNT.get(name, 2) + 1))):
                kind = str(rng.choice(kinds, p=weights / weights.sum()))
                _place_on(layout, host, level, kind, occupied.setdefault((index, level), []), rng)
    for class_id, kind in REQUIRED.items():
        for _ in range(60):
            if any(t.class_id == class_id for t in layout.objects) or not hosts:
                break
            index = int(rng.integers(len(hosts)))
            level = int(rng.integers(len(hosts[index].surfaces)))
            _place_on(layout, hosts[index], level, kind, occupied.setdefault((index, level), []), rng)


def _place_on(
    layout: Layout,
    host: PlacedObject,
    level: int,
    kind: str,
    occupied: list[tuple[float, float, float, float]],
    rng: np.random.Generator,
) -> bool:
    """Place a new object of a kind on one surface of a host; return False if it does not fit."""
    x0, y0, x1, y1, z, free = host.surfaces[level]
    model = _build(kind, x1 - x0, free, rng)
    w, d, h = model.size
    yaw = float(rng.uniform(-0.4, 0.4)) if model.class_id in (14, 15) or "stack" in model.name else 0.0
    c, s = abs(np.cos(yaw)), abs(np.sin(yaw))
    w, d = c * w + s * d, s * w + c * d
    if h > free - 0.01 or w > x1 - x0 or d > y1 - y0 + 0.02:
        return False
    for _ in range(8):
        x = float(rng.uniform(x0 + w / 2, x1 - w / 2))
        y = float(rng.uniform(min(y0 + d / 2, y1 - d / 2), max(y1 - d / 2, y0 + d / 2)))
        if kind == "books":
            y = y0 + d / 2
        rect = (x - w / 2, y - d / 2, x + w / 2, y + d / 2)
        if all(
            rect[0] > r[2] + 0.01 or r[0] > rect[2] + 0.01 or rect[1] > r[3] + 0.01 or r[1] > rect[3] + 0.01
            for r in occupied
        ):
            occupied.append(rect)
            return _add_object(layout, host, model, (x, y, z), yaw)
    return False


def _add_object(
    layout: Layout, host: PlacedObject, model: FurnitureModel, at: tuple[float, float, float], yaw: float
) -> bool:
    """Add a model at a position in the frame of its host; return False if an object above it is in the way."""
    c, s = np.cos(host.yaw), np.sin(host.yaw)
    x, y = host.at[0] + c * at[0] - s * at[1], host.at[1] + s * at[0] + c * at[1]
    z = host.at[2] + at[2]
    total = host.yaw + yaw
    ct, st = abs(np.cos(total)), abs(np.sin(total))
    half_x = (ct * model.size[0] + st * model.size[1]) / 2
    half_y = (st * model.size[0] + ct * model.size[1]) / 2
    rect = (x - half_x, y - half_y, x + half_x, y + half_y)
    top = z + model.size[2]
    for other in layout.objects:  # objects above the host: cupboards, curtains, coats, pictures
        if other is not host and other.room == host.room and other.height[1] > z + 2e-3 and other.height[0] < top:
            a = other.footprint
            if a[0] < rect[2] and rect[0] < a[2] and a[1] < rect[3] and rect[1] < a[3]:
                return False
    position = (float(x), float(y), float(z))
    layout.objects.append(
        PlacedObject(model.class_id, model.name, position, total, model.parts, rect, (z, top), host.room)
    )
    return True
