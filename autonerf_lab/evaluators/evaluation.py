"""Function ``evaluate``: score a field in the tasks of the protocol.

If a task fails, its rows give the reason and the other tasks continue. A field of photographs, for which no ground
truth exists, is scored on held-out photographs.
"""

import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from tqdm import tqdm

from autonerf_lab.data.dataset import Dataset
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import DataError, UnknownNameError
from autonerf_lab.evaluators.context import EvaluationContext
from autonerf_lab.evaluators.field_alignment import aligned_data, aligned_field
from autonerf_lab.evaluators.fused_labels import FusedLabels
from autonerf_lab.evaluators.metrics import METRICS
from autonerf_lab.evaluators.nearest_view import NearestView
from autonerf_lab.evaluators.oracle import TrueField
from autonerf_lab.evaluators.radiance_field import RadianceField
from autonerf_lab.evaluators.rendering import evaluate_rendering, photographed_views
from autonerf_lab.evaluators.scores import Scores
from autonerf_lab.evaluators.task import Task
from autonerf_lab.evaluators.tasks import DEFAULT_TASKS, TASKS, available, default_tasks, rows_of, run_task
from autonerf_lab.evaluators.tsdf import fused_scores
from autonerf_lab.nerf.field_frame import FieldFrame
from autonerf_lab.presets import Preset
from autonerf_lab.presets import preset as get_preset
from autonerf_lab.utils.arguments import refuse_name

if TYPE_CHECKING:
    from autonerf_lab.evaluators.lpips import Lpips
    from autonerf_lab.scenes.scene import Scene


def _check_scene(what: str, poses: np.ndarray, meta: Mapping[str, Any], frame: FieldFrame, scene: "Scene") -> None:
    name, known = meta.get("scene"), meta.get("scene_sha256")
    if name and name != scene.name:
        raise DataError(f"{what} belongs to scene {name!r}, not {scene.name!r}; evaluate it in its own scene")
    if known and known != scene.sha256:
        raise DataError(f"{what} belongs to another version of scene {scene.name!r}; record it again")
    if frame.unit != 1 or np.any(frame.origin):
        raise DataError(
            f"{what} is not in metres (photographs); evaluate it on held-out photographs instead of a scene"
        )
    low, high = scene.bounds
    outside = np.mean(np.any((poses[:, :3, 3] < low) | (poses[:, :3, 3] > high), axis=1))
    if outside > 0.5:  # drift of the odometry alone stays below this
        raise DataError(f"{100 * outside:.0f} % of the poses of {what} lie outside the bounds of scene {scene.name!r}")


