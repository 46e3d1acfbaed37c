"""Play trajectories of one scene, alone or side by side: in a notebook, as a page, as a video."""

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
from autonerf_lab.exploration.replay import Replay, replay_map
from autonerf_lab.utils import storage
from autonerf_lab.utils.extras import NATURAL_SIZE, optional
from autonerf_lab.viz.figures.rollouts import replay_figure
from autonerf_lab.viz.player.page import page_html, player_html
from autonerf_lab.viz.player.step_image import step_image
from autonerf_lab.viz.video import write_video

MAX_FRAMES = 300  # of all trajectories together, unless ``every`` is given
FPS = 12  # frames per second


class Player:
    """Player of trajectories of one scene; create it with :func:`play`. A notebook shows it as an animation.

    Args:
        replays: trajectories replayed at the same number of steps.
    """

    def __init__(self, replays: Sequence[Replay]) -> None:
        self.replays = list(replays)

    def __len__(self) -> int:
        """Return the number of shown steps."""
        return len(self.replays[0].steps)

    def image(self, k: int) -> np.ndarray:
        """Return the k-th of the shown steps as an (H, W, 3) uint8 image; negative k counts from the end."""
        return step_image(self.replays, range(len(self))[k])

    def figure(self) -> Figure:
        """Return a figure of the growing maps: one row per trajectory; start, quarter, half and end as columns."""
        return replay_figure(self.replays, [round(share * (len(self) - 1)) for share in (0, 0.25, 0.5, 1)])

    def save(self, file: str | Path, progress: bool = True) -> Path:
        """Write a self-contained page (``.html``) or a video (``.mp4``, ``.gif``).

        Args:
            file: output file; its extension selects the format.
            progress: show a progress bar while a video is written.

        Returns:
            The file.

        Raises:
            DataError: another extension, or a file that cannot be written.
            MissingPackageError: a video without the extra ``viewer``.
        """
        file = Path(file)
        kind = file.suffix.lower()
        if kind == ".html":
            storage.write_bytes(file, page_html(self.replays, self._html).encode())
            return file
        if kind not in (".gif", ".mp4"):
            raise DataError(f"{file}: unknown extension; a player is saved as .html, .gif or .mp4")
        return write_video(map(self.image, range(len(self))), len(self), file, FPS, progress)

    def widget(self) -> Any:
        """Return an ipywidgets player; unlike the animation it needs a running kernel.

        Raises:
            MissingPackageError: the extra ``notebooks`` is not installed.
        """
        widgets = optional("ipywidgets", "notebooks")
        last = len(self) - 1
        timer = widgets.Play(min=0, max=last, interval=1000 // FPS, description="play")
        slider = widgets.IntSlider(min=0, max=last, description="frame", layout={"width": "60%"})
        widgets.jslink((timer, "value"), (slider, "value"))
        image = widgets.Image(value=_jpeg(self.image(0)), format="jpeg", layout=NATURAL_SIZE)
        slider.observe(lambda change: setattr(image, "value", _jpeg(self.image(change["new"]))), "value")
        return widgets.VBox([image, widgets.HBox([timer, slider])])

    @cached_property
    def _html(self) -> str:
        return player_html(self.replays)

    def _repr_html_(self) -> str:
        return self._html

    def __repr__(self) -> str:
        return f"Player({', '.join(replay.name for replay in self.replays)}: {len(self)} steps)"


def play(*trajectories: Trajectory, every: int | None = None) -> Player:
    """Play trajectories: camera views, the growing map, path and waypoint, and the explored area.

    The maps are rebuilt from depth, semantics and poses. A trajectory without depth shows its images and its path.

    Args:
        trajectories: one, or several of the same scene. All share steps and map scale; a shorter trajectory stays at
            its last step.
        every: show every n-th step and the last one. By default, n is chosen so that the page stays small.

    Returns:
        A player. Display it in a notebook, or call ``save``, ``figure`` or ``widget``.

    Raises:
        WrongTypeError: not a trajectory.
        DataError: no trajectory, trajectories of different scenes, or one that cannot be replayed.
        ValueError: ``every`` is below 1.

    Example:
        >>> from autonerf_lab.geometry import Intrinsics, planar_pose
        >>> rgb, poses = np.zeros((3, 4, 4, 3), np.uint8), np.stack([planar_pose(k, 0, 0) for k in range(3)])
        >>> play(Trajectory(poses, rgb, None, None, Intrinsics.from_fov(4, 4), {"policy": "random"}), every=2)
        Player(random: 2 steps)
    """
    if not trajectories:
        raise DataError("no trajectory to play; pass one or more")
    if every is not None and every < 1:
        raise ValueError(f"every must be at least 1, not {every}")
    longest = max(len(trajectory) for trajectory in trajectories)
    stride = every or -(-longest // max(1, MAX_FRAMES // len(trajectories)))
    steps = np.unique(np.append(np.arange(0, longest, stride), longest - 1))
    scenes = {str(trajectory.meta.get("scene_sha256") or trajectory.meta.get("scene")) for trajectory in trajectories}
    if len(scenes) > 1:
        names = ", ".join(str(trajectory.meta.get("scene")) for trajectory in trajectories)
        raise DataError(f"cannot play trajectories of different scenes together ({names}); play each alone")
    return Player([replay_map(trajectory, steps) for trajectory in trajectories])


def _jpeg(image: np.ndarray) -> bytes:
    data = io.BytesIO()
    Image.fromarray(image).save(data, "JPEG", quality=90)
    return data.getvalue()
