"""Training of policies: the vector environment, interruptions and errors."""

import multiprocessing
import os
import signal
from dataclasses import replace
from functools import partial

import gymnasium
import numpy as np
import pandas as pd
import pytest
import torch
from interrupted_training import TINY
from safetensors.numpy import load_file
from stable_baselines3.common.buffers import DictRolloutBuffer
from toy_scene import to_scene, two_rooms

from autonerf_lab import cli
from autonerf_lab.data.trajectory import load_trajectory
from autonerf_lab.envs import ENVS
from autonerf_lab.errors import DataError, RunFolderError, TrainingError, UnknownNameError
from autonerf_lab.geometry import planar_pose
from autonerf_lab.mapping import empty_map
from autonerf_lab.policies import load_policy, make_policy
from autonerf_lab.policies.interfaces import CompactInterface
from autonerf_lab.policies.networks import RecurrentNetwork
from autonerf_lab.policies.spec import SPECS, make_interface, make_network
from autonerf_lab.policies.weights import load_weights, read_meta, save_weights
from autonerf_lab.training import session, shortest_path_expert, train
from autonerf_lab.training.augmentation import SymmetryAugmentation
from autonerf_lab.training.ppo import TimedBuffer
from autonerf_lab.training.settings import settings_of
from autonerf_lab.training.worker_pool import WorkerPool
from autonerf_lab.types import Observation

# Four updates, two in each episode; the scene is a toy, because every worker would bake the texture of a frozen one.
RECURRENT = settings_of("e2e-cov", frames=80, environments=2, rollout=10, epochs=1, batch=8, sensor=16, episode=20)
GOALS = settings_of(
    "pointgoal",
    frames=120,
    environments=2,
    rollout=20,
    epochs=1,
    batch=16,
    episode=30,
    demonstrations=3,
    scenes=("dev-1",),
)
make_tiny = partial(train.make_env, TINY, "cov")


def reachable(obs: dict, number: int) -> int:
    """Return the index of the ``number``-th reachable block."""
    row, col = np.argwhere(obs["reach"][0])[number]
    return int(row * CompactInterface.GRID + col)


def test_the_pool_equals_a_loop_over_environments():
    pool = WorkerPool(make_tiny, environments=3, workers=2, seed=5)
    try:
        seen = pool.reset()
        for index in range(3):
            env, episode = make_tiny(), 0
            here = env.reset(seed=int(np.random.SeedSequence([5, index, episode]).generate_state(1)[0]))[0]
            np.testing.assert_array_equal(seen["reach"][index], here["reach"])
        actions = np.array([reachable({"reach": seen["reach"][i]}, 0) for i in range(3)])
        _, rewards, ends, _ = pool.step(actions)
        assert not ends.any()
        there, reward, _, truncated, _ = env.step(actions[2])
        assert rewards[2] == np.float32(reward) and not truncated
        again, rewards, ends, infos = pool.step(actions)
        there, reward, _, truncated, _ = env.step(actions[2])
        assert rewards[2] == np.float32(reward) and truncated and ends.all()
        assert infos[2]["TimeLimit.truncated"]
        np.testing.assert_array_equal(infos[2]["terminal_observation"]["map"], there["map"])
        fresh = env.reset(seed=int(np.random.SeedSequence([5, 2, 1]).generate_state(1)[0]))[0]
        np.testing.assert_array_equal(again["map"][2], fresh["map"])
    finally:
        pool.close()


def test_the_initial_turns_do_not_count_as_decisions():
    env = train.make_env(TINY, "cov")
    seen, _ = env.reset(seed=0)
    steps, over = [], False
    while not over:
        seen, _, _, over, info = env.step(reachable(seen, 0))
        steps.append(info["steps"])
    assert len(steps) == TINY.episode
    assert env.unwrapped.observation.step == 9 + sum(steps) <= env.unwrapped._max_steps == 9 + 12 * TINY.episode


