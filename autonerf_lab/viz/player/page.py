"""HTML of the player: one small image per step, and lines that the browser draws over the map.

The page loads nothing from elsewhere: it works without kernel, server and network.
"""

import io
from collections.abc import Sequence
from importlib.resources import files
from typing import Any

import numpy as np
from PIL import Image

from autonerf_lab.classes import CLASS_COLORS, CLASS_NAMES
from autonerf_lab.data.images import data_url
from autonerf_lab.exploration.replay import EXPLORED, FRONTIER, OCCUPIED, PALETTE, Replay, union_box
from autonerf_lab.mapping.semantic_map import MAP_CELL
from autonerf_lab.viz.figures.style import SOURCE_COLORS
from autonerf_lab.viz.player.step_image import BODY, COLORS, REACH, area_ticks, half_fov_deg

_MAX_SIDE = 256  # pixels of a view: the page stays below 8 MB
_CHART = (1000, 96)  # width and height of the chart, SVG units


def page_html(replays: Sequence[Replay], player: str) -> str:
    """Return a complete HTML document around the result of :func:`player_html`."""
    return _template("page.html.jinja").render(title=title(replays), player=player)


def player_html(replays: Sequence[Replay]) -> str:
    """Return the HTML of a player of trajectories replayed at the same number of steps."""
    box = union_box(replays)
    contexts = [_context(replay, box, number) for number, replay in enumerate(replays)]
    ticks = area_ticks(replays)
    last = max(int(replay.steps[-1]) for replay in replays)
    data = {
        "steps": np.max([replay.steps for replay in replays], axis=0).tolist(),
        "trajectories": [
            {**context["data"], "curve": _area_curve(replay, ticks, last)}
            for context, replay in zip(contexts, replays, strict=True)
        ],
    }
    return _template("player.html.jinja").render(
        title=title(replays),
        scene=replays[0].trajectory.meta.get("scene"),
        trajectories=contexts,
        data=data,
        last=last,
        end=len(replays[0].steps) - 1,
        box={"x": box[0, 0], "y": -box[1, 1], "w": (box[1] - box[0])[0], "h": (box[1] - box[0])[1]},
        body=BODY,
        chart={"w": _CHART[0], "h": _CHART[1]},
        ticks=[(f"{tick:g}", _CHART[1] * (1 - tick / ticks[-1])) for tick in ticks],
        legend=_legend(replays),
    )


def title(replays: Sequence[Replay]) -> str:
    """Return the names of the policies and of the scene as plain text."""
    scene = replays[0].trajectory.meta.get("scene")
    return " and ".join(replay.name for replay in replays) + ("" if scene is None else f" in {scene}")


def _template(name: str) -> Any:
    import jinja2

    source = (files("autonerf_lab.viz.player") / name).read_text(encoding="utf-8")
    return jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True).from_string(source)


def _context(replay: Replay, box: np.ndarray, number: int) -> dict[str, Any]:
    """Return the template variables of one trajectory; ``data`` is read by the script of the page."""
    trajectory, steps = replay.trajectory, replay.steps.tolist()
    views = [{"name": "camera", "frames": [_encode_rgb(trajectory.rgb[t]) for t in steps]}]
    if trajectory.semantics is not None:
        frames = [_encode_indexed(trajectory.semantics[t], CLASS_COLORS) for t in steps]
        views.append({"name": "classes", "frames": frames})
    map_box = None
    if replay.maps is not None:
        views.append({"name": "map", "frames": [_encode_indexed(cells[::-1], PALETTE) for cells in replay.maps]})
        low = replay.corner
        high = low + MAP_CELL * np.array(replay.maps[0].shape[::-1])
        extent = (box[1] - box[0]) / 100  # percent
        map_box = [*((low[0], box[1, 1]) - np.array([box[0, 0], high[1]])) / extent, *(high - low) / extent]
    reach = REACH * np.exp(1j * np.radians(half_fov_deg(replay)))
    status = [_status(replay, k) for k in range(len(steps))]
    data = {
        "views": [view["frames"] for view in views],
        "status": status,
        "path": _svg_points(replay.planar[: steps[-1] + 1, :2]),
        "others": [
            {"name": name, "color": SOURCE_COLORS[name], "path": _svg_points(poses[: steps[-1] + 1, :2, 3])}
            for name, poses in trajectory.other_poses.items()
        ],
        "poses": [[t, *_svg_pose(replay.planar[t])] for t in steps],
        "waypoints": [point and [round(point[0], 2), round(-point[1], 2)] for point in replay.waypoints],
    }
    return {
        "name": replay.name,
        "status": status[-1],
        "views": [(view["name"], view["frames"][-1]) for view in views if view["name"] != "map"],
        "map": None if map_box is None else views[-1]["frames"][-1],
        "map_box": map_box,
        "aspect": trajectory.rgb.shape[2] / trajectory.rgb.shape[1],
        "wedge": f"M0 0 L{reach.real:.3f} {-reach.imag:.3f} A{REACH} {REACH} 0 0 1 {reach.real:.3f} {reach.imag:.3f} Z",
        "color": number % len(COLORS),
        "data": data,
    }


