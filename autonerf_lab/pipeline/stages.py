"""Stages of a run: scene, explore, fit, evaluate, mesh, report.

Each stage reads its inputs from the run folder and writes its outputs there, also if several stages run in one process.
An interrupted run therefore gives the same results as an uninterrupted one, and each stage is also a command.
"""

from collections.abc import Callable

from autonerf_lab.data.trajectory import BYTES_PER_PIXEL, MAX_BYTES
from autonerf_lab.errors import DataError, RunFolderError
from autonerf_lab.pipeline.context import StageContext
from autonerf_lab.utils import storage


def _scene(context: StageContext) -> None:
    from autonerf_lab.scenes.spec import dumps

    scene, run = context.scene, context.run
    _ = scene.texture  # bake it here, so that its time does not count for the stage `explore`
    if scene.spec is None:
        storage.write_json(run / "scene.json", {"imported": run.config.scene, "triangles": len(scene.faces)})
    else:
        storage.write_bytes(run / "scene.json", dumps(scene.spec).encode())


def _explore(context: StageContext) -> None:
    from autonerf_lab.bundle_adjustment import refine_poses
    from autonerf_lab.exploration import explore
    from autonerf_lab.exploration.rollout import MAP_SIZE
    from autonerf_lab.pipeline.figures import draw_trajectory
    from autonerf_lab.segmentation import TRUE
    from autonerf_lab.simulator import Simulator
    from autonerf_lab.simulator.motion_noise import motion_noise

    config, size = context.run.config, context.preset
    noise = motion_noise(config.noise, config.noise_scale)
    sim = Simulator.from_preset(context.scene, size, noise, config.depth_noise, config.semantics or TRUE)
    need = size.episode_steps * size.width * size.height * BYTES_PER_PIXEL
    if need > MAX_BYTES:  # could be recorded, but not loaded
        raise DataError(f"the images of the episode need {need} bytes, at most {MAX_BYTES}; use fewer or smaller ones")
    refined = config.poses == "refined"  # the policy acts on the estimate, which is refined after the episode
    trajectory = explore(
        sim, config.policy, steps=size.episode_steps, seed=config.seed, map_size=config.map_size or MAP_SIZE,
        poses="estimated" if refined else config.poses or "odometry",
    )  # fmt: skip
    folder = context.run / "trajectory"
    trajectory.save(folder)  # first: refinement can be refused
    if refined:
        try:
            trajectory = refine_poses(trajectory)
        except DataError as error:
            raise DataError(
                f"{error}. The exploration is saved with its estimated poses; `autonerf-lab adopt {folder} --out RUN` "
                "makes a run folder from it"
            ) from error
        trajectory.save_poses(folder)
    draw_trajectory(context.run / "figures", context.scene, context.trajectory, context.options.figures)


def _fit(context: StageContext) -> None:
    from autonerf_lab.nerf import fit

    config = context.run.config
    if config.model is None:
        raise RunFolderError(f"{context.run.path}: no model is set; choose one with `autonerf-lab fit --model`")
    folder = context.run / "nerf"
    # an interrupted training continues from its checkpoint, which is removed when the field is saved
    fit(
        context.trajectory, config.model, context.preset, seed=config.seed, device=context.options.device,
        checkpoint=folder,
    ).save(folder)  # fmt: skip


def _evaluate(context: StageContext) -> None:
    from autonerf_lab.evaluators import evaluate, upstream_scores
    from autonerf_lab.evaluators.field_alignment import aligned_field
    from autonerf_lab.evaluators.tasks import default_tasks
    from autonerf_lab.pipeline.figures import draw_scores

    run, scene, options = context.run, context.scene, context.options
    scores = evaluate(
        context.nerf,
        scene,
        context.preset,
        run.config.seed,
        list(dict.fromkeys([*default_tasks(context.nerf.meta), *options.optional_tasks])),
        trajectory=context.trajectory if options.baselines else None,
        lpips_weights=options.lpips,
        checkpoint=run / "finetuning",
        oracle=options.baselines,
    )
    scores.save(run / "scores.json")  # first: the most important result
    for name, rows in scores.baselines.items():
        rows.save(run / f"baselines/{name}.json")
    if options.upstream:
        print("evaluating the same field with the definitions of the released code", flush=True)
        upstream_scores(context.nerf, scene, context.preset, run.config.seed).save(run / "baselines/upstream.json")
    draw_scores(run / "figures", aligned_field(context.nerf), scene, scores.artifacts, options.figures)
    if options.lpips is not None:
        print(f"LPIPS weights: SHA-256 {options.lpips.sha256}", flush=True)


def _mesh(context: StageContext) -> None:
    from autonerf_lab.evaluators import export_mesh, extract_mesh, semantic_mesh

    voxel, suffix = context.options.voxel or context.preset.mesh_voxel, context.options.mesh_format
    mesh = extract_mesh(context.nerf, voxel)
    if len(mesh.faces):
        export_mesh(mesh, context.run / f"mesh/color.{suffix}")
        export_mesh(semantic_mesh(mesh), context.run / f"mesh/semantic.{suffix}")
    else:  # a valid result of an untrained field
        print("no mesh was written: the field has no surface that is visible in a training view", flush=True)
    counts = {"vertices": len(mesh.vertices), "triangles": len(mesh.faces), "voxel_m": voxel}
    storage.write_json(context.run / "mesh/mesh.json", counts)


def _report(context: StageContext) -> None:
    from autonerf_lab.pipeline.report import write_report

    write_report(context.run)


STAGE_FUNCTIONS: dict[str, Callable[[StageContext], None]] = {
    "scene": _scene,
    "explore": _explore,
    "fit": _fit,
    "evaluate": _evaluate,
    "mesh": _mesh,
    "report": _report,
}
