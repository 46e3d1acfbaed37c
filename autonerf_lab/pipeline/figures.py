"""The pictures that a run keeps for its report, with the words that go with them."""

from collections.abc import Callable, Collection
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from autonerf_lab.pipeline.gallery import Gallery
from autonerf_lab.viz import figures

if TYPE_CHECKING:
    from autonerf_lab.data.trajectory import Trajectory
    from autonerf_lab.evaluators.radiance_field import Field
    from autonerf_lab.scenes.scene import Scene


def draw_walk(folder: Path, scene: "Scene", trajectory: "Trajectory", only: Collection[str] | None = None) -> None:
    """Pictures of the stage ``explore``.

    Args:
        folder: of the pictures.
        scene: drawn from above, under the walk.
        trajectory: the walk; its ``meta`` holds the curves.
        only: names of those to draw; all without.
    """
    gallery = Gallery(folder, "explore", only)
    steps, meta = len(trajectory), trajectory.meta
    area, way, bumps = meta["explored_m2"][-1], meta["path_m"][-1], sum(meta["collided"])
    gallery.add(
        "walk",
        "from_above",
        partial(figures.walk_view, scene, trajectory.poses),
        title="The apartment from above",
        caption=f"{steps} steps, from dark to light; the white dot is the start. The ceiling is taken off.",
        alt=f"Floor plan of the apartment with furniture, and the line of a walk of {way:.0f} metres through it",
    )
    gallery.add(
        "walk",
        "frames",
        partial(figures.walk_frames, trajectory),
        title="What the robot saw",
        caption="Evenly spaced in time. The field learns from the colours and the classes; depth is for the robot's "
        "own map only.",
        alt="A row of camera images along the walk, with depth and class images beneath",
    )
    gallery.add(
        "walk",
        "curves",
        partial(figures.explored_area, trajectory),
        title="How much it had seen",
        caption=f"{area:.0f} m² explored on a way of {way:.0f} m, with {bumps} collisions.",
        alt=f"Two curves over {steps} steps: the explored area rises to {area:.0f} square metres",
    )
    gallery.close()


def draw_scores(
    folder: Path, field: "Field", scene: "Scene", artifacts: dict[str, Any], only: Collection[str] | None = None
) -> None:
    """Pictures of the stage ``evaluate``. One that cannot be drawn says why in its place: the scores are what counts.

    Args:
        folder: of the pictures.
        field: that was scored.
        scene: the truth.
        artifacts: the raw material of the scores, by task.
        only: names of those to draw; all without.
    """
    gallery = Gallery(folder, "evaluate", only)
    gallery.add(
        "rendering",
        "comparison",
        _drawn(figures.render_comparison, artifacts["rendering"]),
        title="Truth and rendering",
        caption="One row a test pose, from the best to the worst. FLIP is an error as the eye sees it.",
        alt="A grid of images: true and rendered colours and classes from four poses, with maps of the FLIP error",
    )
    gallery.add(
        "rendering",
        "confusion",
        _drawn(figures.confusion, artifacts["rendering"]),
        title="Which class became which",
        caption="Of the pixels that truly are of the class of a row, how many were rendered as each class.",
        alt="Confusion matrix of the rendered classes",
    )
    gallery.add(
        "geometry",
        "depth",
        _drawn(figures.depth_errors, artifacts["rendering"]),
        title="How far away the field believes things to be",
        caption="One row a test pose, from the smallest to the largest median error. Red is too near, blue too far, "
        "white is right; the colours end at 50 cm.",
        alt="A grid of images from four poses: colour, true depth, rendered depth, and their signed difference in "
        "centimetres",
    )
    gallery.add(
        "geometry",
        "sections",
        _drawn(figures.density_sections, field, scene),
        title="The density, cut open",
        caption="Bright is where the field is opaque, blue lines are where the surfaces truly are. The white mark on "
        "the colour bar is the density from which the maps call a place occupied. Striped space was seen from "
        "nowhere: what the field says there means nothing.",
        alt="Two sections through the density of the field, a floor plan at one metre and an elevation, with the "
        "outline of the true surfaces; space that was never seen is striped",
    )
    gallery.add(
        "maps",
        "overlay",
        _drawn(figures.map_overlay, artifacts["maps"]),
        title="Predicted and true maps",
        caption="Left, every cell that counts: found, missed, imagined, or never seen. Right, where the objects are.",
        alt="Three floor plans: agreement of the predicted occupancy with the truth, true classes, predicted classes",
    )
    gallery.add(
        "planning",
        "paths",
        _drawn(figures.planned_paths, artifacts["planning"]),
        title="Planned paths on the true map",
        caption="Green paths succeed. The colour of a failure is its reason.",
        alt="Two floor plans with planned paths: to points on the left, to objects on the right",
    )
    gallery.add(
        "pose_refinement",
        "animation",
        _drawn(figures.refinement_frames, field, artifacts["pose_refinement"]),
        title="One camera, step by step",
        caption="The picture of the field slides over the target as its pose is corrected. Dotted lines are the "
        "limits of convergence, 3° and 2 cm.",
        alt="Animation: the view of the field moves towards the target image, beside curves of the two pose errors",
    )
    gallery.add(
        "pose_refinement",
        "traces",
        _drawn(figures.refinement_trace, artifacts["pose_refinement"]),
        title="All cameras",
        caption="Each line is a camera. On the right, three of them before and after.",
        alt="Error curves of all refined cameras, and difference images before and after for three of them",
    )
    gallery.add(
        "mesh",
        "views",
        _drawn(figures.mesh_view, artifacts["mesh"]),
        title="The mesh, cut open",
        caption="In the colours of the field, by class, and by its distance to the true surface.",
        alt="Slanted views into the reconstructed apartment: coloured, by class, and by distance to the truth",
    )
    if "navigation" in artifacts:
        gallery.add(
            "navigation",
            "walks",
            _drawn(figures.walked_paths, artifacts["navigation"]),
            title="The same episodes in both places",
            caption="A robot makes its map as it walks. The colour of a failure is its reason; it does not fit where "
            "the ground is grey.",
            alt="Two floor plans with walked paths: in the reconstructed mesh, and in the true scene",
        )
    if "finetuning" in artifacts:
        gallery.add(
            "finetuning",
            "practice",
            _drawn(figures.practice, artifacts["finetuning"]),
            title="Practice, and what it was good for",
            caption="Left, how often the policy arrived while it practised, each in its own place. Right, all of them "
            "in the true scene.",
            alt="Curves of success over frames of practice, and bars of success and SPL in the true scene",
        )
    gallery.close()


def _drawn(draw: Callable[..., Any], *args: Any) -> Callable[[], Any]:
    """Draws, or says why not."""

    def image() -> Any:
        try:
            return draw(*args)
        except Exception as error:
            return figures.nothing(f"this picture could not be drawn: {type(error).__name__}: {error}")

    return image
