"""Training of policies: the vector environment against a loop, and runs that are stopped, killed and disturbed."""

import os
import signal
from dataclasses import replace
from functools import partial

import gymnasium
import numpy as np
import pytest
import torch
from safetensors.numpy import load_file
from stable_baselines3.common.buffers import DictRolloutBuffer

from autonerf_lab import cli
from autonerf_lab.data.trajectory import load_trajectory
from autonerf_lab.envs.explore import ExploreEnv
from autonerf_lab.errors import DataError, RunFolderError, TrainingError
from autonerf_lab.geometry import planar_pose
from autonerf_lab.mapping import empty_map
from autonerf_lab.policies import load_policy, make_policy
from autonerf_lab.policies.interfaces import CompactView
from autonerf_lab.policies.networks import make_network
from autonerf_lab.policies.weights import load_weights, read_meta, save_weights
from autonerf_lab.training import imitation, train
from autonerf_lab.training.augmentation import Symmetry
from autonerf_lab.training.ppo import TimedBuffer
from autonerf_lab.training.settings import PolicySettings, settings_of
from autonerf_lab.training.worker_pool import WorkerPool
from autonerf_lab.types import Observation

TINY = PolicySettings(
    frames=180, demonstrations=0, environments=2, episode=2, rollout=2, epochs=1, batch=4, sensor=16, target_kl=None
)
RECURRENT = settings_of(
    "e2e-cov", frames=120, environments=2, rollout=10, epochs=1, batch=8, sensor=16, episode=20, scenes=("train-00",)
)
TO_GOALS = settings_of(
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


def place(seen: dict, number: int) -> int:
    """The ``number``-th block that can be reached."""
    row, col = np.argwhere(seen["reach"][0])[number]
    return int(row * CompactView.GRID + col)


def test_workers_answer_as_a_loop_does():
    pool = WorkerPool(make_tiny, environments=3, workers=2, seed=5)
    try:
        seen = pool.reset()
        for index in range(3):
            env, episode = make_tiny(), 0
            here = env.reset(seed=int(np.random.SeedSequence([5, index, episode]).generate_state(1)[0]))[0]
            np.testing.assert_array_equal(seen["reach"][index], here["reach"])
        actions = np.array([place({"reach": seen["reach"][i]}, 0) for i in range(3)])
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


def test_a_look_around_takes_nothing_from_the_decisions():
    env = train.make_env(TINY, "cov")
    seen, _ = env.reset(seed=0)
    steps, over = [], False
    while not over:
        seen, _, _, over, info = env.step(place(seen, 0))
        steps.append(info["steps"])
    assert len(steps) == TINY.episode
    assert env.unwrapped.observation.step == 9 + sum(steps) <= env.unwrapped._max_steps == 9 + 12 * TINY.episode


def broken(transition):
    raise ZeroDivisionError("in my reward")


@pytest.mark.parametrize(
    ("reward", "message"), [(lambda transition: float("nan"), "nan"), (broken, "ZeroDivisionError: in my reward")]
)
def test_a_bad_reward_is_told_by_its_worker(reward, message):
    pool = WorkerPool(partial(train.make_env, TINY, reward), environments=2, workers=1)
    try:
        with pytest.raises(TrainingError, match=f"worker 0.*{message}"):
            pool.reset()  # the first look around is rewarded too
    finally:
        pool.close()


def test_a_worker_that_dies_is_named():
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
        ("e2e-cur", RECURRENT, "actor"),
        ("e2e-rec+0.1*nov", RECURRENT, "actor"),
        ("pointgoal", TO_GOALS, "actor"),
    ],
)
def test_stopped_and_continued_it_ends_with_the_same_bits(name, settings, last, tmp_path, monkeypatch):
    monkeypatch.setattr(train, "ANEW_EVERY", 2)  # of goals: the third rollout begins between episodes
    whole = train.train_policy(name, tmp_path / "whole", settings, workers=1, progress=False)
    monkeypatch.setattr(train, "SAVE_EVERY", 0.0)
    finished = train.Run._on_rollout_end
    rollouts = []

    def stop_in_the_third(run):
        rollouts.append(run)
        if len(rollouts) == 3:
            raise KeyboardInterrupt
        finished(run)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(train.Run, "_on_rollout_end", stop_in_the_third)
        train.train_policy(name, tmp_path / "parts", settings, workers=2, progress=False)
    assert (tmp_path / "parts" / train.CHECKPOINT).exists()
    parts = train.train_policy(name, tmp_path / "parts", settings, workers=1, progress=False)
    before, after = weights_of(whole), weights_of(parts)
    assert before.keys() == after.keys()
    assert all(np.array_equal(before[name], after[name]) for name in before)
    assert (tmp_path / "whole/curve.csv").read_text() == (tmp_path / "parts/curve.csv").read_text()
    assert np.abs(after[f"{last}.weight"]).max() > 0  # it has learned something
    kept = load_file(tmp_path / "parts" / train.CHECKPOINT)
    assert all(np.array_equal(kept[f"parameter/{name}"].astype(np.float16), value) for name, value in after.items())

    with pytest.raises(RunFolderError, match=r"checkpoint.*\(lr differ\)"):
        train.train_policy(name, tmp_path / "parts", replace(settings, lr=2e-3), workers=1, progress=False)
    (tmp_path / "parts" / train.CHECKPOINT).write_bytes(b"\x10\0\0\0\0\0\0\0 not safetensors")
    with pytest.raises(DataError, match=r"checkpoint.safetensors is damaged"):
        train.train_policy(name, tmp_path / "parts", settings, workers=1, progress=False)


