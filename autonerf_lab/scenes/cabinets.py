"""Furniture models of tables, shelves, cupboards and kitchen units."""

import numpy as np

from autonerf_lab.scenes.furniture_model import FurnitureModel, pick


def dining_table(rng: np.random.Generator, room_for: float = 1.8) -> FurnitureModel:
    """Build a dining table with four legs, on trestles, or round on a foot; at most ``room_for`` metres long."""
    kind = str(pick(rng, "legs", "trestle", "round")) if room_for >= 1.15 else "legs"
    h = float(rng.uniform(0.73, 0.77))
    if kind == "round":
        r = float(rng.uniform(0.5, 0.6))
        model = FurnitureModel(7, "dining table (round)", (2 * r, 2 * r, h), clear=0)
        model.lathe(
            [(r * 0.45, 0), (r * 0.42, 0.03), (0.06, 0.07), (0.045, 0.3), (0.06, h - 0.06), (r * 0.5, h - 0.035)],
            0, 0, 0, "wood_table", n=14,
        )  # fmt: skip
        model.lathe([(r - 0.03, 0), (r, 0.012), (r, 0.035), (0, 0.035)], 0, 0, h - 0.035, "wood_table", n=28)
        model.surfaces.append((-r * 0.6, -r * 0.6, r * 0.6, r * 0.6, h, 0.8))
        return model
    w = min(room_for, float(rng.uniform(1.2, 1.8)))
    d = float(rng.uniform(0.78, 0.92))
    model = FurnitureModel(7, f"dining table ({kind})", (w, d, h), clear=0)
    model.box(w, d, 0.035, 0, 0, h - 0.035, "wood_table", omit="")
    if kind == "legs":
        model.legs(w, d, h - 0.035, 0.06, "wood_table", 0.02)
        for y in (-1, 1):
            model.box(w - 0.16, 0.02, 0.07, 0, y * (d / 2 - 0.05), h - 0.105, "wood_table", omit="xXZ")
        for x in (-1, 1):
            model.box(0.02, d - 0.16, 0.07, x * (w / 2 - 0.05), 0, h - 0.105, "wood_table", omit="yYZ")
    else:
        for x in (-1, 1):
            model.box(0.07, d - 0.2, 0.05, x * (w / 2 - 0.25), 0, 0, "wood_table")
            model.box(0.07, 0.12, h - 0.085, x * (w / 2 - 0.25), 0, 0.05, "wood_table", omit="zZ")
            model.box(0.07, d - 0.25, 0.04, x * (w / 2 - 0.25), 0, h - 0.075, "wood_table", omit="Z")
        model.box(w - 0.57, 0.03, 0.1, 0, 0, 0.3, "wood_table", omit="xX")
    model.surfaces.append((-w / 2 + 0.12, -d / 2 + 0.12, w / 2 - 0.12, d / 2 - 0.12, h, 0.8))
    return model


def low_table(rng: np.random.Generator) -> FurnitureModel:
    """Build a coffee table: a rectangular top over a shelf, or round on three legs."""
    h = float(rng.uniform(0.36, 0.45))
    if rng.random() < 0.4:
        r = float(rng.uniform(0.36, 0.45))
        model = FurnitureModel(0, "coffee table (round)", (2 * r, 2 * r, h), clear=0)
        for k in range(3):
            x, y = r * 0.65 * float(np.cos(2.1 * k)), r * 0.65 * float(np.sin(2.1 * k))
            model.lathe([(0.016, 0), (0.024, h - 0.03)], x, y, 0, "wood_low", n=6)
        model.lathe([(r - 0.02, 0), (r, 0.01), (r, 0.03), (0, 0.03)], 0, 0, h - 0.03, "wood_low", n=24)
        model.surfaces.append((-r * 0.6, -r * 0.6, r * 0.6, r * 0.6, h, 0.8))
        return model
    w, d = float(rng.uniform(0.85, 1.15)), float(rng.uniform(0.48, 0.6))
    model = FurnitureModel(0, "coffee table", (w, d, h), clear=0)
    model.legs(w, d, h - 0.04, 0.05, "wood_low")
    model.box(w, d, 0.04, 0, 0, h - 0.04, "wood_low", omit="")
    model.box(w - 0.06, d - 0.06, 0.02, 0, 0, 0.12, "wood_low", omit="")
    model.surfaces.append((-w / 2 + 0.08, -d / 2 + 0.08, w / 2 - 0.08, d / 2 - 0.08, h, 0.8))
    return model


