"""Models of small objects, wall objects, plants, lamps, screens and rugs."""

import numpy as np

from autonerf_lab.scenes.furniture_model import FurnitureModel, extent, pick

BOOK_COLORS, PICTURES, RUGS = 10, 8, 4


def books(rng: np.random.Generator, room_for: float, free: float) -> FurnitureModel:
    """Build a row of standing books, at most ``room_for`` metres long and lower than ``free`` metres."""
    model = FurnitureModel(11, "books", (0, 0, 0), clear=0)
    count = int(rng.integers(4, 11))
    widths = rng.uniform(0.022, 0.05, count)
    widths = widths[: max(2, int(np.searchsorted(np.cumsum(widths), room_for)))]
    total, tallest, deep = float(widths.sum()), 0.0, 0.0
    x = -total / 2
    for width in widths.tolist():
        h = min(free - 0.02, float(rng.uniform(0.19, 0.29)))
        d = float(rng.uniform(0.14, 0.19))
        model.box(width - 0.002, d, h, x + width / 2, d / 2 - 0.095, 0, f"book{int(rng.integers(BOOK_COLORS))}")
        x += width
        tallest, deep = max(tallest, h), max(deep, d)
    model.size = (total, 0.2, tallest)
    return model


def book_stack(rng: np.random.Generator) -> FurnitureModel:
    """Build a stack of one to four books."""
    w, d = float(rng.uniform(0.2, 0.26)), float(rng.uniform(0.15, 0.19))
    model = FurnitureModel(11, "books (stack)", (w, d, 0), clear=0)
    z = 0.0
    for _ in range(int(rng.integers(1, 5))):
        h = float(rng.uniform(0.02, 0.045))
        shrink = float(rng.uniform(0.86, 0.98))
        yaw = float(rng.uniform(-0.08, 0.08))
        model.box(w * shrink, d * shrink, h, 0, 0, z, f"book{int(rng.integers(BOOK_COLORS))}", yaw=yaw)
        z += h
    model.size = (w, d, z)
    return model


def vase(rng: np.random.Generator) -> FurnitureModel:
    """Build a vase: bellied, slender, conical or spherical; some hold flowers."""
    h = float(rng.uniform(0.18, 0.34))
    profiles = {
        "bellied": [
            (0.5, 0),
            (0.9, 0.25),
            (1, 0.45),
            (0.6, 0.75),
            (0.4, 0.88),
            (0.5, 1),
            (0.42, 1),
            (0.3, 0.85),
            (0, 0.7),
        ],
        "slender": [(0.55, 0), (0.75, 0.2), (0.62, 0.6), (0.45, 0.85), (0.7, 1), (0.6, 1), (0.35, 0.85), (0, 0.7)],
        "cone": [(0.5, 0), (0.6, 0.3), (1, 1), (0.92, 1), (0.5, 0.4), (0, 0.38)],
        "ball": [
            (0.45, 0),
            (0.85, 0.18),
            (1, 0.42),
            (0.85, 0.66),
            (0.42, 0.82),
            (0.4, 1),
            (0.32, 1),
            (0.3, 0.8),
            (0, 0.7),
        ],
    }
    kind = str(pick(rng, *profiles))
    r = h * {"bellied": 0.3, "slender": 0.26, "cone": 0.26, "ball": 0.42}[kind]
    model = FurnitureModel(13, f"vase ({kind})", (2 * r, 2 * r, h), clear=0)
    material = f"vase{int(rng.integers(4))}"
    model.lathe([(r * a, h * b) for a, b in profiles[kind]], 0, 0, 0, material, n=10)
    if rng.random() < 0.45:
        for k in range(5):
            leaf = [0.2, 0.035, 0.02]
            model.parts.append(
                {
                    "leaf": leaf,
                    "at": [0, 0, h * 0.93],
                    "yaw": 1.26 * k,
                    "tilt": float(rng.uniform(0.9, 1.4)),
                    "m": "flower",
                }
            )
        low, high = extent(model.parts)
        model.size = (2 * max(high[0], -low[0]), 2 * max(high[1], -low[1]), float(high[2]))
    return model


def cup(rng: np.random.Generator) -> FurnitureModel:
    """Build a cup with a handle."""
    r, h = float(rng.uniform(0.036, 0.046)), float(rng.uniform(0.08, 0.105))
    model = FurnitureModel(14, "cup", (2 * r + 0.03, 2 * r, h), clear=0)
    material = f"cup{int(rng.integers(4))}"
    profile = [(r * 0.86, 0), (r, h * 0.3), (r, h), (r * 0.88, h), (r * 0.84, h * 0.25), (0, h * 0.2)]
    model.lathe(profile, 0, 0, 0, material, n=8)
    for z, sz in ((0.22 * h, 0.012), (0.72 * h, 0.012)):
        model.box(0.026, 0.012, sz, r + 0.011, 0, z, material, omit="x")
    model.box(0.01, 0.012, 0.62 * h, r + 0.022, 0, 0.22 * h, material, omit="")
    return model


