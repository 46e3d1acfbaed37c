"""Labelled frames of apartments with random materials, light, gloss and cameras, to train a segmenter.

Half of the poses are sampled as the agent stands, uniformly over floor and heading. The others look at an object of a
class chosen uniformly, because books, cups and bottles fill few pixels of a random view.
"""

import copy
import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from autonerf_lab.geometry import CAMERA_HEIGHT, Intrinsics, planar_pose, so3_exp
from autonerf_lab.scenes import load_scene, scene_names
from autonerf_lab.scenes.build import build
from autonerf_lab.scenes.generator import generate_spec
from autonerf_lab.simulator import Simulator
from autonerf_lab.utils.storage import read_arrays, write_arrays

FIRST_SEED = 10_000_000  # of fresh apartments; no frozen scene has such a seed
HELD_OUT = 20_000_000  # first seed of the apartments that measure and calibrate a training
_NEAR, _FAR = 0.7, 4.5  # metres to an object that a pose looks at
_TRIES = 12  # poses tried for an object
_VISIBLE = 12  # pixels of the class that make a pose valid


@dataclass(frozen=True)
class Frames:
    """N labelled images."""

    rgb: np.ndarray  # (N, H, W, 3) uint8
    depth: np.ndarray  # (N, H, W) float16, metres
    semantics: np.ndarray  # (N, H, W) uint8, class index

    @classmethod
    def joined(cls, parts: "list[Frames]") -> "Frames":
        """Return the images of all parts."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))


def randomized_spec(spec: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """Return a specification with random colours of materials and random light; the shapes stay.

    Example:
        >>> from autonerf_lab.scenes.generator import generate_spec
        >>> spec = generate_spec(7)
        >>> other = randomized_spec(spec, np.random.default_rng(0))
        >>> other["objects"] == spec["objects"], other["materials"] == spec["materials"]
        (True, False)
    """
    spec = copy.deepcopy(spec)
    for material in spec["materials"].values():
        gain = math.exp(rng.normal(0, 0.15))
        tint = rng.normal(0, 10, 3)
        shift = rng.normal(0, 60, 3) if rng.random() < 0.15 else np.zeros(3)
        for key in ("color", "color2"):
            if key in material:
                color = np.array(material[key]) * gain + tint + shift
                material[key] = [int(v) for v in np.clip(color, 5, 250)]
    lamps, day = math.exp(rng.normal(0, 0.4)), math.exp(rng.normal(0, 0.5))
    for light in spec["lights"]:
        light["power"] *= (lamps if light["kind"] == "lamp" else day) * math.exp(rng.normal(0, 0.2))
    return spec


def render_frames(
    spec: dict[str, Any], count: int, rng: np.random.Generator, size: int = 128, level: bool = False
) -> Frames:
    """Render labelled frames of one apartment.

    Args:
        spec: specification of the apartment.
        count: number of frames.
        rng: random generator of poses and gloss.
        size: pixels a side.
        level: test views: poses uniform over floor and heading, level camera at the robot's height, no gloss.
    """
    scene = build(spec)
    sim = Simulator(scene, Intrinsics.from_fov(size, size), gloss=not level and rng.random() < 0.5)
    frames = []
    for k in range(count):
        pose = sim.sample_pose(rng) if level or k % 2 else _pose_of_object(sim, rng)
        frames.append(sim.render(pose if level else _moved_camera(pose, rng)))
    depth = np.stack([f.depth for f in frames]).astype(np.float16)
    return Frames(np.stack([f.rgb for f in frames]), depth, np.stack([f.semantics for f in frames]))


def _pose_of_object(sim: Simulator, rng: np.random.Generator) -> np.ndarray:
    """Sample a pose that looks at an object of a random class."""
    objects = [item for item in sim.scene.instances if item.class_id]
    classes = sorted({item.class_id for item in objects})
    pose = sim.sample_pose(rng)
    if not classes:
        return pose
    chosen = int(rng.choice(classes))
    of_class = [item for item in objects if item.class_id == chosen]
    for _ in range(_TRIES):
        target = of_class[int(rng.integers(len(of_class)))].center
        for _ in range(_TRIES):
            x, y = sim.navigation.sample(rng)
            if _NEAR < math.hypot(target[0] - x, target[1] - y) < _FAR:
                break
        else:
            continue
        heading = math.atan2(target[1] - y, target[0] - x) + rng.normal(0, 0.3)
        pose = planar_pose(x, y, heading)
        if (sim.render(pose, rgb=False).semantics == chosen).sum() >= _VISIBLE:
            break
    return pose


def _moved_camera(pose: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Change height, pitch and roll of half of the cameras."""
    pose = pose.copy()
    if rng.random() < 0.5:
        pose[2, 3] = np.clip(CAMERA_HEIGHT + rng.normal(0, 0.2), 0.4, 1.5)
        pose[:3, :3] = pose[:3, :3] @ so3_exp(np.array([rng.normal(0, 0.12), 0, rng.normal(0, 0.04)]))
    return pose


def training_frames(folder: Path, index: int, count: int, seed: int, size: int = 128) -> Frames:
    """Render the frames of a training apartment, or read them from the folder.

    Args:
        folder: folder of the rendered frames, one file per apartment.
        index: number of the apartment: first the ``train-*`` scenes, then fresh seeds.
        count: number of frames.
        seed: random seed of appearance and poses.
        size: pixels a side.
    """
    path = folder / f"apartment-{index:04d}.safetensors"
    if not path.exists():
        rng = np.random.default_rng([seed, index])
        names = scene_names("train")
        spec = load_scene(names[index]).spec if index < len(names) else generate_spec(FIRST_SEED + index)
        assert spec is not None
        frames = render_frames(randomized_spec(spec, rng), count, rng, size)
        write_arrays(path, vars(frames))
    return _read(path)


def held_out_frames(folder: Path, apartments: int, count: int, seed: int, size: int = 128) -> Frames:
    """Render test views of apartments without training frames, or read them.

    Arguments as in :func:`training_frames`.
    """
    parts = []
    for k in range(apartments):
        path = folder / f"held-out-{k:04d}.safetensors"
        if not path.exists():
            frames = render_frames(generate_spec(HELD_OUT + k), count, np.random.default_rng([seed, k]), size, True)
            write_arrays(path, vars(frames))
        parts.append(_read(path))
    return Frames.joined(parts)


def _read(path: Path) -> Frames:
    arrays, _ = read_arrays(path, dict[str, Any])
    return Frames(arrays["rgb"], arrays["depth"], arrays["semantics"])
