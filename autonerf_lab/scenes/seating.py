"""Furniture models of chairs, couches and beds. Each function samples variant and proportions from ``rng``."""

import numpy as np

from autonerf_lab.scenes.furniture_model import FurnitureModel, pick


def chair(rng: np.random.Generator, kind: str | None = None) -> FurnitureModel:
    """Build a chair: ``slats`` (wooden), ``upholstered``, ``shell`` (plastic) or ``office``; a random kind if None."""
    kind = kind or str(pick(rng, "slats", "upholstered", "shell"))
    w, d, seat = float(rng.uniform(0.42, 0.47)), float(rng.uniform(0.44, 0.5)), float(rng.uniform(0.44, 0.47))
    h = float(rng.uniform(0.82, 0.95))
    model = FurnitureModel(1, f"chair ({kind})", (w, d, h))
    if kind == "slats":
        model.legs(w, d, seat - 0.03, 0.036, "wood_chair")
        model.box(w, d, 0.03, 0, 0, seat - 0.03, "wood_chair", omit="")
        for x in (-1, 1):
            model.box(0.036, 0.03, h - seat, x * (w / 2 - 0.018), -d / 2 + 0.015, seat, "wood_chair")
        for z in np.linspace(seat + 0.12, h - 0.08, int(rng.integers(2, 4))):
            model.box(w - 0.072, 0.018, 0.07, 0, -d / 2 + 0.015, float(z), "wood_chair", omit="xX")
    elif kind == "upholstered":
        model.legs(w, d, seat - 0.09, 0.034, "wood_chair", 0.01)
        model.cushion(w, d, 0.09, 0, 0, seat - 0.09, "fabric_chair")
        model.cushion(w * 0.96, 0.07, h - seat - 0.02, 0, -d / 2 + 0.045, seat, "fabric_chair")
    elif kind == "shell":
        for x in (-1, 1):
            for y in (-1, 1):
                model.lathe(
                    [(0.013, 0), (0.02, seat - 0.03)], x * (w / 2 - 0.05), y * (d / 2 - 0.05), 0, "wood_chair", n=6
                )
        model.lathe(
            [(0.7, 0), (0.97, 0.02), (1, 0.05), (0.9, 0.035), (0, 0.03)],
            0,
            0.01,
            seat - 0.035,
            "plastic_chair",
            n=16,
            power=3.2,
            scale=[w / 2, d / 2],
        )
        model.lathe(
            [(0.98, 0), (1.0, 0.15), (0.93, h - seat - 0.05), (0.75, h - seat)],
            0,
            -0.01,
            seat,
            "plastic_chair",
            n=9,
            power=2.4,
            scale=[w / 2, d / 2 - 0.02],
            arc=[3.55, 5.87],
        )
    else:
        model.size = (0.54, 0.54, h)
        for k in range(5):
            angle = 2 * np.pi * k / 5 + 0.3
            model.box(
                0.25,
                0.035,
                0.03,
                0.125 * float(np.cos(angle)),
                0.125 * float(np.sin(angle)),
                0.05,
                "black",
                yaw=float(angle),
                omit="",
            )
            model.box(0.03, 0.03, 0.05, 0.23 * float(np.cos(angle)), 0.23 * float(np.sin(angle)), 0, "black", omit="zZ")
        model.cylinder(0.025, seat - 0.12, 0, 0, 0.06, "metal", 8)
        model.cushion(w, d - 0.04, 0.08, 0, 0.02, seat - 0.06, "fabric_office")
        model.box(0.05, 0.02, 0.2, 0, -d / 2 + 0.03, seat - 0.02, "black", omit="zZ")
        model.cushion(w * 0.9, 0.06, h - seat - 0.06, 0, -d / 2 + 0.06, seat + 0.08, "fabric_office")
    return model


def couch(rng: np.random.Generator, room_for: float = 2.3) -> FurnitureModel:
    """Build a couch of two or three seats, at most ``room_for`` metres wide, with arms, feet and loose cushions."""
    seats = 3 if room_for >= 2.0 and rng.random() < 0.7 else 2
    arm = float(rng.uniform(0.12, 0.2))
    w = min(room_for, seats * float(rng.uniform(0.58, 0.66)) + 2 * arm)
    d, h, seat = float(rng.uniform(0.84, 0.94)), float(rng.uniform(0.74, 0.86)), float(rng.uniform(0.4, 0.45))
    arm_height = float(rng.uniform(0.54, 0.63))
    foot = float(pick(rng, 0.05, 0.1, 0.14))
    model = FurnitureModel(
        2, f"couch ({seats} seats)", (w, d, h + 0.1), clear=0.5
    )  # the loose cushions rise above the back
    model.legs(w, d, foot, 0.05, "wood_couch", 0.02)
    inner = w - 2 * arm
    model.box(w, d, seat - 0.14 - foot, 0, 0, foot, "fabric_couch", omit="")
    model.box(w, 0.16, h - seat + 0.1, 0, -d / 2 + 0.08, seat - 0.14, "fabric_couch")
    for side in (-1, 1):
        x = side * (w / 2 - arm / 2)
        if foot > 0.12:
            model.cushion(arm, d, arm_height - seat + 0.14, x, 0, seat - 0.14, "fabric_couch")
        else:
            model.box(arm, d - 0.16, arm_height - seat + 0.14, x, 0.08, seat - 0.14, "fabric_couch")
    each = inner / seats
    for k in range(seats):
        x = -inner / 2 + each * (k + 0.5)
        model.cushion(each - 0.012, d - 0.18, 0.15, x, 0.085, seat - 0.14, "fabric_couch")
        model.cushion(each - 0.03, 0.17, h - seat + 0.02, x, -d / 2 + 0.2, seat + 0.005, "fabric_couch", tilt=0.12)
    for side in (-1, 1):
        if rng.random() < 0.75:
            material = f"fabric_cushion{int(rng.integers(3))}"
            x = side * (inner / 2 - 0.24)
            model.cushion(0.42, 0.13, 0.4, x, -d / 2 + 0.38, seat + 0.015, material, tilt=0.3, yaw=side * 0.15)
    return model