def bottle(rng: np.random.Generator) -> FurnitureModel:
    """Build a wine, water or squat bottle with a label and a cap."""
    kind = str(pick(rng, "wine", "water", "squat"))
    r, h = {"wine": (0.038, 0.3), "water": (0.036, 0.26), "squat": (0.045, 0.2)}[kind]
    model = FurnitureModel(15, f"bottle ({kind})", (2 * r, 2 * r, h), clear=0)
    material = f"bottle{int(rng.integers(4))}"
    shoulder = {"wine": 0.62, "water": 0.7, "squat": 0.6}[kind]
    model.lathe(
        [(r * 0.9, 0), (r, 0.02), (r, h * shoulder), (r * 0.42, h * (shoulder + 0.14)), (r * 0.38, h * 0.93)],
        0, 0, 0, material, n=8,
    )  # fmt: skip
    model.lathe([(r * 1.02, 0), (r * 1.02, h * 0.3)], 0, 0, h * 0.18, f"label{int(rng.integers(3))}", n=8)
    model.lathe([(r * 0.44, 0), (r * 0.44, h * 0.08), (0, h * 0.08)], 0, 0, h * 0.92, "black", n=8)
    return model


def clock(rng: np.random.Generator) -> FurnitureModel:
    """Build a round or square wall clock; its centre is 1.75 m above the floor."""
    r = float(rng.uniform(0.14, 0.19))
    model = FurnitureModel(12, "clock", (2 * r, 0.05, 1.75 + r), clear=0)
    if rng.random() < 0.7:
        rim = [(r, 0), (r, 0.035), (r * 0.9, 0.04), (r * 0.88, 0.025)]
        model.lathe(rim, 0, -0.025, 1.75, "frame_dark", n=24, tilt=-np.pi / 2)
        s = r * 0.885
        model.lathe([(s, 0), (0, 0.001)], 0, 0.0, 1.75, "clock", n=24, tilt=-np.pi / 2)
    else:
        s = r * 0.9
        model.box(2 * s, 0.03, 2 * s, 0, -0.01, 1.75 - s, "frame_dark", omit="y")
        model.box(2 * s * 0.9, 0.004, 2 * s * 0.9, 0, 0.007, 1.75 - s * 0.9, "clock_square", omit="y")
    return model


def picture(rng: np.random.Generator, widest: float) -> FurnitureModel:
    """Build a framed wall picture, at most ``widest`` metres wide; its centre is 1.55 m above the floor."""
    h = float(rng.uniform(0.35, 0.75))
    w = min(widest, h * float(pick(rng, 0.72, 1.0, 1.4)))
    z = 1.55 - h / 2
    model = FurnitureModel(0, "picture", (w, 0.03, z + h), clear=0)
    model.box(w, 0.022, h, 0, -0.004, z, str(pick(rng, "frame_dark", "frame_light")), omit="y")
    model.box(w - 0.05, 0.003, h - 0.05, 0, 0.0085, z + 0.025, f"picture{int(rng.integers(PICTURES))}", omit="y")
    return model


def rug(rng: np.random.Generator, w: float, d: float) -> FurnitureModel:
    """Build a rug of w x d metres, 8 mm thick; the robot can drive over it."""
    model = FurnitureModel(0, "rug", (w, d, 0.008), clear=0)
    number = int(rng.integers(RUGS))
    if rng.random() < 0.35 and max(w, d) < 1.6 * min(w, d):
        r = min(w, d) / 2
        model.size = (2 * r, 2 * r, 0.008)
        model.lathe([(r, 0), (r, 0.008), (0, 0.008)], 0, 0, 0, f"round_rug{number}", n=28)
    else:
        model.box(w, d, 0.008, 0, 0, 0, f"rug{number}")
    return model