def evaluate(
    nerf: RadianceField,
    scene: "Scene | Dataset",
    preset: str | Preset | None = None,
    seed: int = 0,
    tasks: Iterable[str] | None = None,
    progress: bool = True,
    trajectory: Trajectory | Dataset | None = None,
    lpips_weights: "str | Path | Lpips | None" = None,
    checkpoint: str | Path | None = None,
    oracle: bool = False,
) -> Scores:
    """Score a field in its scene, or on held-out photographs.

    A field that was trained on other poses than the true ones is first aligned with the scene, by the planar rigid
    motion that fits its training poses to the true ones; the task ``trajectory`` states it in ``scores.details``.

    Args:
        nerf: a trained NeRF, or an object with the interface :class:`~autonerf_lab.evaluators.RadianceField`.
        scene: the scene of the field, as ground truth. Or the held-out part of :meth:`Dataset.split`: the only task is
            then ``held_out``, with PSNR, SSIM, LPIPS and FLIP, as means over the photographs, with accuracy and IoU of
            the classes if there are labels, and with the median depth error if there is depth in metres; ``preset`` and
            ``seed`` have no effect.
        preset: settings of the tasks.
        seed: random seed of test poses, planning episodes, random pixels and mesh samples.
        tasks: names in :data:`~autonerf_lab.evaluators.TASKS`, or of installed packages. Default: all built-in tasks
            that are not optional, ``trajectory`` for a field trained on other poses than the true ones, and
            ``segmentation`` for one trained on predicted labels.
            ``navigation`` (minutes) and ``finetuning`` (an hour) run only if they are named.
        progress: show a progress bar.
        trajectory: training data of the field. With it, ``scores.baselines["nearest_view"]`` holds the rendering scores
            of the nearest training image, and ``["tsdf"]`` the mesh scores of the fused depth (extra ``open3d``).
            If its labels were predicted, ``["fused_labels"]`` holds the rendering scores with the labels of the frames
            fused in a point cloud.
        lpips_weights: file of the weights (:mod:`autonerf_lab.evaluators.lpips`), or a loaded ``Lpips``. Its SHA-256 is
            stored in ``scores.weights``. Without, LPIPS has no value (for photographs: no row).
        checkpoint: folder of the training checkpoints of ``finetuning``; interrupted trainings continue there.
        oracle: also score the true geometry in the same tasks: ``scores.baselines["oracle"]``. Optional tasks are left
            out; they have scores in the true scene of their own.

    Returns:
        One row per metric, in the order of the protocol. A value that cannot be computed is None, and ``status`` gives
        the reason. ``scores.artifacts`` holds the data for the figures, by task, and the values of each photograph:
        ``scores.artifacts["held_out"]["psnr"]``, in the order of its ``"names"``.

    Raises:
        UnknownNameError: unknown task or preset.
        DataError: the field or the trajectory belongs to another scene, is not in metres, lies outside the scene, or
            cannot be aligned with it;
            tasks are given for photographs; the file of ``lpips_weights`` is missing or damaged; the disk is full.
        WrongTypeError: the field or the scene is a name.
        MemoryError: out of memory.

    Example::

        train, held_out = lab.load_dataset("photographs").split()
        print(lab.evaluate(lab.fit(train), held_out, trajectory=train).table())
    """
    refuse_name(nerf, "the field", "lab.load_nerf({})")
    refuse_name(scene, "the scene", "lab.load_scene({})")
    lpips = _load_lpips(lpips_weights)
    if isinstance(scene, Dataset):
        if tasks is not None:
            raise DataError("photographs have no ground truth for tasks; leave out the argument tasks, or pass a scene")
        return _score_photographs(nerf, scene, progress, trajectory, lpips)
    nerf, trajectory = aligned_field(nerf), None if trajectory is None else aligned_data(trajectory)
    settings, names = get_preset(preset), list(default_tasks(nerf.meta) if tasks is None else tasks)
    nearest: Any = None if trajectory is None else NearestView(trajectory)
    if nearest is not None:  # before any computation
        _check_scene("this trajectory", nearest.poses, nearest.meta, nearest.frame, scene)
    chosen = _chosen(names, TASKS if set(names) <= set(TASKS) else available())
    context = EvaluationContext(nerf, scene, settings, seed, lpips=lpips, checkpoint=checkpoint)
    scores = _score(context, chosen, progress)
    if nearest is not None and "rendering" in names:  # the baseline has no other method than render
        context = EvaluationContext(nearest, scene, settings, seed, lpips=lpips)
        scores.baselines["nearest_view"] = _score(context, [TASKS["rendering"]], False)
    if isinstance(trajectory, Trajectory) and trajectory.depth is not None:
        if "mesh" in names:
            scores.baselines["tsdf"] = fused_scores(nerf, scene, settings, seed, trajectory)
        if trajectory.confidence is not None and "rendering" in names:
            fused: Any = FusedLabels(nerf, trajectory)
            context = EvaluationContext(fused, scene, settings, seed, lpips=lpips)
            scores.baselines["fused_labels"] = _score(context, [TASKS["rendering"]], False)
    if oracle:
        names = [name for name in names if name in DEFAULT_TASKS]
        scores.baselines["oracle"] = _oracle_scores(scene, settings, seed, names, progress, lpips)
    return scores


def oracle_scores(
    scene: "Scene",
    preset: str | Preset | None = None,
    seed: int = 0,
    tasks: Iterable[str] | None = None,
    lpips_weights: "str | Path | Lpips | None" = None,
) -> Scores:
    """Score the true geometry in the same tasks, as an upper bound for a field.

    Arguments and errors are those of :func:`evaluate`, whose ``oracle=True`` adds these scores to its result.

    Example:
        >>> from autonerf_lab.scenes import load_scene
        >>> oracle_scores(load_scene("val-0"), "smoke", tasks=["rendering"])["rendering", "miou"]
        100.0
    """
    names = DEFAULT_TASKS if tasks is None else tasks
    return _oracle_scores(scene, get_preset(preset), seed, names, False, _load_lpips(lpips_weights))


