"""Environments: conformance of all of them, and values computed by hand."""

import math
from functools import partial

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import load_env_creator
from gymnasium.utils.env_checker import check_env
from toy_scene import empty_room, to_scene, two_rooms

from autonerf_lab.envs import ENVS
from autonerf_lab.envs.explore import ExploreEnv, local_window
from autonerf_lab.envs.pointgoal import STOP, PointGoalEnv
from autonerf_lab.envs.waypoint import WaypointEnv
from autonerf_lab.errors import RewardError, UnknownNameError
from autonerf_lab.exploration import MAP_SIZE
from autonerf_lab.geometry import planar_from_pose, planar_pose
from autonerf_lab.mapping import empty_map
from autonerf_lab.policies.interfaces import FOLLOW_STEPS, CompactInterface, PaperInterface, stack_maps, window_slices
from autonerf_lab.policies.modular import Modular
from autonerf_lab.policies.networks import CompactNetwork
from autonerf_lab.rewards import weighted
from autonerf_lab.simulator import MotionNoise
from autonerf_lab.types import Action

SMALL = {
    "Explore": {"size": 16, "window": 60},
    "Waypoint": {"size": 16, "interface": PaperInterface(60)},
    "Egocentric": {"size": 16},
    "PointGoal": {"size": 16},
}


@pytest.fixture(scope="module")
def scene():
    return to_scene(two_rooms())


def small(name: str) -> dict:
    return SMALL[name.removeprefix("AutoNeRF/").removesuffix("-v0")]


def play(env: gymnasium.Env, seed: int, steps: int = 4) -> list[np.ndarray]:
    """Return all observations and rewards of an episode of random actions."""
    rng = np.random.default_rng(seed)
    env.action_space.seed(int(rng.integers(1000)))
    observation, _ = env.reset(seed=seed)
    obs = [np.asarray(v, dtype=float).ravel() for v in observation.values()]
    for _ in range(steps):
        observation, reward, *_ = env.step(env.action_space.sample())
        obs += [np.asarray(v, dtype=float).ravel() for v in observation.values()] + [np.array([reward])]
    return obs