def plant(rng: np.random.Generator, tall: bool = True) -> FurnitureModel:
    """Build a potted plant with sword-shaped leaves, a bush or a palm; ``tall`` for the floor, else for a table."""
    kind = str(pick(rng, "sword", "bush", "palm")) if tall else str(pick(rng, "sword", "bush"))
    pot_r, pot_h = (float(rng.uniform(0.14, 0.19)), float(rng.uniform(0.24, 0.34))) if tall else (0.065, 0.11)
    height = float(rng.uniform(0.8, 1.35)) if tall else float(rng.uniform(0.26, 0.36))
    model = FurnitureModel(3, f"potted plant ({kind})", (0, 0, height), clear=0)
    rim = [(pot_r * 0.72, 0), (pot_r, pot_h), (pot_r * 0.9, pot_h), (pot_r * 0.88, pot_h * 0.88), (0, pot_h * 0.9)]
    model.lathe(rim, 0, 0, 0, f"pot{int(rng.integers(3))}", n=14)
    above = height - pot_h

    def leaf(length: float, width: float, droop: float, z: float, yaw: float, tilt: float) -> None:
        leaf_shape = [round(length, 3), round(width, 3), round(droop, 3)]
        model.parts.append({"leaf": leaf_shape, "at": [0, 0, z], "yaw": yaw, "tilt": tilt, "m": "leaf"})

    if kind == "sword":
        for k in range(12 if tall else 8):
            yaw = 2.4 * k
            leaf(
                above * float(rng.uniform(0.7, 1.02)),
                above * 0.12,
                0.02,
                pot_h * 0.85,
                yaw,
                float(rng.uniform(1.2, 1.5)),
            )
    elif kind == "bush":
        model.cylinder(0.012 if tall else 0.005, above * 0.7, 0, 0, pot_h * 0.88, "stem", 6)
        for k in range(30 if tall else 16):
            f = k / (30 if tall else 16)
            length = above * float(rng.uniform(0.3, 0.42)) * (1.15 - 0.45 * f)
            leaf(length, length * 0.5, length * 0.25, pot_h + above * (0.15 + 0.55 * f), 2.4 * k, 0.2 + 0.9 * f)
    else:
        model.lathe([(0.028, 0), (0.02, above * 0.55)], 0, 0, pot_h * 0.88, "stem", n=7)
        for k in range(16):
            length = above * float(rng.uniform(0.34, 0.46))
            leaf(length, length * 0.17, length * 0.4, pot_h + above * 0.5, 2.4 * k, 0.45 + 0.85 * k / 16)
    low, high = extent(model.parts)
    model.size = (2 * max(high[0], -low[0]), 2 * max(high[1], -low[1]), float(high[2]))
    return model


def tv(rng: np.random.Generator, w: float) -> FurnitureModel:
    """Build a flat-screen TV of width ``w`` metres on a foot."""
    h = w * 0.56
    model = FurnitureModel(6, "tv", (w, 0.2, h + 0.06), clear=0)
    model.box(w * 0.42, 0.2, 0.012, 0, 0, 0, "black")
    model.box(0.08, 0.03, 0.07, 0, -0.02, 0.012, "black", omit="zZ")
    model.box(w, 0.035, h, 0, 0, 0.06, "black", omit="")
    model.box(w - 0.03, 0.003, h - 0.035, 0, 0.019, 0.078, "screen", omit="y")
    return model


def wall_shelf(rng: np.random.Generator) -> FurnitureModel:
    """Build a wall shelf of one or two boards with brackets."""
    w, d = float(rng.uniform(0.6, 1.1)), 0.22
    boards = int(rng.integers(1, 3))
    model = FurnitureModel(0, "wall shelf", (w, d, 1.35 + 0.36 * (boards - 1)), clear=0)
    for k in range(boards):
        z = 1.32 + 0.36 * k
        model.box(w, d, 0.03, 0, 0, z, "wood_shelf", omit="y")
        for x in (-1, 1):
            model.box(0.02, d * 0.8, 0.06, x * w * 0.36, -d * 0.1, z - 0.06, "black", omit="yZ")
        model.surfaces.append((-w / 2 + 0.03, -d / 2 + 0.01, w / 2 - 0.03, d / 2 - 0.01, z + 0.03, 0.32))
    return model


def basket(rng: np.random.Generator) -> FurnitureModel:
    """Build a round basket, open at the top."""
    r, h = float(rng.uniform(0.13, 0.2)), float(rng.uniform(0.28, 0.5))
    model = FurnitureModel(0, "basket", (2 * r, 2 * r, h), clear=0)
    model.lathe([(r * 0.82, 0), (r, h), (r * 0.93, h), (r * 0.8, h * 0.3), (0, h * 0.3)], 0, 0, 0, "basket", n=14)
    return model


def towel_rail(rng: np.random.Generator) -> FurnitureModel:
    """Build a wall rail with two towels."""
    model = FurnitureModel(0, "towel rail", (0.7, 0.1, 1.3), clear=0)
    model.box(0.7, 0.018, 0.018, 0, 0.03, 1.26, "chrome", omit="")
    for x in (-1, 1):
        model.box(0.02, 0.08, 0.02, x * 0.33, -0.01, 1.26, "chrome", omit="y")
        h = float(rng.uniform(0.4, 0.65))
        model.box(0.28, 0.03, h, x * 0.16, 0.03, 1.285 - h, f"towel{int(rng.integers(2))}", omit="")
    return model


