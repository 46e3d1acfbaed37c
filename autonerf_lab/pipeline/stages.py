"""The main job as stages over a run folder: scene, explore, fit, evaluate, mesh, report.

A stage takes what it needs from the folder and leaves what it makes there, even within one process: a run that was
interrupted and resumed is the same as one that was not, and each stage is also a command of its own.
"""

import time
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from autonerf_lab.config import Preset, preset
from autonerf_lab.errors import DataError, RunFolderError, UnknownNameError
from autonerf_lab.pipeline.run_folder import STAGES, RunConfig, RunFolder, load_run, locked, open_run
from autonerf_lab.utils import storage
from autonerf_lab.utils.resources import peak_gb

if TYPE_CHECKING:
    from autonerf_lab.data.trajectory import Trajectory
    from autonerf_lab.evaluators.lpips import Lpips
    from autonerf_lab.nerf import NeRF
    from autonerf_lab.scenes import Scene

BEFORE = {"fit": "explore", "evaluate": "fit", "mesh": "fit", "report": "evaluate"}
INPUTS = {"fit": ("trajectory",), "evaluate": ("scene", "trajectory", "nerf"), "mesh": ("nerf",), "report": ()}
SCANS = (".glb", ".obj", ".ply")


@dataclass(frozen=True)
class Options:
    """What may be asked of the stages, and changes nothing else in a run."""

    lpips: "Lpips | None" = None
    upstream: bool = False  # beside the scores, those by the definitions of the released code
    baselines: bool = True  # put other things than the field through the tasks too
    optional: Sequence[str] = ()  # tasks that are only done when they are asked for
    interest: bool = False  # pixels of pose refinement from interest regions
    voxel: float | None = None  # metres; that of the preset without
    suffix: str = "glb"  # of the meshes: glb or ply
    pictures: Collection[str] | None = None  # names of those to draw; all without


class Workspace:
    """A run folder and what its stages share; everything is read from the folder when somebody first asks."""

    def __init__(self, run: RunFolder, scene: "Scene | None" = None, options: Options | None = None) -> None:
        self.run, self.options = run, options or Options()
        if scene is not None:
            self.scene = scene

    @property
    def preset(self) -> Preset:
        """The sizes of the run."""
        size = preset(self.run.config.preset)
        return replace(size, refine_interest=self.options.interest or size.refine_interest)

    @cached_property
    def scene(self) -> "Scene":
        """The apartment.

        Raises:
            DataError: it is not the one the run was made in.
        """
        scene = find_scene(self.run.config.scene)
        if scene.sha256 != self.run.config.scene_sha256:
            raise DataError(
                f"{self.run.path}: scene {self.run.config.scene!r} is not the apartment it was when the run began; "
                "begin another run"
            )
        return scene

    @cached_property
    def trajectory(self) -> "Trajectory":
        """The walk.

        Raises:
            DataError: a file is missing or damaged, or it was walked in another scene.
        """
        from autonerf_lab.data.trajectory import load_trajectory

        folder = self.run / "trajectory"
        trajectory = load_trajectory(folder)
        found = trajectory.meta.get("scene_sha256")
        if found != self.run.config.scene_sha256:
            raise DataError(
                f"{folder} was walked in another scene ({str(trajectory.meta.get('scene'))[:80]!r}), this run is about "
                f"{self.run.config.scene!r}; put the right folder back, or `autonerf-lab explore --overwrite` again"
            )
        return trajectory

    @cached_property
    def nerf(self) -> "NeRF":
        """The trained field.

        Raises:
            DataError: a file is missing or damaged.
        """
        from autonerf_lab.nerf import load_nerf

        return load_nerf(self.run / "nerf")


def find_scene(name: str) -> "Scene":
    """A scene by its name in the library, or by the path of a specification (JSON) or of a scan.

    Raises:
        UnknownNameError: lists the names of the library.
        SceneError: the file is not a scene.
    """
    from autonerf_lab.scenes import import_scene, load_scene

    return import_scene(name) if Path(name).suffix.lower() in SCANS else load_scene(name)


