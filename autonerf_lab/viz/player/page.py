"""The page of a player: pictures a step, as small as they are, and lines that the browser draws over them.

Nothing outside the page is asked for: it plays without kernel, server or network.
"""

import io
from collections.abc import Sequence
from importlib.resources import files
from typing import Any

import numpy as np
from PIL import Image

from autonerf_lab.classes import CLASS_COLORS, CLASS_NAMES
from autonerf_lab.data.images import data_url
from autonerf_lab.exploration.replay import EXPLORED, FRONTIER, OCCUPIED, PALETTE, Retraced
from autonerf_lab.mapping.semantic_map import MAP_CELL
from autonerf_lab.viz.player.step_image import BODY, COLORS, REACH, area_ticks, half_view, union_box

_MAX_SIDE = 256  # pixels of a view: the page stays below 8 MB
_CHART = (1000, 96)  # units of the drawing


def page(walks: Sequence[Retraced], inside: str) -> str:
    """A whole document around :func:`player`."""
    return _template("page.html.jinja").render(title=title(walks), player=inside)


def player(walks: Sequence[Retraced]) -> str:
    """The HTML of walks that show the same number of steps."""
    box = union_box(walks)
    shown = [_walk(walk, box, number) for number, walk in enumerate(walks)]
    ticks = area_ticks(walks)
    last = max(int(walk.steps[-1]) for walk in walks)
    data = {
        "steps": np.max([walk.steps for walk in walks], axis=0).tolist(),
        "walks": [{**one["data"], "curve": _curve(walk, ticks, last)} for one, walk in zip(shown, walks, strict=True)],
    }
    return _template("player.html.jinja").render(
        title=title(walks),
        scene=walks[0].trajectory.meta.get("scene"),
        walks=shown,
        data=data,
        last=last,
        end=len(walks[0].steps) - 1,
        box={"x": box[0, 0], "y": -box[1, 1], "w": (box[1] - box[0])[0], "h": (box[1] - box[0])[1]},
        body=BODY,
        chart={"w": _CHART[0], "h": _CHART[1]},
        ticks=[(f"{tick:g}", _CHART[1] * (1 - tick / ticks[-1])) for tick in ticks],
        legend=_legend(walks),
    )


def title(walks: Sequence[Retraced]) -> str:
    """Which walks these are, as plain text."""
    scene = walks[0].trajectory.meta.get("scene")
    return " and ".join(walk.name for walk in walks) + ("" if scene is None else f" in {scene}")


def _template(name: str) -> Any:
    import jinja2

    source = (files("autonerf_lab.viz.player") / name).read_text(encoding="utf-8")
    return jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True).from_string(source)


def _walk(walk: Retraced, box: np.ndarray, number: int) -> dict[str, Any]:
    """What the template wants of a walk; ``data`` is for the script."""
    kept, steps = walk.trajectory, walk.steps.tolist()
    views = [{"name": "camera", "frames": [_rgb(kept.rgb[t]) for t in steps]}]
    if kept.semantics is not None:
        views.append({"name": "classes", "frames": [_indexed(kept.semantics[t], CLASS_COLORS) for t in steps]})
    place = None
    if walk.maps is not None:
        views.append({"name": "map", "frames": [_indexed(cells[::-1], PALETTE) for cells in walk.maps]})
        low = walk.corner
        high = low + MAP_CELL * np.array(walk.maps[0].shape[::-1])
        extent = (box[1] - box[0]) / 100  # percent
        place = [*((low[0], box[1, 1]) - np.array([box[0, 0], high[1]])) / extent, *(high - low) / extent]
    reach = REACH * np.exp(1j * np.radians(half_view(walk)))
    facts = [_facts(walk, k) for k in range(len(steps))]
    data = {
        "views": [view["frames"] for view in views],
        "facts": facts,
        "way": [f"{x:.2f},{-y:.2f}" for x, y in walk.planar[: steps[-1] + 1, :2]],
        "at": [[t, *_pose(walk.planar[t])] for t in steps],
        "waypoints": [point and [round(point[0], 2), round(-point[1], 2)] for point in walk.waypoints],
    }
    return {
        "name": walk.name,
        "facts": facts[-1],
        "views": [(view["name"], view["frames"][-1]) for view in views if view["name"] != "map"],
        "map": None if place is None else views[-1]["frames"][-1],
        "place": place,
        "aspect": kept.rgb.shape[2] / kept.rgb.shape[1],
        "wedge": f"M0 0 L{reach.real:.3f} {-reach.imag:.3f} A{REACH} {REACH} 0 0 1 {reach.real:.3f} {reach.imag:.3f} Z",
        "color": number % len(COLORS),
        "data": data,
    }


def _facts(walk: Retraced, k: int) -> str:
    area = "" if walk.area is None else f"{walk.area[k]:.1f} m² explored, "
    return f"{area}{walk.length[walk.steps[k]]:.1f} m walked"


def _pose(planar: np.ndarray) -> list[float]:
    """x, y, heading with y down and degrees clockwise, as a drawing has it."""
    x, y, heading = planar
    return [round(float(x), 2), round(float(-y), 2), round(float(-np.degrees(heading)), 1)]


def _curve(walk: Retraced, ticks: list[float], last: int) -> list[str]:
    if walk.area is None:
        return []
    x = walk.steps / max(last, 1) * _CHART[0]
    return [f"{a:.1f},{b:.1f}" for a, b in zip(x, _CHART[1] * (1 - walk.area / ticks[-1]), strict=True)]


def _legend(walks: Sequence[Retraced]) -> list[tuple[str, str]]:
    """Names and colours of what the maps and the class images hold at the steps that are shown."""
    entries = []
    maps = [walk.maps[-1] for walk in walks if walk.maps is not None]
    if maps:
        entries = [("explored", EXPLORED), ("edge of the known", FRONTIER), ("obstacle", OCCUPIED)]
        found = np.unique(np.concatenate([cells.reshape(-1) for cells in maps]))
        entries += [(CLASS_NAMES[k - OCCUPIED], int(k)) for k in found if k > OCCUPIED]
    return [(name, "#{:02x}{:02x}{:02x}".format(*PALETTE[index, :3])) for name, index in entries]


def _rgb(view: np.ndarray) -> str:
    image, data = Image.fromarray(view), io.BytesIO()
    image.thumbnail((_MAX_SIDE, _MAX_SIDE))
    image.save(data, "WEBP", quality=80, method=2)
    return data_url(data.getvalue(), "webp")


def _indexed(picture: np.ndarray, palette: np.ndarray) -> str:
    """A picture of few colours, pixel by pixel."""
    image, data = Image.fromarray(picture).convert("P"), io.BytesIO()
    image.putpalette(palette[:, :3].tobytes())
    if palette is CLASS_COLORS:
        image.thumbnail((_MAX_SIDE, _MAX_SIDE), Image.Resampling.NEAREST)
    transparency = {"transparency": 0} if palette.shape[1] == 4 else {}
    image.save(data, "PNG", **transparency)
    return data_url(data.getvalue(), "png")