def test_episodes_that_outlast_a_rollout_are_walked_and_counted_to_their_end(tmp_path, monkeypatch):
    settings = replace(TO_GOALS, frames=256, rollout=4, batch=8, episode=6, demonstrations=0)
    ended: list[dict] = []
    told = train.Run._tell

    def listen(run):
        ended.extend(info for _, info in run._ended)
        told(run)

    monkeypatch.setattr(train.Run, "_tell", listen)
    train.train_policy("pointgoal", tmp_path, settings, workers=1, progress=False)
    out_of_steps = [info for info in ended if info["TimeLimit.truncated"]]
    assert len(out_of_steps) >= 3  # one who acts at random does not stop in 6 steps once in 6
    assert len(out_of_steps) < len(ended)


def test_a_number_that_is_not_finite_stops_it_and_leaves_the_checkpoint(tmp_path, monkeypatch):
    monkeypatch.setattr(train, "SAVE_EVERY", 0.0)
    finished = train.Run._on_rollout_end

    def poison(run):
        finished(run)
        if (tmp_path / train.CHECKPOINT).exists():
            with torch.no_grad():
                run.model.policy.network.first.weight[0] = torch.nan

    monkeypatch.setattr(train.Run, "_on_rollout_end", poison)
    with pytest.raises(TrainingError, match=r"not finite after .* frames; .*checkpoint.safetensors is the last good"):
        train.train_policy("modular-cov", tmp_path, TINY, workers=1, progress=False)
    kept = load_file(tmp_path / train.CHECKPOINT)
    assert all(np.isfinite(array).all() for array in kept.values())


def test_a_symmetry_turns_what_is_seen_and_actions_back():
    env = Symmetry(train.make_env(TINY, "cov").env)
    rng = np.random.default_rng(0)
    kinds = set()
    for seed in range(12):
        seen, _ = env.reset(seed=seed)
        kinds.add(env.turn)
        plain = CompactView().see(env.unwrapped.map)
        assert np.sort(plain["reach"][2].ravel()).tolist() == np.sort(seen["reach"][2].ravel()).tolist()
        # what is ahead of the robot stays ahead: reachable ground along the heading
        for shown in (plain, seen):
            rows, cols = np.nonzero(shown["map"][1] > 0)
            middle = (CompactView.GRID - 1) / 2
            shown["ahead"] = ((cols - middle) * shown["heading"][0] + (rows - middle) * shown["heading"][1]).sum()
        assert seen["ahead"] == pytest.approx(plain["ahead"], rel=1e-4)
        choice = place(seen, int(rng.integers(seen["reach"][0].sum())))
        way = seen["reach"][1].ravel()[choice]
        _, _, _, _, info = env.step(choice)
        block = CompactView()
        goals = [a for a in range(block.GRID**2) if plain["reach"][0].ravel()[a]]
        same = [a for a in goals if plain["reach"][1].ravel()[a] == way]
        env.reset(seed=seed)
        assert any(np.allclose(block.waypoint(a, env.unwrapped.map), info["waypoint"]) for a in same)
    assert len(kinds) >= 6


def test_it_learns_to_choose_as_frontier_does_and_what_that_is_worth(monkeypatch):
    monkeypatch.setattr(imitation, "EPOCHS", 60)  # of few decisions
    settings = replace(TINY, demonstrations=6, episode=20, sensor=32, scale=0.1)
    view, network = make_network(settings.network)
    decisions = imitation.demonstrate(view, settings, "cov")
    assert decisions.returns[0] > 3 * decisions.returns[-1]  # most is found early in an episode
    seen = {name: torch.from_numpy(values) for name, values in decisions.seen.items()}
    actions = torch.from_numpy(decisions.actions)
    assert (seen["reach"][:, 0].flatten(1).gather(1, actions[:, None]) > 0).all()  # all are places one can reach
    assert not seen["reach"][:, 5].any()

    def judge():
        with torch.no_grad():
            chances, value = network(seen)
        error = ((value - torch.from_numpy(decisions.returns)) ** 2).mean().item()
        return chances.log_prob(actions).mean().item(), error

    chance, error = judge()
    imitation.imitate(network, decisions, settings)
    chance_after, error_after = judge()
    assert chance_after > chance + 0.5
    assert error_after < 0.5 * error


