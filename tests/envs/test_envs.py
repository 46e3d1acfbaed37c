"""The environments: what every one must do, and values worked by hand."""

import math
from functools import partial

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import load_env_creator
from gymnasium.utils.env_checker import check_env
from toy_scene import empty_room, of_toy, two_rooms

from autonerf_lab.envs import ENVS
from autonerf_lab.envs.explore import ExploreEnv, local_window
from autonerf_lab.envs.pointgoal import STOP, PointGoalEnv
from autonerf_lab.envs.waypoint import WaypointEnv
from autonerf_lab.errors import RewardError, UnknownNameError
from autonerf_lab.geometry import planar_from_pose, planar_pose
from autonerf_lab.mapping import empty_map
from autonerf_lab.policies.interfaces import FOLLOW_STEPS, CompactView, PaperView, global_input, window_of
from autonerf_lab.policies.modular import Modular
from autonerf_lab.policies.networks import CompactNetwork
from autonerf_lab.simulator import Noise
from autonerf_lab.types import Action

SMALL = {
    "Explore": {"size": 16, "window": 60},
    "Waypoint": {"size": 16, "view": PaperView(60)},
    "Egocentric": {"size": 16},
    "PointGoal": {"size": 16},
}


@pytest.fixture(scope="module")
def scene():
    return of_toy(two_rooms())


def small(name: str) -> dict:
    return SMALL[name.removeprefix("AutoNeRF/").removesuffix("-v0")]


def play(env: gymnasium.Env, seed: int, steps: int = 4) -> list[np.ndarray]:
    """Everything an agent gets to see of an episode."""
    rng = np.random.default_rng(seed)
    env.action_space.seed(int(rng.integers(1000)))
    observation, _ = env.reset(seed=seed)
    seen = [np.asarray(v, dtype=float).ravel() for v in observation.values()]
    for _ in range(steps):
        observation, reward, *_ = env.step(env.action_space.sample())
        seen += [np.asarray(v, dtype=float).ravel() for v in observation.values()] + [np.array([reward])]
    return seen


@pytest.mark.parametrize("name", ENVS)
class TestEvery:
    def test_passes_gymnasiums_checker(self, name, scene):
        env = gymnasium.make(name, scene=scene, render_mode="rgb_array", **small(name))
        check_env(env.unwrapped)

    def test_is_made_by_its_bare_name_in_training_scenes(self, name):
        env = gymnasium.make(name)
        env.unwrapped._rgb = False  # colours would bake the scene's texture
        seen = {env.unwrapped.reset(seed=seed)[1]["scene"] for seed in range(3)}
        assert len(seen) > 1 and all(scene.startswith("train-") for scene in seen)

    def test_same_seed_same_episode_through_wrappers(self, name, scene):
        made = partial(gymnasium.make, name, scene=[scene, scene], noise=Noise(True, True), **small(name))
        plain, wrapped = made(), gymnasium.wrappers.RecordEpisodeStatistics(gymnasium.wrappers.TimeLimit(made(), 9))
        for a, b in zip(play(plain, 5), play(wrapped, 5), strict=True):
            np.testing.assert_array_equal(a, b)
        assert any((a != b).any() for a, b in zip(play(plain, 5), play(plain, 6), strict=True))

    def test_shows_the_robots_view(self, name, scene):
        env = gymnasium.make(name, scene=scene, render_mode="rgb_array", **small(name))
        env.reset(seed=0)
        picture = env.render()
        assert picture.shape == (16, 16, 3) and picture.std() > 1

    def test_wrong_names_are_told_at_once(self, name, scene):
        with pytest.raises(UnknownNameError, match="valid names"):
            gymnasium.make(name, scene=["train-00", "nowhere-1"])
        with pytest.raises(ValueError, match="at least one"):
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
            seen, _ = both.reset(seed=[3, 4])
            for seed in (3, 4):
                expected, _ = here.reset(seed=seed)
                for key, value in expected.items():
                    np.testing.assert_array_equal(seen[key][seed - 3], value)
            assert both.step(both.action_space.sample())[1].shape == (2,)
        finally:
            both.close()


@pytest.mark.parametrize("kind", [ExploreEnv, WaypointEnv])
def test_a_wrong_reward_is_told_at_once(kind, scene):
    with pytest.raises(UnknownNameError, match="valid names"):
        kind(scene=scene, reward="none")


