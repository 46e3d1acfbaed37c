"""``evaluate``: every task of the protocol for one field in one scene. A task that fails gives rows that say so.

A field of photographs, of which no truth is known, is scored on those that it was not trained on.
"""

import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from tqdm import tqdm

from autonerf_lab.config import Preset
from autonerf_lab.config import preset as get_preset
from autonerf_lab.data.dataset import Dataset
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import DataError, UnknownNameError
from autonerf_lab.evaluators.lpips import Lpips
from autonerf_lab.evaluators.nearest_view import NearestView
from autonerf_lab.evaluators.oracle import TrueField
from autonerf_lab.evaluators.radiance_field import Field
from autonerf_lab.evaluators.rendering import evaluate_rendering, photographed_views
from autonerf_lab.evaluators.scores import Scores
from autonerf_lab.evaluators.tasks import METRICS, Run, rows_of, run_task
from autonerf_lab.evaluators.tsdf import fused_scores
from autonerf_lab.nerf.frame import FieldFrame

if TYPE_CHECKING:
    from autonerf_lab.scenes.scene import Scene


def _check_scene(what: str, poses: np.ndarray, meta: Mapping[str, Any], frame: FieldFrame, scene: "Scene") -> None:
    name, known = meta.get("scene"), meta.get("scene_sha256")
    if name and name != scene.name:
        raise DataError(f"{what} shows scene {name!r}, not {scene.name!r}; evaluate in the scene it was made in")
    if known and known != scene.sha256:
        raise DataError(f"{what} shows another scene of the name {scene.name!r}: the apartment has changed since")
    if frame.unit != 1 or np.any(frame.origin):
        raise DataError(f"{what} is not in metres, as that of photographs: only held-out photographs can judge it")
    low, high = scene.bounds
    outside = np.mean(np.any((poses[:, :3, 3] < low) | (poses[:, :3, 3] > high), axis=1))
    if outside > 0.5:  # odometry may drift through a wall, but not all the way
        raise DataError(f"{100 * outside:.0f} % of the cameras of {what} lie outside the bounds of {scene.name!r}")


def evaluate(
    nerf: Field,
    scene: "Scene | Dataset",
    preset: str | Preset | None = None,
    seed: int = 0,
    tasks: Iterable[str] | None = None,
    progress: bool = True,
    trajectory: Trajectory | Dataset | None = None,
    lpips_weights: "str | Path | Lpips | None" = None,
    keep: str | Path | None = None,
    oracle: bool = False,
) -> Scores:
    """Score a field in its scene, or on photographs that were held out.

    Args:
        nerf: a trained NeRF, or anything that answers the methods of :class:`~autonerf_lab.evaluators.Field`.
        scene: the truth; the one the field was trained in. Or the held-out half of :meth:`Dataset.split`: the task is
            ``held_out`` then, the only one, with PSNR, SSIM, LPIPS and FLIP, and where there are labels, accuracy and
            IoU of the classes, means over the photographs; ``preset`` and ``seed`` do not matter.
        preset: sizes of the tasks.
        seed: of test poses, planning episodes, random pixels and mesh samples.
        tasks: names out of ``METRICS``, all without; and those of ``OPTIONAL``, which are asked for by name:
            ``navigation`` takes minutes, ``finetuning`` hours.
        progress: show a bar.
        trajectory: what the field was trained on. When given, ``scores.baselines["nearest_view"]`` says what showing
            its nearest image instead of a rendering would score, and ``["tsdf"]`` what its depth, fused, scores as a
            mesh (with the extra ``open3d``).
        lpips_weights: the file of :mod:`autonerf_lab.evaluators.lpips`, or an ``Lpips`` that has read (and checked)
            it; ``scores.weights`` keeps its SHA-256. Without, LPIPS has no value (of photographs: no row).
        keep: folder of what takes hours, the trainings of ``finetuning``: interrupted, they go on there.
        oracle: put the true geometry through the same tasks too: ``scores.baselines["oracle"]``. Those of
            ``OPTIONAL`` have values of the true scene of their own.

    Returns:
        One row a metric, in the order of the protocol. A value that cannot be computed is None and its ``status`` says
        why; a task that fails does so alone. ``scores.artifacts`` holds the raw material of the pictures by task, and
        the values of each photograph: ``scores.artifacts["held_out"]["psnr"]``, in the order of its ``"names"``.

    Raises:
        UnknownNameError: a task or preset that does not exist.
        DataError: the field or the trajectory shows another scene, is not in metres, or lies outside of the scene;
            tasks that need the truth, where there are only photographs; the file of ``lpips_weights`` is missing or
            not as it should be; the disk is full.
        MemoryError: there is too little.

    Example::

        train, held_out = lab.load_dataset("photographs").split()
        print(lab.evaluate(lab.fit(train), held_out, trajectory=train).table())
    """
    lpips = _read(lpips_weights)
    if isinstance(scene, Dataset):
        if tasks is not None:
            raise DataError("photographs hold no truth for tasks: leave tasks out, or give the scene")
        return _held_out(nerf, scene, progress, trajectory, lpips)
    size, names = get_preset(preset), [*METRICS] if tasks is None else list(tasks)
    nearest: Any = None if trajectory is None else NearestView(trajectory)
    if nearest is not None:  # before anything is computed
        _check_scene("this trajectory", nearest.cameras, nearest.meta, nearest.frame, scene)
    scores = _score(Run, nerf, scene, size, seed, names, progress, lpips, keep)
    if nearest is not None and "rendering" in names:  # it renders, and this task asks nothing else
        scores.baselines["nearest_view"] = _score(Run, nearest, scene, size, seed, ["rendering"], False, lpips)
    if isinstance(trajectory, Trajectory) and trajectory.depth is not None and "mesh" in names:
        scores.baselines["tsdf"] = fused_scores(nerf, scene, size, seed, trajectory)
    if oracle:
        names = [name for name in names if name in METRICS]
        scores.baselines["oracle"] = _of_truth(scene, size, seed, names, progress, lpips)
    return scores