def filled_buffer(kind, rewards, values, starts):
    space = gymnasium.spaces.Dict({"x": gymnasium.spaces.Box(0, 1, (1,))})
    buffer = kind(len(rewards), space, gymnasium.spaces.Discrete(2), gamma=0.9, gae_lambda=0.5, n_envs=1)
    buffer.reset()
    for reward, value, start in zip(rewards, values, starts, strict=True):
        seen, action, one = {"x": np.zeros((1, 1))}, np.zeros((1, 1)), torch.zeros(1)
        buffer.add(seen, action, np.array([reward]), np.array([start]), torch.tensor([value]), one)
    return buffer


def test_a_decision_of_half_the_time_is_discounted_half_as_much():
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


def test_end_to_end_policies_have_no_demonstrations():
    with pytest.raises(ValueError, match="demonstrations are waypoints"):
        settings_of("e2e-cov", demonstrations=3)


@pytest.mark.parametrize("kind", [{"kind": "compact"}, {"kind": "paper", "window": 48}])
def test_an_action_and_its_waypoint_lead_to_the_same_place(kind):
    view, _ = make_network(kind)
    env = ExploreEnv(scene="train-00", size=32, rgb=False, max_steps=30, window=round(12 / view.cell))
    env.reset(seed=1)
    for action in [0, 1] * 15:
        env.step(np.int64(action))
    x, y = env.map.pose[:2, 3]
    point = np.array([x + 0.3, y - 0.2])
    again = view.waypoint(view.action(point, env.map), env.map)
    np.testing.assert_allclose(again, point, atol=0.5)
    np.testing.assert_allclose(view.waypoint(view.action(again, env.map), env.map), again, atol=1e-5)
    if kind["kind"] == "compact":
        assert view.action(np.array([x + 40.0, y]), env.map) is None


def test_weights_say_what_is_wrong_with_them(tmp_path):
    _, network = make_network({"kind": "compact"})
    save_weights(tmp_path / "mine", network, {"policy": "modular-cov", "network": {"kind": "compact"}})
    assert make_policy(str(tmp_path / "mine.safetensors")).waypoint is None
    _, other = make_network({"kind": "paper", "window": 48})
    with pytest.raises(DataError, match=r"belongs to another policy.*other channels"):
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


def test_an_end_to_end_policy_remembers_an_episode_and_no_more(tmp_path):
    _, network = make_network({"kind": "egocentric"})
    with torch.no_grad():
        network.actor.weight.normal_()
    save_weights(tmp_path / "mine", network, {"policy": "e2e-cov", "network": {"kind": "egocentric"}})
    policy = load_policy(tmp_path / "mine")
    start = planar_pose(0, 0, 0)
    rng = np.random.default_rng(0)
    images = [rng.integers(256, size=(84, 84, 3)).astype(np.uint8) for _ in range(12)]
    walks = []
    for _ in range(2):
        policy.reset(np.random.default_rng(3))
        shown = [Observation(image, np.ones((84, 84)), np.zeros((84, 84)), start) for image in images]
        walks.append([policy.act(empty_map(start), observation) for observation in shown])
    assert walks[0] == walks[1] and len(set(walks[0])) > 1
    assert policy._memory[0].abs().max() > 0


def test_a_policy_of_ones_own_walks_by_the_path_of_its_weights(tmp_path, capsys):
    _, network = make_network({"kind": "compact"})
    save_weights(tmp_path / "mine", network, {"policy": "modular-cov", "network": {"kind": "compact"}})
    run = ["explore", "--policy", f"{tmp_path}/mine.safetensors", "--preset", "smoke", "--out", f"{tmp_path}/run"]
    assert cli.main(run) == 0
    assert load_trajectory(tmp_path / "run" / "trajectory").meta["policy"].endswith("mine.safetensors")
    assert cli.main([*run[:2], f"{tmp_path}/other.safetensors", "--out", f"{tmp_path}/other"]) == 1
    assert "other.json does not exist" in capsys.readouterr().err


def test_a_training_tells_its_curve_and_ends_when_it_is_told_to(tmp_path):
    told = []
    train.train_policy("modular-cov", tmp_path / "whole", TINY, workers=1, progress=False, callback=told.append)
    assert told == read_meta(tmp_path / "whole" / "policy")["curve"] and len(told) == 4

    def stop(row):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train.train_policy("modular-cov", tmp_path / "part", TINY, workers=1, progress=False, callback=stop)
    assert not (tmp_path / "part" / "policy.json").exists()
