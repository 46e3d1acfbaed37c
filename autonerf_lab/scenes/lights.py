"""Generator stage 6: light sources."""

import numpy as np

from autonerf_lab.scenes import objects
from autonerf_lab.scenes.layout import Layout, PlacedObject
from autonerf_lab.scenes.stairs import cut_out
from autonerf_lab.scenes.structure import REVEAL, floor_rects


def place_lights(layout: Layout, rng: np.random.Generator) -> None:
    """Add ceiling lamps in every room, a pendant over the dining table and daylight through every window."""
    table = next((t for t in layout.objects if t.class_id == 7), None)
    if table is not None:
        _lamp(layout, table.room, table.at[:2], layout.height, "pendant", [1.0, 0.88, 0.7], 2.2, rng)
    for index in range(len(layout.rooms)):
        ceiling = cut_out(floor_rects(layout, index), None if layout.storey else layout.stairwell)
        rects = sorted(ceiling, key=lambda r: (r[0] - r[2]) * (r[3] - r[1]))
        for x0, y0, x1, y1 in rects[:2]:
            long_x = x1 - x0 >= y1 - y0
            area = (x1 - x0) * (y1 - y0)
            if area < 3 and (x0, y0, x1, y1) != rects[0]:
                continue
            count = 1 if max(x1 - x0, y1 - y0) < 4.6 else (2 if max(x1 - x0, y1 - y0) < 8 else 3)
            for k in range(count):
                f = (k + 0.5) / count
                at = (x0 + (x1 - x0) * (f if long_x else 0.5), y0 + (y1 - y0) * (0.5 if long_x else f))
                warm = [1.0, float(rng.uniform(0.86, 0.93)), float(rng.uniform(0.66, 0.8))]
                power = (2.2 + 0.42 * min(area, 30) / count) * float(rng.uniform(0.85, 1.15))
                if table is not None and np.hypot(at[0] - table.at[0], at[1] - table.at[1]) < 0.7:
                    continue  # the pendant lights this area
                _lamp(layout, index, at, layout.height, "bowl", warm, power, rng)
    day = float(rng.uniform(0.75, 1.15))
    for o in layout.openings:
        if o.kind == "window":
            d = np.array(o.direction)
            inward = np.array([-d[1], d[0]])
            centre = np.array(o.at) - inward * (REVEAL - 0.06)
            layout.lights.append(
                {
                    "kind": "window",
                    "at": [*centre.tolist(), (o.low + o.high) / 2],
                    "size": [o.width - 0.1, o.high - o.low - 0.1],
                    "along": d.tolist(),
                    "color": [0.86, 0.94, 1.0],
                    "power": day,
                }
            )


def _lamp(
    layout: Layout,
    room: int,
    at: tuple[float, ...],
    top: float,
    kind: str,
    color: list[float],
    power: float,
    rng: np.random.Generator,
) -> None:
    """Add a ceiling lamp (``bowl`` or ``pendant``) and its light source."""
    model = objects.ceiling_lamp(rng, kind)
    drop = 0.13 if kind == "bowl" else 0.98
    x, y = float(at[0]), float(at[1])
    rect = (x - 0.2, y - 0.2, x + 0.2, y + 0.2)
    layout.objects.append(
        PlacedObject(0, model.name, (x, y, top), 0.0, model.parts, rect, (top - drop + 0.05, top), room)
    )
    layout.lights.append({"kind": "lamp", "at": [x, y, top - drop], "radius": 0.12, "color": color, "power": power})