def test_reward_is_the_growth_of_the_map_and_time_ends_the_episode(scene):
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


def test_a_reward_with_memory_is_reset(scene):
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


def test_terms_of_a_sum_are_told_and_add_up_along_a_waypoint(scene):
    for kind, action in ((ExploreEnv, np.int64(1)), (WaypointEnv, np.ones(2, np.float32))):
        env = kind(scene=scene, reward="cov+0.5*nov", size=16)
        assert env.reset(seed=0)[1]["reward_terms"] == {"cov": 0, "nov": 0}
        for _ in range(3):
            _, reward, *_, info = env.step(action)
            assert reward == pytest.approx(info["reward_terms"]["cov"] + 0.5 * info["reward_terms"]["nov"])
    assert info["reward_terms"]["nov"] > 1  # of 25 steps
    plain = ExploreEnv(scene=scene, size=16, window=60)
    assert "reward_terms" not in plain.reset(seed=0)[1]


def test_only_a_privileged_reward_is_shown_the_scene(scene):
    class Shown:
        references = 30

        def reset(self, rng):
            self.places = None

        def show(self, observations):
            assert self.places is None, "reset comes first"
            self.places = observations

        def __call__(self, transition):
            return 0.0

    shown = [Shown(), Shown()]
    for reward in shown:
        env = ExploreEnv(scene=scene, reward=reward, size=16, window=60)
        env.reset(seed=3)
        assert len(reward.places) == 30
        for place in reward.places:
            x, y, _ = planar_from_pose(place.pose)
            assert env.sim.navigation.is_navigable(x, y)
            np.testing.assert_array_equal(place.rgb, env.sim.render(place.pose).rgb)
            np.testing.assert_array_equal(place.depth, env.sim.render(place.pose).depth)
    headings = np.array([planar_from_pose(place.pose)[2] for place in shown[0].places])
    assert headings.min() < -1 and headings.max() > 1  # anywhere, and not where the robot is
    for a, b in zip(*(reward.places for reward in shown), strict=True):
        np.testing.assert_array_equal(a.pose, b.pose)


def test_a_reward_that_fails_is_named_with_the_step(scene):
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
    seen = global_input(state, 10, viewpoints=True)
    assert seen.shape == (48, 10, 10) and seen.dtype == np.uint8
    assert np.argwhere(seen[4]).tolist() == [[0, 9], [5, 5]]  # occupied, whole map
    assert np.argwhere(seen[8 + 2]).tolist() == [[5, 4]]  # class 3, around the robot at row and column 15
    assert np.argwhere(seen[8 + 15]).tolist() == [[5, 6]]  # occupied, and nobody knows by what
    assert np.argwhere(seen[24 + 12 + 7]).tolist() == [[9, 0]]
    assert np.argwhere(seen[2]).tolist() == [[5, 5]] == np.argwhere(seen[6]).tolist()


def test_a_waypoint_is_reached_and_its_rewards_add_up():
    env = WaypointEnv(scene=of_toy(empty_room(8.0, 8.0)), size=32, view=PaperView(120))
    env.reset(seed=2)
    rows, cols = window_of(env.map, 120)
    target = np.array([4.0, 4.0])
    corner = env.map.origin + np.array([cols.start, rows.start]) * env.map.cell
    before = env.map.explored.sum()
    for _ in range(2):
        action = ((target - corner) / 12.0 * 2 - 1).astype(np.float32)
        _, reward, _, truncated, info = env.step(action)
        assert info["waypoint"] == pytest.approx(target, abs=1e-4)
        assert reward == pytest.approx((env.map.explored.sum() - before) * env.map.cell**2)
        before = env.map.explored.sum()
        rows, cols = window_of(env.map, 120)
        corner = env.map.origin + np.array([cols.start, rows.start]) * env.map.cell
    assert np.linalg.norm(env.sim.pose[:2, 3] - target) < 0.4 and not truncated


def test_waypoints_share_the_time_of_the_episode(scene):
    env = WaypointEnv(scene=scene, size=16, view=PaperView(60), max_steps=2 * FOLLOW_STEPS + 5)
    env.reset(seed=0)
    ends = [env.step(np.zeros(2, np.float32))[3] for _ in range(3)]
    assert ends == [False, False, True]


