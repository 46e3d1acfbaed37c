"""Run the stages of a run folder, and load its results."""

import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from autonerf_lab.errors import DataError, UnknownNameError
from autonerf_lab.pipeline.context import StageContext, StageOptions, find_scene, scene_source
from autonerf_lab.pipeline.run_folder import STAGES, RunConfig, load_run, locked, open_run
from autonerf_lab.pipeline.stages import STAGE_FUNCTIONS
from autonerf_lab.presets import preset
from autonerf_lab.segmentation import segmenter_source
from autonerf_lab.utils.resources import peak_gb

if TYPE_CHECKING:
    from autonerf_lab.data.trajectory import Trajectory
    from autonerf_lab.nerf import NeRF

PREREQUISITES = {"fit": "explore", "evaluate": "fit", "mesh": "fit", "report": "evaluate"}
INPUTS = {"fit": ("trajectory",), "evaluate": ("scene", "trajectory", "nerf"), "mesh": ("nerf",), "report": ()}


def check_arguments(
    policy: str | None = None, model: str | None = None, options: StageOptions | None = None, **overrides: Any
) -> None:
    """Check names and values before a run starts.

    Args:
        policy: Name of a policy, path of its weights, or ``module:Class``.
        model: Name of a model.
        options: Options of the stages.
        overrides: Values that replace those of the preset, see :func:`run_pipeline`.

    Raises:
        UnknownNameError: A name does not exist. The message lists the valid names.
        DataError: The weights of a policy are missing or damaged, or a value is out of range.
    """
    options = options or StageOptions()
    _check_semantics(overrides.pop("semantics", None))
    _check_noise(*(overrides.pop(name, None) for name in ("noise", "noise_scale", "depth_noise")))
    _check_poses(overrides.pop("poses", None))
    for key, value in overrides.items():
        low, high = {"hfov_deg": (0, 180), "map_size": (40, 1 << 14)}.get(key, (0, 1 << 20))
        if value is not None and not low < value < high:
            option = {"hfov_deg": "--fov"}.get(key, f"--{key.replace('_', '-')}")
            raise DataError(f"{key} ({option}) must be more than {low} and less than {high}, not {value}")
    if options.voxel is not None and not options.voxel > 0:
        raise DataError(f"voxel must be a length in metres and more than 0, not {options.voxel}")
    if options.mesh_format not in ("glb", "ply", "obj"):
        raise UnknownNameError("mesh format", options.mesh_format, ("glb", "ply", "obj"))
    if options.device is not None:
        from autonerf_lab.nerf.model import check_device

        check_device(options.device)
    if options.optional_tasks:
        from autonerf_lab.evaluators.tasks import optional_tasks

        for name in options.optional_tasks:
            if name not in optional_tasks():
                raise UnknownNameError("optional task", name, optional_tasks())
    if policy is not None:
        from autonerf_lab.policies import make_policy

        make_policy(policy)
    if model is not None:
        from autonerf_lab.nerf import model_spec

        model_spec(model)


def _check_semantics(semantics: str | None) -> None:
    if semantics is not None:
        from autonerf_lab.segmentation import make_segmenter

        make_segmenter(semantics)


def _check_noise(noise: str | None, scale: float | None, depth: str | None) -> None:
    if noise is None and scale is not None:
        raise DataError("noise_scale (--noise-scale) needs a noise model: choose one with --noise, such as ans")
    if noise is not None or depth is not None:
        from autonerf_lab.simulator.depth_noise import depth_noise
        from autonerf_lab.simulator.motion_noise import motion_noise

        motion_noise(noise, scale)
        depth_noise(depth)


def _check_poses(poses: str | None) -> None:
    if poses is not None:
        from autonerf_lab.data.pose_sources import check_source
        from autonerf_lab.exploration.rollout import POSES

        check_source(poses, (*POSES, "refined"))


