"""Environments in worker processes, several in each, as one vector environment of Stable-Baselines3.

Episode ``k`` of environment ``i`` is seeded by the run's seed, ``i`` and ``k``, and by nothing else: at the boundary of
an episode the state of an environment is one number.
"""

import multiprocessing
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
    """``environments`` copies of an environment, divided among ``workers`` processes.

    Args:
        make: makes one; it may be defined in a notebook.
        environments: how many.
        workers: processes.
        seed: of all episodes.

    Raises:
        TrainingError: a worker raised or died; from any method.
    """

    def __init__(self, make: MakeEnv, environments: int, workers: int, seed: int = 0) -> None:
        context = multiprocessing.get_context("spawn")
        self._shares = [list(part) for part in np.array_split(np.arange(environments), min(workers, environments))]
        self._pipes: list[Connection] = []
        self._processes = []
        for share in self._shares:
            here, there = context.Pipe()
            arguments = (there, CloudpickleWrapper(make), [int(i) for i in share], seed)
            process = context.Process(target=_work, args=arguments, daemon=True)
            process.start()
            there.close()
            self._pipes.append(here)
            self._processes.append(process)
        self._send([("spaces",)] * len(self._pipes))
        super().__init__(environments, *self._receive()[0])
        self.begin(0)

    def begin(self, episode: int) -> None:
        """The next :meth:`reset` begins this episode in every environment."""
        self.call("begin", episode)

    def call(self, name: str, *arguments: Any) -> list[Any]:
        """Call a function of the workers; one answer each."""
        self._send([(name, *arguments)] * len(self._pipes))
        return self._receive()

    def reset(self) -> Any:
        """Begin an episode in every environment."""
        answers = [seen for part in self.call("reset") for seen in part]
        return self._stacked(answers)

    def step_async(self, actions: np.ndarray) -> None:
        """Act."""
        self._send([("step", actions[share]) for share in self._shares])

    def step_wait(self) -> Any:
        """Observations, rewards, ends, infos; an episode that is over has begun again."""
        answers = [answer for part in self._receive() for answer in part]
        seen, rewards, ends, infos = zip(*answers, strict=True)
        return self._stacked(seen), np.array(rewards, np.float32), np.array(ends), list(infos)

    def close(self) -> None:
        """End the workers."""
        for pipe, process in zip(self._pipes, self._processes, strict=True):
            pipe.close()  # a worker that reads the end of its pipe ends
            process.join(timeout=5)
            if process.is_alive():
                process.terminate()

    def _stacked(self, seen: Sequence[Any]) -> Any:
        if isinstance(self.observation_space, gymnasium.spaces.Dict):
            return {name: np.stack([one[name] for one in seen]) for name in self.observation_space}
        return np.stack(seen)

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
                fine, answer = pipe.recv()
            except (EOFError, OSError) as error:
                raise self._died(number) from error
            if not fine:
                raise TrainingError(f"worker {number}: {answer}")
            answers.append(answer)
        return answers

    def _died(self, number: int) -> TrainingError:
        process = self._processes[number]
        process.join(timeout=5)
        return TrainingError(
            f"worker {number} (process {process.pid}) died with exit code {process.exitcode}; the same command goes on "
            "from the last checkpoint; out of memory? then with fewer --workers"
        )

    # What Stable-Baselines3 asks of a vector environment, and training does not use.

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Only the render mode, which Stable-Baselines3 asks for."""
        return [None] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Not supported."""
        raise NotImplementedError

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Not supported."""
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """None is."""
        return [False] * self.num_envs


class _Share:
    """The environments of one worker; its methods are what the pool can call."""

    def __init__(self, make: MakeEnv, indices: list[int], seed: int) -> None:
        self.envs: dict[int, Any] = {index: make() for index in indices}
        self.seed = seed
        self.episode = 0
        self.episodes = dict.fromkeys(indices, 0)

    def spaces(self) -> tuple[Any, Any]:
        env = next(iter(self.envs.values()))
        return env.observation_space, env.action_space

    def begin(self, episode: int) -> None:
        self.episodes = dict.fromkeys(self.episodes, episode)

    def reset(self) -> list[Any]:
        return [self._reset(index) for index in self.envs]

    def step(self, actions: np.ndarray) -> list[Any]:
        return [self._step(index, action) for index, action in zip(self.envs, actions, strict=True)]

    def collect(self) -> list[dict[str, np.ndarray]]:
        """What the rewards of the environments have seen."""
        return [env.unwrapped.reward.collect() for env in self.envs.values()]

    def teach(self, state: dict[str, np.ndarray]) -> None:
        """What one of them has learned from it."""
        for env in self.envs.values():
            env.unwrapped.reward.load_state_dict(state)

    def _reset(self, index: int) -> Any:
        words = [self.seed, index, self.episodes[index]]
        self.episodes[index] += 1
        return self.envs[index].reset(seed=int(np.random.SeedSequence(words).generate_state(1)[0]))[0]

    def _step(self, index: int, action: Any) -> tuple[Any, float, bool, dict[str, Any]]:
        seen, value, terminated, truncated, info = self.envs[index].step(action)
        reward = float(value)
        if not np.isfinite(reward):
            raise TrainingError(f"the reward is {reward} in scene {info.get('scene')!r}")
        if terminated or truncated:
            info["terminal_observation"] = seen
            info["TimeLimit.truncated"] = truncated and not terminated
            seen = self._reset(index)
        return seen, reward, terminated or truncated, info


def _work(pipe: Connection, make: CloudpickleWrapper, indices: list[int], seed: int) -> None:
    """Answer until the pool closes the pipe."""
    torch.set_num_threads(1)  # rewards that learn use it; there are as many workers as cores
    share: _Share | None = None
    while True:
        try:
            name, *arguments = pipe.recv()
        except (EOFError, OSError, KeyboardInterrupt):
            return
        try:
            share = share or _Share(make.var, indices, seed)
            pipe.send((True, getattr(share, name)(*arguments)))
        except KeyboardInterrupt:
            return
        except Exception as error:  # whatever a reward or a scene raises; the pool tells it
            pipe.send((False, f"{type(error).__name__}: {error}"))