@pytest.mark.parametrize("name", ENVS)
class TestEvery:
    def test_passes_gymnasiums_checker(self, name, scene):
        env = gymnasium.make(name, scene=scene, render_mode="rgb_array", **small(name))
        check_env(env.unwrapped)

    def test_the_defaults_use_the_training_scenes(self, name):
        env = gymnasium.make(name)
        env.unwrapped._rgb = False  # color images would bake the texture of the scene
        obs = {env.unwrapped.reset(seed=seed)[1]["scene"] for seed in range(3)}
        assert len(obs) > 1 and all(scene.startswith("train-") for scene in obs)

    def test_equal_seeds_give_equal_episodes_with_wrappers(self, name, scene):
        made = partial(gymnasium.make, name, scene=[scene, scene], noise=MotionNoise(True, True), **small(name))
        plain, wrapped = made(), gymnasium.wrappers.RecordEpisodeStatistics(gymnasium.wrappers.TimeLimit(made(), 9))
        for a, b in zip(play(plain, 5), play(wrapped, 5), strict=True):
            np.testing.assert_array_equal(a, b)
        assert any((a != b).any() for a, b in zip(play(plain, 5), play(plain, 6), strict=True))

    def test_noise_by_name_changes_motion_odometry_and_depth(self, name, scene):
        exact, noisy = (
            gymnasium.make(name, scene=scene, **options, **small(name)).unwrapped
            for options in ({}, {"noise": "ans", "depth_noise": "redwood"})
        )
        for env in (exact, noisy):
            env.reset(seed=3)
            env.step(0 * env.action_space.sample())
        assert (noisy.sim.noise.model, noisy.sim.depth_noise) == ("ans", "redwood")
        assert not np.allclose(noisy.sim.pose, exact.sim.pose)
        assert not np.allclose(noisy.observation.pose, noisy.sim.pose), "odometry has its own errors"
        for env, differs in ((exact, False), (noisy, True)):
            assert (env.observation.depth != env.sim.render(env.sim.pose).depth).any() == differs

    def test_renders_the_robots_view(self, name, scene):
        env = gymnasium.make(name, scene=scene, render_mode="rgb_array", **small(name))
        env.reset(seed=0)
        image = env.render()
        assert image.shape == (16, 16, 3) and image.dtype == np.uint8 and image.std() > 1

    @pytest.mark.filterwarnings("ignore:invalid escape sequence")  # in moviepy, when Python compiles it
    def test_videos_are_recorded(self, name, scene, tmp_path):
        pytest.importorskip("moviepy")
        env = gymnasium.make(name, scene=scene, render_mode="rgb_array", max_steps=3, **small(name))
        env = gymnasium.wrappers.RecordVideo(env, str(tmp_path / "videos"), episode_trigger=lambda episode: True)
        env.reset(seed=0)
        while not any(env.step(env.action_space.sample())[2:4]):
            pass
        env.close()
        assert [path.suffix for path in (tmp_path / "videos").iterdir()] == [".mp4"]

    def test_unknown_names_are_refused(self, name, scene):
        with pytest.raises(UnknownNameError, match="valid names"):
            gymnasium.make(name, scene=["train-00", "nowhere-1"])
        with pytest.raises(ValueError, match="at least one scene"):
            gymnasium.make(name, scene=[])
        with pytest.raises(ValueError, match="ansi"):
            load_env_creator(ENVS[name])(scene=scene, render_mode="ansi")

    def test_runs_in_spawned_processes(self, name):
        options = small(name) | {"rgb": False, "scene": "train-01"}
        here = gymnasium.make(name, **options)
        both = gymnasium.vector.AsyncVectorEnv(
            [partial(gymnasium.make, f"autonerf_lab:{name}", **options)] * 2, context="spawn"
        )
        try:
            obs, _ = both.reset(seed=[3, 4])
            for seed in (3, 4):
                expected, _ = here.reset(seed=seed)
                for key, value in expected.items():
                    np.testing.assert_array_equal(obs[key][seed - 3], value)
            assert both.step(both.action_space.sample())[1].shape == (2,)
        finally:
            both.close()


@pytest.mark.parametrize("kind", [ExploreEnv, WaypointEnv])
def test_an_unknown_reward_is_refused(kind, scene):
    with pytest.raises(UnknownNameError, match="valid names"):
        kind(scene=scene, reward="none")


def test_the_reward_is_the_new_area_and_the_episode_is_truncated(scene):
    env = gymnasium.make("AutoNeRF/Explore-v0", scene=scene, size=16, max_steps=5, rgb=False)
    _, info = env.reset(seed=0)
    for step in range(5):
        before = info["explored_m2"]
        observation, reward, terminated, truncated, info = env.step(1)
        assert reward == pytest.approx(info["explored_m2"] - before)
        assert info["explored_m2"] == pytest.approx(env.unwrapped.map.explored.sum() * 0.05**2)
        assert not terminated
        assert truncated == (step == 4)
    assert not observation["rgb"].any()


def test_a_reward_with_state_is_reset(scene):
    class Constant:
        resets = 0

        def reset(self, rng):
            self.resets += 1

        def __call__(self, transition):
            return 2.0

    reward = Constant()
    env = ExploreEnv(scene=scene, reward=reward, size=16)
    env.reset(seed=0)
    env.reset()
    assert reward.resets == 2
    assert env.step(np.int64(1))[1] == 2.0


def test_the_terms_of_a_sum_are_in_info_and_add_up_along_a_waypoint(scene):
    for kind, action in ((ExploreEnv, np.int64(1)), (WaypointEnv, np.ones(2, np.float32))):
        env = kind(scene=scene, reward="cov+0.5*nov", size=16)
        assert env.reset(seed=0)[1]["reward_terms"] == {"cov": 0, "nov": 0}
        for _ in range(3):
            _, reward, *_, info = env.step(action)
            assert reward == pytest.approx(info["reward_terms"]["cov"] + 0.5 * info["reward_terms"]["nov"])
    assert info["reward_terms"]["nov"] > 1  # of 25 steps
    plain = ExploreEnv(scene=scene, size=16, window=60)
    assert "reward_terms" not in plain.reset(seed=0)[1]


