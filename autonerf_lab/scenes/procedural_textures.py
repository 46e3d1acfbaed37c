"""Procedural albedo: one pattern per kind of material, evaluated at every texel.

``s, t`` are metres along and up the patch, ``a, b`` the same in [0, 1], ``p`` the point in the world frame. Every kind
adds mottling at the scale of a metre, a decimetre and a few centimetres, so that even plain walls have texture: without
it, images give a radiance field no parallax there.
"""

import math

import numpy as np
from numba import njit

from autonerf_lab.scenes.value_noise import hash01, noise2, noise3

KINDS: dict[str, int] = {
    name: number
    for number, name in enumerate(
        (
            "plaster", "paint", "wood", "herringbone", "grain", "tile", "checker", "carpet", "fabric", "plaid",
            "dots", "stripes", "damask", "stone", "metal", "ceramic", "bands", "label", "glass", "leaf", "book",
            "picture", "rug", "outdoors", "screen", "clock", "clock_square", "rings",
        )
    )
}  # fmt: skip
PLASTER, PAINT, WOOD, HERRINGBONE, GRAIN, TILE, CHECKER, CARPET, FABRIC, PLAID, DOTS = range(11)
STRIPES, DAMASK, STONE, METAL, CERAMIC, BANDS, LABEL, GLASS, LEAF, BOOK, PICTURE, RUG = range(11, 23)
OUTDOORS, SCREEN, CLOCK, CLOCK_SQUARE, RINGS = range(23, 28)
MOTTLE = {"plaster": 0.3, "paint": 0.22, "carpet": 0.3, "fabric": 0.24, "stripes": 0.26, "damask": 0.26}

GLOSS = {  # specular share of reflected light by kind of material, for renderers with highlights
    "wood": 0.25, "herringbone": 0.25, "grain": 0.15, "tile": 0.45, "checker": 0.45, "stone": 0.4, "metal": 0.6,
    "ceramic": 0.7, "glass": 0.8, "screen": 0.6, "picture": 0.3, "label": 0.3,
}  # fmt: skip


@njit(cache=True)
def _step(x: float, low: float, high: float) -> float:
    """Return the smooth step from 0 at ``low`` to 1 at ``high``."""
    f = min(1.0, max(0.0, (x - low) / (high - low)))
    return f * f * (3 - 2 * f)


@njit(cache=True)
def _grain(along: float, across: float, seed: int) -> float:
    """Return wood grain in [0, 1)."""
    bend = noise2(along * 0.9, across * 4.0, seed) * 0.25
    ring = noise2(along * 1.3, across * 22.0 + bend * 18, seed + 1)
    fibre = noise2(along * 5.0, across * 75.0, seed + 2)
    return 0.68 * ring + 0.32 * fibre


@njit(cache=True)
def _clock(x: float, y: float, square: bool, seed: int) -> float:
    """Return 1 on the ticks, hands and rim of a clock face, else 0; x, y in [-1, 1], y up."""
    r = math.sqrt(x * x + y * y)
    angle = math.atan2(x, y) % (2 * math.pi)
    edge = max(abs(x), abs(y)) if square else r
    near = abs((angle * 6 / math.pi + 0.5) % 1.0 - 0.5)
    if 0.72 < edge < 0.92 and near * r < 0.1:
        return 1.0
    minute, hour = hash01(1, 0, 0, seed) * 2 * math.pi, hash01(2, 0, 0, seed) * 2 * math.pi
    for hand, length, wide in ((minute, 0.68, 0.055), (hour, 0.45, 0.08)):
        along = x * math.sin(hand) + y * math.cos(hand)
        across = abs(x * math.cos(hand) - y * math.sin(hand))
        if -0.1 < along < length and across < wide:
            return 1.0
    return 1.0 if edge > 0.97 or r < 0.09 else 0.0