def shelf(rng: np.random.Generator, w: float | None = None) -> FurnitureModel:
    """Build open shelves with a back panel; small objects can stand on every board."""
    w = w or float(rng.uniform(0.75, 1.2))
    d, h = float(rng.uniform(0.28, 0.34)), float(pick(rng, 0.9, 1.45, 1.9))
    boards = max(2, round(h / 0.36))
    model = FurnitureModel(0, "shelf", (w, d, h), clear=0.5)
    for x in (-1, 1):
        model.box(0.022, d, h, x * (w / 2 - 0.011), 0, 0, "wood_shelf")
    model.box(w - 0.044, 0.01, h - 0.03, 0, -d / 2 + 0.005, 0, "wood_shelf", omit="xXyz")
    gap = (h - 0.06 - 0.022) / boards
    for k in range(boards + 1):
        z = 0.06 + gap * k
        model.box(w - 0.044, d - 0.012, 0.022, 0, 0.006, z, "wood_shelf", omit="xXy")
        free = gap - 0.022 if k < boards else 0.6
        model.surfaces.append((-w / 2 + 0.03, -d / 2 + 0.02, w / 2 - 0.03, d / 2 - 0.01, z + 0.022, free))
    return model


def fronted(
    rng: np.random.Generator,
    name: str,
    w: float,
    d: float,
    h: float,
    columns: int,
    rows: int,
    body: str,
    plinth: float = 0.06,
) -> FurnitureModel:
    """Build a cupboard or chest of drawers: a carcass with a grid of fronts, each with a handle.

    Args:
        rng: Random generator of the variant.
        name: Name of the object.
        w: Width, metres.
        d: Depth, metres.
        h: Height, metres.
        columns: Number of fronts side by side.
        rows: Number of fronts above each other.
        body: Material of the carcass; the fronts use ``body + "_front"``.
        plinth: Height of the plinth, metres.
    """
    model = FurnitureModel(0, name, (w, d, h), clear=0.5)
    model.box(w, d - 0.02, h - plinth, 0, -0.01, plinth, body, omit="y")
    model.box(w - 0.02, d - 0.06, plinth, 0, -0.02, 0, "plinth", omit="yzZ")
    bar = bool(rng.random() < 0.5)
    for i in range(columns):
        for j in range(rows):
            fw, fh = w / columns, (h - plinth) / rows
            x, z = -w / 2 + fw * (i + 0.5), plinth + fh * j
            model.box(fw - 0.008, 0.018, fh - 0.008, x, d / 2 - 0.011, z + 0.004, body + "_front", omit="y")
            if fh > fw:
                side = 1 if i % 2 == 0 else -1
                hx, hz = x + side * (fw / 2 - 0.05), z + (fh * 0.5 if fh > 1 else fh - 0.22)
                size = (0.014, 0.022, 0.16) if bar else (0.03, 0.022, 0.03)
            else:
                hx, hz, size = x, z + fh * 0.62, (0.16, 0.022, 0.014) if bar else (0.03, 0.022, 0.03)
            model.box(*size, hx, d / 2 + 0.009, hz, "metal", omit="y")
    model.size = (w, d + 0.02, h)
    if h < 1.4:
        model.surfaces.append((-w / 2 + 0.05, -d / 2 + 0.04, w / 2 - 0.05, d / 2 - 0.04, h, 0.9))
    return model


def desk(rng: np.random.Generator) -> FurnitureModel:
    """Build a desk: a top on legs with a drawer unit."""
    w, d, h = float(rng.uniform(1.05, 1.4)), float(rng.uniform(0.58, 0.68)), float(rng.uniform(0.72, 0.75))
    model = FurnitureModel(0, "desk", (w, d, h), clear=0.75)
    model.legs(w, d, h - 0.03, 0.045, "wood_desk")
    model.box(w, d, 0.03, 0, 0, h - 0.03, "wood_desk", omit="")
    x = w / 2 - 0.26
    model.box(0.4, d - 0.08, h - 0.15, x, -0.02, 0.12, "wood_desk", omit="Z")
    for k in range(3):
        fh = (h - 0.15) / 3
        model.box(0.385, 0.016, fh - 0.01, x, d / 2 - 0.052, 0.125 + fh * k, "wood_desk", omit="y")
        model.box(0.12, 0.02, 0.015, x, d / 2 - 0.034, 0.125 + fh * (k + 0.6), "metal", omit="y")
    model.surfaces.append((-w / 2 + 0.08, -d / 2 + 0.06, w / 2 - 0.08, d / 2 - 0.2, h, 0.8))
    return model