def test_a_privileged_reward_gets_reference_observations(scene):
    class Privileged:
        references = 30

        def reset(self, rng):
            self.references_seen = None

        def set_references(self, observations):
            assert self.references_seen is None, "reset comes first"
            self.references_seen = observations

        def __call__(self, transition):
            return 0.0

    shown = [Privileged(), Privileged()]
    for reward in shown:
        env = ExploreEnv(scene=scene, reward=reward, size=16, window=60)
        env.reset(seed=3)
        assert len(reward.references_seen) == 30
        for place in reward.references_seen:
            x, y, _ = planar_from_pose(place.pose)
            assert env.sim.navigation.is_navigable(x, y)
            np.testing.assert_array_equal(place.rgb, env.sim.render(place.pose).rgb)
            np.testing.assert_array_equal(place.depth, env.sim.render(place.pose).depth)
    headings = np.array([planar_from_pose(place.pose)[2] for place in shown[0].references_seen])
    assert headings.min() < -1 and headings.max() > 1  # independent of the robot's pose
    for a, b in zip(*(reward.references_seen for reward in shown), strict=True):
        np.testing.assert_array_equal(a.pose, b.pose)


@pytest.mark.parametrize("wrap", [lambda reward: reward, lambda reward: weighted({"cov": 1.0, reward: 0.5})])
def test_an_error_in_reset_names_the_reward(scene, wrap):
    class Broken:
        def reset(self, rng):
            raise KeyError("lamp")

        def __call__(self, transition):
            return 0.0

    env = ExploreEnv(scene=scene, reward=wrap(Broken()), size=16, window=60)
    with pytest.raises(RewardError, match="reward 'Broken' failed in reset: KeyError: 'lamp'"):
        env.reset(seed=0)


def test_errors_of_a_reward_name_the_reward_and_the_step(scene):
    def broken(transition):
        raise KeyError("sofa")

    env = ExploreEnv(scene=scene, reward=broken, size=16, window=60)
    env.reset(seed=0)
    with pytest.raises(RewardError, match="reward 'broken' failed at step 1: KeyError: 'sofa'"):
        env.step(np.int64(1))


def test_window_follows_the_robot_and_stops_at_the_border():
    state = empty_map(planar_pose(0, 0, 0), size=20, cell=1.0)
    state.semantics[3, 10, 11] = True
    window = local_window(state, 10)
    assert np.argwhere(window[2]).tolist() == [[5, 5]]
    assert window[4, 5, 6] == 4
    state.pose[:2, 3] = 9.5, -9.5
    assert np.argwhere(local_window(state, 10)[2]).tolist() == [[0, 9]]


def test_the_whole_map_is_pooled_by_its_maximum():
    state = empty_map(planar_pose(0, 0, 0), size=30, cell=1.0)
    state.occupied[0, 29] = state.semantics[2, 15, 14] = state.viewpoints[7, 29, 0] = True
    state.occupied[15, 16] = True
    obs = stack_maps(state, 10, viewpoints=True)
    assert obs.shape == (48, 10, 10) and obs.dtype == np.uint8
    assert np.argwhere(obs[4]).tolist() == [[0, 9], [5, 5]]  # occupied, whole map
    assert np.argwhere(obs[8 + 2]).tolist() == [[5, 4]]  # class 3, around the robot at row and column 15
    assert np.argwhere(obs[8 + 15]).tolist() == [[5, 6]]  # occupied, without a class
    assert np.argwhere(obs[24 + 12 + 7]).tolist() == [[9, 0]]
    assert np.argwhere(obs[2]).tolist() == [[5, 5]] == np.argwhere(obs[6]).tolist()