def test_a_waypoint_that_is_reached_makes_way_for_the_next(scene):
    view = CompactView(follow=12, arrival=0.35)
    env = WaypointEnv(scene=scene, size=32, view=view, decisions=8)
    seen, info = env.reset(seed=0)
    policy = Modular(CompactView(follow=12, arrival=0.35), CompactNetwork())
    # both look around first
    assert [policy.act(env.map, env.observation) for _ in range(9)] == [Action.TURN_LEFT] * 9
    assert env.observation.step == 9 and info["path_m"] == 0 and policy.waypoint is None
    for k in range(8):
        blocks = np.argwhere(seen["reach"][0] > 0)
        row, col = blocks[np.argmin(np.abs(seen["reach"][1][tuple(blocks.T)] * 10 - 1.2))]  # about 1.2 m away
        seen, _, _, over, info = env.step(int(row * view.GRID + col))
        away = np.linalg.norm(env.map.pose[:2, 3] - info["waypoint"])
        assert (away < 0.35 and info["steps"] <= 12) or info["steps"] == 12
        assert over == (k == 7)
        # a walk ends it where training does
        policy.waypoint, policy._age = info["waypoint"], info["steps"]
        policy.act(env.map, env.observation)
        assert policy._age == 1
    assert env.observation.step < 9 + 8 * 12


def test_a_place_is_tried_where_one_decision_leads_there():
    view, map = CompactView(), empty_map(planar_pose(0, 0, 0))
    map.explored[:] = True
    for x in (5.25, 1.25):  # metres ahead
        view.waypoint(16 * view.GRID + 16 + round(x * 2 - 0.5), map)
    row = view.see(map)["reach"][5, 16]
    assert row[16 + 2] == pytest.approx(np.log(2)) and row[16 + 3] == pytest.approx(np.log1p(np.exp(-0.5)))
    assert row[16 + 8 :].max() < 1e-6, "it is far, and only on the way"
    view.reset()
    assert not view.see(map)["reach"][5].any()


@pytest.mark.parametrize("shift", range(4))  # of the fine cells against the coarse ones
@pytest.mark.parametrize(("gap", "fits"), [(0.25, False), (0.5, True)])
def test_places_behind_a_gap_are_there_if_the_robot_fits_through(shift, gap, fits):
    map = empty_map(planar_pose(0, 0, 0))
    middle, width = 240 + shift, round(gap / map.cell)
    map.explored[:] = True
    map.occupied[:, 280 + shift] = True  # a wall two metres ahead
    map.occupied[middle : middle + width, 280 + shift] = False
    reach = CompactView().see(map)["reach"]
    assert reach[0, 16, 18], "in front of it"
    assert bool(reach[0, 16, 24]) == fits


def follow_shortest(env: PointGoalEnv) -> tuple[float, dict, bool]:
    """Turn towards the goal of an empty room, walk, stop."""
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


def test_who_walks_straight_to_the_goal_succeeds():
    env = PointGoalEnv(scene=of_toy(empty_room(6.0, 6.0)), size=8)
    for seed in range(5):
        _, start = env.reset(seed=seed)
        assert start["distance_to_goal"] >= 1.0
        total, info, over = follow_shortest(env)
        assert over and info["success"] and info["spl"] > 0.85
        # progress and success, less a cent a step
        progress = start["distance_to_goal"] - info["distance_to_goal"]
        assert total == pytest.approx(progress + 2.5 - 0.01 * (env._observation.step + 1), abs=1e-6)


def test_the_goal_is_seen_from_the_robot():
    env = PointGoalEnv(scene=of_toy(empty_room(6.0, 6.0)), size=8)
    seen, _ = env.reset(seed=0)
    x, y, heading = planar_from_pose(env.sim.pose)
    distance, cosine, sine = seen["goal"]
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


def test_walls_count():
    """From room to room the shortest way is longer than the line of sight; stopping behind a wall is no success."""
    env = PointGoalEnv(scene="dev-2", size=8)
    ratios = []
    for seed in range(10):
        _, info = env.reset(seed=seed)
        line = float(np.linalg.norm(env.goal - env.sim.pose[:2, 3]))
        ratios.append(info["distance_to_goal"] / line)
    assert min(ratios) > 0.97 and max(ratios) > 1.3