def fridge(rng: np.random.Generator) -> FurnitureModel:
    """Build a refrigerator with two doors, freezer below or above, handles on one side."""
    w, d, h = float(rng.uniform(0.58, 0.68)), float(rng.uniform(0.6, 0.66)), float(rng.uniform(1.65, 1.9))
    model = FurnitureModel(10, "refrigerator", (w, d + 0.03, h), clear=0.6)
    body = str(pick(rng, "fridge", "fridge", "steel"))
    model.box(w, d - 0.07, h, 0, -0.035, 0, body, omit="yz")
    split = h * float(pick(rng, 0.36, 0.68))
    hand = int(pick(rng, -1, 1))  # type: ignore[call-overload]
    for z0, z1 in ((0.05, split - 0.006), (split + 0.006, h - 0.005)):
        model.box(w - 0.006, 0.055, z1 - z0, 0, d / 2 - 0.04, z0, body, omit="")
        low = z1 - 0.42 if z0 < 0.1 else z0 + 0.06
        model.box(0.022, 0.03, 0.34, hand * (w / 2 - 0.06), d / 2 + 0.0, low, "metal", omit="")
    return model


def kitchen_run(
    rng: np.random.Generator, width: float, with_sink: bool, with_oven: bool
) -> list[tuple[FurnitureModel, float]]:
    """Build a row of kitchen base units under one worktop, as separate models.

    Args:
        rng: Random generator of the variant.
        width: Width of the row, metres.
        with_sink: Include a sink unit.
        with_oven: Include an oven.

    Returns:
        One (model, x) per unit from left to right; x is the centre of the unit relative to the centre of the row,
        metres.
    """
    d, h = 0.6, 0.9
    slots: list[tuple[str, float]] = []
    left = width
    if with_oven:
        slots.append(("oven", 0.6))
        left -= 0.6
    if with_sink:
        slots.append(("sink", 0.8 if left >= 1.2 else 0.6))
        left -= slots[-1][1]
    units = max(0, round(left / 0.5))
    plain = [("unit", left / units) for _ in range(units)] if units else []
    if units == 0 and left > 0.02:
        slots = [(kind, w + left / len(slots)) for kind, w in slots]
    order = plain + slots if rng.random() < 0.5 else plain[:1] + slots + plain[1:]
    if units >= 3 and len(slots) == 2:
        order = [plain[0], slots[1], *plain[1:-1], slots[0], plain[-1]]
    models: list[tuple[FurnitureModel, float]] = []
    x = -width / 2
    for kind, w in order:
        maker = {"oven": _oven, "sink": _kitchen_sink, "unit": _unit}[kind]
        models.append((maker(rng, w, d, h), x + w / 2))
        x += w
    return models


def _worktop(model: FurnitureModel, w: float, d: float, h: float) -> None:
    model.box(w, d + 0.02, 0.038, 0, 0.01, h - 0.038, "worktop", omit="y")


def _unit(rng: np.random.Generator, w: float, d: float, h: float) -> FurnitureModel:
    rows = int(pick(rng, 1, 1, 3))  # type: ignore[call-overload]
    model = fronted(rng, "kitchen unit", w, d, h - 0.038, 1, rows, "kitchen", 0.1)
    model.surfaces.clear()
    _worktop(model, w, d, h)
    model.size = (w, d + 0.02, h)
    model.surfaces.append((-w / 2 + 0.06, -d / 2 + 0.08, w / 2 - 0.06, d / 2 - 0.1, h, 0.45))
    return model


def _oven(rng: np.random.Generator, w: float, d: float, h: float) -> FurnitureModel:
    """Build an oven with a glass door, a panel of knobs and a hob of four plates."""
    body = str(pick(rng, "oven_steel", "oven_white", "oven_black"))
    model = FurnitureModel(8, "oven", (w, d + 0.02, h), clear=0.6)
    model.box(w, d - 0.03, h - 0.03, 0, -0.015, 0, body, omit="yz")
    model.box(w - 0.012, 0.022, 0.5, 0, d / 2 - 0.02, 0.2, body, omit="y")
    model.box(w - 0.12, 0.006, 0.32, 0, d / 2 - 0.006, 0.25, "oven_glass", omit="y")
    model.box(w - 0.14, 0.02, 0.022, 0, d / 2 + 0.02, 0.63, "metal", omit="")
    model.box(w - 0.012, 0.022, 0.14, 0, d / 2 - 0.02, 0.04, body, omit="y")
    model.box(w, 0.03, 0.14, 0, d / 2 - 0.016, h - 0.17, "oven_panel", omit="y")
    for k in range(5):
        x = (k - 2) * w * 0.16
        model.lathe([(0.02, 0), (0.017, 0.022), (0, 0.022)], x, d / 2 - 0.001, h - 0.1, "metal", n=8, tilt=-np.pi / 2)
    model.box(w, d, 0.03, 0, 0, h - 0.03, "hob", omit="y")
    for sx, sy, r in ((-1, -1, 0.075), (1, -1, 0.09), (-1, 1, 0.09), (1, 1, 0.075)):
        model.lathe([(r, 0), (r, 0.008), (0, 0.008)], sx * w * 0.22, sy * d * 0.2, h, "plate", n=14)
    return model