def test_a_waypoint_is_reached_and_its_rewards_add_up():
    env = WaypointEnv(scene=to_scene(empty_room(8.0, 8.0)), size=32, interface=PaperInterface(120))
    env.reset(seed=2)
    rows, cols = window_slices(env.map, 120)
    target = np.array([4.0, 4.0])
    corner = env.map.origin + np.array([cols.start, rows.start]) * env.map.cell
    before = env.map.explored.sum()
    for _ in range(2):
        action = ((target - corner) / 12.0 * 2 - 1).astype(np.float32)
        _, reward, _, truncated, info = env.step(action)
        assert info["waypoint"] == pytest.approx(target, abs=1e-4)
        assert reward == pytest.approx((env.map.explored.sum() - before) * env.map.cell**2)
        before = env.map.explored.sum()
        rows, cols = window_slices(env.map, 120)
        corner = env.map.origin + np.array([cols.start, rows.start]) * env.map.cell
    assert np.linalg.norm(env.sim.pose[:2, 3] - target) < 0.4 and not truncated


def test_waypoints_share_the_time_of_the_episode(scene):
    env = WaypointEnv(scene=scene, size=16, interface=PaperInterface(60), max_steps=2 * FOLLOW_STEPS + 5)
    env.reset(seed=0)
    ends = [env.step(np.zeros(2, np.float32))[3] for _ in range(3)]
    assert ends == [False, False, True]


def test_a_reached_waypoint_ends_the_decision(scene):
    interface = CompactInterface(follow=12, arrival=0.35)
    env = WaypointEnv(scene=scene, size=32, interface=interface, decisions=8)
    obs, info = env.reset(seed=0)
    policy = Modular(CompactInterface(follow=12, arrival=0.35), CompactNetwork())
    # both make the initial turns
    assert [policy.act(env.map, env.observation) for _ in range(9)] == [Action.TURN_LEFT] * 9
    assert env.observation.step == 9 and info["path_m"] == 0 and policy.waypoint is None
    for k in range(8):
        blocks = np.argwhere(obs["reach"][0] > 0)
        row, col = blocks[np.argmin(np.abs(obs["reach"][1][tuple(blocks.T)] * 10 - 1.2))]  # about 1.2 m away
        obs, _, _, over, info = env.step(int(row * interface.GRID + col))
        away = np.linalg.norm(env.map.pose[:2, 3] - info["waypoint"])
        assert (away < 0.35 and info["steps"] <= 12) or info["steps"] == 12
        assert over == (k == 7)
        # a rollout ends the waypoint after the same number of steps as training
        policy.waypoint, policy._age = info["waypoint"], info["steps"]
        policy.act(env.map, env.observation)
        assert policy._age == 1
    assert env.observation.step < 9 + 8 * 12


def test_only_waypoints_within_one_decision_count_as_tried():
    interface, map = CompactInterface(), empty_map(planar_pose(0, 0, 0))
    map.explored[:] = True
    for x in (7.25, 1.25):  # metres ahead
        interface.to_waypoint(16 * interface.GRID + 16 + round(x * 2 - 0.5), map)
    row = interface.observe(map)["reach"][5, 16]
    assert row[16 + 2] == pytest.approx(np.log(2)) and row[16 + 3] == pytest.approx(np.log1p(np.exp(-0.5)))
    assert row[16 + 8 :].max() < 1e-6, "too far for one decision"
    interface.reset()
    assert not interface.observe(map)["reach"][5].any()


@pytest.mark.parametrize("shift", range(4))  # of the fine cells against the coarse ones
@pytest.mark.parametrize(("gap", "fits"), [(0.25, False), (0.5, True)])
def test_candidates_behind_a_gap_exist_if_the_robot_fits_through(shift, gap, fits):
    map = empty_map(planar_pose(0, 0, 0))
    middle, width = 240 + shift, round(gap / map.cell)
    map.explored[:] = True
    map.occupied[:, 280 + shift] = True  # a wall two metres ahead
    map.occupied[middle : middle + width, 280 + shift] = False
    reach = CompactInterface().observe(map)["reach"]
    assert reach[0, 16, 18], "in front of it"
    assert bool(reach[0, 16, 24]) == fits


