"""Training and test views of a scene for the benchmarks of fields.

Poses are uniform over navigable ground and heading; training and test views have different seeds. Both are written as
trajectory folders, so that a training process never holds a scene, its texture or a simulator.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from shapely import Polygon

from autonerf_lab.data.dataset import Dataset
from autonerf_lab.data.trajectory import Trajectory, load_trajectory
from autonerf_lab.evaluators.nearest_view import NearestView
from autonerf_lab.evaluators.rendering import evaluate_rendering, photographed_views, sample_test_poses
from autonerf_lab.scenes import Scene, generate_apartment, load_scene
from autonerf_lab.simulator import Simulator

TEST_SEED, TRAIN_SEED = 0, 1


def write_views(name: str, folder: Path, train: int, test: int) -> dict[str, float | None]:
    """Render training and test views of a scene, 128x128 and supersampled as in ``explore``, into a folder.

    Returns:
        ``area_m2``, floor area of the rooms; ``psnr`` and the other scores of the nearest-view baseline.
    """
    scene = scene_by_name(name)
    sim = Simulator(scene)
    for part, count, seed in (("train", train, TRAIN_SEED), ("test", test, TEST_SEED)):
        photographs(sim, count, seed).save(folder / part)
    train_views, test_views = read_views(folder)
    baseline = NearestView(train_views)
    scores = evaluate_rendering(baseline, photographed_views(Dataset.from_trajectory(test_views))).values
    return {"area_m2": floor_area(scene.spec), **scores}


def photographs(sim: Simulator, count: int, seed: int) -> Trajectory:
    """Render views at ``count`` random poses."""
    poses = sample_test_poses(sim, count, seed)
    frames = [sim.render(c2w) for c2w in poses]
    rgb, depth, semantics = (np.stack([getattr(f, key) for f in frames]) for key in ("rgb", "depth", "semantics"))
    return Trajectory(poses, rgb, depth, semantics, sim.intrinsics, {"scene": sim.scene.name})


def read_views(folder: Path, count: int | None = None, depth: bool = False) -> tuple[Trajectory, Trajectory]:
    """Read the first ``count`` training views, without depth by default, and the test views."""
    train, test = load_trajectory(folder / "train"), load_trajectory(folder / "test")
    assert train.semantics is not None and train.depth is not None  # write_views renders all layers
    train = replace(
        train,
        poses=train.poses[:count],
        rgb=train.rgb[:count],
        semantics=train.semantics[:count],
        depth=train.depth[:count] if depth else None,
    )
    return train, test


def scene_by_name(name: str) -> Scene:
    """Return a scene of the package, or generate ``apartment-SEED``."""
    kind, _, seed = name.partition("-")
    return generate_apartment(int(seed)) if kind == "apartment" else load_scene(name)


def floor_area(spec: dict | None) -> float:
    """Return the floor area of the rooms of a generated apartment, without walls, m²; 0 without a specification."""
    return sum(Polygon(room["polygon"]).area for room in (spec["rooms"] if spec else ()))