def broken(transition):
    raise ZeroDivisionError("in my reward")


@pytest.mark.parametrize(
    ("reward", "message"), [(lambda transition: float("nan"), "nan"), (broken, "ZeroDivisionError: in my reward")]
)
def test_errors_of_a_reward_name_the_worker(reward, message):
    pool = WorkerPool(partial(train.make_env, TINY, reward), environments=2, workers=1)
    try:
        with pytest.raises(TrainingError, match=f"worker 0.*{message}"):
            pool.reset()  # the initial turns are rewarded too
    finally:
        pool.close()


def test_workers_end_if_one_cannot_make_its_environment():
    before = {process.pid for process in multiprocessing.active_children()}
    with pytest.raises(TrainingError, match=r"worker 0.*nowhere"):
        WorkerPool(partial(train.make_env, replace(TINY, scenes=("nowhere",)), "cov"), environments=2, workers=2)
    assert {process.pid for process in multiprocessing.active_children()} <= before


def test_a_dead_worker_is_named():
    pool = WorkerPool(make_tiny, environments=2, workers=2)
    try:
        pool.reset()
        os.kill(pool._processes[1].pid, signal.SIGKILL)
        with pytest.raises(TrainingError, match=r"worker 1 .*exit code -9.*last checkpoint"):
            pool.step(np.zeros(2, int))
    finally:
        pool.close()


def weights_of(path):
    return load_file(f"{path}.safetensors")


@pytest.mark.parametrize(
    ("name", "settings", "last"),
    [
        ("modular-cov", replace(TINY, demonstrations=1), "score"),
        ("e2e-rec+0.1*nov+0.1*cur", RECURRENT, "actor"),
        ("pointgoal", GOALS, "actor"),
    ],
)
def test_a_resumed_training_is_bit_identical(name, settings, last, tmp_path, monkeypatch):
    monkeypatch.setattr(session, "RESTART_EVERY", 2)  # for pointgoal: the third rollout begins between episodes
    scenes = [to_scene(two_rooms())] if settings is RECURRENT else None
    run = partial(train.train_policy, name, progress=False, scenes=scenes)
    whole = run(tmp_path / "whole", settings, workers=1)
    monkeypatch.setattr(session, "SAVE_EVERY", 0.0)
    original = session.TrainingSession._on_rollout_end
    rollouts = []

    def stop_in_the_third(run):
        rollouts.append(run)
        if len(rollouts) == 3:
            raise KeyboardInterrupt
        original(run)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(session.TrainingSession, "_on_rollout_end", stop_in_the_third)
        run(tmp_path / "parts", settings, workers=2)
    assert (tmp_path / "parts" / train.CHECKPOINT).exists()
    parts = run(tmp_path / "parts", settings, workers=1)
    before, after = weights_of(whole), weights_of(parts)
    assert before.keys() == after.keys()
    assert all(np.array_equal(before[name], after[name]) for name in before)
    assert (tmp_path / "whole/curve.csv").read_text() == (tmp_path / "parts/curve.csv").read_text()
    assert np.abs(after[f"{last}.weight"]).max() > 0  # it was trained
    checkpoint = load_file(tmp_path / "parts" / train.CHECKPOINT)
    assert all(
        np.array_equal(checkpoint[f"parameter/{name}"].astype(np.float16), value) for name, value in after.items()
    )

    with pytest.raises(RunFolderError, match=r"checkpoint.*\(lr differ\)"):
        run(tmp_path / "parts", replace(settings, lr=2e-3), workers=1)
    with monkeypatch.context() as patch, pytest.raises(RunFolderError, match=r"checkpoint.*\(version differ\)"):
        patch.setattr(train, "__version__", "0.1.0")
        run(tmp_path / "parts", settings, workers=1)
    (tmp_path / "parts" / train.CHECKPOINT).write_bytes(b"\x10\0\0\0\0\0\0\0 not safetensors")
    with pytest.raises(DataError, match=r"checkpoint.safetensors is damaged"):
        run(tmp_path / "parts", settings, workers=1)