def armchair(rng: np.random.Generator) -> FurnitureModel:
    """Build an upholstered armchair."""
    w, d, h = float(rng.uniform(0.74, 0.82)), float(rng.uniform(0.76, 0.84)), float(rng.uniform(0.8, 0.92))
    model = FurnitureModel(1, "chair (armchair)", (w, d, h), clear=0.4)
    model.legs(w, d, 0.16, 0.04, "wood_couch", 0.04)
    model.box(w - 0.02, d - 0.04, 0.14, 0, 0, 0.16, "fabric_armchair", omit="")
    for x in (-1, 1):
        model.cushion(0.14, d - 0.1, 0.32, x * (w / 2 - 0.08), 0.03, 0.28, "fabric_armchair")
    model.cushion(w - 0.3, d - 0.18, 0.15, 0, 0.06, 0.3, "fabric_armchair")
    model.cushion(w - 0.06, 0.16, h - 0.3, 0, -d / 2 + 0.1, 0.3, "fabric_armchair")
    if rng.random() < 0.5:
        model.cushion(0.4, 0.12, 0.36, 0, -d / 2 + 0.26, 0.46, f"fabric_cushion{int(rng.integers(3))}", tilt=0.25)
    return model


def bed(rng: np.random.Generator, double: bool = True) -> FurnitureModel:
    """Build a single or double bed with headboard, folded duvet and pillows, sometimes with a throw."""
    w = float(rng.uniform(1.45, 1.68)) if double else float(rng.uniform(0.92, 1.05))
    d, h = float(rng.uniform(2.04, 2.12)), float(rng.uniform(0.85, 1.1))
    top = float(rng.uniform(0.5, 0.58))
    kind = str(pick(rng, "wood", "padded", "bars"))
    model = FurnitureModel(4, f"bed ({'double' if double else 'single'})", (w, d, h), clear=0.4)
    if kind == "padded":
        model.box(w, d, 0.26, 0, 0, 0.05, "fabric_bed", omit="z")
        for k in range(4 if double else 2):
            n = 4 if double else 2
            model.cushion(w / n - 0.01, 0.09, h - 0.3, w / n * (k + 0.5) - w / 2, -d / 2 + 0.045, 0.3, "fabric_bed")
    else:
        model.legs(w, d, 0.2, 0.06, "wood_bed")
        model.box(w, d, 0.13, 0, 0, 0.18, "wood_bed", omit="")
        if kind == "wood":
            model.box(w, 0.045, h - 0.3, 0, -d / 2 + 0.0225, 0.3, "wood_bed")
        else:
            model.box(w, 0.04, 0.06, 0, -d / 2 + 0.02, h - 0.06, "wood_bed", omit="")
            for x in np.linspace(-w / 2 + 0.03, w / 2 - 0.03, 7 if double else 5):
                model.box(0.035, 0.03, h - 0.36, float(x), -d / 2 + 0.02, 0.3, "wood_bed", omit="zZ")
    model.cushion(w - 0.05, d - 0.07, top - 0.29, 0, 0.02, 0.29, "sheet")
    model.cushion(w + 0.02, d * 0.66, 0.17, 0, d * 0.165 - 0.01, top - 0.1, "duvet")
    model.cushion(w + 0.03, 0.34, 0.1, 0, -d * 0.14, top - 0.01, "sheet")
    if rng.random() < 0.6:
        model.cushion(w + 0.05, 0.55, 0.175, 0, d / 2 - 0.45, top - 0.09, "fabric_throw")
    for k in range(2 if double else 1):
        x = (k - 0.5) * w * 0.48 if double else 0.0
        model.cushion(w * (0.43 if double else 0.72), 0.4, 0.14, x, -d / 2 + 0.32, top - 0.01, "sheet", tilt=0.18)
        if rng.random() < 0.5:
            model.cushion(
                0.38, 0.13, 0.34, x, -d / 2 + 0.56, top + 0.05, f"fabric_cushion{int(rng.integers(3))}", tilt=0.75
            )
    return model
