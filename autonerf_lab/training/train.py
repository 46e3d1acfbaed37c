"""Train a policy: ``train_policy("modular-obs", "runs/modular-obs")``.

The folder holds the checkpoint, written at the end of an episode, when the environments have no state but the number of
the next episode; ``policy.safetensors`` and ``.json``, what a walk needs; ``curve.csv`` and ``curve.png``; and the
logs of TensorBoard. Stopped at any moment, the same call goes on from the checkpoint and ends with the same bits.
"""

import json
import time
from dataclasses import asdict, replace
from functools import partial
from operator import mul
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pandas as pd
import torch
from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from tqdm import tqdm

from autonerf_lab.envs.egocentric import EgocentricEnv
from autonerf_lab.envs.waypoint import WaypointEnv
from autonerf_lab.errors import DataError, RunFolderError, TrainingError
from autonerf_lab.policies.networks import make_network
from autonerf_lab.policies.weights import save_weights
from autonerf_lab.rewards import LearnedReward, Reward, make_reward
from autonerf_lab.storage import read_arrays, write_arrays
from autonerf_lab.training.ppo import make_ppo, network_of, numbers, restore
from autonerf_lab.training.settings import PolicySettings, command_of, settings_of
from autonerf_lab.training.symmetry import Symmetry
from autonerf_lab.training.workers import WorkerPool

CHECKPOINT = "checkpoint.safetensors"
SAVE_EVERY = 60.0  # seconds between two checkpoints
_OF_REWARD = "reward/"  # begins the names of its arrays in a checkpoint


def make_env(settings: PolicySettings, reward: str | Reward) -> gymnasium.Env:
    """The environment that a policy trains in: the training scenes, with colours only where they are looked at."""
    options: dict[str, Any] = {"reward": reward, "size": settings.sensor, "max_steps": settings.max_steps}
    env: gymnasium.Env
    if settings.network["kind"] == "egocentric":
        env = EgocentricEnv(**options)
    else:
        env = WaypointEnv(make_network(settings.network)[0], **options)
    env = gymnasium.wrappers.TransformReward(env, partial(mul, settings.scale))
    return Symmetry(env) if settings.network["kind"] == "compact" else env


class Run(BaseCallback):
    """What happens around PPO's own loop: seeds, checkpoints, the curve, the bar.

    Args:
        folder: of the checkpoint.
        identity: tells this training from another.
        settings: of the training.
        pool: the environments.
        reward: the one that learns for those of all environments, if it does learn.
        progress: show a bar.
    """

    def __init__(
        self,
        folder: Path,
        identity: dict[str, Any],
        settings: PolicySettings,
        pool: WorkerPool,
        reward: Reward,
        progress: bool,
    ) -> None:
        super().__init__()
        self.model: PPO | RecurrentPPO
        self.folder, self.identity, self.settings = folder, identity, settings
        self.pool, self.progress = pool, progress
        self.reward = reward if isinstance(reward, LearnedReward) else None
        self.curve: list[dict[str, float]] = []
        self.episode, self.seconds = 0, 0.0
        self.rollouts = 0
        self._sums = np.zeros(settings.environments)
        self._saved = self._started = time.perf_counter()

    @property
    def frames(self) -> int:
        """Actions of the robots so far."""
        return self.model.num_timesteps * self.settings.actions

    def resume(self) -> None:
        """Go on from the checkpoint, if there is one.

        Raises:
            RunFolderError: it belongs to a training with other settings.
            DataError: it is damaged.
        """
        path = self.folder / CHECKPOINT
        if not path.exists():
            return
        try:
            arrays, header = read_arrays(path)
            if header["identity"] != self.identity:
                differ = sorted(k for k in self.identity if header["identity"].get(k) != self.identity[k])
                raise RunFolderError(
                    f"{path} belongs to another training ({', '.join(differ)} differ); remove it, or use another folder"
                )
            restore(self.model, {k: v for k, v in arrays.items() if not k.startswith(_OF_REWARD)})
            if self.reward:
                learned = {k.removeprefix(_OF_REWARD): v for k, v in arrays.items() if k.startswith(_OF_REWARD)}
                self.reward.load_state_dict(learned)
                self.pool.call("teach", learned)
            self.curve, self.episode, self.seconds = header["curve"], header["episode"], header["seconds"]
            self.model.num_timesteps, self.model._n_updates = header["timesteps"], header["updates"]
            self.pool.begin(self.episode)
        except (KeyError, TypeError, ValueError) as error:  # a DataError is a ValueError
            raise DataError(f"{path} is damaged ({error!r}); remove it to start the training again") from error

    def save(self) -> None:
        """Write the checkpoint: only between two episodes."""
        header = {
            "identity": self.identity,
            "curve": self.curve,
            "episode": self.episode,
            "seconds": self.seconds + time.perf_counter() - self._started,
            "timesteps": self.model.num_timesteps,
            "updates": self.model._n_updates,
        }
        learned = self.reward.state_dict() if self.reward else {}
        arrays = numbers(self.model) | {_OF_REWARD + name: array for name, array in learned.items()}
        write_arrays(self.folder / CHECKPOINT, arrays, header)
        self._saved = time.perf_counter()

    def finish(self) -> None:
        """Keep the end of a training, where it is that of an episode too: it may be given more frames."""
        if self._between_episodes:
            self.save()

    def _on_training_start(self) -> None:
        total = self.settings.frames
        self._bar = tqdm(
            total=total, initial=min(self.frames, total), desc="train", unit="frame", disable=not self.progress
        )

    def _on_rollout_start(self) -> None:
        # Stable-Baselines3 draws from the global generators: seeded here, they need not be saved.
        words = np.random.SeedSequence([self.settings.seed, self.model.num_timesteps]).generate_state(2)
        torch.manual_seed(int(words[0]))
        np.random.seed(int(words[1]))  # noqa: NPY002 - the minibatches of Stable-Baselines3
        if not all(torch.isfinite(value).all() for value in network_of(self.model).parameters()):
            raise TrainingError(f"a parameter is not finite after {self.frames} frames; {self._kept()}")
        if self._between_episodes and time.perf_counter() - self._saved >= SAVE_EVERY:
            self.save()

    @property
    def _between_episodes(self) -> bool:
        return self.model.num_timesteps > 0 and bool(np.all(self.model._last_episode_starts))

    def _on_step(self) -> bool:
        self._sums += self.locals["rewards"] / self.settings.scale
        ends = self.locals["dones"]
        if ends.any():
            self.episode += 1
            areas = [info["explored_m2"] for info, end in zip(self.locals["infos"], ends, strict=True) if end]
            row = {
                "frames": self.frames,
                "reward": float(self._sums[ends].mean()),
                "explored_m2": float(np.mean(areas)),
            }
            self.curve.append(row)
            self._sums[ends] = 0
            self._bar.set_postfix_str(f"reward an episode {row['reward']:.1f}, explored {row['explored_m2']:.0f} m²")
            for name, value in row.items():
                self.logger.record(f"episode/{name}", value)
        self._bar.update(self.settings.environments * self.settings.actions)
        return True

    def _on_rollout_end(self) -> None:
        buffer = self.model.rollout_buffer
        for name in ("rewards", "values", "returns"):
            if not np.isfinite(getattr(buffer, name)).all():
                raise TrainingError(f"{name} are not finite after {self.frames} frames; {self._kept()}")
        if self.reward:
            seen = [batch for part in self.pool.call("collect") for batch in part]
            learned = self.reward.update({name: np.concatenate([batch[name] for batch in seen]) for name in seen[0]})
            for name, value in learned.items():
                self.logger.record(f"reward/{name}", value)
            self.pool.call("teach", self.reward.state_dict())

    def _on_training_end(self) -> None:
        self._bar.close()

    def _kept(self) -> str:
        path = self.folder / CHECKPOINT
        return f"{path} is the last good state" if path.exists() else "there is no checkpoint yet"


