"""One step of one or several trajectories as an image: camera views, map and explored area. For videos and widgets."""

from collections.abc import Sequence
from functools import cache

import numpy as np
from matplotlib.font_manager import findfont
from matplotlib.ticker import MaxNLocator
from PIL import Image, ImageColor, ImageDraw, ImageFont

from autonerf_lab.classes import colorize
from autonerf_lab.exploration.replay import PALETTE, Replay, union_box
from autonerf_lab.mapping.semantic_map import MAP_CELL
from autonerf_lab.viz.figures.maps import GROUND
from autonerf_lab.viz.figures.style import BLUE, GREEN, ORANGE

COLORS = (BLUE, ORANGE, GREEN, "#CC79A7")  # one per trajectory, repeated from the fifth on
INK, SOFT, RULE = "#1C1E21", "#62676E", "#D9DADB"  # text, grey text, grid lines
BODY = 0.2  # drawn radius of the robot, metres
REACH = 0.8  # drawn radius of its field of view, metres
_VIEW, _GAP, _TITLE, _CHART = 230, 10, 34, 120  # pixels
_COLUMNS = 4  # trajectories in a row
_SUPERSAMPLE = 2  # lines are drawn at this scale and then reduced: anti-aliasing


def step_image(replays: Sequence[Replay], k: int) -> np.ndarray:
    """Draw all trajectories at the k-th of the shown steps.

    A single trajectory has its views to the left of its map. Several trajectories stand side by side, four in a row,
    each with its views above its map. All maps have the same scale.

    Args:
        replays: trajectories replayed at the same number of steps.
        k: index into ``Replay.steps``.

    Returns:
        (H, W, 3) uint8; the size does not depend on k.
    """
    box = union_box(replays)
    side = 2 * _VIEW + _GAP
    alone = len(replays) == 1
    width = min(max(round(side * (box[1] - box[0])[0] / (box[1] - box[0])[1]), 300), 900) if alone else side
    height = side if alone else round(side * (box[1] - box[0])[1] / (box[1] - box[0])[0])
    column = _VIEW + _GAP + width if alone else side
    panel = (column + 2 * _GAP, _GAP + _TITLE + (side if alone else _VIEW + _GAP + height) + _GAP)
    columns = min(len(replays), _COLUMNS)
    chart = panel[1] * -(-len(replays) // columns)  # its top
    image = Image.new("RGB", (columns * panel[0], chart + _CHART + _GAP), "white")
    pen = ImageDraw.Draw(image)
    for number, replay in enumerate(replays):
        row, place = divmod(number, columns)
        left, top = place * panel[0] + _GAP, row * panel[1] + _GAP
        pen.text((left, top), replay.name[:40], INK, _font(17))
        pen.text((left + column, top + 3), _status(replay, k), SOFT, _font(13), anchor="ra")
        top += _TITLE
        for index, view in enumerate(view_images(replay, k)):
            at = (left, top + index * (_VIEW + _GAP)) if alone else (left + index * (_VIEW + _GAP), top)
            image.paste(_fit(view, index > 0), at)
        at = (left + _VIEW + _GAP, top) if alone else (left, top + _VIEW + _GAP)
        image.paste(_map_image(replay, k, box, (width, height), COLORS[number % len(COLORS)]), at)
    _draw_area_chart(image, replays, k, (_GAP, chart, image.width - _GAP, chart + _CHART))
    return np.asarray(image)


def view_images(replay: Replay, k: int) -> list[np.ndarray]:
    """Return the camera image and, if the trajectory has semantics, the class image; (H, W, 3) uint8 each."""
    t, trajectory = replay.steps[k], replay.trajectory
    return [trajectory.rgb[t]] + ([] if trajectory.semantics is None else [colorize(trajectory.semantics[t])])


def _status(replay: Replay, k: int) -> str:
    area = "" if replay.area is None else f" · {replay.area[k]:.1f} m² explored"
    return f"step {replay.steps[k]}{area} · {replay.length[replay.steps[k]]:.1f} m travelled"


def _fit(view: np.ndarray, classes: bool) -> Image.Image:
    """Scale a view and centre it in a square; class images are not interpolated."""
    scale = _VIEW / max(view.shape[:2])
    size = (max(1, round(view.shape[1] * scale)), max(1, round(view.shape[0] * scale)))
    filter = Image.Resampling.NEAREST if classes else Image.Resampling.BICUBIC
    square = Image.new("RGB", (_VIEW, _VIEW), GROUND)
    square.paste(Image.fromarray(view).resize(size, filter), ((_VIEW - size[0]) // 2, (_VIEW - size[1]) // 2))
    return square


def _map_image(replay: Replay, k: int, box: np.ndarray, size: tuple[int, int], color: str) -> Image.Image:
    """Draw the map with the path so far, the waypoint and the robot."""
    scale = _SUPERSAMPLE * min(size / (box[1] - box[0]))
    middle = (box[0] + box[1]) / 2
    canvas = Image.new("RGB", (_SUPERSAMPLE * size[0], _SUPERSAMPLE * size[1]), GROUND)

    def pixels(points: np.ndarray) -> np.ndarray:
        return (np.atleast_2d(points) - middle) * (scale, -scale) + np.array(canvas.size) / 2

    if replay.maps is not None:
        cells = Image.fromarray(PALETTE[replay.maps[k]][::-1])
        extent = MAP_CELL * np.array(cells.size)
        low, high = (pixels(replay.corner + extent * share).round()[0] for share in ((0, 1), (1, 0)))
        large = cells.resize((int(high[0] - low[0]), int(high[1] - low[1])), Image.Resampling.NEAREST)
        canvas.paste(large, (int(low[0]), int(low[1])), large)
    pen = ImageDraw.Draw(canvas, "RGBA")
    x, y, heading = replay.planar[replay.steps[k]]
    here = pixels(np.array([x, y]))[0]
    waypoint = replay.waypoints[k]
    if waypoint is not None:
        there = pixels(np.array(waypoint))[0]
        pen.line([*here, *there], fill=(*ImageColor.getrgb(INK), 110), width=_SUPERSAMPLE)
        for radius, fill in ((7, "white"), (5, INK), (3, "white")):
            pen.circle((there[0], there[1]), radius * _SUPERSAMPLE, fill=fill)
    path = pixels(replay.planar[: replay.steps[k] + 1, :2])
    for thickness, fill in ((5, "white"), (3, color)):
        if len(path) > 1:
            pen.line(path.reshape(-1).tolist(), fill=fill, width=thickness * _SUPERSAMPLE, joint="curve")
    reach, body = REACH * scale, BODY * scale
    half, middle_deg = half_fov_deg(replay), -np.degrees(heading)
    pen.pieslice(
        [*(here - reach), *(here + reach)], middle_deg - half, middle_deg + half, (*ImageColor.getrgb(color), 70)
    )
    pen.circle((here[0], here[1]), body, fill=color, outline="white", width=2 * _SUPERSAMPLE)
    arrow = np.array([[0.8, 0], [-0.6, 0.5], [-0.3, 0], [-0.6, -0.5]]) * body
    rotation = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    pen.polygon((here + arrow @ rotation.T * (1, -1)).reshape(-1).tolist(), fill="white")
    return canvas.reduce(_SUPERSAMPLE)


def half_fov_deg(replay: Replay) -> float:
    """Return half of the horizontal field of view, degrees."""
    k = replay.trajectory.intrinsics
    return float(np.degrees(np.arctan(k.width / 2 / k.fl_x)))


def area_ticks(replays: Sequence[Replay]) -> list[float]:
    """Return axis ticks in square metres, from 0 to above the largest explored area; empty if no replay has a map."""
    areas = [float(replay.area.max()) for replay in replays if replay.area is not None]
    return [float(tick) for tick in MaxNLocator(4).tick_values(0, max(areas))] if areas else []


def _draw_area_chart(image: Image.Image, replays: Sequence[Replay], k: int, frame: tuple[int, int, int, int]) -> None:
    """Draw the explored area over the steps; the part up to the current step is thick."""
    ticks = area_ticks(replays)
    if not ticks:
        return
    left, right, top, bottom = frame[0] + 50, frame[2] - 14, 10, frame[3] - frame[1] - 24
    last = max(int(replay.steps[-1]) for replay in replays)
    canvas = Image.new("RGB", (_SUPERSAMPLE * image.width, _SUPERSAMPLE * (frame[3] - frame[1])), "white")
    pen = ImageDraw.Draw(canvas, "RGBA")
    heights = [bottom - tick / ticks[-1] * (bottom - top) for tick in ticks]
    for height in heights:
        pen.line([_SUPERSAMPLE * v for v in (left, height, right, height)], RULE, _SUPERSAMPLE)
    for number, replay in enumerate(replays):
        if replay.area is None:
            continue
        x = left + replay.steps / max(last, 1) * (right - left)
        y = bottom - replay.area / ticks[-1] * (bottom - top)
        line, color = _SUPERSAMPLE * np.stack([x, y], axis=1), COLORS[number % len(COLORS)]
        if len(line) > 1:
            faint = (*ImageColor.getrgb(color), 80)
            pen.line(line.reshape(-1).tolist(), faint, 2 * _SUPERSAMPLE, joint="curve")
        if k:
            pen.line(line[: k + 1].reshape(-1).tolist(), color, 3 * _SUPERSAMPLE, joint="curve")
        pen.circle((line[k][0], line[k][1]), 5 * _SUPERSAMPLE, fill=color, outline="white", width=_SUPERSAMPLE)
    image.paste(canvas.reduce(_SUPERSAMPLE), (0, frame[1]))
    text = ImageDraw.Draw(image)
    for tick, height in zip(ticks, heights, strict=True):
        text.text((left - 8, frame[1] + height), f"{tick:g} m²", SOFT, _font(11), anchor="rm")
    text.text((left, frame[1] + bottom + 8), "step 0", SOFT, _font(11))
    text.text(((left + right) / 2, frame[1] + bottom + 8), "explored area", SOFT, _font(11), anchor="ma")
    text.text((right, frame[1] + bottom + 8), f"{last}", SOFT, _font(11), anchor="ra")


@cache
def _font(size: int) -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(findfont("DejaVu Sans"), size)  # shipped with matplotlib