def _oracle_scores(
    scene: "Scene", preset: Preset, seed: int, names: Iterable[str], progress: bool, lpips: "Lpips | None"
) -> Scores:
    from autonerf_lab.simulator import Simulator

    field = TrueField(scene, Simulator.from_preset(scene, preset))
    return _score(EvaluationContext(field, scene, preset, seed, lpips=lpips), _chosen(names, available()), progress)


def upstream_scores(
    nerf: RadianceField,
    scene: "Scene",
    preset: str | Preset | None = None,
    seed: int = 0,
    tasks: Iterable[str] | None = None,
    progress: bool = True,
) -> Scores:
    """Score a field by the definitions of the code that was released with the paper.

    These definitions differ from those of :func:`evaluate` in all tasks except rendering, see
    :mod:`autonerf_lab.evaluators.upstream`. Arguments and errors are those of :func:`evaluate`.

    Example::

        print(lab.evaluate(nerf, scene).table(upstream=upstream_scores(nerf, scene)))
    """
    from autonerf_lab.evaluators.upstream import UPSTREAM_TASKS, UpstreamContext

    chosen = _chosen(UPSTREAM_TASKS if tasks is None else tasks, UPSTREAM_TASKS)
    return _score(UpstreamContext(aligned_field(nerf), scene, get_preset(preset), seed), chosen, progress)


def _chosen(names: Iterable[str], tasks: Mapping[str, Task]) -> list[Task]:
    names = list(names)
    for name in names:
        if name not in tasks:
            raise UnknownNameError("task", name, tasks)
    return [tasks[name] for name in names]


def _score(context: EvaluationContext, tasks: list[Task], progress: bool) -> Scores:
    field = context.field
    _check_scene("this field", field.poses, field.meta, field.frame, context.scene)
    scores = Scores()
    scores.weights = _weights(context.lpips)
    ticks = [task.ticks(context.preset) for task in tasks]
    with tqdm(total=sum(count or 1 for count in ticks), disable=not progress, leave=False) as bar:
        context.tick = bar.update
        for task, count in zip(tasks, ticks, strict=True):
            bar.set_description(task.name.replace("_", " "))
            rows, result = run_task(context, task)
            scores.extend(rows)
            scores.artifacts[task.name], scores.details[task.name] = result.artifact, result.details
            if not count:
                bar.update()
    return scores


def _load_lpips(weights: "str | Path | Lpips | None") -> "Lpips | None":
    if not isinstance(weights, str | Path):
        return weights
    from autonerf_lab.evaluators.lpips import Lpips  # imports torch

    return Lpips(weights)


def _weights(lpips: "Lpips | None") -> dict[str, str]:
    return {"lpips": lpips.sha256} | {f"lpips_{part}": value for part, value in lpips.parts.items()} if lpips else {}


def _score_photographs(
    nerf: RadianceField, data: Dataset, progress: bool, trained_on: Trajectory | Dataset | None, lpips: "Lpips | None"
) -> Scores:
    start = time.perf_counter()
    with tqdm(total=len(data), disable=not progress, leave=False, desc="held out") as bar:
        result = evaluate_rendering(nerf, photographed_views(data), bar.update, lpips)
    seconds = time.perf_counter() - start
    classes = () if result.status.get("miou") == "no labels" else ("per_class_accuracy", "miou")
    depth = ("depth_median_error_m",) if data.metric and data.depths is not None else ()
    names = ("psnr", "ssim", *(("lpips",) if lpips else ()), "flip", *classes, *depth)
    metrics = [METRICS["rendering", name] for name in names]
    common = {key: nerf.meta.get(key) or default for key, default in (("scene", ""), ("preset", ""), ("seed", 0))}
    scores = Scores(
        rows_of("held_out", metrics, result, nerf.meta, {"seconds": seconds, **common}),
        {"held_out": {**result.artifact, "names": data.names}},
    )
    scores.weights = _weights(lpips)
    if trained_on is not None:
        nearest: Any = NearestView(trained_on)
        scores.baselines["nearest_view"] = _score_photographs(nearest, data, False, None, lpips)
    return scores
