"""Walks at one step as one picture, for films and widgets: what the robot sees, its map, and how much it knows."""

from collections.abc import Sequence
from functools import cache

import numpy as np
from matplotlib.font_manager import findfont
from matplotlib.ticker import MaxNLocator
from PIL import Image, ImageColor, ImageDraw, ImageFont

from autonerf_lab.classes import colorize
from autonerf_lab.exploration.replay import PALETTE, Retraced
from autonerf_lab.mapping.semantic_map import MAP_CELL
from autonerf_lab.viz.figures.style import BLUE, GREEN, ORANGE

COLORS = (BLUE, ORANGE, GREEN, "#CC79A7")  # of the first walk, the second, ...
GROUND, INK, SOFT, RULE = "#E9EBEE", "#1C1E21", "#62676E", "#D9DADB"
BODY = 0.2  # metres, how large the robot is drawn
REACH = 0.8  # metres, how far its view is drawn
_VIEW, _GAP, _TITLE, _CHART = 230, 10, 34, 120  # pixels
_FINE = 2  # drawn so many times larger, then shrunk: lines without steps


def draw(walks: Sequence[Retraced], k: int) -> np.ndarray:
    """All walks at the k-th of the steps they show.

    One walk has its views beside its map, several stand side by side and have theirs above it, all maps in one scale.

    Returns:
        (H, W, 3) uint8, of the same size for every k.
    """
    box = union_box(walks)
    side = 2 * _VIEW + _GAP
    alone = len(walks) == 1
    width = min(max(round(side * (box[1] - box[0])[0] / (box[1] - box[0])[1]), 300), 900) if alone else side
    height = side if alone else round(side * (box[1] - box[0])[1] / (box[1] - box[0])[0])
    column = _VIEW + _GAP + width if alone else side
    step = (column + 2 * _GAP, 2 * _GAP + _TITLE + (side if alone else _VIEW + _GAP + height) + _GAP + _CHART)
    picture = Image.new("RGB", (len(walks) * step[0], step[1]), "white")
    pen = ImageDraw.Draw(picture)
    for number, walk in enumerate(walks):
        left, top = number * step[0] + _GAP, _GAP
        pen.text((left, top), walk.name[:40], INK, _font(17))
        pen.text((left + column, top + 3), _facts(walk, k), SOFT, _font(13), anchor="ra")
        top += _TITLE
        for place, view in enumerate(views(walk, k)):
            at = (left, top + place * (_VIEW + _GAP)) if alone else (left + place * (_VIEW + _GAP), top)
            picture.paste(_fit(view, place > 0), at)
        at = (left + _VIEW + _GAP, top) if alone else (left, top + _VIEW + _GAP)
        picture.paste(_map(walk, k, box, (width, height), COLORS[number % len(COLORS)]), at)
    _chart(picture, walks, k, (_GAP, step[1] - _GAP - _CHART, len(walks) * step[0] - _GAP, step[1] - _GAP))
    return np.asarray(picture)


def union_box(walks: Sequence[Retraced]) -> np.ndarray:
    """(2, 2) lower and upper corner of what any of the walks knows, world x, y."""
    boxes = np.stack([walk.box() for walk in walks])
    return np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])


def views(walk: Retraced, k: int) -> list[np.ndarray]:
    """What the robot sees: colours, and classes where the walk kept them, (H, W, 3) uint8 each."""
    t, kept = walk.steps[k], walk.trajectory
    return [kept.rgb[t]] + ([] if kept.semantics is None else [colorize(kept.semantics[t])])


def _facts(walk: Retraced, k: int) -> str:
    area = "" if walk.area is None else f" · {walk.area[k]:.1f} m² explored"
    return f"step {walk.steps[k]}{area} · {walk.length[walk.steps[k]]:.1f} m walked"