def test_a_resumed_imitation_is_bit_identical(tmp_path, monkeypatch):
    run = partial(train.train_policy, "pointgoal", progress=False, workers=1)
    settings = replace(GOALS, frames=0, demonstrations=4)
    monkeypatch.setattr(shortest_path_expert, "STEPS", 8)  # the third update is in the middle of the first episodes
    whole = run(tmp_path / "whole", settings)
    monkeypatch.setattr(shortest_path_expert, "SAVE_EVERY", 0.0)
    original, calls = shortest_path_expert.Imitation.advance, []

    def stop_in_the_third(imitation):
        calls.append(imitation)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return original(imitation)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(shortest_path_expert.Imitation, "advance", stop_in_the_third)
        run(tmp_path / "parts", settings)
    saved = tmp_path / "parts" / train.IMITATION
    content = saved.read_bytes()
    assert {len(episode.actions) for episode in calls[0].episodes} == {16}

    with pytest.raises(RunFolderError, match=r"imitation.*\(lr differ\)"):
        run(tmp_path / "parts", replace(settings, lr=2e-3))
    for damage in (lambda name: name.replace(b"hidden", b"hiddem"), lambda name: name.replace(b"PCG64", b"PCG65")):
        saved.write_bytes(damage(content))
        with pytest.raises(DataError, match=r"imitation.safetensors is damaged .*; remove it to start"):
            run(tmp_path / "parts", settings)
    saved.write_bytes(content)

    parts = run(tmp_path / "parts", settings)
    before, after = weights_of(whole), weights_of(parts)
    assert all(np.array_equal(before[name], after[name]) for name in before)
    assert not saved.exists() and (tmp_path / "parts" / train.CHECKPOINT).exists()


def test_episodes_longer_than_a_rollout_run_to_their_end(tmp_path, monkeypatch):
    settings = replace(GOALS, frames=256, rollout=4, batch=8, episode=6, demonstrations=0)
    ended: list[dict] = []
    original = session.TrainingSession._add_row

    def listen(run):
        ended.extend(run._ended)
        original(run)

    monkeypatch.setattr(session.TrainingSession, "_add_row", listen)
    train.train_policy("pointgoal", tmp_path, settings, workers=1, progress=False)
    out_of_steps = [info for info in ended if info["TimeLimit.truncated"]]
    assert len(out_of_steps) >= 3  # random actions contain no stop in 6 steps with probability 0.18
    assert len(out_of_steps) < len(ended)


def test_a_parameter_that_is_not_finite_stops_the_training_and_keeps_the_checkpoint(tmp_path, monkeypatch):
    monkeypatch.setattr(session, "SAVE_EVERY", 0.0)
    finished = session.TrainingSession._on_rollout_end

    def poison(run):
        finished(run)
        if (tmp_path / train.CHECKPOINT).exists():
            with torch.no_grad():
                run.model.policy.network.first.weight[0] = torch.nan

    monkeypatch.setattr(session.TrainingSession, "_on_rollout_end", poison)
    with pytest.raises(TrainingError, match=r"not finite after .* frames; .*checkpoint.safetensors is the last good"):
        train.train_policy("modular-cov", tmp_path, TINY, workers=1, progress=False)
    kept = load_file(tmp_path / train.CHECKPOINT)
    assert all(np.isfinite(array).all() for array in kept.values())