def follow_shortest(env: PointGoalEnv) -> tuple[float, dict, bool]:
    """Turn towards the goal in an empty room, move straight, stop."""
    total, info, over = 0.0, {}, False
    for _ in range(200):
        x, y, heading = planar_from_pose(env.sim.pose)
        away = env.goal - np.array([x, y])
        error = math.remainder(math.atan2(away[1], away[0]) - heading, 2 * math.pi)
        action = STOP if np.hypot(*away) < 0.2 else 0 if abs(error) < math.pi / 12 + 1e-9 else 1 if error > 0 else 2
        _, reward, over, _, info = env.step(np.int64(action))
        total += reward
        if over:
            break
    return total, info, over


def test_a_straight_path_to_the_goal_succeeds():
    env = PointGoalEnv(scene=to_scene(empty_room(6.0, 6.0)), size=8)
    for seed in range(5):
        _, start = env.reset(seed=seed)
        assert start["distance_to_goal"] >= 1.0
        total, info, over = follow_shortest(env)
        assert over and info["success"] and info["spl"] > 0.85
        # progress and success minus the cost of the steps
        progress = start["distance_to_goal"] - info["distance_to_goal"]
        assert total == pytest.approx(progress + 2.5 - 0.01 * (env._observation.step + 1), abs=1e-6)


def test_the_goal_is_relative_to_the_robot():
    env = PointGoalEnv(scene=to_scene(empty_room(6.0, 6.0)), size=8)
    obs, _ = env.reset(seed=0)
    x, y, heading = planar_from_pose(env.sim.pose)
    distance, cosine, sine = obs["goal"]
    ahead = heading + math.atan2(sine, cosine)
    there = np.array([x + distance * math.cos(ahead), y + distance * math.sin(ahead)])
    assert there == pytest.approx(env.goal, abs=1e-4)
    turned, *_ = env.step(np.int64(1))  # to the left: the goal is 30 degrees more to the right
    change = math.atan2(sine, cosine) - math.atan2(turned["goal"][2], turned["goal"][1])
    assert math.remainder(change, 2 * math.pi) == pytest.approx(math.pi / 6, abs=1e-5)


def test_stopping_far_away_fails_and_time_truncates(scene):
    env = PointGoalEnv(scene=scene, size=8, max_steps=3)
    env.reset(seed=0)
    _, reward, terminated, truncated, info = env.step(np.int64(STOP))
    assert terminated and not truncated and not info["success"] and info["spl"] == 0 and reward == -0.01
    env.reset(seed=0)
    ends = [env.step(np.int64(1))[2:4] for _ in range(3)]
    assert ends == [(False, False), (False, False), (False, True)]


def test_the_distance_to_the_goal_is_a_path_length():
    """Between rooms, the shortest path is longer than the straight line."""
    env = PointGoalEnv(scene="dev-2", size=8)
    ratios = []
    for seed in range(10):
        _, info = env.reset(seed=seed)
        line = float(np.linalg.norm(env.goal - env.sim.pose[:2, 3]))
        ratios.append(info["distance_to_goal"] / line)
    assert min(ratios) > 0.97 and max(ratios) > 1.3


def test_the_paper_interface_accepts_the_map_of_explore():
    """The map of a rollout has another size than that of the training; both are pooled around their centre."""
    interface = PaperInterface()
    map = empty_map(planar_pose(0.03, 0.02, 0.0), MAP_SIZE)
    map.explored[320:322, 320:330] = True
    assert interface.observation_space.contains(interface.observe(map))
    training = empty_map(planar_pose(0.03, 0.02, 0.0), 720)
    training.explored[360:362, 360:370] = True
    np.testing.assert_array_equal(interface.observe(map)["map"], interface.observe(training)["map"])