@njit(cache=True)
def _picture(a: float, b: float, seed: int, c1: np.ndarray, c2: np.ndarray, out: np.ndarray) -> None:
    """Write the colour of a wall picture: a white mount around a landscape, discs or colour fields."""
    if a < 0.1 or a > 0.9 or b < 0.1 or b > 0.9:
        for k in range(3):
            out[k] = 0.92 - 0.03 * k
        return
    x, y = (a - 0.1) / 0.8, (b - 0.1) / 0.8
    style = seed % 3
    if style == 0:
        for k in range(3):
            out[k] = (0.85 - 0.25 * y) * (0.5 + 0.5 * c1[k])
        sun = (x - 0.25 - 0.5 * hash01(5, 0, 0, seed)) ** 2 + (y - 0.75) ** 2
        if sun < 0.008:
            out[0], out[1], out[2] = 0.98, 0.86, 0.5
        for layer in range(4):
            ridge = 0.62 - 0.15 * layer + 0.22 * (noise2(x * (3 + layer), layer * 7.3, seed) - 0.5)
            ridge += 0.05 * (noise2(x * 17, layer * 3.1, seed) - 0.5)
            if y < ridge:
                f = 0.25 + 0.2 * layer
                for k in range(3):
                    out[k] = (1 - f) * (0.45 + 0.5 * c1[k]) + f * c2[k] * 0.8
    elif style == 1:
        for k in range(3):
            out[k] = 0.8 * c1[k] + 0.15
        for disc in range(7):
            cx, cy = hash01(disc, 1, 0, seed), hash01(disc, 2, 0, seed)
            radius = 0.08 + 0.2 * hash01(disc, 3, 0, seed)
            if (x - cx) ** 2 + (y - cy) ** 2 < radius * radius:
                f = hash01(disc, 4, 0, seed)
                for k in range(3):
                    out[k] = f * c2[k] + (1 - f) * (1 - c1[k]) * (0.5 + 0.5 * hash01(disc, 5 + k, 0, seed))
    else:
        i = int(x * 3.999 + 0.6 * noise2(y * 2, 3.3, seed))
        j = int(y * 3.999 + 0.6 * noise2(x * 2, 8.1, seed))
        f = hash01(i, j, 0, seed)
        for k in range(3):
            out[k] = f * c1[k] + (1 - f) * c2[k] * (0.6 + 0.5 * hash01(i, j, 1 + k, seed))
    brush = 0.82 + 0.36 * noise2(x * 30, y * 12, seed + 3)
    for k in range(3):
        out[k] = min(1.0, out[k] * brush)


@njit(cache=True)
def _rug(a: float, b: float, ls: float, lt: float, seed: int) -> float:
    """Return the pattern of a rug in [0, 1]: a border around lozenges, waves or blocks."""
    border = min(min(a, 1 - a) * ls, min(b, 1 - b) * lt)
    x, y = (a - 0.5) * ls, (b - 0.5) * lt
    if 0.06 < border < 0.1 or 0.14 < border < 0.16:
        return 1.0
    if border < 0.16:
        return 0.25 + 0.5 * ((x + y) % 0.12 < 0.06)
    style = seed % 3
    if style == 0:
        cell = 0.34
        u, v = abs((x / cell) % 1.0 - 0.5), abs((y / cell) % 1.0 - 0.5)
        ring = u + v
        return 1.0 if 0.3 < ring < 0.4 or ring < 0.12 else 0.1
    if style == 1:
        return 1.0 if math.sin(y * 22 + 1.8 * math.sin(x * 9)) > 0.2 else 0.12
    return math.floor(hash01(math.floor(x / 0.22), math.floor(y / 0.22), 0, seed) * 4) / 3


