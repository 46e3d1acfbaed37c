"""State of a running policy training: seeds, checkpoints, the learning curve and learned rewards."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
import torch
from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from tqdm import tqdm

from autonerf_lab.errors import DataError, TrainingError
from autonerf_lab.policies.spec import make_interface, spec_of
from autonerf_lab.rewards import LearnedReward, Reward
from autonerf_lab.training.checkpoint import CHECKPOINT, load_training_state, training_state
from autonerf_lab.training.ppo import TimedBuffer, network_of
from autonerf_lab.training.settings import PolicySettings
from autonerf_lab.training.worker_pool import WorkerPool
from autonerf_lab.utils.storage import write_arrays

SAVE_EVERY = 60.0  # seconds between two checkpoints
RESTART_EVERY = 16  # rollouts between two restarts of all episodes, if episodes end at different times
_REWARD_PREFIX = "reward/"  # of the arrays of a learned reward in a checkpoint


_Count = Annotated[int, msgspec.Meta(ge=0, le=1 << 53)]


@dataclass(frozen=True)
class CheckpointHeader:
    """Header of the checkpoint of a policy training."""

    fingerprint: dict[str, Any]
    curve: list[dict[str, int | float]]
    episode: _Count
    frames: _Count
    seconds: float
    timesteps: _Count
    updates: _Count


class TrainingSession(BaseCallback):
    """Callback of PPO for seeds, checkpoints, the learning curve, learned rewards and the progress bar.

    Args:
        folder: folder of the checkpoint.
        fingerprint: policy, settings and inputs of the training, to recognise its checkpoint.
        settings: settings of the training.
        pool: environments.
        reward: reward of the training; if it is learned, this copy learns. None if the environment has its own.
        progress: show a progress bar.
        on_row: called with every row of the learning curve.
    """

    def __init__(
        self,
        folder: Path,
        fingerprint: dict[str, Any],
        settings: PolicySettings,
        pool: WorkerPool,
        reward: Reward | None,
        progress: bool,
        on_row: Callable[[dict[str, float]], None],
    ) -> None:
        super().__init__()
        self.model: PPO | RecurrentPPO
        self.folder, self.fingerprint, self.settings = folder, fingerprint, settings
        self.pool, self.progress, self.on_row = pool, progress, on_row
        self.reward = reward if isinstance(reward, LearnedReward) else None
        self.curve: list[dict[str, float]] = []
        self.frames = 0  # robot actions so far
        self.follow: int = make_interface(settings.network).follow
        self.aligned = spec_of(settings.network).fixed_length  # the episodes of all environments end together
        self.episode, self.seconds = 0, 0.0
        # Sum of the rewards and discounted return of each running episode, and the discount of its next reward.
        self._sums, self._returns, self._discounts = (np.zeros(settings.environments) for _ in range(3))
        self._begin(np.ones(settings.environments, bool))
        self._ended: list[dict[str, Any]] = []  # rewards, returns and infos of the episodes of this rollout
        self._saved = self._started = time.perf_counter()
        self._threads = torch.get_num_threads()

    def resume(self, arrays: dict[str, np.ndarray], header: CheckpointHeader) -> None:
        """Load a checkpoint.

        Raises:
            DataError: the checkpoint is damaged.
        """
        try:
            load_training_state(network_of(self.model), self.model.policy.optimizer, arrays)
            if self.reward:
                learned = {k.removeprefix(_REWARD_PREFIX): v for k, v in arrays.items() if k.startswith(_REWARD_PREFIX)}
                self.reward.load_state_dict(learned)
                self.share_reward()
        except (KeyError, TypeError, ValueError, RuntimeError) as error:  # RuntimeError: another shape
            raise DataError(
                f"{self.folder / CHECKPOINT} is damaged ({error!r}); remove it to start the training again"
            ) from error
        self.curve, self.episode, self.seconds = header.curve, header.episode, header.seconds
        self.frames = header.frames
        self.model.num_timesteps, self.model._n_updates = header.timesteps, header.updates
        self.pool.set_episode(self.episode if self.aligned else self._steps)

    def share_reward(self) -> None:
        """Give the state of a learned reward to the copies of all environments."""
        if self.reward:
            self.pool.call("load_reward_state", self.reward.state_dict())

    def save(self) -> None:
        """Write the checkpoint; call it only between two episodes, or before the first."""
        header = {
            "fingerprint": self.fingerprint,
            "curve": self.curve,
            "episode": self.episode,
            "frames": self.frames,
            "seconds": self.seconds + time.perf_counter() - self._started,
            "timesteps": self.model.num_timesteps,
            "updates": self.model._n_updates,
        }
        learned = self.reward.state_dict() if self.reward else {}
        state = training_state(network_of(self.model), self.model.policy.optimizer)
        arrays = state | {_REWARD_PREFIX + name: array for name, array in learned.items()}
        write_arrays(self.folder / CHECKPOINT, arrays, header)
        self._saved = time.perf_counter()

    def remaining(self) -> float:
        """Return the share of the frames that remains."""
        return max(0.0, 1 - self.frames / self.settings.frames) if self.settings.frames else 0.0

    def _on_training_start(self) -> None:
        total = self.settings.frames
        self._bar = tqdm(total=total, initial=self.frames, desc="train", unit="frame", disable=not self.progress)

    def _on_rollout_start(self) -> None:
        self._over = not self.remaining()
        if self._over:
            if self._between_episodes or not self.aligned:
                self.save()  # to extend the training later
            return
        # Stable-Baselines3 uses the global generators. Seeding them here makes saving their state unnecessary.
        words = np.random.SeedSequence([self.settings.seed, self.model.num_timesteps]).generate_state(2)
        torch.manual_seed(int(words[0]))
        np.random.seed(int(words[1]))  # noqa: NPY002 - the minibatches of Stable-Baselines3
        if not all(torch.isfinite(value).all() for value in network_of(self.model).parameters()):
            raise TrainingError(f"a parameter is not finite after {self.frames} frames; {self._last_checkpoint()}")
        # The workers need the cores during a rollout: waiting threads of torch would take time from them.
        torch.set_num_threads(1)
        if self._restart_due:
            self._restart()
        if self._between_episodes and time.perf_counter() - self._saved >= SAVE_EVERY:
            self.save()

    def _restart(self) -> None:
        """Restart all episodes. This is done rarely, so that stuck episodes reach their time limit."""
        self.pool.set_episode(self._steps)
        self.model._last_obs = self.pool.reset()
        self.model._last_episode_starts = np.ones(self.settings.environments, bool)
        self._begin(np.ones(self.settings.environments, bool))

    def _begin(self, which: np.ndarray) -> None:
        self._sums[which], self._returns[which], self._discounts[which] = 0, 0, 1

    @property
    def _steps(self) -> int:
        """Decisions per environment so far, an upper bound of its number of episodes."""
        return self.model.num_timesteps // self.settings.environments

    @property
    def _restart_due(self) -> bool:
        return not self.aligned and self._steps % (RESTART_EVERY * self.settings.rollout) == 0

    @property
    def _between_episodes(self) -> bool:
        ended = bool(np.all(self.model._last_episode_starts)) if self.aligned else self._restart_due
        return self.model.num_timesteps > 0 and ended

    def _on_step(self) -> bool:
        if self._over:
            return False
        rewards, ends, infos = self.locals["rewards"] / self.settings.scale, self.locals["dones"], self.locals["infos"]
        steps = np.array([info.get("steps", 1) for info in infos])
        durations = steps / self.follow  # in decisions of maximum duration
        self._sums += rewards
        self._returns += self._discounts * rewards
        self._discounts *= self.settings.gamma**durations
        taken = int(steps.sum())
        self.frames += taken
        buffer = self.model.rollout_buffer
        if isinstance(buffer, TimedBuffer):
            buffer.durations[buffer.pos] = durations
        self.episode += bool(ends.any())
        for k in np.flatnonzero(ends):
            self._ended.append(infos[k] | {"reward": self._sums[k], "return": self._returns[k]})
        self._begin(ends)
        self._bar.update(taken)
        return True

    def _add_row(self) -> None:
        """Add a row to the learning curve: means over the episodes that ended in this rollout."""
        row: dict[str, float] = {"frames": self.frames}
        units = {"reward": 1, "return": 1, "explored_m2": 1, "success": 100, "spl": 100}  # success and SPL in percent
        for name, unit in units.items():
            values = [unit * ended[name] for ended in self._ended if name in ended]
            row |= {name: float(np.mean(values))} if values else {}
        self._ended.clear()
        self.curve.append(row)
        result = f"explored {row['explored_m2']:.0f} m²" if self.aligned else f"success {row['success']:.0f} %"
        self._bar.set_postfix_str(f"reward per episode {row['reward']:.1f}, {result}")
        for name, value in row.items():
            self.logger.record(f"episode/{name}", value)
        self.on_row(row)

    def _on_rollout_end(self) -> None:
        torch.set_num_threads(self._threads)
        if self._ended:
            self._add_row()
        buffer = self.model.rollout_buffer
        for name in ("rewards", "values", "returns"):
            if not np.isfinite(getattr(buffer, name)).all():
                raise TrainingError(f"{name} are not finite after {self.frames} frames; {self._last_checkpoint()}")
        if self.reward:
            batches = [batch for part in self.pool.call("collect_samples") for batch in part]
            losses = self.reward.update({k: np.concatenate([batch[k] for batch in batches]) for k in batches[0]})
            for name, value in losses.items():
                self.logger.record(f"reward/{name}", value)
            self.share_reward()

    def _on_training_end(self) -> None:
        self._bar.close()

    def _last_checkpoint(self) -> str:
        path = self.folder / CHECKPOINT
        return f"{path} is the last good state" if path.exists() else "there is no checkpoint yet"