def _kitchen_sink(rng: np.random.Generator, w: float, d: float, h: float) -> FurnitureModel:
    """Build a kitchen sink: a steel basin set into the worktop, with a rim and a tap."""
    model = FurnitureModel(9, "sink (kitchen)", (w, d + 0.02, h + 0.29), clear=0.6)
    model.box(w, d - 0.02, h - 0.2, 0, -0.01, 0, "kitchen", omit="yzZ")
    for i in (-1, 1):
        model.box(w / 2 - 0.008, 0.018, h - 0.15, i * w / 4, d / 2 - 0.011, 0.104, "kitchen_front", omit="y")
        model.box(0.014, 0.022, 0.14, i * 0.05, d / 2 + 0.009, h - 0.3, "metal", omit="y")
    bw, bd, deep = w - 0.2, 0.36, 0.17
    side = (w - bw) / 2
    for i in (-1, 1):  # the worktop around the hole
        model.box(side, d + 0.02, 0.038, i * (w / 2 - side / 2), 0.01, h - 0.038, "worktop", omit="xXyz")
        y0, y1 = (-d / 2, -bd / 2) if i < 0 else (bd / 2, d / 2 + 0.02)
        model.box(bw, y1 - y0, 0.038, 0, (y0 + y1) / 2, h - 0.038, "worktop", omit="xXyz")
    x, y, z = bw / 2, bd / 2, h - deep
    up = [0, 0, deep]
    for at, u in [
        ((-x, -y, z), [0, bd, 0]), ((x, y, z), [0, -bd, 0]), ((x, -y, z), [-bw, 0, 0]), ((-x, y, z), [bw, 0, 0]),
    ]:  # fmt: skip
        model.parts.append({"quad": [u, up], "at": list(at), "m": "steel_sink"})
    model.parts.append({"quad": [[bw, 0, 0], [0, bd, 0]], "at": [-x, -y, z], "m": "steel_sink"})
    for i in (-1, 1):
        model.box(0.02, bd + 0.04, 0.005, i * (x + 0.01), 0, h, "steel_sink")
        model.box(bw, 0.02, 0.005, 0, i * (y + 0.01), h, "steel_sink")
    _tap(model, 0.0, -y - 0.05, h)
    return model


def _tap(model: FurnitureModel, x: float, y: float, z: float, tall: float = 0.24) -> None:
    model.cylinder(0.02, 0.05, x, y, z, "chrome", 8)
    model.cylinder(0.011, tall, x, y, z + 0.05, "chrome", 8)
    model.box(0.02, 0.17, 0.018, x, y + 0.08, z + tall + 0.035, "chrome", omit="")
    model.box(0.016, 0.016, 0.05, x, y + 0.157, z + tall - 0.01, "chrome", omit="Z")
    model.box(0.08, 0.012, 0.012, x + 0.045, y, z + 0.05, "chrome", omit="")


def wall_cupboards(rng: np.random.Generator, w: float) -> FurnitureModel:
    """Build wall cupboards to hang over a worktop; the origin is on the floor below them."""
    h, d = 0.62, 0.33
    n = max(1, round(w / 0.5))
    model = FurnitureModel(0, "wall cupboard", (w, d, 1.45 + h), clear=0)
    model.box(w, d - 0.018, h, 0, -0.009, 1.45, "kitchen", omit="y")
    for k in range(n):
        fw = w / n
        x = -w / 2 + fw * (k + 0.5)
        model.box(fw - 0.008, 0.018, h - 0.008, x, d / 2 - 0.009, 1.454, "kitchen_front", omit="y")
        model.box(
            0.014, 0.02, 0.12, x + (1 if k % 2 == 0 else -1) * (fw / 2 - 0.05), d / 2 + 0.01, 1.5, "metal", omit="y"
        )
    return model


def hood(rng: np.random.Generator, w: float) -> FurnitureModel:
    """Build an extractor hood to hang over an oven."""
    model = FurnitureModel(0, "extractor hood", (w, 0.45, 2.4), clear=0)
    model.box(w, 0.45, 0.06, 0, 0, 1.55, "steel", omit="y")
    model.box(0.28, 0.26, 0.8, 0, -0.095, 1.61, "steel", omit="yzZ")
    return model