def coat_rack(rng: np.random.Generator) -> FurnitureModel:
    """Build a board with hooks and coats."""
    model = FurnitureModel(0, "coat rack", (0.9, 0.2, 1.75), clear=0)
    model.box(0.9, 0.02, 0.1, 0, -0.09, 1.65, "wood_shelf", omit="y")
    for k in range(5):
        x = -0.36 + 0.18 * k
        model.box(0.02, 0.06, 0.02, x, -0.05, 1.68, "metal", omit="y")
        if rng.random() < 0.6:
            h, w = float(rng.uniform(0.6, 0.95)), float(rng.uniform(0.15, 0.2))
            coat = [(0.75, 0), (1.0, 0.05), (0.95, h * 0.6), (0.8, h * 0.88), (0.25, h)]
            scale = [w / 2 * 1.15, 0.075]
            model.lathe(coat, x, -0.015, 1.69 - h, f"coat{int(rng.integers(3))}", n=10, power=3, scale=scale)
    return model


def table_lamp(rng: np.random.Generator) -> FurnitureModel:
    """Build a table lamp with a fabric shade."""
    h = float(rng.uniform(0.34, 0.46))
    model = FurnitureModel(0, "table lamp", (0.24, 0.24, h), clear=0)
    model.lathe([(0.07, 0), (0.06, 0.02), (0.012, 0.04), (0.012, h - 0.16)], 0, 0, 0, "metal", n=10)
    model.lathe([(0.12, 0), (0.085, 0.18), (0.0, 0.175)], 0, 0, h - 0.18, "lampshade", n=14)
    return model


def floor_lamp(rng: np.random.Generator) -> FurnitureModel:
    """Build a floor lamp with a fabric shade."""
    h = float(rng.uniform(1.45, 1.7))
    model = FurnitureModel(0, "floor lamp", (0.36, 0.36, h), clear=0)
    model.lathe([(0.14, 0), (0.13, 0.02), (0.014, 0.035), (0.012, h - 0.25)], 0, 0, 0, "black", n=10)
    model.lathe([(0.18, 0), (0.13, 0.28), (0.0, 0.275)], 0, 0, h - 0.28, "lampshade", n=16)
    return model


def radiator(rng: np.random.Generator, w: float) -> FurnitureModel:
    """Build a radiator of width ``w`` metres."""
    model = FurnitureModel(0, "radiator", (w, 0.1, 0.7), clear=0)
    model.box(w, 0.06, 0.55, 0, 0, 0.13, "radiator", omit="")
    for k in range(int(w / 0.12)):
        model.box(0.06, 0.02, 0.5, -w / 2 + 0.08 + 0.12 * k, 0.035, 0.155, "radiator", omit="y")
    return model


def curtain(rng: np.random.Generator, w: float, top: float, bottom: float) -> FurnitureModel:
    """Build a gathered curtain of width ``w`` between the heights ``bottom`` and ``top``, metres."""
    model = FurnitureModel(0, "curtain", (w, 0.1, top), clear=0)
    n = max(8, int(w / 0.035))
    x = np.linspace(w / 2, -w / 2, n + 1)
    wave = 0.028 * np.sin(np.arange(n + 1) * 1.7 + rng.uniform(0, 6)) * (0.8 + 0.2 * np.sin(np.arange(n + 1) * 0.6))
    line = [[round(float(a), 3), round(float(b), 3)] for a, b in zip(x, wave, strict=True)]
    model.parts.append(
        {"ribbon": line, "height": round(top - bottom, 3), "at": [0, 0, round(bottom, 3)], "m": "curtain"}
    )
    model.box(w, 0.09, 0.025, 0, -0.045, top, "window_frame", omit="y")
    return model


def ceiling_lamp(rng: np.random.Generator, kind: str) -> FurnitureModel:
    """Build a ceiling lamp, ``pendant`` or a glass bowl; z = 0 is the ceiling."""
    if kind == "pendant":
        drop = 0.75
        model = FurnitureModel(0, "pendant lamp", (0.4, 0.4, 0), clear=0)
        model.cylinder(0.006, drop, 0, 0, -drop, "black", 6)
        model.lathe([(0.2, 0), (0.17, 0.1), (0.05, 0.2), (0, 0.2)], 0, 0, -drop - 0.16, "shade_pendant", n=14)
        model.lathe([(0, 0), (0.045, 0.03), (0.05, 0.06), (0, 0.1)], 0, 0, -drop - 0.1, "bulb", n=8)
        return model
    model = FurnitureModel(0, "ceiling lamp", (0.36, 0.36, 0), clear=0)
    model.lathe([(0, -0.1), (0.1, -0.09), (0.17, -0.045), (0.18, 0)], 0, 0, 0, "bulb", n=14)
    return model
