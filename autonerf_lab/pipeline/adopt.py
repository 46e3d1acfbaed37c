"""Run folder from a saved trajectory: ``autonerf-lab adopt TRAJECTORY --scene SCENE --out RUN``."""

import time
from math import atan, degrees
from pathlib import Path
from typing import Any

from autonerf_lab.data.trajectory import Trajectory, load_trajectory
from autonerf_lab.errors import DataError
from autonerf_lab.pipeline.context import StageContext, find_scene, scene_source
from autonerf_lab.pipeline.figures import draw_trajectory
from autonerf_lab.pipeline.run_folder import RunConfig, locked, open_run
from autonerf_lab.pipeline.stages import STAGE_FUNCTIONS
from autonerf_lab.presets import preset
from autonerf_lab.utils.resources import peak_gb


def adopt_trajectory(
    folder: str | Path,
    out: str | Path,
    scene: str | None = None,
    preset_name: str | None = None,
    model: str | None = "semantic-nerfacto",
) -> Path:
    """Make a run folder of a trajectory that was saved with :meth:`Trajectory.save`, so that the later stages can run.

    Args:
        folder: Trajectory folder.
        out: Run folder; new or empty.
        scene: Scene of the trajectory: a name in the library, or a path; default: the one that the trajectory names.
        preset_name: Preset of the later stages.
        model: Model of the stage ``fit``.

    Returns:
        The run folder, whose stages ``scene`` and ``explore`` are finished.

    Raises:
        DataError: The trajectory is damaged, or was recorded in another scene.
        RunFolderError: ``out`` holds a run or other files.
    """
    from autonerf_lab.scenes import scene_names

    trajectory = load_trajectory(folder)
    name = scene or trajectory.meta.get("scene")
    if not isinstance(name, str):
        raise DataError(f"{folder} does not name its scene; give it with --scene")
    if scene is None and name not in scene_names():
        raise DataError(f"{folder} was recorded in {name[:80]!r}, no scene of the library; give its file with --scene")
    loaded = find_scene(name)
    known = trajectory.meta.get("scene_sha256")
    if known != loaded.sha256:
        raise DataError(
            f"{folder} was recorded in another scene ({str(trajectory.meta.get('scene'))[:80]!r}), not {name!r}"
        )
    camera, seed = trajectory.intrinsics, trajectory.meta.get("seed")
    config = RunConfig(
        scene_source(name),
        loaded.sha256,
        str(trajectory.meta.get("policy") or "unknown"),
        preset(preset_name).name,
        seed if isinstance(seed, int) else 0,
        model,
        steps=len(trajectory),
        width=camera.width,
        height=camera.height,
        hfov_deg=round(degrees(2 * atan(camera.width / 2 / camera.fl_x)), 6),
        **_conditions(trajectory),
    )
    out = Path(out)
    with locked(out):
        run = open_run(out, config, "explore")
        context = StageContext(run, loaded)
        started = time.perf_counter()
        STAGE_FUNCTIONS["scene"](context)
        run.mark_finished("scene", time.perf_counter() - started, peak_gb())
        started = time.perf_counter()
        trajectory.save(run / "trajectory")
        draw_trajectory(run / "figures", loaded, trajectory)
        run.mark_finished("explore", time.perf_counter() - started, peak_gb())
    return out


def _conditions(trajectory: Trajectory) -> dict[str, Any]:
    """Return noise, pose source and semantics that ``explore`` has recorded, as settings of a run."""
    meta, noise = trajectory.meta, trajectory.meta.get("noise")
    found = {name: meta[name] for name in ("depth_noise", "semantics") if isinstance(meta.get(name), str)}
    if isinstance(noise, dict) and noise.get("actuation") and noise.get("odometry"):
        scale = noise.get("scale")
        found["noise"] = str(noise.get("model"))
        found["noise_scale"] = scale if isinstance(scale, int | float) and scale != 1 else None
        found["poses"] = trajectory.pose_source
    return found