def run_pipeline(
    out: str | Path,
    scene: str,
    policy: str,
    preset_name: str | None = None,
    seed: int = 0,
    model: str | None = None,
    last: str = "report",
    overwrite: bool = False,
    options: StageOptions | None = None,
    **overrides: Any,
) -> None:
    """Run all stages up to ``last`` in the folder ``out``, or continue an interrupted run there.

    Args:
        out: Run folder.
        scene: Name in the scene library, or path of a specification or scan.
        policy: Name of a policy, path of its weights, or ``module:Class``.
        preset_name: Name of a preset; None: see :func:`autonerf_lab.presets.preset`.
        seed: Random seed of the whole run.
        model: Name of a model; may be None if ``last`` is before ``fit``.
        last: Name of the last stage.
        overwrite: Replace a finished or different run.
        options: Options of the stages.
        overrides: ``steps``, ``map_size``, ``width``, ``height``, ``hfov_deg``, ``noise``, ``noise_scale``,
            ``depth_noise``, ``poses`` and ``semantics`` of :class:`RunConfig`.

    Raises:
        AutoNerfError: A name is unknown, the folder holds something else, or a stage failed.
    """
    check_arguments(policy, model, options, **overrides)
    chosen = preset(preset_name).name
    started = time.perf_counter()
    loaded = find_scene(scene)
    loading_seconds = time.perf_counter() - started
    overrides["semantics"] = segmenter_source(overrides.get("semantics"))
    config = RunConfig(scene_source(scene), loaded.sha256, policy, chosen, seed, model, **overrides)
    with locked(Path(out)):
        run = open_run(out, config, last, overwrite)
        if model is not None and run.config.model is None:
            run.set_fit(model)
        _run_stages(StageContext(run, loaded, options), STAGES[: STAGES.index(last) + 1], loading_seconds)


def run_stage(
    out: str | Path,
    stage: str,
    model: str | None = None,
    overwrite: bool = False,
    options: StageOptions | None = None,
    poses: str | None = None,
) -> None:
    """Run one stage in an existing run folder.

    Args:
        out: Run folder.
        stage: Name of the stage.
        model: Name of the model, for the stage ``fit``.
        overwrite: Replace finished results of the stage.
        options: Options of the stage.
        poses: Pose source of the stage ``fit``: one that the trajectory has. None: that of the exploration.

    Raises:
        AutoNerfError: A previous stage is not finished, the stage is finished already, or it failed.
    """
    check_arguments(model=model, options=options)
    with locked(load_run(out).path):
        run = load_run(out)
        run.require(PREREQUISITES[stage])
        context = StageContext(run, options=options)
        if stage == "report":
            # can always be written again; the old file stays until the new one is complete
            run.stages.pop(stage, None)
        elif run.finished(stage) and overwrite:
            if stage == "fit":
                run.config = replace(run.config, fit_poses=None)
            for name in INPUTS[stage]:  # check the inputs before the old results are removed
                getattr(context, name)
        if poses is not None:
            context.recorded.with_poses(poses)
        run.clear_stage(stage, overwrite)
        if stage == "fit":
            run.set_fit(model, poses)
        _run_stages(context, [stage])


def load_finished_field(out: str | Path) -> "NeRF":
    """Load the radiance field of a run, or of a folder of :mod:`autonerf_lab.pipeline.photographs`.

    Raises:
        RunFolderError: The folder holds no run, or its stage ``fit`` is not finished.
        DataError: A file is missing or damaged.
    """
    if not (Path(out) / "run.json").exists() and (Path(out) / "nerf/nerf.json").exists():
        from autonerf_lab.nerf import load_nerf

        return load_nerf(Path(out) / "nerf")
    run = load_run(out)
    run.require("fit")
    return StageContext(run).nerf


def load_finished_trajectory(folder: str | Path) -> "Trajectory":
    """Load the trajectory of a run, or a trajectory folder.

    Raises:
        RunFolderError: The stage ``explore`` of the run is not finished.
        DataError: A file is missing or damaged.
    """
    if (Path(folder) / "run.json").exists():
        run = load_run(folder)
        run.require("explore")
        return StageContext(run).trajectory
    from autonerf_lab.data.trajectory import load_trajectory

    return load_trajectory(folder)


def score_table(out: str | Path) -> str:
    """Return the scores of a run as a text table, next to those of the paper and of the baselines."""
    from autonerf_lab.evaluators import Scores

    run = load_run(out)
    files = sorted((run / "baselines").glob("*.json"))
    return Scores.load(run / "scores.json").table(**{file.stem: Scores.load(file) for file in files})


def _run_stages(context: StageContext, stages: Iterable[str], loading_seconds: float = 0.0) -> None:
    """Run the unfinished stages in order and record their times; ``loading_seconds`` count for the stage ``scene``."""
    for stage in stages:
        if context.run.finished(stage):
            print(f"{stage:<9} already finished", flush=True)
            continue
        print(f"{stage:<9} ...", flush=True)
        started = time.perf_counter()
        STAGE_FUNCTIONS[stage](context)
        seconds = time.perf_counter() - started + (loading_seconds if stage == "scene" else 0.0)
        context.run.mark_finished(stage, seconds, peak_gb())
        print(f"{stage:<9} {seconds:6.1f} s", flush=True)
