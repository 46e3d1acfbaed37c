"""Photographs of a scene from everywhere: what the benchmarks of fields train on, and what they are judged by.

Poses are uniform over the navigable ground and heading; those to train on and those to test have different seeds. Both
are written as trajectory folders, so that a process that trains never holds a scene, its texture or a simulator.
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


def write_views(name: str, folder: Path, train: int, test: int) -> dict[str, float]:
    """Photograph a scene as ``explore`` would, 128x128 and supersampled.

    Returns:
        ``area_m2``, the floor of its rooms; ``psnr`` and the other scores of showing the nearest training view.
    """
    scene = scene_by_name(name)
    sim = Simulator(scene)
    for part, count, seed in (("train", train, TRAIN_SEED), ("test", test, TEST_SEED)):
        photographs(sim, count, seed).save(folder / part)
    known, asked = read_views(folder)
    scores = evaluate_rendering(NearestView(known), photographed_views(Dataset.of(asked))).values
    return {"area_m2": floor_area(scene.spec), **scores}


def photographs(sim: Simulator, count: int, seed: int) -> Trajectory:
    """Images from everywhere, as if somebody had carried the robot there."""
    poses = sample_test_poses(sim, count, seed)
    frames = [sim.render(c2w) for c2w in poses]
    rgb, depth, semantics = (np.stack([getattr(f, key) for f in frames]) for key in ("rgb", "depth", "semantics"))
    return Trajectory(poses, rgb, depth, semantics, sim.intrinsics, {"scene": sim.scene.name})


def read_views(folder: Path, count: int | None = None, depth: bool = False) -> tuple[Trajectory, Trajectory]:
    """The views to train on, the first ``count`` of them, with depth only where it is asked for; and those to test."""
    train, test = load_trajectory(folder / "train"), load_trajectory(folder / "test")
    chosen = slice(count)
    train = replace(
        train,
        poses=train.poses[chosen],
        rgb=train.rgb[chosen],
        semantics=train.semantics[chosen],
        depth=train.depth[chosen] if depth else None,
    )
    return train, test


def scene_by_name(name: str) -> Scene:
    """A frozen scene, or ``apartment-SEED`` fresh from the generator."""
    kind, _, seed = name.partition("-")
    return generate_apartment(int(seed)) if kind == "apartment" else load_scene(name)


def floor_area(spec: dict) -> float:
    """Square metres of the rooms of a generated apartment, walls left out."""
    return sum(Polygon(room["polygon"]).area for room in spec["rooms"])
