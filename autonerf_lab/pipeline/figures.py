"""Figures of a run for its report, with titles, captions and alternative texts."""

from collections.abc import Callable, Collection
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from autonerf_lab.evaluators.tasks import TASKS, available
from autonerf_lab.pipeline.gallery import Gallery
from autonerf_lab.viz import figures

if TYPE_CHECKING:
    from autonerf_lab.data.trajectory import Trajectory
    from autonerf_lab.evaluators.radiance_field import RadianceField
    from autonerf_lab.scenes.scene import Scene


def draw_trajectory(
    folder: Path, scene: "Scene", trajectory: "Trajectory", only: Collection[str] | None = None
) -> None:
    """Draw the figures of the stage ``explore``.

    Args:
        folder: folder of the figures.
        scene: drawn from above, below the trajectory.
        trajectory: the recorded trajectory; its ``meta`` holds the curves.
        only: names of the figures to draw; default: all.
    """
    gallery = Gallery(folder, "explore", only)
    steps, meta = len(trajectory), trajectory.meta
    area, length, collisions = meta["explored_m2"][-1], meta["path_m"][-1], sum(meta["collided"])
    gallery.add(
        "trajectory",
        "from_above",
        partial(figures.trajectory_view, scene, trajectory.pose_sources.get("true", trajectory.poses)),
        title="Trajectory, seen from above",
        caption=f"{steps} steps; the colour shows the step, and the white dot is the start. The ceiling is not drawn.",
        alt=f"Floor plan of the furnished apartment with the trajectory of the robot, {length:.0f} metres long",
    )
    if trajectory.pose_source != "true" and "true" in trajectory.other_poses:
        gallery.add(
            "trajectory",
            "drift",
            partial(figures.pose_drift, trajectory),
            title="True, measured and estimated path",
            caption=f"The robot used its {trajectory.pose_source} poses. Errors are distances from the true pose, "
            "without alignment. The dotted line is the standard deviation that the pose estimate predicts for itself.",
            alt="Paths of the pose sources from above, beside curves of position and heading error over the steps",
        )
        if trajectory.depth is not None:
            gallery.add(
                "trajectory",
                "pose_maps",
                partial(figures.pose_maps, trajectory),
                title="Map before and after the correction of the poses",
                caption="Points of the depth images between 0.3 and 1.6 m above the floor, placed with the poses of "
                "each source; dotted: true path. With wrong poses, a wall appears several times.",
                alt="Walls and furniture from above as points of all depth images, one panel for each pose source",
            )
    gallery.add(
        "trajectory",
        "frames",
        partial(figures.trajectory_frames, trajectory),
        title="Camera images along the trajectory",
        caption="Evenly spaced in time: colour, depth and object classes. The radiance field is trained on colours and "
        "classes; the robot uses depth for its map.",
        alt="Camera images along the trajectory: a row of colour images, a row of depth images, a row of class images",
    )
    gallery.add(
        "trajectory",
        "curves",
        partial(figures.explored_area, trajectory),
        title="Explored area and path length",
        caption=f"{area:.0f} m² were explored on a path of {length:.0f} m, with {collisions} collisions.",
        alt=f"Two curves over {steps} steps: the explored area rises to {area:.0f} square metres, the path length to "
        f"{length:.0f} metres",
    )
    gallery.close()


def draw_scores(
    folder: Path,
    field: "RadianceField",
    scene: "Scene",
    artifacts: dict[str, Any],
    only: Collection[str] | None = None,
) -> None:
    """Draw the figures of the stage ``evaluate``, task by task. A figure that fails shows the error instead.

    Args:
        folder: folder of the figures.
        field: the field that was scored.
        scene: the ground truth.
        artifacts: data of each task, ``scores.artifacts``.
        only: names of the figures to draw; default: all.
    """
    gallery, tasks = Gallery(folder, "evaluate", only), available()
    for name, artifact in artifacts.items():
        inputs = {"artifact": artifact, "field": field, "scene": scene}
        for figure in tasks[name].figures:
            draw = partial(_drawn, figure.draw, {key: inputs[key] for key in figure.inputs})
            file = figure.name if name in TASKS else f"{name}_{figure.name}"  # plug-ins cannot overwrite figures
            gallery.add(name, file, draw, title=figure.title, caption=figure.caption, alt=figure.alt)
    gallery.close()


def _drawn(draw: str | Callable[..., Any], inputs: dict[str, Any]) -> Any:
    """Call a drawing function, or return a figure with the error: a figure that fails must not stop a run."""
    if not inputs.get("artifact", True):
        return figures.empty_figure()
    try:
        return (getattr(figures, draw) if isinstance(draw, str) else draw)(*inputs.values())
    except Exception as error:
        return figures.empty_figure(f"this figure could not be drawn: {type(error).__name__}: {error}")
