"""Watch a walk, or several of one scene beside each other: in a notebook, as a page, as a film."""

import io
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import DataError
from autonerf_lab.exploration.replay import PALETTE, Retraced, retrace
from autonerf_lab.mapping.semantic_map import MAP_CELL
from autonerf_lab.utils import storage
from autonerf_lab.utils.extras import OWN_SIZE, optional
from autonerf_lab.viz.player.page import page, player
from autonerf_lab.viz.player.step_image import COLORS, GROUND, draw, union_box
from autonerf_lab.viz.video import save_film

MAX_FRAMES = 300  # of all walks together, where nobody says how many steps to leave out
FPS = 12


class Player:
    """Walks of one scene, ready to be watched. A notebook shows it as an animation; make one with :func:`play`.

    Args:
        walks: retraced at the same number of steps.
    """

    def __init__(self, walks: Sequence[Retraced]) -> None:
        self.walks = list(walks)

    def __len__(self) -> int:
        """How many steps are shown."""
        return len(self.walks[0].steps)

    def picture(self, k: int) -> np.ndarray:
        """(H, W, 3) uint8, everything at the k-th of the steps that are shown; k may count from the end."""
        return draw(self.walks, range(len(self))[k])

    def figure(self) -> Figure:
        """How the maps grew: a row a policy, at the beginning, after a quarter, after half, and at the end."""
        low, high = union_box(self.walks)
        columns = [round(share * (len(self) - 1)) for share in (0, 0.25, 0.5, 1)]
        width, aspect = 3.4, float(np.divide(*(high - low)[::-1]))
        size = (width * len(columns) + 0.3, (width * aspect + 0.35) * len(self.walks))
        figure = Figure(figsize=size, layout="constrained")
        axes = figure.subplots(len(self.walks), len(columns), squeeze=False)
        for number, (row, walk) in enumerate(zip(axes, self.walks, strict=True)):
            for ax, k in zip(row, columns, strict=True):
                _floor_plan(ax, walk, k, COLORS[number % len(COLORS)])
                ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
            row[0].set_ylabel(walk.name, fontsize=10, parse_math=False)
        return figure

    def save(self, file: str | Path, progress: bool = True) -> Path:
        """Write a page that needs nothing else (``.html``), or a film (``.mp4``, ``.gif``).

        Args:
            file: its ending says which.
            progress: show a bar while a film is made.

        Returns:
            The file.

        Raises:
            DataError: another ending, or a file that cannot be written.
            MissingPackageError: a film without the extra ``viewer``.
        """
        file = Path(file)
        kind = file.suffix.lower()
        if kind == ".html":
            storage.write_bytes(file, page(self.walks, self._html).encode())
            return file
        if kind not in (".gif", ".mp4"):
            raise DataError(f"{file}: a walk is written as .html, .gif or .mp4")
        return save_film(map(self.picture, range(len(self))), len(self), file, FPS, progress)

    def widget(self) -> Any:
        """The same with the controls of ipywidgets; unlike the animation it needs a running kernel.

        Raises:
            MissingPackageError: the extra ``notebooks`` is not installed.
        """
        widgets = optional("ipywidgets", "notebooks")
        last = len(self) - 1
        clock = widgets.Play(min=0, max=last, interval=1000 // FPS, description="play")
        slider = widgets.IntSlider(min=0, max=last, description="frame", layout={"width": "60%"})
        widgets.jslink((clock, "value"), (slider, "value"))
        shown = widgets.Image(value=_jpeg(self.picture(0)), format="jpeg", layout=OWN_SIZE)
        slider.observe(lambda change: setattr(shown, "value", _jpeg(self.picture(change["new"]))), "value")
        return widgets.VBox([shown, widgets.HBox([clock, slider])])

    @cached_property
    def _html(self) -> str:
        return player(self.walks)

    def _repr_html_(self) -> str:
        return self._html

    def __repr__(self) -> str:
        return f"Player({', '.join(walk.name for walk in self.walks)}: {len(self)} pictures)"


def play(*trajectories: Trajectory, every: int | None = None) -> Player:
    """Watch walks: what the robot sees, the map that it builds, where it heads, and how much it knows.

    The maps are built again from depth, classes and poses. A walk without depth shows its images and its way.

    Args:
        trajectories: one, or several of one scene, which share the steps, the scale and the orientation of the maps.
            The shorter ones wait at their end.
        every: show every so many-th step, and the last; without it, so many that a page stays small.

    Raises:
        WrongTypeError: not a trajectory.
        DataError: no trajectory, trajectories of different scenes, or one that cannot be replayed.

    Example:
        >>> from autonerf_lab.geometry import Intrinsics, planar_pose
        >>> rgb, poses = np.zeros((3, 4, 4, 3), np.uint8), np.stack([planar_pose(k, 0, 0) for k in range(3)])
        >>> play(Trajectory(poses, rgb, None, None, Intrinsics.from_fov(4, 4), {"policy": "random"}), every=2)
        Player(random: 2 pictures)
    """
    if not trajectories:
        raise DataError("there is no walk to play; name one or more")
    if every is not None and every < 1:
        raise ValueError(f"every must be at least 1, not {every}")
    longest = max(len(walk) for walk in trajectories)
    stride = every or -(-longest // max(1, MAX_FRAMES // len(trajectories)))
    steps = np.unique(np.append(np.arange(0, longest, stride), longest - 1))
    scenes = {str(walk.meta.get("scene_sha256") or walk.meta.get("scene")) for walk in trajectories}
    if len(scenes) > 1:
        names = ", ".join(str(walk.meta.get("scene")) for walk in trajectories)
        raise DataError(f"walks of different scenes cannot be compared ({names}); play each alone")
    return Player([retrace(walk, steps) for walk in trajectories])


def _floor_plan(ax: Any, walk: Retraced, k: int, color: str) -> None:
    ax.set(facecolor=GROUND, aspect="equal", xticks=[], yticks=[])
    if walk.maps is not None:
        shape = MAP_CELL * np.array(walk.maps[k].shape[::-1])
        left, bottom, right, top = *walk.corner, *(walk.corner + shape)
        extent = (left, right, bottom, top)
        ax.imshow(PALETTE[walk.maps[k]], origin="lower", extent=extent, interpolation="nearest")
    x, y, heading = walk.planar[: walk.steps[k] + 1].T
    ax.plot(x, y, color=color, linewidth=1.2)
    ax.plot(x[0], y[0], "o", color="white", markeredgecolor=color, markersize=6)
    ax.plot(x[-1], y[-1], "o", color=color, markersize=7)
    ax.annotate(
        "",
        (x[-1] + 0.7 * np.cos(heading[-1]), y[-1] + 0.7 * np.sin(heading[-1])),
        (x[-1], y[-1]),
        arrowprops={"arrowstyle": "->", "color": color, "linewidth": 1.6},
    )
    area = "" if walk.area is None else f": {walk.area[k]:.0f} m²"
    ax.set_title(f"step {walk.steps[k]}{area}", fontsize=9)


def _jpeg(picture: np.ndarray) -> bytes:
    data = io.BytesIO()
    Image.fromarray(picture).save(data, "JPEG", quality=90)
    return data.getvalue()
