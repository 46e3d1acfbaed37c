"""Scores of a trajectory, without a field: coverage (task 8 of the protocol) and summed rewards of the paper."""

from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import DataError
from autonerf_lab.evaluators.coverage import area_under, coverage
from autonerf_lab.evaluators.metrics import METRICS, metrics_of
from autonerf_lab.exploration import MAP_SIZE, visible_map
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.mapping import Mapper, empty_map, enlarged
from autonerf_lab.presets import Preset
from autonerf_lab.rewards import REWARDS
from autonerf_lab.scenes.scene import Scene
from autonerf_lab.simulator import Simulator
from autonerf_lab.types import MapState, Observation, Score, Transition
from autonerf_lab.utils import storage

SENSOR = 84  # side of the depth images that coverage is measured with, pixels
_METRIC_OF = {"area": "coverage", "obstacles": "obstacle_coverage", "semantics": "semantic_coverage",
              "viewpoints": "viewpoint_coverage"}  # fmt: skip
SUMMED = tuple(metric.name for metric in metrics_of("reward"))  # rewards that count new map cells
CURVE_POINTS = 50
ARRAYS = tuple(field.name for field in fields(MapState) if field.name != "cell")

Curves = dict[str, list[float]]


def trajectory_scores(trajectory: Trajectory, scene: Scene, preset: Preset, cache: Path) -> tuple[list[Score], Curves]:
    """Score a trajectory: coverage (task ``exploration``) and summed rewards (task ``reward``).

    Args:
        trajectory: recorded in the scene.
        scene: the ground truth.
        preset: gives the number of poses from which visibility is computed.
        cache: folder in which the visible map of the scene is stored for the next call.

    Returns:
        The scores; and the coverage after 2, 4, ... 100 % of the trajectory, by metric.

    Raises:
        DataError: the cache is damaged, or cannot be written.
    """
    sim = Simulator(scene, Intrinsics.from_fov(SENSOR, SENSOR), supersample=1, rgb=False)
    steps = len(trajectory)
    marks = np.ceil(np.arange(1, CURVE_POINTS + 1) * steps / CURVE_POINTS).astype(int) - 1
    values: dict[str, float] = {}
    curves = {}
    visible = cached_visible_map(sim, preset.visible_poses, cache)
    for quantity, curve in coverage(sim, trajectory, visible).items():
        metric = _METRIC_OF[quantity]
        curves[metric] = curve[marks].round(2).tolist()
        values[metric], values[f"{metric}_auc"] = float(curve[-1]), area_under(curve)
    meta = trajectory.meta
    values["explored_area_m2"] = float(meta["explored_m2"][-1])
    values["collisions"] = float(sum(meta["collided"]))
    values["path_length_m"] = float(meta["path_m"][-1])
    rows = [_score("exploration", name, value, steps) for name, value in values.items()]
    return rows + [_score("reward", name, value, steps) for name, value in summed_rewards(trajectory).items()], curves


def _score(task: str, name: str, value: float, steps: int) -> Score:
    return Score(task, name, value, METRICS[task, name].unit, n=steps)


def summed_rewards(trajectory: Trajectory) -> dict[str, float]:
    """Sum the rewards ``cov``, ``obs``, ``sem`` and ``view`` over all steps, from the map of the robot.

    Args:
        trajectory: with depth and semantics.
    """
    assert trajectory.depth is not None and trajectory.semantics is not None  # the simulator records both
    mapper = Mapper(empty_map(trajectory.poses[0], MAP_SIZE), trajectory.intrinsics, grows=True)
    first = None
    for t, pose in enumerate(trajectory.poses):
        observation = Observation(trajectory.rgb[t], trajectory.depth[t], trajectory.semantics[t], pose, step=t)
        _, state = mapper.add(observation)
        if first is None:
            first = _copy(state)
    assert first is not None
    first = enlarged(first, (len(state.explored) - len(first.explored)) // 2)
    # Cells are never unmapped, so the sum over all steps equals the reward of one step from first to last map.
    whole = Transition(first, state, observation, trajectory.meta["actions"][-1])
    return {name: float(REWARDS[name](whole)) for name in SUMMED}


@dataclass(frozen=True)
class _CacheHeader:
    """Header of a cached map."""

    cell: float  # metres
    size: int  # cells per side


def cached_visible_map(sim: Simulator, poses: int, cache: Path) -> MapState:
    """Return :func:`visible_map`, from the cache if it is there.

    Args:
        sim: simulator of the scene.
        poses: number of poses.
        cache: folder of the cached maps.

    Raises:
        DataError: the cache is damaged, or cannot be written.
    """
    path = cache / f"{sim.scene.sha256[:16]}-{poses}.safetensors"
    if path.exists():
        arrays, header = storage.read_arrays(path, _CacheHeader)
        packed = (header.size, -(-header.size // 8))  # the last axis holds eight cells per byte
        if any(name not in arrays or arrays[name].shape[-2:] not in (packed, (4, 4), (2,)) for name in ARRAYS):
            raise DataError(f"{path} is damaged; remove it, and it is computed again")
        return MapState(**{name: _unpacked(arrays[name], header.size) for name in ARRAYS}, cell=header.cell)
    visible = visible_map(sim, poses)
    arrays = {name: _packed(getattr(visible, name)) for name in ARRAYS}
    storage.write_arrays(path, arrays, {"cell": visible.cell, "size": len(visible.explored)})
    return visible


def _packed(array: np.ndarray) -> np.ndarray:
    return np.packbits(array, axis=-1) if array.dtype == np.bool_ else array


def _unpacked(array: np.ndarray, size: int) -> np.ndarray:
    return np.unpackbits(array, axis=-1, count=size).astype(np.bool_) if array.dtype == np.uint8 else array


def _copy(state: MapState) -> MapState:
    return replace(state, **{name: getattr(state, name).copy() for name in ARRAYS})