@njit(cache=True)
def _outdoors(a: float, b: float, seed: int, out: np.ndarray) -> None:
    """Write the colour of the view through a window: sky, houses and trees."""
    cloud = 0.6 * noise2(a * 3, b * 5, seed) + 0.4 * noise2(a * 9, b * 14, seed)
    white = _step(cloud, 0.45, 0.75)
    out[0] = 0.56 + 0.18 * (1 - b) + 0.26 * white
    out[1] = 0.74 + 0.12 * (1 - b) + 0.14 * white
    out[2] = 0.95
    house = int(a * 3 + hash01(1, 0, 0, seed))
    roof = 0.3 + 0.28 * hash01(house, 2, 0, seed)
    if b < roof:
        tone = 0.55 + 0.3 * hash01(house, 3, 0, seed)
        out[0], out[1], out[2] = tone, tone * (0.82 + 0.12 * hash01(house, 4, 0, seed)), tone * 0.74
        u, v = (a * 15) % 1.0, (b * 11) % 1.0
        if 0.3 < u < 0.72 and 0.25 < v < 0.75 and b < roof - 0.05:
            out[0], out[1], out[2] = 0.3, 0.36, 0.42
    tree = 0.16 + 0.3 * noise2(a * 5, 0.5, seed + 5) + 0.06 * noise2(a * 30, b * 30, seed + 6)
    if b < tree:
        green = 0.22 + 0.4 * noise2(a * 24, b * 24, seed + 7)
        out[0], out[1], out[2] = green * 0.7, green, green * 0.45