def test_a_symmetry_transforms_observations_and_inverts_actions():
    env = SymmetryAugmentation(train.make_env(TINY, "cov").env)
    rng = np.random.default_rng(0)
    kinds = set()
    for seed in range(12):
        seen, _ = env.reset(seed=seed)
        kinds.add(env.symmetry)
        plain = CompactInterface().observe(env.unwrapped.map)
        assert np.sort(plain["reach"][2].ravel()).tolist() == np.sort(seen["reach"][2].ravel()).tolist()
        # explored ground ahead of the robot stays ahead
        for shown in (plain, seen):
            rows, cols = np.nonzero(shown["map"][1] > 0)
            middle = (CompactInterface.GRID - 1) / 2
            shown["ahead"] = ((cols - middle) * shown["heading"][0] + (rows - middle) * shown["heading"][1]).sum()
        assert seen["ahead"] == pytest.approx(plain["ahead"], rel=1e-4)
        choice = reachable(seen, int(rng.integers(seen["reach"][0].sum())))
        way = seen["reach"][1].ravel()[choice]
        _, _, _, _, info = env.step(choice)
        block = CompactInterface()
        goals = [a for a in range(block.GRID**2) if plain["reach"][0].ravel()[a]]
        same = [a for a in goals if plain["reach"][1].ravel()[a] == way]
        env.reset(seed=seed)
        assert any(np.allclose(block.to_waypoint(a, env.unwrapped.map), info["waypoint"]) for a in same)
    assert len(kinds) >= 6


def filled_buffer(kind, rewards, values, starts):
    space = gymnasium.spaces.Dict({"x": gymnasium.spaces.Box(0, 1, (1,))})
    buffer = kind(len(rewards), space, gymnasium.spaces.Discrete(2), gamma=0.9, gae_lambda=0.5, n_envs=1)
    buffer.reset()
    for reward, value, start in zip(rewards, values, starts, strict=True):
        seen, action, one = {"x": np.zeros((1, 1))}, np.zeros((1, 1)), torch.zeros(1)
        buffer.add(seen, action, np.array([reward]), np.array([start]), torch.tensor([value]), one)
    return buffer


def test_the_discount_depends_on_the_duration():
    plain, timed = (
        filled_buffer(kind, [1.0, 2.0, 4.0], [0.5, 1.0, 3.0], [1, 0, 1]) for kind in (DictRolloutBuffer, TimedBuffer)
    )
    for buffer in (plain, timed):
        buffer.compute_returns_and_advantage(torch.tensor([[2.0]]), np.array([0.0]))
    np.testing.assert_allclose(timed.advantages, plain.advantages, rtol=1e-6)
    np.testing.assert_allclose(timed.returns, plain.returns, rtol=1e-6)
    timed.durations[:, 0] = [0.5, 1.0, 2.0]
    timed.compute_returns_and_advantage(torch.tensor([[2.0]]), np.array([0.0]))
    last = 4 + 0.81 * 2 - 3
    middle = 2 - 1  # the episode ends after it
    first = 1 + 0.9**0.5 * 1 - 0.5 + 0.9**0.5 * 0.5 * middle
    np.testing.assert_allclose(timed.advantages[:, 0], [first, middle, last], rtol=1e-6)


def test_end_to_end_policies_have_no_teacher():
    with pytest.raises(ValueError, match="e2e policies have no teacher"):
        settings_of("e2e-cov", demonstrations=3)


def test_errors_of_weights(tmp_path):
    _, network = make_network({"kind": "compact"})
    save_weights(tmp_path / "mine", network, {"policy": "modular-cov", "network": {"kind": "compact"}})
    assert make_policy(str(tmp_path / "mine.safetensors")).waypoint is None
    _, other = make_network({"kind": "paper", "window": 48})
    with pytest.raises(DataError, match=r"belongs to another network.*network settings"):
        load_weights(tmp_path / "mine", other)
    with pytest.raises(DataError, match=r"nothing.json does not exist"):
        load_policy(tmp_path / "nothing")
    (tmp_path / "mine.safetensors").write_bytes(b"rubbish")
    with pytest.raises(DataError, match=r"not a readable safetensors"):
        load_policy(tmp_path / "mine")
    with torch.no_grad():
        network.score.bias[0] = torch.inf
    save_weights(tmp_path / "mine", network, {"policy": "modular-cov", "network": {"kind": "compact"}})
    with pytest.raises(DataError, match="not finite"):
        load_policy(tmp_path / "mine")