def _svg_points(positions: np.ndarray) -> list[str]:
    return [f"{x:.2f},{-y:.2f}" for x, y in positions]


def _status(replay: Replay, k: int) -> str:
    area = "" if replay.area is None else f"{replay.area[k]:.1f} m² explored, "
    return f"{area}{replay.length[replay.steps[k]]:.1f} m travelled"


def _svg_pose(planar: np.ndarray) -> list[float]:
    """Convert x, y, heading to SVG conventions: y down, clockwise degrees."""
    x, y, heading = planar
    return [round(float(x), 2), round(float(-y), 2), round(float(-np.degrees(heading)), 1)]


def _area_curve(replay: Replay, ticks: list[float], last: int) -> list[str]:
    """Return the explored area as SVG points of the chart."""
    if replay.area is None:
        return []
    x = replay.steps / max(last, 1) * _CHART[0]
    return [f"{a:.1f},{b:.1f}" for a, b in zip(x, _CHART[1] * (1 - replay.area / ticks[-1]), strict=True)]


def _legend(replays: Sequence[Replay]) -> list[tuple[str, str]]:
    """Return names and colours of the map states, of the classes in the last maps, and of other pose sources."""
    entries = []
    maps = [replay.maps[-1] for replay in replays if replay.maps is not None]
    if maps:
        entries = [("explored", EXPLORED), ("frontier", FRONTIER), ("obstacle", OCCUPIED)]
        found = np.unique(np.concatenate([cells.reshape(-1) for cells in maps]))
        entries += [(CLASS_NAMES[k - OCCUPIED], int(k)) for k in found if k > OCCUPIED]
    shown = [(name, "#{:02x}{:02x}{:02x}".format(*PALETTE[index, :3])) for name, index in entries]
    others = dict.fromkeys(name for replay in replays for name in replay.trajectory.other_poses)
    return shown + [(f"{name} path", SOURCE_COLORS[name]) for name in others]


def _encode_rgb(view: np.ndarray) -> str:
    """Encode an (H, W, 3) uint8 image as a WebP data URL."""
    image, data = Image.fromarray(view), io.BytesIO()
    image.thumbnail((_MAX_SIDE, _MAX_SIDE))
    image.save(data, "WEBP", quality=80, method=2)
    return data_url(data.getvalue(), "webp")


def _encode_indexed(indices: np.ndarray, palette: np.ndarray) -> str:
    """Encode (H, W) uint8 palette indices without loss as a PNG data URL."""
    image, data = Image.fromarray(indices).convert("P"), io.BytesIO()
    image.putpalette(palette[:, :3].tobytes())
    if palette is CLASS_COLORS:
        image.thumbnail((_MAX_SIDE, _MAX_SIDE), Image.Resampling.NEAREST)
    transparency = {"transparency": 0} if palette.shape[1] == 4 else {}
    image.save(data, "PNG", **transparency)
    return data_url(data.getvalue(), "png")
