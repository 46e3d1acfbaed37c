"""Furniture models of bathrooms: toilet, wash basin, mirror, bath tub, shower, washing machine."""

import numpy as np

from autonerf_lab.scenes.cabinets import _tap
from autonerf_lab.scenes.furniture_model import FurnitureModel


def toilet(rng: np.random.Generator) -> FurnitureModel:
    """Build a toilet: pedestal bowl with seat, lid (open or closed) and cistern."""
    w, d = float(rng.uniform(0.36, 0.39)), float(rng.uniform(0.64, 0.69))
    model = FurnitureModel(5, "toilet", (w, d, 0.92), clear=0.5)  # height with the lid open
    length = d - 0.2
    y = d / 2 - length / 2
    oval = {"n": 16, "scale": [w / 2, length / 2], "power": 2.4}
    up = bool(rng.random() < 0.35)
    model.lathe(
        [(0.62, 0), (0.56, 0.08), (0.6, 0.18), (0.9, 0.33), (1.0, 0.385), (0.98, 0.4)], 0, y, 0, "ceramic", **oval
    )
    if up:
        model.lathe(
            [(0.98, 0.4), (0.96, 0.415), (0.68, 0.415), (0.6, 0.36), (0.3, 0.26), (0, 0.25)], 0, y, 0, "ceramic", **oval
        )
        model.lathe(
            [(0.98, 0), (1, 0.01), (0.98, 0.03), (0, 0.03)],
            0,
            -d / 2 + 0.215,
            0.42 + length / 2,
            "ceramic_lid",
            tilt=-1.45,
            **oval,
        )
    else:
        model.lathe([(0.99, 0.4), (1.0, 0.42), (0.99, 0.44), (0.9, 0.452), (0, 0.455)], 0, y, 0, "ceramic_lid", **oval)
    model.box(w * 0.6, 0.22, 0.36, 0, -d / 2 + 0.2, 0, "ceramic", omit="zZy")
    model.box(w, 0.175, 0.4, 0, -d / 2 + 0.0875, 0.36, "ceramic", omit="y")
    model.box(w + 0.016, 0.185, 0.03, 0, -d / 2 + 0.0925, 0.76, "ceramic", omit="y")
    model.cylinder(0.022, 0.012, 0, -d / 2 + 0.09, 0.79, "chrome", 10)
    return model


def wash_basin(rng: np.random.Generator) -> FurnitureModel:
    """Build a wash basin on a pedestal or on a cupboard."""
    w, d, h = float(rng.uniform(0.54, 0.68)), float(rng.uniform(0.44, 0.5)), 0.86
    model = FurnitureModel(9, "sink (wash basin)", (w, d, h + 0.16), clear=0.55)
    bowl = [(0.4, 0), (0.88, 0.09), (1, 0.15), (0.99, 0.165), (0.82, 0.16), (0.66, 0.09), (0.3, 0.045), (0, 0.04)]
    model.lathe(bowl, 0, 0, h - 0.165, "ceramic", n=18, power=3.2, scale=[w / 2, d / 2])
    if rng.random() < 0.5:
        model.lathe([(0.11, 0), (0.085, 0.1), (0.08, 0.5), (0.12, h - 0.13)], 0, -0.06, 0, "ceramic", n=12)
    else:
        model.box(w * 0.92, d * 0.86, h - 0.3, 0, -0.02, 0.14, "bath_cupboard", omit="y")
        for i in (-1, 1):
            model.box(w * 0.455, 0.016, h - 0.31, i * w * 0.23, d * 0.41 + 0.008, 0.145, "bath_cupboard", omit="y")
            model.box(0.012, 0.018, 0.12, i * 0.035, d * 0.41 + 0.025, h - 0.36, "chrome", omit="y")
    _tap(model, 0, -d / 2 + 0.06, h - 0.005, 0.1)
    return model


