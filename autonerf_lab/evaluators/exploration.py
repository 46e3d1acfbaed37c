"""What a walk is worth without any field: task 8 of the protocol, and the rewards of the paper, summed."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from autonerf_lab.config import Preset
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.evaluators.coverage import area_under, coverage, visible_map
from autonerf_lab.exploration import MAP_SIZE
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.mapping import Mapper, empty_map
from autonerf_lab.rewards import REWARDS
from autonerf_lab.scenes.scene import Scene
from autonerf_lab.simulator import Simulator
from autonerf_lab.types import MapState, Observation, Score, Transition
from autonerf_lab.utils import storage

SENSOR = 84  # pixels a side: what coverage is measured with, whatever camera the walk had
METRICS = {"area": "coverage", "obstacles": "obstacle_coverage", "semantics": "semantic_coverage",
           "viewpoints": "viewpoint_coverage"}  # fmt: skip
SUMMED = ("cov", "obs", "sem", "view")  # rewards that count new cells: their sum is what the map gained
CURVE_POINTS = 50
ARRAYS = tuple(field.name for field in fields(MapState) if field.name != "cell")

Curves = dict[str, list[float]]


def walk_scores(walk: Trajectory, scene: Scene, preset: Preset, cache: Path) -> tuple[list[Score], Curves]:
    """Task ``exploration``: shares of what is visible, percent; and task ``reward``: sums over the walk, square metres.

    Args:
        walk: of the scene.
        scene: the truth.
        preset: says how thoroughly the scene is looked at.
        cache: a folder, where what is visible in the scene is kept for the next walk.

    Returns:
        The scores; and the shares after 2, 4, ... 100 % of the walk, by metric.

    Raises:
        DataError: the cache is damaged, or cannot be written.
    """
    sim = Simulator(scene, Intrinsics.from_fov(SENSOR, SENSOR), supersample=1, rgb=False)
    steps = len(walk)
    marks = np.ceil(np.arange(1, CURVE_POINTS + 1) * steps / CURVE_POINTS).astype(int) - 1
    rows, curves = [], {}
    for quantity, curve in coverage(sim, walk, kept_visible_map(sim, preset.visible_poses, cache)).items():
        metric = METRICS[quantity]
        curves[metric] = curve[marks].round(2).tolist()
        rows.append(Score("exploration", metric, float(curve[-1]), "%", n=steps))
        rows.append(Score("exploration", f"{metric}_auc", area_under(curve), "%", n=steps))
    meta = walk.meta
    rows.append(Score("exploration", "explored_area_m2", float(meta["explored_m2"][-1]), "m2", n=steps))
    rows.append(Score("exploration", "collisions", float(sum(meta["collided"])), "", n=steps))
    rows.append(Score("exploration", "path_length_m", float(meta["path_m"][-1]), "m", n=steps))
    rows += [Score("reward", name, value, "m2", n=steps) for name, value in summed_rewards(walk).items()]
    return rows, curves


def summed_rewards(walk: Trajectory) -> dict[str, float]:
    """``cov``, ``obs``, ``sem`` and ``view`` over all steps, from the map that the robot had."""
    assert walk.depth is not None and walk.semantics is not None  # a walk of the simulator has both
    mapper = Mapper(empty_map(walk.poses[0], MAP_SIZE), walk.intrinsics)
    first = None
    for t, pose in enumerate(walk.poses):
        seen = Observation(walk.rgb[t], walk.depth[t], walk.semantics[t], pose, step=t)
        _, known = mapper.add(seen)
        if first is None:
            first = _copy(known)
    assert first is not None
    whole = Transition(first, known, seen, walk.meta["actions"][-1])  # nothing is ever unseen, so the sum telescopes
    return {name: float(REWARDS[name](whole)) for name in SUMMED}


def kept_visible_map(sim: Simulator, poses: int, cache: Path) -> MapState:
    """:func:`visible_map`, from the cache where it is there.

    Raises:
        DataError: the cache is damaged, or cannot be written.
    """
    path = cache / f"{sim.scene.sha256[:16]}-{poses}.safetensors"
    if path.exists():
        arrays, header = storage.read_arrays(path)
        return MapState(**{name: _unpacked(arrays[name], header["size"]) for name in ARRAYS}, cell=header["cell"])
    visible = visible_map(sim, poses)
    header = {"cell": visible.cell, "size": len(visible.explored)}
    storage.write_arrays(path, {name: _packed(getattr(visible, name)) for name in ARRAYS}, header)
    return visible


def _packed(array: np.ndarray) -> np.ndarray:
    return np.packbits(array, axis=-1) if array.dtype == np.bool_ else array


def _unpacked(array: np.ndarray, size: int) -> np.ndarray:
    return np.unpackbits(array, axis=-1, count=size).astype(np.bool_) if array.dtype == np.uint8 else array


def _copy(map: MapState) -> MapState:
    return replace(map, **{name: getattr(map, name).copy() for name in ARRAYS})