def train_policy(
    name: str,
    folder: str | Path,
    settings: PolicySettings | None = None,
    reward: str | Reward | None = None,
    workers: int = 2,
    progress: bool = True,
) -> Path:
    """Train a policy by PPO on the training apartments, or go on with it.

    Args:
        name: ``modular-<reward>`` or ``e2e-<reward>``.
        folder: of the run; a checkpoint in it is continued.
        settings: without them, those of :func:`~autonerf_lab.training.settings.settings_of`.
        reward: in place of the one in the name.
        workers: processes; they do not change the result.
        progress: show a bar.

    Returns:
        The path of the weights, for :func:`autonerf_lab.explore` and :func:`autonerf_lab.policies.make_policy`.

    Raises:
        UnknownNameError: not the name of a policy that is trained, or no such reward.
        RunFolderError: the folder holds another training.
        TrainingError: a value is not finite, or a worker died; the last checkpoint stays as it was.
    """
    folder, settings = Path(folder), settings or settings_of(name)
    chosen = reward or name.partition("-")[2]
    learning = make_reward(chosen)
    frames_an_update = settings.actions * settings.rollout * settings.environments
    identity = {"policy": name, **json.loads(json.dumps(asdict(replace(settings, frames=0))))}
    started = time.perf_counter()
    pool = WorkerPool(partial(make_env, settings, chosen), settings.environments, workers, settings.seed)
    try:
        ppo = make_ppo(pool, lambda: make_network(settings.network)[1], settings, folder / "tensorboard")
        run = Run(folder, identity, settings, pool, learning, progress)
        run.model = ppo
        run.resume()
        updates = -(-settings.frames // frames_an_update)
        remaining = updates * settings.rollout * settings.environments - ppo.num_timesteps
        ppo._last_obs = None
        if remaining > 0:
            ppo.learn(remaining, callback=run, reset_num_timesteps=False, tb_log_name="ppo")
            run.finish()
    finally:
        pool.close()
    pd.DataFrame(run.curve).to_csv(folder / "curve.csv", index=False)
    save_weights(
        folder / "policy",
        network_of(ppo),
        {
            "policy": name,
            "command": command_of(name, settings) if reward is None else None,
            "seed": settings.seed,
            "network": settings.network,
            "frames": run.frames,
            "hours": round((run.seconds + time.perf_counter() - started) / 3600, 3),
            "settings": identity,
            "curve": run.curve,
        },
    )
    return folder / "policy"