def check_names(policy: str | None = None, model: str | None = None, options: Options | None = None) -> None:
    """Fail before anything is made, not after ten minutes.

    Raises:
        UnknownNameError: lists the valid names.
        DataError: the weights of a policy of one's own are missing or damaged; a voxel is not larger than nothing.
    """
    options = options or Options()
    if options.voxel is not None and not options.voxel > 0:
        raise DataError(f"a voxel is a length in metres, not {options.voxel}")
    if options.suffix not in ("glb", "ply"):
        raise UnknownNameError("format of meshes", options.suffix, ("glb", "ply"))
    if options.optional:
        from autonerf_lab.evaluators.tasks import OPTIONAL

        for name in options.optional:
            if name not in OPTIONAL:
                raise UnknownNameError("optional task", name, OPTIONAL)
    if policy is not None:
        from autonerf_lab.policies import make_policy

        make_policy(policy)
    if model is not None:
        from autonerf_lab.nerf import model_spec

        model_spec(model)


def begin(
    out: str | Path,
    scene: str,
    policy: str,
    preset_name: str | None = None,
    seed: int = 0,
    model: str | None = None,
    last: str = "report",
    overwrite: bool = False,
    options: Options | None = None,
) -> None:
    """Run the stages up to ``last`` in the folder ``out``; go on there if the same run was interrupted.

    Raises:
        AutoNerfError: a name is unknown, the folder holds something else, or a stage failed.
    """
    check_names(policy, model, options)
    chosen = preset(preset_name).name
    started = time.perf_counter()
    apartment = find_scene(scene)
    spent = time.perf_counter() - started
    where = str(Path(scene).resolve()) if Path(scene).suffix else scene  # the run may be resumed from another folder
    config = RunConfig(where, apartment.sha256, policy, chosen, seed, model)
    with locked(Path(out)):
        run = open_run(out, config, last, overwrite)
        if model is not None and run.config.model is None:
            run.choose_model(model)
        run_stages(Workspace(run, apartment, options), STAGES[: STAGES.index(last) + 1], spent)


def resume(
    out: str | Path,
    stage: str,
    model: str | None = None,
    overwrite: bool = False,
    options: Options | None = None,
) -> None:
    """Run one stage in a folder that has come as far.

    Raises:
        AutoNerfError: the stage before it is missing, it is finished already, or it failed.
    """
    check_names(model=model, options=options)
    with locked(Path(load_run(out).path)):
        run = load_run(out)
        run.require(BEFORE[stage])
        work = Workspace(run, options=options)
        if stage == "report":
            # holds nothing of its own: made again without a question, and the old one stays until the new one is there
            run.stages.pop(stage, None)
        elif run.finished(stage) and overwrite:
            for name in INPUTS[stage]:  # read before anything is removed: what cannot be made again must not go
                getattr(work, name)
        run.begin_again(stage, overwrite)
        if model is not None:
            run.choose_model(model)
        run_stages(work, [stage])


def run_stages(work: Workspace, stages: Iterable[str], spent: float = 0.0) -> None:
    """Run those of ``stages`` that are not finished, in order, and write down what each took.

    Args:
        work: the run.
        stages: names from ``STAGES``.
        spent: seconds that the scene has already taken.
    """
    for stage in stages:
        if work.run.finished(stage):
            print(f"{stage:<9} finished before", flush=True)
            continue
        print(f"{stage:<9} ...", flush=True)
        started = time.perf_counter()
        STAGE_FUNCTIONS[stage](work)
        seconds = time.perf_counter() - started + (spent if stage == "scene" else 0.0)
        work.run.mark(stage, seconds, peak_gb())
        print(f"{stage:<9} {seconds:6.1f} s", flush=True)


def finished_field(out: str | Path) -> "NeRF":
    """The field of a run that has one, or of photographs: see :mod:`autonerf_lab.pipeline.photographs`.

    Raises:
        RunFolderError: the folder holds no run, or none that was fitted.
        DataError: a file is missing or damaged.
    """
    if not (Path(out) / "run.json").exists() and (Path(out) / "nerf/nerf.json").exists():
        from autonerf_lab.nerf import load_nerf

        return load_nerf(Path(out) / "nerf")
    run = load_run(out)
    run.require("fit")
    return Workspace(run).nerf


def finished_walk(folder: str | Path) -> "Trajectory":
    """The walk of a run that has one, or of a trajectory folder.

    Raises:
        RunFolderError: a run without a walk.
        DataError: a file is missing or damaged.
    """
    if (Path(folder) / "run.json").exists():
        run = load_run(folder)
        run.require("explore")
        return Workspace(run).trajectory
    from autonerf_lab.data.trajectory import load_trajectory

    return load_trajectory(folder)