def test_an_end_to_end_policy_has_a_recurrent_state_per_episode(tmp_path):
    _, network = make_network({"kind": "egocentric"})
    with torch.no_grad():
        network.actor.weight.normal_()
    save_weights(tmp_path / "mine", network, {"policy": "e2e-cov", "network": {"kind": "egocentric"}})
    policy = load_policy(tmp_path / "mine")
    start = planar_pose(0, 0, 0)
    rng = np.random.default_rng(0)
    images = [rng.integers(256, size=(84, 84, 3)).astype(np.uint8) for _ in range(12)]
    rollouts = []
    for _ in range(2):
        policy.reset(np.random.default_rng(3))
        shown = [Observation(image, np.ones((84, 84)), np.zeros((84, 84)), start) for image in images]
        rollouts.append([policy.act(empty_map(start), observation) for observation in shown])
    assert rollouts[0] == rollouts[1] and len(set(rollouts[0])) > 1
    assert policy._memory[0].abs().max() > 0


def test_explore_with_the_path_of_weights(tmp_path, capsys):
    _, network = make_network({"kind": "compact"})
    save_weights(tmp_path / "mine", network, {"policy": "modular-cov", "network": {"kind": "compact"}})
    run = ["explore", "--policy", f"{tmp_path}/mine.safetensors", "--preset", "smoke", "--out", f"{tmp_path}/run"]
    assert cli.main(run) == 0
    assert load_trajectory(tmp_path / "run" / "trajectory").meta["policy"].endswith("mine.safetensors")
    assert cli.main([*run[:2], f"{tmp_path}/other.safetensors", "--out", f"{tmp_path}/other"]) == 1
    assert "other.json does not exist" in capsys.readouterr().err


def test_the_callback_gets_the_learning_curve_and_can_stop_the_training(tmp_path):
    told = []
    train.train_policy("modular-cov", tmp_path / "whole", TINY, workers=1, progress=False, callback=told.append)
    assert told == read_meta(tmp_path / "whole" / "policy")["curve"] and len(told) == 4

    def stop(row):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train.train_policy("modular-cov", tmp_path / "part", TINY, workers=1, progress=False, callback=stop)
    assert not (tmp_path / "part" / "policy.json").exists()


@pytest.mark.parametrize("frames", [1, 48, 60, 110])
def test_frames_are_robot_actions_rounded_up_to_whole_rollouts(frames, tmp_path):
    settings = replace(TINY, frames=frames)
    weights = train.train_policy("modular-cov", tmp_path, settings, workers=1, progress=False)
    rollouts = [0, *pd.read_csv(tmp_path / "curve.csv").frames]
    assert rollouts[-2] < frames <= rollouts[-1] == read_meta(weights)["frames"]
    assert 4 * len(rollouts[1:]) <= rollouts[-1] <= 48 * len(rollouts[1:])  # 2 x 2 decisions of 1 to 12 actions


@pytest.mark.parametrize("kind", SPECS)
def test_every_spec_is_complete(kind):
    spec = SPECS[kind]
    assert spec.environment in ENVS and (spec.teacher is None or spec.teacher in train.TEACHERS)
    interface, network = make_network({"kind": kind} | ({"window": 48} if kind == "paper" else {}))
    assert isinstance(network, RecurrentNetwork) == spec.recurrent
    assert (spec.policy is None) == (spec.rewards is None)
    name = spec.name if spec.rewards is None else f"{spec.name}-{next(iter(spec.rewards))}"
    assert SPECS[settings_of(name).network["kind"]].name == spec.name
    if spec.policy is not None:
        assert spec.policy(interface, network).waypoint is None
    with pytest.raises(UnknownNameError, match="unknown kind of network 'other'; valid names: compact, egocentric"):
        make_interface({"kind": "other"})
