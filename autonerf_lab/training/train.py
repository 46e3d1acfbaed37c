"""Train a policy: ``train_policy("modular-obs", "runs/modular-obs")``.

Before PPO a global policy imitates frontier exploration (:mod:`autonerf_lab.training.imitation`), and one that goes to
places a robot that knows the way (:mod:`autonerf_lab.training.shortest_path_expert`).

The folder holds the checkpoint, written between episodes, when the environments have no state but the number of the
next one; ``policy.safetensors`` and ``.json``, what a walk needs; ``curve.csv`` and ``curve.png``; and the
logs of TensorBoard. Stopped at any moment, the same call goes on from the checkpoint and ends with the same bits.
"""

import json
import time
from collections.abc import Callable, Sequence
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
from autonerf_lab.envs.pointgoal import PointGoalEnv
from autonerf_lab.envs.waypoint import WaypointEnv
from autonerf_lab.errors import DataError, RunFolderError, TrainingError
from autonerf_lab.policies import weights_path, weights_sha256
from autonerf_lab.policies.egocentric import EgocentricView
from autonerf_lab.policies.networks import RecurrentNetwork, make_network, make_view
from autonerf_lab.policies.pointgoal import GoalView
from autonerf_lab.policies.weights import load_weights, save_weights
from autonerf_lab.rewards import LearnedReward, Reward, make_reward
from autonerf_lab.scenes import Scene
from autonerf_lab.training.augmentation import Symmetry
from autonerf_lab.training.imitation import demonstrate, imitate
from autonerf_lab.training.ppo import TimedBuffer, make_ppo, network_of, numbers, restore
from autonerf_lab.training.settings import POINTGOAL, PolicySettings, command_of, settings_of
from autonerf_lab.training.shortest_path_expert import learn_the_way
from autonerf_lab.training.worker_pool import WorkerPool
from autonerf_lab.utils.storage import read_arrays, write_arrays

CHECKPOINT = "checkpoint.safetensors"
SAVE_EVERY = 60.0  # seconds between two checkpoints
ANEW_EVERY = 16  # rollouts after which episodes that end one by one begin anew, so that there is a moment between them
_OF_REWARD = "reward/"  # begins the names of its arrays in a checkpoint


Scenes = Sequence[str | Scene] | None


def make_env(settings: PolicySettings, reward: str | Reward, scenes: Scenes = None) -> gymnasium.Env:
    """The environment that a policy trains in: the training scenes, with colours only where they are looked at."""
    view = make_view(settings.network)
    options: dict[str, Any] = {"size": settings.sensor, "scene": scenes or settings.scenes or None}
    options["max_steps"] = settings.episode * view.follow
    env: gymnasium.Env
    if isinstance(view, GoalView):
        env = PointGoalEnv(**options)
    elif isinstance(view, EgocentricView):
        env = EgocentricEnv(reward=reward, **options)
    else:
        options["max_steps"] += view.opening
        env = WaypointEnv(view, decisions=settings.episode, reward=reward, **options)
    env = gymnasium.wrappers.TransformReward(env, partial(mul, settings.scale))
    return Symmetry(env) if settings.network["kind"] == "compact" else env


def read_checkpoint(path: Path, identity: dict[str, Any]) -> tuple[dict[str, np.ndarray], dict[str, Any]] | None:
    """Arrays and header of a checkpoint; None where there is none.

    Raises:
        RunFolderError: it belongs to a training with other settings.
        DataError: it is damaged.
    """
    if not path.exists():
        return None
    try:
        arrays, header = read_arrays(path)
        found = header["identity"]
    except (KeyError, ValueError) as error:  # a DataError is a ValueError
        raise _damaged(path, error) from error
    if found != identity:
        differ = sorted(k for k in {*found, *identity} if found.get(k) != identity.get(k))
        raise RunFolderError(
            f"{path} belongs to another training ({', '.join(differ)} differ); remove it, or use another folder"
        )
    return arrays, header


def _damaged(path: Path, error: Exception) -> DataError:
    return DataError(f"{path} is damaged ({error!r}); remove it to start the training again")


