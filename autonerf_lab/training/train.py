"""Train a policy: ``train_policy("modular-obs", "runs/modular-obs")``.

Before PPO a modular policy imitates frontier exploration (:mod:`autonerf_lab.training.imitation`), and a PointGoal
policy imitates shortest paths (:mod:`autonerf_lab.training.shortest_path_expert`).

The folder contains the checkpoint; the weights, ``policy.safetensors`` and ``policy.json``; the learning curve,
``curve.csv``; and TensorBoard logs. Checkpoints are written between episodes, when the only state of
an environment is the number of its next episode; that of the imitation of shortest paths holds the actions of the
running episodes, and repeats them. After an interruption the same call resumes from the checkpoint and
gives bit-identical weights.
"""

import json
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from operator import mul
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import pandas as pd
import torch
from gymnasium.envs.registration import load_env_creator
from torch import nn

from autonerf_lab.envs import ENVS
from autonerf_lab.errors import DataError
from autonerf_lab.nerf.model import check_device
from autonerf_lab.policies import weights_path, weights_sha256
from autonerf_lab.policies.networks import RecurrentNetwork
from autonerf_lab.policies.spec import make_interface, make_network, spec_of
from autonerf_lab.policies.weights import load_weights, save_weights
from autonerf_lab.rewards import Reward, make_reward
from autonerf_lab.training.augmentation import SymmetryAugmentation
from autonerf_lab.training.checkpoint import CHECKPOINT, read_checkpoint
from autonerf_lab.training.imitation import demonstrate, imitate
from autonerf_lab.training.ppo import make_ppo, network_of
from autonerf_lab.training.probe import probe
from autonerf_lab.training.session import CheckpointHeader, TrainingSession
from autonerf_lab.training.settings import PolicySettings, Scenes, command_of, settings_of
from autonerf_lab.training.shortest_path_expert import imitate_shortest_paths
from autonerf_lab.training.worker_pool import MakeEnv, WorkerPool
from autonerf_lab.utils.storage import write_bytes
from autonerf_lab.version import __version__

_File = tuple[Path, dict[str, Any]]  # path of a checkpoint, and the fingerprint of its training
IMITATION = "imitation.safetensors"  # checkpoint of a PointGoal policy before PPO


def make_env(settings: PolicySettings, reward: str | Reward, scenes: Scenes = None) -> gymnasium.Env:
    """Make the training environment of a policy.

    Args:
        settings: settings of the training.
        reward: reward; ignored if the environment has its own.
        scenes: scenes instead of those of the settings.
    """
    spec, interface = spec_of(settings.network), make_interface(settings.network)
    options: dict[str, Any] = {"size": settings.sensor, "scene": scenes or settings.scenes or None}
    options["max_steps"] = settings.episode * interface.follow + interface.initial_turns
    if spec.waypoints:
        options |= {"interface": interface, "decisions": settings.episode}
    if spec.rewards is not None:
        options["reward"] = reward
    env = load_env_creator(ENVS[spec.environment])(**options)
    assert isinstance(env, gymnasium.Env)
    env = gymnasium.wrappers.TransformReward(env, partial(mul, settings.scale))
    return SymmetryAugmentation(env) if spec.symmetric else env


class _Lesson(NamedTuple):
    """Arguments of a teacher."""

    settings: PolicySettings
    reward: str | Reward
    scenes: Scenes
    make: MakeEnv
    checkpoint: _File
    progress: bool


def _imitate_frontier(network: nn.Module, lesson: _Lesson) -> float:
    settings, reward, scenes, _, _, progress = lesson
    shown = demonstrate(make_interface(settings.network), settings, reward, progress, scenes)
    imitate(network, shown, settings, progress)
    return 0.0


def _imitate_shortest_paths(network: nn.Module, lesson: _Lesson) -> float:
    assert isinstance(network, RecurrentNetwork)
    return imitate_shortest_paths(network, lesson.make, lesson.settings, *lesson.checkpoint, lesson.progress)


TEACHERS = {"frontier": _imitate_frontier, "shortest-path": _imitate_shortest_paths}