def _fit(view: np.ndarray, classes: bool) -> Image.Image:
    """A view in the middle of a square."""
    scale = _VIEW / max(view.shape[:2])
    size = (max(1, round(view.shape[1] * scale)), max(1, round(view.shape[0] * scale)))
    way = Image.Resampling.NEAREST if classes else Image.Resampling.BICUBIC
    square = Image.new("RGB", (_VIEW, _VIEW), GROUND)
    square.paste(Image.fromarray(view).resize(size, way), ((_VIEW - size[0]) // 2, (_VIEW - size[1]) // 2))
    return square


def _map(walk: Retraced, k: int, box: np.ndarray, size: tuple[int, int], color: str) -> Image.Image:
    scale = _FINE * min(size / (box[1] - box[0]))
    middle = (box[0] + box[1]) / 2
    fine = Image.new("RGB", (_FINE * size[0], _FINE * size[1]), GROUND)

    def pixels(points: np.ndarray) -> np.ndarray:
        return (np.atleast_2d(points) - middle) * (scale, -scale) + np.array(fine.size) / 2

    if walk.maps is not None:
        cells = Image.fromarray(PALETTE[walk.maps[k]][::-1])
        extent = MAP_CELL * np.array(cells.size)
        low, high = pixels(walk.corner + extent * (0, 1)).round()[0], pixels(walk.corner + extent * (1, 0)).round()[0]
        large = cells.resize((int(high[0] - low[0]), int(high[1] - low[1])), Image.Resampling.NEAREST)
        fine.paste(large, (int(low[0]), int(low[1])), large)
    pen = ImageDraw.Draw(fine, "RGBA")
    x, y, heading = walk.planar[walk.steps[k]]
    here = pixels(np.array([x, y]))[0]
    target = walk.waypoints[k]
    if target is not None:
        there = pixels(np.array(target))[0]
        pen.line([*here, *there], fill=(*ImageColor.getrgb(INK), 110), width=_FINE)
        for radius, paint in ((7, "white"), (5, INK), (3, "white")):
            pen.circle((there[0], there[1]), radius * _FINE, fill=paint)
    way = pixels(walk.planar[: walk.steps[k] + 1, :2])
    for thickness, paint in ((5, "white"), (3, color)):
        if len(way) > 1:
            pen.line(way.reshape(-1).tolist(), fill=paint, width=thickness * _FINE, joint="curve")
    reach, body = REACH * scale, BODY * scale
    half, middle_deg = half_view(walk), -np.degrees(heading)
    pen.pieslice(
        [*(here - reach), *(here + reach)], middle_deg - half, middle_deg + half, (*ImageColor.getrgb(color), 70)
    )
    pen.circle((here[0], here[1]), body, fill=color, outline="white", width=2 * _FINE)
    nose = np.array([[0.8, 0], [-0.6, 0.5], [-0.3, 0], [-0.6, -0.5]]) * body
    turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    pen.polygon((here + nose @ turn.T * (1, -1)).reshape(-1).tolist(), fill="white")
    return fine.reduce(_FINE)


def half_view(walk: Retraced) -> float:
    """Half of the horizontal field of view, degrees."""
    k = walk.trajectory.intrinsics
    return float(np.degrees(np.arctan(k.width / 2 / k.fl_x)))


def area_ticks(walks: Sequence[Retraced]) -> list[float]:
    """Square metres, from 0 to more than any of the walks explored; empty when none has a map."""
    areas = [float(walk.area.max()) for walk in walks if walk.area is not None]
    return [float(tick) for tick in MaxNLocator(4).tick_values(0, max(areas))] if areas else []


def _chart(picture: Image.Image, walks: Sequence[Retraced], k: int, frame: tuple[int, int, int, int]) -> None:
    """Curves of the explored area, thick as far as the walk has come."""
    ticks = area_ticks(walks)
    if not ticks:
        return
    left, right, top, bottom = frame[0] + 50, frame[2] - 14, 10, frame[3] - frame[1] - 24
    last = max(int(walk.steps[-1]) for walk in walks)
    fine = Image.new("RGB", (_FINE * picture.width, _FINE * (frame[3] - frame[1])), "white")
    pen = ImageDraw.Draw(fine, "RGBA")
    heights = [bottom - tick / ticks[-1] * (bottom - top) for tick in ticks]
    for level in heights:
        pen.line([_FINE * left, _FINE * level, _FINE * right, _FINE * level], RULE, _FINE)
    for number, walk in enumerate(walks):
        if walk.area is None:
            continue
        x, y = left + walk.steps / max(last, 1) * (right - left), bottom - walk.area / ticks[-1] * (bottom - top)
        line, color = _FINE * np.stack([x, y], axis=1), COLORS[number % len(COLORS)]
        if len(line) > 1:
            pen.line(line.reshape(-1).tolist(), (*ImageColor.getrgb(color), 80), 2 * _FINE, joint="curve")
        if k:
            pen.line(line[: k + 1].reshape(-1).tolist(), color, 3 * _FINE, joint="curve")
        pen.circle((line[k][0], line[k][1]), 5 * _FINE, fill=color, outline="white", width=_FINE)
    picture.paste(fine.reduce(_FINE), (0, frame[1]))
    text = ImageDraw.Draw(picture)
    for tick, level in zip(ticks, heights, strict=True):
        text.text((left - 8, frame[1] + level), f"{tick:g} m²", SOFT, _font(11), anchor="rm")
    text.text((left, frame[1] + bottom + 8), "step 0", SOFT, _font(11))
    text.text((right, frame[1] + bottom + 8), f"{last}", SOFT, _font(11), anchor="ra")


@cache
def _font(size: int) -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(findfont("DejaVu Sans"), size)  # it comes with matplotlib