def summary(out: str | Path) -> str:
    """The scores of a run as a table, beside the paper's and the baselines."""
    from autonerf_lab.evaluators import Scores

    run = load_run(out)
    files = sorted((run / "baselines").glob("*.json"))
    return Scores.load(run / "scores.json").table(**{file.stem: Scores.load(file) for file in files})


def _scene(work: Workspace) -> None:
    from autonerf_lab.scenes.spec import dumps

    scene = work.scene
    _ = scene.texture  # baked here, so that the walk's seconds are the walk's
    if scene.spec is None:
        storage.write_json(work.run / "scene.json", {"imported": work.run.config.scene, "triangles": len(scene.faces)})
    else:
        storage.write_bytes(work.run / "scene.json", dumps(scene.spec).encode())


def _explore(work: Workspace) -> None:
    from autonerf_lab.exploration import explore
    from autonerf_lab.pipeline.figures import draw_walk
    from autonerf_lab.simulator import Simulator

    config, size = work.run.config, work.preset
    sim = Simulator.of_preset(work.scene, size)
    explore(sim, config.policy, steps=size.walk_steps, seed=config.seed).save(work.run / "trajectory")
    draw_walk(work.run / "figures", work.scene, work.trajectory, work.options.pictures)


def _fit(work: Workspace) -> None:
    from autonerf_lab.nerf import fit

    config = work.run.config
    if config.model is None:
        raise RunFolderError(f"{work.run.path} names no model; `autonerf-lab fit` chooses one")
    folder = work.run / "nerf"
    # the checkpoint lets a training that was interrupted go on in the middle; it goes when the field is saved
    fit(work.trajectory, config.model, work.preset, seed=config.seed, checkpoint=folder).save(folder)


def _evaluate(work: Workspace) -> None:
    from autonerf_lab.evaluators import METRICS, evaluate, upstream_scores
    from autonerf_lab.pipeline.figures import draw_scores

    seed, scene, asked = work.run.config.seed, work.scene, work.options
    scores = evaluate(
        work.nerf,
        scene,
        work.preset,
        seed,
        [*METRICS, *asked.optional],
        trajectory=work.trajectory if asked.baselines else None,
        lpips_weights=asked.lpips,
        keep=work.run / "finetuning",
        oracle=asked.baselines,
    )
    scores.save(work.run / "scores.json")  # before anything that is less precious
    for name, rows in scores.baselines.items():
        rows.save(work.run / f"baselines/{name}.json")
    if asked.upstream:
        print("the same field by the definitions of the released code", flush=True)
        upstream_scores(work.nerf, scene, work.preset, seed).save(work.run / "baselines/upstream.json")
    draw_scores(work.run / "figures", work.nerf, scene, scores.artifacts, asked.pictures)
    if asked.lpips is not None:
        print(f"LPIPS with the weights of SHA-256 {asked.lpips.sha256}", flush=True)


def _mesh(work: Workspace) -> None:
    from autonerf_lab.evaluators import export_mesh, extract_mesh, semantic_mesh

    voxel, suffix = work.options.voxel or work.preset.mesh_voxel, work.options.suffix
    mesh = extract_mesh(work.nerf, voxel)
    if len(mesh.faces):
        export_mesh(mesh, work.run / f"mesh/color.{suffix}")
        export_mesh(semantic_mesh(mesh), work.run / f"mesh/semantic.{suffix}")
    else:  # a result too, of a field that learned nothing
        print("the field has no surface that a training view saw: no mesh is written", flush=True)
    counts = {"vertices": len(mesh.vertices), "triangles": len(mesh.faces), "voxel_m": voxel}
    storage.write_json(work.run / "mesh/mesh.json", counts)


def _report(work: Workspace) -> None:
    from autonerf_lab.pipeline.report import write_report

    write_report(work.run)


STAGE_FUNCTIONS: dict[str, Callable[[Workspace], None]] = {
    "scene": _scene,
    "explore": _explore,
    "fit": _fit,
    "evaluate": _evaluate,
    "mesh": _mesh,
    "report": _report,
}