def train_policy(
    name: str,
    folder: str | Path,
    settings: PolicySettings | None = None,
    reward: str | Reward | None = None,
    workers: int = 2,
    progress: bool = True,
    callback: Callable[[dict[str, float]], None] = lambda row: None,
    scenes: Scenes = None,
    start: str | Path | None = None,
    device: str = "cpu",
) -> Path:
    """Train a policy, or resume its training from the checkpoint in the folder.

    Args:
        name: ``modular-<reward>``, ``paper-<reward>``, ``e2e-<reward>`` or ``pointgoal``.
        folder: folder of the training.
        settings: settings; None for those of :func:`~autonerf_lab.training.settings.settings_of`.
        reward: reward instead of the one in the name; ignored for ``pointgoal``.
        workers: number of worker processes; the result does not depend on it.
        progress: show a progress bar.
        callback: called after every rollout in which an episode ended, with a row of the learning curve: ``frames``,
            ``reward``, ``return`` (discounted), and ``explored_m2`` or ``success`` and ``spl``. An exception it raises
            ends the training.
        scenes: training scenes instead of those of the settings, for example a reconstructed mesh.
        start: initial weights instead of imitation: the name of a built-in policy or a path.
        device: torch device of the network during PPO. The environments and the imitation are computed on the CPU.

    Returns:
        Path of the weights without suffix, for :func:`autonerf_lab.policies.load_policy`.

    Raises:
        UnknownNameError: unknown policy or reward.
        RunFolderError: the folder contains another training.
        DataError: the initial weights are missing or belong to another network, or nothing would be trained.
        DeviceError: the device does not exist on this machine.
        TrainingError: a value is not finite, or a worker process died; the last checkpoint is kept.
    """
    check_device(device)
    folder, settings = Path(folder), settings or settings_of(name)
    if not settings.frames and (start is not None or not settings.demonstrations):
        raise DataError("nothing would be trained: set frames, or demonstrations without initial weights")
    chosen = reward or name.partition("-")[2]
    spec = spec_of(settings.network)
    learned = None if spec.rewards is None else make_reward(chosen)
    first = None if start is None else weights_path(str(start))
    if first is not None and not first.exists():
        raise DataError(f"{first} does not exist; start from a built-in policy or from a .safetensors file")
    fingerprint: dict[str, Any] = {"version": __version__, "policy": name}
    fingerprint |= json.loads(json.dumps(asdict(replace(settings, frames=0))))
    if scenes is not None:
        fingerprint["training_scenes"] = [scene if isinstance(scene, str) else scene.sha256 for scene in scenes]
    if first is not None:
        fingerprint["start"] = weights_sha256(str(first))
    # errors are raised before processes start
    checkpoint = read_checkpoint(folder / CHECKPOINT, fingerprint, CheckpointHeader)
    make = partial(make_env, settings, chosen, scenes)
    threads = torch.get_num_threads()  # the session changes it
    started = time.perf_counter()
    pool = WorkerPool(make, settings.environments, workers, settings.seed)
    try:
        session = TrainingSession(folder, fingerprint, settings, pool, learned, progress, callback)
        logs = folder / "tensorboard"
        ppo = make_ppo(pool, lambda: make_network(settings.network)[1], settings, logs, device, session.remaining)
        session.model = ppo
        if checkpoint:
            session.resume(*checkpoint)
        else:
            network = network_of(ppo)
            if first is not None:
                load_weights(first, network)
            elif settings.demonstrations and spec.teacher:
                lesson = _Lesson(settings, chosen, scenes, make, (folder / IMITATION, fingerprint), progress)
                session.seconds = TEACHERS[spec.teacher](network.cpu(), lesson)
                network.to(device)
            session.share_reward()  # its random initial values may differ between processes
            session.save()
            (folder / IMITATION).unlink(missing_ok=True)
        ppo._last_obs = None
        if session.remaining() > 0:
            # The session ends the training: Stable-Baselines3 counts decisions, not frames.
            ppo.learn(sys.maxsize, callback=session, reset_num_timesteps=False, tb_log_name="ppo")
    finally:
        pool.close()
        torch.set_num_threads(threads)
    write_bytes(folder / "curve.csv", pd.DataFrame(session.curve).to_csv(index=False, lineterminator="\n").encode())
    network = network_of(ppo).cpu()
    save_weights(
        folder / "policy",
        network,
        {
            "policy": name,
            "command": command_of(name, settings, start, device) if reward is scenes is None else None,
            "seed": settings.seed,
            "network": settings.network,
            "frames": session.frames,
            "hours": round((session.seconds + time.perf_counter() - started) / 3600, 3),
            "settings": fingerprint | {"frames": settings.frames},  # a training can be continued with more
            "probe": probe(network, make),
            "curve": session.curve,
        },
    )
    return folder / "policy"
