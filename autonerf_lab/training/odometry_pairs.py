"""Pairs of successive depth images with the true motion between them, to train learned odometry.

From random poses of the training apartments, a robot with noise of actuation makes a few random actions. Depth has the
noise of the sensor. Only the pixels of a :class:`~autonerf_lab.localization.scan.Scan` are kept. The error of odometry
is sampled when a pair is used, so that it is another one each time.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from autonerf_lab.geometry import Intrinsics
from autonerf_lab.localization.odometry import OdometryModel
from autonerf_lab.localization.residual_image import residual_image
from autonerf_lab.localization.scan import STRIDE, make_scan
from autonerf_lab.localization.se2 import between, to_planar
from autonerf_lab.scenes import load_scene
from autonerf_lab.simulator import Simulator
from autonerf_lab.simulator.motion_noise import MotionNoise
from autonerf_lab.types import Action
from autonerf_lab.utils.storage import read_arrays, write_arrays

ACTIONS = 8  # of each start pose
SIZE = 128  # pixels of the depth images
SCALES = (0.5, 1.0, 2.0)  # of the odometry noise
_SHARES = (0.5, 0.25, 0.25)  # of forward motions, left and right turns
_NOISES: Mapping[float, tuple[MotionNoise, OdometryModel]] = {
    scale: (MotionNoise(scale=scale), OdometryModel.from_noise(MotionNoise(scale=scale))) for scale in SCALES
}


@dataclass(frozen=True)
class Pairs:
    """Runs of :data:`ACTIONS` actions, N of them."""

    depth: np.ndarray  # (N, ACTIONS + 1, R, C) uint16, millimetres, every second pixel; 0 for none
    motions: np.ndarray  # (N, ACTIONS, 3) true motions in the frame of the robot, metres and radians
    actions: np.ndarray  # (N, ACTIONS) uint8


def training_pairs(folder: Path, scene: str, runs: int, seed: int) -> Pairs:
    """Render the pairs of a training apartment, or read them from the folder.

    Args:
        folder: folder of the rendered pairs, one file per apartment.
        scene: name of the apartment.
        runs: number of start poses.
        seed: random seed.
    """
    path = folder / f"{scene}.safetensors"
    if not path.exists():
        write_arrays(path, vars(render_pairs(scene, runs, seed)))
    arrays, _ = read_arrays(path, dict[str, Any])
    return Pairs(arrays["depth"], arrays["motions"], arrays["actions"])


def render_pairs(scene: str, runs: int, seed: int) -> Pairs:
    """Render runs from random start poses of a scene; arguments as in :func:`training_pairs`.

    Example:
        >>> pairs = render_pairs("train-00", 1, 0)
        >>> pairs.depth.shape, pairs.motions.shape, pairs.actions.shape
        ((1, 9, 64, 64), (1, 8, 3), (1, 8))
    """
    noise = MotionNoise(odometry=False)
    sim = Simulator(load_scene(scene), camera(), 1, rgb=False, noise=noise, depth_noise="redwood")
    rng = np.random.default_rng([seed, *scene.encode()])
    actions = rng.choice(len(_SHARES), p=_SHARES, size=(runs, ACTIONS)).astype(np.uint8)
    depth = np.empty((runs, ACTIONS + 1, SIZE // STRIDE, SIZE // STRIDE), np.uint16)
    poses = np.empty((runs, ACTIONS + 1, 3))
    for run in range(runs):
        observation = sim.reset(seed=int(rng.integers(1 << 31)))
        for t in range(ACTIONS + 1):
            depth[run, t] = np.rint(1000 * observation.depth[::STRIDE, ::STRIDE])
            poses[run, t] = to_planar(observation.pose)
            if t < ACTIONS:
                observation = sim.step(int(actions[run, t]))
    return Pairs(depth, between(poses[:, :-1], poses[:, 1:]), actions)


def camera() -> Intrinsics:
    """Return the camera of the pairs."""
    return Intrinsics.from_fov(SIZE, SIZE)


def sample_batch(pairs: Pairs, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sample runs, and errors of the odometry of all their pairs.

    Args:
        pairs: N runs.
        count: number of runs in the batch; it has B = count * ACTIONS pairs.
        rng: random generator.

    Returns:
        (B, 5, R, C) residual images at the measured motions, (B, 3, 3) information of the odometry, and (B, 3) the
        corrections that lead to the true motions.
    """
    images, priors, wanted = [], [], []
    for run in rng.integers(len(pairs.depth), size=count):
        noise, model = _NOISES[float(rng.choice(SCALES))]
        # a scan reads every second pixel of the image
        full = (pairs.depth[run] / 1000).repeat(STRIDE, axis=1).repeat(STRIDE, axis=2)
        scans = [make_scan(depth, camera()) for depth in full]
        for t in range(ACTIONS):
            action, true = Action(int(pairs.actions[run, t])), pairs.motions[run, t]
            measured = model.corrected(true + noise.odometry_error(action, rng), action)
            images.append(residual_image(scans[t + 1], scans[t], measured))
            priors.append(np.linalg.inv(model.covariances[action]))
            wanted.append(true - measured)
    return np.stack(images), np.stack(priors), np.stack(wanted)