class Run(BaseCallback):
    """What happens around PPO's own loop: seeds, checkpoints, the curve, the bar.

    Args:
        folder: of the checkpoint.
        identity: tells this training from another.
        settings: of the training.
        pool: the environments.
        reward: the one that learns for those of all environments, if it does learn; None where it is the
            environment's own.
        progress: show a bar.
        told: of every row of the curve.
    """

    def __init__(
        self,
        folder: Path,
        identity: dict[str, Any],
        settings: PolicySettings,
        pool: WorkerPool,
        reward: Reward | None,
        progress: bool,
        told: Callable[[dict[str, float]], None],
    ) -> None:
        super().__init__()
        self.model: PPO | RecurrentPPO
        self.folder, self.identity, self.settings = folder, identity, settings
        self.pool, self.progress, self.told = pool, progress, told
        self.reward = reward if isinstance(reward, LearnedReward) else None
        self.curve: list[dict[str, float]] = []
        self.frames = 0  # actions of the robots so far
        view = make_view(settings.network)
        self.follow: int = view.follow
        self.aligned = not isinstance(view, GoalView)  # episodes of all environments end together
        self.episode, self.seconds = 0, 0.0
        self._sums = np.zeros(settings.environments)
        self._ended: list[tuple[float, dict[str, Any]]] = []  # rewards and infos of the episodes of this rollout
        self._saved = self._started = time.perf_counter()

    def resume(self, arrays: dict[str, np.ndarray], header: dict[str, Any]) -> None:
        """Go on from a checkpoint.

        Raises:
            DataError: it is damaged.
        """
        try:
            restore(self.model, {k: v for k, v in arrays.items() if not k.startswith(_OF_REWARD)})
            if self.reward:
                learned = {k.removeprefix(_OF_REWARD): v for k, v in arrays.items() if k.startswith(_OF_REWARD)}
                self.reward.load_state_dict(learned)
                self.pool.call("teach", learned)
            self.curve, self.episode, self.seconds = header["curve"], header["episode"], header["seconds"]
            self.frames = header["frames"]
            self.model.num_timesteps, self.model._n_updates = header["timesteps"], header["updates"]
            self.pool.begin(self.episode if self.aligned else self._steps)
        except (KeyError, TypeError, ValueError) as error:
            raise _damaged(self.folder / CHECKPOINT, error) from error

    def save(self) -> None:
        """Write the checkpoint: only between two episodes, or before the first."""
        header = {
            "identity": self.identity,
            "curve": self.curve,
            "episode": self.episode,
            "frames": self.frames,
            "seconds": self.seconds + time.perf_counter() - self._started,
            "timesteps": self.model.num_timesteps,
            "updates": self.model._n_updates,
        }
        learned = self.reward.state_dict() if self.reward else {}
        arrays = numbers(self.model) | {_OF_REWARD + name: array for name, array in learned.items()}
        write_arrays(self.folder / CHECKPOINT, arrays, header)
        self._saved = time.perf_counter()

    def finish(self) -> None:
        """Keep the end of a training: it may be given more frames, unless it is amid episodes that end together."""
        if self._between_episodes or not self.aligned:
            self.save()

    def _on_training_start(self) -> None:
        total, done = self.model._total_timesteps, self.model.num_timesteps
        self._bar = tqdm(total=total, initial=done, desc="train", unit="decision", disable=not self.progress)

    def _on_rollout_start(self) -> None:
        # Stable-Baselines3 draws from the global generators: seeded here, they need not be saved.
        words = np.random.SeedSequence([self.settings.seed, self.model.num_timesteps]).generate_state(2)
        torch.manual_seed(int(words[0]))
        np.random.seed(int(words[1]))  # noqa: NPY002 - the minibatches of Stable-Baselines3
        if not all(torch.isfinite(value).all() for value in network_of(self.model).parameters()):
            raise TrainingError(f"a parameter is not finite after {self.frames} frames; {self._kept()}")
        if self._anew:
            self._begin_anew()
        if self._between_episodes and time.perf_counter() - self._saved >= SAVE_EVERY:
            self.save()

    def _begin_anew(self) -> None:
        """Seldom: who is stuck would else be cut off, and neither be counted nor learn its way out."""
        self.pool.begin(self._steps)
        self.model._last_obs = self.pool.reset()
        self.model._last_episode_starts = np.ones(self.settings.environments, bool)
        self._sums[:] = 0

    @property
    def _steps(self) -> int:
        """Steps of every environment; none has begun as many episodes."""
        return self.model.num_timesteps // self.settings.environments

    @property
    def _anew(self) -> bool:
        return not self.aligned and self._steps % (ANEW_EVERY * self.settings.rollout) == 0

    @property
    def _between_episodes(self) -> bool:
        ended = bool(np.all(self.model._last_episode_starts)) if self.aligned else self._anew
        return self.model.num_timesteps > 0 and ended

    def _on_step(self) -> bool:
        self._sums += self.locals["rewards"] / self.settings.scale
        ends, infos = self.locals["dones"], self.locals["infos"]
        steps = np.array([info.get("steps", 1) for info in infos])
        self.frames += int(steps.sum())
        buffer = self.model.rollout_buffer
        if isinstance(buffer, TimedBuffer):
            buffer.durations[buffer.pos] = steps / self.follow
        self.episode += bool(ends.any())
        self._ended += [(self._sums[k], infos[k]) for k in np.flatnonzero(ends)]
        self._sums[ends] = 0
        self._bar.update(self.settings.environments)
        return True

    def _tell(self) -> None:
        """A row of the curve: means over the episodes that ended."""
        row: dict[str, float] = {"frames": self.frames, "reward": float(np.mean([gained for gained, _ in self._ended]))}
        for name, unit in (("explored_m2", 1), ("success", 100), ("spl", 100)):  # the latter in percent
            values = [unit * info[name] for _, info in self._ended if name in info]
            row |= {name: float(np.mean(values))} if values else {}
        self._ended.clear()
        self.curve.append(row)
        done = f"explored {row['explored_m2']:.0f} m²" if self.aligned else f"success {row['success']:.0f} %"
        self._bar.set_postfix_str(f"reward an episode {row['reward']:.1f}, {done}, {self.frames} frames")
        for name, value in row.items():
            self.logger.record(f"episode/{name}", value)
        self.told(row)

    def _on_rollout_end(self) -> None:
        if self._ended:
            self._tell()
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
    callback: Callable[[dict[str, float]], None] = lambda row: None,
    scenes: Scenes = None,
    start: str | Path | None = None,
) -> Path:
    """Train a policy by PPO on the training apartments, or go on with it.

    Args:
        name: ``modular-<reward>``, ``e2e-<reward>`` or ``pointgoal``.
        folder: of the run; a checkpoint in it is continued.
        settings: without them, those of :func:`~autonerf_lab.training.settings.settings_of`.
        reward: in place of the one in the name. (That of ``pointgoal`` is its environment's.)
        workers: processes; they do not change the result.
        progress: show a bar.
        callback: called with a row of the curve after every rollout in which an episode ended: ``frames``, ``reward``,
            and ``explored_m2``, or ``success`` and ``spl``. What it raises ends the training, as an interrupt does.
        scenes: in place of those of the settings, scenes that have no name, such as the mesh of a field.
        start: weights to begin with, in place of what a teacher shows: of a policy that ships, by its name, or a path.

    Returns:
        The path of the weights, for :func:`autonerf_lab.explore` and :func:`autonerf_lab.policies.make_policy`.

    Raises:
        UnknownNameError: not the name of a policy that is trained, or no such reward.
        RunFolderError: the folder holds another training.
        DataError: the weights to begin with are missing, or of another network.
        TrainingError: a value is not finite, or a worker died; the last checkpoint stays as it was.
    """
    folder, settings = Path(folder), settings or settings_of(name)
    chosen = reward or name.partition("-")[2]
    learning = None if name == POINTGOAL else make_reward(chosen)
    view = make_view(settings.network)
    first = None if start is None else weights_path(str(start))
    if first is not None and not first.exists():
        raise DataError(f"{first} does not exist: begin with a policy that ships, or with a .safetensors of your own")
    decisions_an_update = settings.rollout * settings.environments
    identity = {"policy": name, **json.loads(json.dumps(asdict(replace(settings, frames=0))))}
    if scenes is not None:
        identity["places"] = [scene if isinstance(scene, str) else scene.sha256 for scene in scenes]
    if first is not None:
        identity["start"] = weights_sha256(str(first))
    kept = read_checkpoint(folder / CHECKPOINT, identity)  # before the processes begin: who is refused need not wait
    make = partial(make_env, settings, chosen, scenes)
    started = time.perf_counter()
    pool = WorkerPool(make, settings.environments, workers, settings.seed)
    try:
        ppo = make_ppo(pool, lambda: make_network(settings.network)[1], settings, folder / "tensorboard")
        run = Run(folder, identity, settings, pool, learning, progress, callback)
        run.model = ppo
        if kept:
            run.resume(*kept)
        else:
            network = network_of(ppo)
            if first is not None:
                load_weights(first, network)
            elif settings.demonstrations and isinstance(network, RecurrentNetwork):
                learn_the_way(network, make, settings, progress)
            elif settings.demonstrations:
                imitate(network, demonstrate(view, settings, chosen, progress), settings, progress)
            run.save()
        updates = -(-settings.frames // (view.follow * decisions_an_update))
        remaining = updates * decisions_an_update - ppo.num_timesteps
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
            "command": command_of(name, settings, start) if reward is scenes is None else None,
            "seed": settings.seed,
            "network": settings.network,
            "frames": run.frames,
            "hours": round((run.seconds + time.perf_counter() - started) / 3600, 3),
            "settings": identity,
            "curve": run.curve,
        },
    )
    return folder / "policy"
