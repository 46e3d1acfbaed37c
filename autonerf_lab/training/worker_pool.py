"""Vector environment for Stable-Baselines3: several environments in each of several worker processes.

The seed of episode ``k`` of environment ``i`` depends only on the seed of the training, ``i`` and ``k``. Between two
episodes, ``k`` is therefore the only state of an environment.
"""

import multiprocessing
import sys
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3.common.vec_env import CloudpickleWrapper, VecEnv

from autonerf_lab.errors import TrainingError

MakeEnv = Callable[[], gymnasium.Env]


class WorkerPool(VecEnv):
    """Copies of an environment, divided among worker processes.

    Args:
        make: makes one environment; it may be defined in a notebook.
        environments: number of environments.
        workers: number of worker processes.
        seed: random seed of all episodes.

    Raises:
        TrainingError: from any method, if a worker raised an exception or died.
    """

    def __init__(self, make: MakeEnv, environments: int, workers: int, seed: int = 0) -> None:
        context = _process_context()
        self._shares = [list(part) for part in np.array_split(np.arange(environments), min(workers, environments))]
        self._pipes: list[Connection] = []
        self._processes = []
        for share in self._shares:
            here, there = context.Pipe()
            arguments = (there, CloudpickleWrapper(make), [int(i) for i in share], seed)
            process = context.Process(target=_run_worker, args=arguments, daemon=True)
            process.start()
            there.close()
            self._pipes.append(here)
            self._processes.append(process)
        try:
            self._send([("spaces",)] * len(self._pipes))
            super().__init__(environments, *self._receive()[0])
            self.set_episode(0)
        except BaseException:
            self.close()
            raise

    def set_episode(self, episode: int) -> None:
        """Set the number of the episode that the next :meth:`reset` begins."""
        self.call("set_episode", episode)

    def call(self, name: str, *arguments: Any) -> list[Any]:
        """Call a method of :class:`_Worker` in every process; return one result per process."""
        self._send([(name, *arguments)] * len(self._pipes))
        return self._receive()

    def reset(self) -> Any:
        """Begin an episode in every environment and return the stacked observations."""
        return self._stacked([obs for part in self.call("reset") for obs in part])

    def step_async(self, actions: np.ndarray) -> None:
        """Send the actions to the workers."""
        self._send([("step", actions[share]) for share in self._shares])

    def step_wait(self) -> Any:
        """Return observations, rewards, ends and infos; environments whose episode ended are already reset."""
        answers = [answer for part in self._receive() for answer in part]
        observations, rewards, ends, infos = zip(*answers, strict=True)
        return self._stacked(observations), np.array(rewards, np.float32), np.array(ends), list(infos)

    def close(self) -> None:
        """Stop the worker processes."""
        for pipe, process in zip(self._pipes, self._processes, strict=True):
            pipe.close()  # a worker stops at the end of its pipe
            process.join(timeout=5)
            if process.is_alive():
                process.terminate()

    def _stacked(self, observations: Sequence[Any]) -> Any:
        if isinstance(self.observation_space, gymnasium.spaces.Dict):
            return {name: np.stack([obs[name] for obs in observations]) for name in self.observation_space}
        return np.stack(observations)

    def _send(self, messages: Sequence[tuple[Any, ...]]) -> None:
        for number, (pipe, message) in enumerate(zip(self._pipes, messages, strict=True)):
            try:
                pipe.send(message)
            except OSError as error:
                raise self._died(number) from error

    def _receive(self) -> list[Any]:
        answers = []
        for number, pipe in enumerate(self._pipes):
            try:
                succeeded, answer = pipe.recv()
            except (EOFError, OSError) as error:
                raise self._died(number) from error
            if not succeeded:
                raise TrainingError(f"worker {number}: {answer}")
            answers.append(answer)
        return answers

    def _died(self, number: int) -> TrainingError:
        process = self._processes[number]
        process.join(timeout=5)
        return TrainingError(
            f"worker {number} (process {process.pid}) died with exit code {process.exitcode}; train again to resume "
            "from the last checkpoint, with fewer workers if the memory was exhausted"
        )

    # Abstract methods of Stable-Baselines3 that training does not use.

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return None for every environment; Stable-Baselines3 asks for the render mode."""
        return [None] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Raise NotImplementedError."""
        raise NotImplementedError

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Raise NotImplementedError."""
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Return False for every environment."""
        return [False] * self.num_envs


class _Worker:
    """Environments of one process; the pool calls its public methods by name."""

    def __init__(self, make: MakeEnv, indices: list[int], seed: int) -> None:
        self.envs: dict[int, Any] = {index: make() for index in indices}
        self.seed = seed
        self.episodes = dict.fromkeys(indices, 0)

    def spaces(self) -> tuple[Any, Any]:
        """Return the observation space and the action space."""
        env = next(iter(self.envs.values()))
        return env.observation_space, env.action_space

    def set_episode(self, episode: int) -> None:
        """Set the number of the next episode of every environment."""
        self.episodes = dict.fromkeys(self.episodes, episode)

    def reset(self) -> list[Any]:
        """Begin an episode in every environment; return the observations."""
        return [self._reset(index) for index in self.envs]

    def step(self, actions: np.ndarray) -> list[Any]:
        """Apply one action in every environment."""
        return [self._step(index, action) for index, action in zip(self.envs, actions, strict=True)]

    def collect_samples(self) -> list[dict[str, np.ndarray]]:
        """Collect the samples of the learned rewards."""
        return [env.unwrapped.reward.collect() for env in self.envs.values()]

    def load_reward_state(self, state: dict[str, np.ndarray]) -> None:
        """Load a state into the learned rewards."""
        for env in self.envs.values():
            env.unwrapped.reward.load_state_dict(state)

    def _reset(self, index: int) -> Any:
        words = [self.seed, index, self.episodes[index]]
        self.episodes[index] += 1
        return self.envs[index].reset(seed=int(np.random.SeedSequence(words).generate_state(1)[0]))[0]

    def _step(self, index: int, action: Any) -> tuple[Any, float, bool, dict[str, Any]]:
        obs, value, terminated, truncated, info = self.envs[index].step(action)
        reward = float(value)
        if not np.isfinite(reward):
            raise TrainingError(f"the reward is {reward} in scene {info.get('scene')!r}")
        if terminated or truncated:
            info["terminal_observation"] = obs
            info["TimeLimit.truncated"] = truncated and not terminated
            obs = self._reset(index)
        return obs, reward, terminated or truncated, info


def _process_context() -> Any:
    """Return the way to start workers: on Linux, copies of a process that has loaded this module.

    They start in milliseconds instead of seconds and share the memory of the libraries.
    """
    if sys.platform != "linux":  # Windows cannot copy a process, and libraries of macOS may crash in a copy
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__, "autonerf_lab.envs.explore"])
    return context


def _run_worker(pipe: Connection, make: CloudpickleWrapper, indices: list[int], seed: int) -> None:
    """Execute calls of the pool until it closes the pipe."""
    torch.set_num_threads(1)  # learned rewards use torch, and there is one worker per core
    worker: _Worker | None = None
    while True:
        try:
            name, *arguments = pipe.recv()
        except (EOFError, OSError, KeyboardInterrupt):
            return
        try:
            worker = worker or _Worker(make.var, indices, seed)
            pipe.send((True, getattr(worker, name)(*arguments)))
        except (BrokenPipeError, KeyboardInterrupt):  # the process of the training was killed, or Ctrl-C
            return
        except Exception as error:  # any error of a reward or a scene; the pool raises it again
            pipe.send((False, f"{type(error).__name__}: {error}"))