def mirror(rng: np.random.Generator) -> FurnitureModel:
    """Build a framed wall mirror; its reflection is part of the texture."""
    w, h = float(rng.uniform(0.5, 0.7)), float(rng.uniform(0.6, 0.8))
    model = FurnitureModel(0, "mirror", (w, 0.03, 1.15 + h), clear=0)
    model.box(w, 0.02, h, 0, -0.005, 1.15, "frame_dark", omit="y")
    model.box(w - 0.06, 0.004, h - 0.06, 0, 0.007, 1.18, "mirror", omit="y")
    return model


def bath_tub(rng: np.random.Generator, length: float) -> FurnitureModel:
    """Build a boxed-in bath tub of a length in metres, with taps at one end."""
    d, h = 0.74, 0.56
    model = FurnitureModel(0, "bath tub", (length, d, h + 0.17), clear=0.4)
    model.box(length, d, h - 0.03, 0, 0, 0, "tub_side", omit="yzZ")
    rim = [(1.0, 0), (1.0, 0.03), (0.9, 0.035), (0.86, 0.0), (0.78, -0.36), (0.6, -0.4), (0, -0.41)]
    model.lathe(rim, 0, 0, h - 0.03, "ceramic", n=24, power=7, scale=[length / 2, d / 2])
    model.box(0.16, 0.03, 0.04, -length / 2 + 0.4, -d / 2 + 0.03, h + 0.12, "chrome", omit="")
    model.box(0.03, 0.12, 0.025, -length / 2 + 0.4, -d / 2 + 0.08, h + 0.12, "chrome", omit="")
    return model


def shower(rng: np.random.Generator) -> FurnitureModel:
    """Build a shower: tray, rail, shower head and a curtain on one side."""
    w = float(rng.uniform(0.8, 0.92))
    model = FurnitureModel(0, "shower", (w, w, 2.0), clear=0.5)
    rim = [(1.0, 0), (1.0, 0.12), (0.9, 0.125), (0.86, 0.06), (0, 0.05)]
    model.lathe(rim, 0, 0, 0, "ceramic", n=20, power=7, scale=[w / 2, w / 2])
    model.cylinder(0.012, 1.0, 0, -w / 2 + 0.05, 1.0, "chrome", 8)
    model.lathe([(0.02, 0), (0.09, 0.03), (0, 0.035)], 0, -w / 2 + 0.14, 1.95, "chrome", n=12)
    model.box(0.014, 0.1, 0.014, 0, -w / 2 + 0.09, 1.985, "chrome", omit="")
    model.box(0.14, 0.04, 0.05, 0, -w / 2 + 0.03, 1.05, "chrome", omit="y")
    model.box(w, 0.018, 0.018, 0, w / 2 - 0.01, 1.98, "chrome", omit="")
    x = np.linspace(-w / 2 + 0.02, -w / 2 + w * 0.45, 13)
    line = [[round(float(v), 3), round(float(w / 2 - 0.035 + 0.018 * np.sin(3.0 * k)), 3)] for k, v in enumerate(x)]
    model.parts.append({"ribbon": line[::-1], "height": 1.82, "at": [0, 0, 0.15], "m": "shower_curtain"})
    return model


def washing_machine(rng: np.random.Generator) -> FurnitureModel:
    """Build a white washing machine with a round door."""
    model = FurnitureModel(0, "washing machine", (0.6, 0.58, 0.85), clear=0.5)
    model.box(0.6, 0.56, 0.85, 0, -0.01, 0, "appliance", omit="yz")
    model.lathe([(0.19, 0), (0.175, 0.03), (0.14, 0.03)], 0, 0.27, 0.44, "chrome", n=18, tilt=-np.pi / 2)
    model.lathe([(0.14, 0), (0.08, 0.018), (0, 0.022)], 0, 0.283, 0.44, "oven_glass", n=18, tilt=-np.pi / 2)
    model.box(0.58, 0.008, 0.1, 0, 0.274, 0.735, "oven_panel", omit="y")
    model.cylinder(0.025, 0.02, 0.12, 0.277, 0.785, "metal", 10, tilt=-np.pi / 2)
    model.surfaces.append((-0.22, -0.2, 0.22, 0.2, 0.85, 0.5))
    return model