@njit(cache=True)
def albedo(
    kind: int, c1: np.ndarray, c2: np.ndarray, scale: float, seed: int, mottle: float,
    s: float, t: float, a: float, b: float, ls: float, lt: float, p: np.ndarray, out: np.ndarray,
) -> None:  # fmt: skip
    """Write the display-space (sRGB) colour of one point to ``out``.

    Args:
        kind: Kind of material, a value of ``KINDS``.
        c1: (3,) first colour in [0, 1].
        c2: (3,) second colour in [0, 1].
        scale: Scale of the pattern.
        seed: Random seed of the pattern.
        mottle: Strength of the mottling.
        s: Position along the patch, metres.
        t: Position up the patch, metres.
        a: Position along the patch in [0, 1].
        b: Position up the patch in [0, 1].
        ls: Length of the patch, metres.
        lt: Height of the patch, metres.
        p: (3,) point in the world frame, metres.
        out: (3,) colour in [0.01, 1], written.
    """
    f = -1.0  # share of the second colour, for kinds that mix two colours
    if kind == PLASTER:
        f = 0.75 * noise3(p[0] * 2.3 / scale, p[1] * 2.3 / scale, p[2] * 2.3 / scale, seed)
        f += 0.5 * (noise3(p[0] * 11, p[1] * 11, p[2] * 11, seed + 1) - 0.25)
    elif kind == PAINT:
        f = noise3(p[0] * 4, p[1] * 4, p[2] * 4, seed)
    elif kind == WOOD:
        wide, long = 0.14 * scale, 1.1 * scale
        row = math.floor(t / wide)
        x = s / long + hash01(int(row), 1, 0, seed)
        board = math.floor(x)
        tone = hash01(int(board), int(row), 2, seed)
        f = 0.55 * _grain(s + 7 * tone, t + 3 * tone, seed) + 0.6 * tone - 0.1
        if (t / wide - row) * wide < 0.006 or (x - board) * long < 0.006:
            f = 1.6
    elif kind == HERRINGBONE:
        side = 0.42 * scale
        i, j = math.floor(s / side), math.floor(t / side)
        u, v = s / side - i, t / side - j
        if (int(i) + int(j)) % 2 == 0:
            u, v = v, u
        strip = math.floor(v * 4)
        tone = hash01(int(i), int(j), int(strip), seed)
        f = 0.5 * _grain(u * side + 5 * tone, v * side + tone, seed) + 0.55 * tone
        if (v * 4 - strip) < 0.06 or u < 0.015:
            f = 1.5
    elif kind == GRAIN:
        f = _grain(s, t, seed) if ls >= lt else _grain(t, s, seed)
        f = 0.9 * f + 0.25 * (noise3(p[0] * 3, p[1] * 3, p[2] * 3, seed + 5) - 0.5)
    elif kind in (TILE, CHECKER):
        i, j = math.floor(s / scale), math.floor(t / scale)
        u, v = (s / scale - i) * scale, (t / scale - j) * scale
        tone = hash01(int(i), int(j), 0, seed)
        if kind == CHECKER:
            f = 0.25 * tone + 0.75 * ((int(i) + int(j)) % 2)
        else:
            f = 0.55 * tone - 0.1
            if hash01(int(i), int(j), 3, seed) > 0.93:
                f = 0.9
        f += 0.4 * (noise2(s * 9 + 31 * tone, t * 9, seed) - 0.5)
        if min(u, v) < 0.007:
            f = 1.5
    elif kind == CARPET:
        f = 0.5 * noise2(s * 45, t * 45, seed) + 0.5 * noise2(s * 8, t * 8, seed + 1)
    elif kind == FABRIC:
        weave = 0.5 + 0.25 * (math.sin(s * 230) + math.sin(t * 230))
        f = 0.3 * weave + 0.4 * noise2(s * 30, t * 30, seed) + 0.3 * noise3(p[0] * 7, p[1] * 7, p[2] * 7, seed + 1)
    elif kind == PLAID:
        u, v = (s / (0.16 * scale)) % 1.0, (t / (0.16 * scale)) % 1.0
        f = 0.45 * (u < 0.45) + 0.45 * (v < 0.45) + 0.1 * (abs(u - 0.7) < 0.06) + 0.1 * (abs(v - 0.7) < 0.06)
    elif kind == DOTS:
        cell = 0.1 * scale
        j = math.floor(t / cell)
        u, v = (s / cell + 0.5 * (int(j) % 2)) % 1.0 - 0.5, t / cell - j - 0.5
        f = 1.0 if u * u + v * v < 0.06 else 0.05
    elif kind == STRIPES:
        u = (s / (0.17 * scale)) % 1.0
        f = 0.85 * _step(abs(u - 0.5), 0.22, 0.26) + 0.6 * (abs(abs(u - 0.5) - 0.13) < 0.02)
    elif kind == DAMASK:
        cell = 0.3 * scale
        j = math.floor(t / cell)
        u, v = (s / cell + 0.5 * (int(j) % 2)) % 1.0 - 0.5, t / cell - j - 0.5
        r = math.sqrt(u * u + v * v) + 1e-9
        petal = 0.25 + 0.13 * math.cos(6 * math.atan2(v, u) + 0.8)
        f = 0.9 * (1 - _step(r, petal - 0.03, petal + 0.03))
        if r < 0.07:
            f = 0.1
    elif kind == STONE:
        vein = noise3(p[0] * 6, p[1] * 6, p[2] * 6, seed) + 0.5 * noise3(p[0] * 19, p[1] * 19, p[2] * 19, seed + 1)
        f = 0.7 * abs(vein - 0.75) * 2 + 0.7 * (noise2(s * 70 / scale * 0.5, t * 70 / scale * 0.5, seed + 2) - 0.3)
    elif kind == METAL:
        x, y = (s, t) if ls >= lt else (t, s)
        f = 0.6 * noise2(x * 2.5, y * 55, seed) + 0.4 * noise3(p[0] * 3, p[1] * 3, p[2] * 3, seed + 1)
    elif kind == CERAMIC:
        f = 0.8 * noise3(p[0] * 14 / scale, p[1] * 14 / scale, p[2] * 14 / scale, seed)
    elif kind == BANDS:
        f = 1.0 if 0.25 < (b * 5 + hash01(3, 0, 0, seed)) % 1.0 < 0.6 else 0.0
    elif kind == LABEL:
        f = 1.0 if b < 0.12 or b > 0.88 or (0.55 < b < 0.75 and (a * 3) % 1.0 < 0.6) else 0.05
        if 0.25 < b < 0.45 and hash01(int(a * 60), int(b * 14), 0, seed) > 0.5:
            f = 0.8
    elif kind == GLASS:
        u = (a * ls + b * lt) / (ls + lt)
        f = 0.15 + 0.7 * _step(math.sin(u * 9 + 1.5), 0.5, 0.9) + 0.5 * (noise2(s * 5, t * 5, seed) - 0.5)
    elif kind == LEAF:
        side = abs(a - 0.5)
        f = 0.7 * (side < 0.06) + 0.3 * (((b * 7 + side * 4) % 1.0) < 0.25) + 0.35 * noise2(a * 4, b * 9, seed)
    elif kind == BOOK:
        up = b if lt >= ls else a
        over = a if lt >= ls else b
        f = 0.08 * noise2(s * 40, t * 40, seed)
        if 0.08 < up < 0.12 or 0.86 < up < 0.9:
            f = 0.9
        if 0.42 < up < 0.78 and 0.3 < over < 0.7 and hash01(int(up * 26), 0, 0, seed) > 0.35:
            f = 0.85
    elif kind == RUG:
        f = 0.85 * _rug(a, b, ls, lt, seed) + 0.25 * noise2(s * 40, t * 40, seed)
    elif kind == RINGS:  # polar coordinates, as for CLOCK
        wave = 0.03 * math.cos(2 * math.pi * a * (10 + seed % 7))
        ring = math.floor((b + wave) * 7)
        f = 0.85 * hash01(int(ring), 0, 0, seed) + 0.2 * noise2(p[0] * 40, p[1] * 40, seed)
    elif kind == CLOCK:  # polar coordinates: a is the angle, b runs from the rim to the centre
        angle = -2 * math.pi * a
        f = _clock(-(1 - b) * math.cos(angle), (1 - b) * math.sin(angle), False, seed)
    elif kind == CLOCK_SQUARE:
        f = _clock(2 * a - 1, 2 * b - 1, True, seed)
    elif kind == SCREEN:
        f = 0.8 * _step(noise2(a * 3, b * 2, seed), 0.35, 0.8) + 0.35 * noise2(a * 13, b * 8, seed + 1)
    elif kind == PICTURE:
        _picture(a, b, seed, c1, c2, out)
    elif kind == OUTDOORS:
        _outdoors(a, b, seed, out)
    if f > -1.0 and kind not in (PICTURE, OUTDOORS):
        f = min(1.6, max(-0.2, f))
        for k in range(3):
            out[k] = c1[k] + f * (c2[k] - c1[k])
    if mottle > 0.0:
        m = 0.4 * noise3(p[0] * 1.1, p[1] * 1.1, p[2] * 1.1, seed + 11) + 0.35 * noise3(
            p[0] * 4.7, p[1] * 4.7, p[2] * 4.7, seed + 12
        )
        m += 0.25 * noise3(p[0] * 21, p[1] * 21, p[2] * 21, seed + 13)
        for k in range(3):
            out[k] *= 1.0 + mottle * (m - 0.5)
    for k in range(3):
        out[k] = min(1.0, max(0.01, out[k]))


def material_table(spec: dict) -> tuple[np.ndarray, np.ndarray]:
    """Return the K materials as arrays for the kernels.

    Returns:
        (K, 9) float64: two colours, scale, glow, mottling; and (K, 2) int64: kind, seed.
    """
    parameters, codes = [], []
    for material in spec["materials"].values():
        one = np.array(material.get("color", (200, 200, 200)), dtype=np.float64) / 255
        two = np.array(material["color2"], dtype=np.float64) / 255 if "color2" in material else one * 0.74
        glow = float(material.get("glow", 0.0))
        mottle = MOTTLE.get(material["kind"], 0.2) if glow < 0.5 else 0.0
        parameters.append([*one, *two, float(material.get("scale", 1.0)), glow, mottle])
        codes.append([KINDS[material["kind"]], int(material.get("seed", 1))])
    return np.array(parameters), np.array(codes, dtype=np.int64)