def oracle_scores(
    scene: "Scene",
    preset: str | Preset | None = None,
    seed: int = 0,
    tasks: Iterable[str] | None = None,
    lpips_weights: "str | Path | Lpips | None" = None,
) -> Scores:
    """What the true geometry scores in the same tasks: no field can be expected to do better.

    Arguments and errors are those of :func:`evaluate`, whose ``oracle=True`` sets these scores beside its own.

    Example:
        >>> from autonerf_lab.scenes import load_scene
        >>> oracle_scores(load_scene("val-0"), "smoke", tasks=["rendering"])["rendering", "miou"]
        100.0
    """
    lpips = _read(lpips_weights)
    return _of_truth(scene, get_preset(preset), seed, tasks, False, lpips)


def _of_truth(
    scene: "Scene", size: Preset, seed: int, tasks: Iterable[str] | None, progress: bool, lpips: Lpips | None
) -> Scores:
    from autonerf_lab.simulator import Simulator

    return _score(Run, TrueField(scene, Simulator.of_preset(scene, size)), scene, size, seed, tasks, progress, lpips)


def upstream_scores(
    nerf: Field,
    scene: "Scene",
    preset: str | Preset | None = None,
    seed: int = 0,
    tasks: Iterable[str] | None = None,
    progress: bool = True,
) -> Scores:
    """The same field in the same tasks, by the definitions of the paper's released code.

    They differ in all but rendering: see :mod:`autonerf_lab.evaluators.upstream`. Arguments and errors are those of
    :func:`evaluate`.

    Example::

        print(lab.evaluate(nerf, scene).table(upstream=upstream_scores(nerf, scene)))
    """
    from autonerf_lab.evaluators.upstream import UpstreamRun

    return _score(UpstreamRun, nerf, scene, get_preset(preset), seed, tasks, progress)


def _score(
    kind: type[Run],
    nerf: Field,
    scene: "Scene",
    size: Preset,
    seed: int,
    tasks: Iterable[str] | None,
    progress: bool,
    lpips: Lpips | None = None,
    keep: str | Path | None = None,
) -> Scores:
    names = [name for name in METRICS if name in kind.metrics] if tasks is None else list(tasks)
    for name in names:
        if name not in kind.metrics:
            raise UnknownNameError("task", name, kind.metrics)
    _check_scene("this field", nerf.cameras, nerf.meta, nerf.frame, scene)
    steps = {"rendering": size.test_poses, "pose_refinement": size.refine_iterations}
    scores = Scores()
    scores.weights = _weights(lpips)
    with tqdm(total=sum(steps.get(name, 1) for name in names), disable=not progress, leave=False) as bar:
        run = kind(nerf, scene, size, seed, bar.update, lpips, keep)
        for name in names:
            bar.set_description(name.replace("_", " "))
            rows, result = run_task(run, name)
            scores.extend(rows)
            scores.artifacts[name], scores.details[name] = result.artifact, result.details
            if name not in steps:
                bar.update()
    return scores


def _read(weights: "str | Path | Lpips | None") -> Lpips | None:
    return Lpips(weights) if isinstance(weights, str | Path) else weights


def _weights(lpips: Lpips | None) -> dict[str, str]:
    return {"lpips": lpips.sha256} | {f"lpips_{part}": value for part, value in lpips.parts.items()} if lpips else {}


def _held_out(
    nerf: Field, data: Dataset, progress: bool, trained_on: Trajectory | Dataset | None, lpips: Lpips | None
) -> Scores:
    start = time.perf_counter()
    with tqdm(total=len(data), disable=not progress, leave=False, desc="held out") as bar:
        result = evaluate_rendering(nerf, photographed_views(data), bar.update, lpips)
    seconds = time.perf_counter() - start
    classes = () if result.status.get("miou") == "no labels" else ("per_class_accuracy", "miou")
    names = ("psnr", "ssim", *(("lpips",) if lpips else ()), "flip", *classes)
    units = {name: METRICS["rendering"][name] for name in names}
    where = {key: nerf.meta.get(key) or default for key, default in (("scene", ""), ("preset", ""), ("seed", 0))}
    scores = Scores(
        rows_of("held_out", units, result, nerf.meta, {"seconds": seconds, **where}),
        {"held_out": {**result.artifact, "names": data.names}},
    )
    scores.weights = _weights(lpips)
    if trained_on is not None:
        nearest: Any = NearestView(trained_on)
        scores.baselines["nearest_view"] = _held_out(nearest, data, False, None, lpips)
    return scores
