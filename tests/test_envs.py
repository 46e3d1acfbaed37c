import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from toy_scene import two_rooms

import autonerf_lab.envs  # noqa: F401 - registers
from autonerf_lab.envs.explore import ExploreEnv, local_window
from autonerf_lab.errors import UnknownNameError
from autonerf_lab.geometry import planar_pose
from autonerf_lab.mapping import empty_map
from autonerf_lab.scenes import Scene


@pytest.fixture(scope="module")
def scene():
    toy = two_rooms()
    return Scene("toy", toy.vertices, toy.faces, toy.face_class, toy.face_instance, toy.uv, bake=lambda: toy.texture)


def test_passes_gymnasiums_checker(scene):
    env = gymnasium.make("AutoNeRF/Explore-v0", scene=scene, size=16, render_mode="rgb_array")
    check_env(env.unwrapped)


def test_made_by_name_with_its_defaults():
    env = gymnasium.make("AutoNeRF/Explore-v0", rgb=False)  # colours would bake the scene's texture
    observation, info = env.reset(seed=1)
    assert env.observation_space.contains(observation)
    assert info["scene"] == "train-00"


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


def test_seed_decides_the_episode(scene):
    episodes = []
    for _ in range(2):
        env = ExploreEnv([scene, scene], size=16)
        env.reset(seed=3)
        episodes.append([env.step(np.int64(a))[0]["depth"] for a in (0, 1, 0)])
        env.reset()
        episodes[-1].append(env.step(np.int64(0))[0]["depth"])
    np.testing.assert_array_equal(episodes[0], episodes[1])


def test_a_reward_with_memory_is_reset(scene):
    class Constant:
        resets = 0

        def reset(self, rng):
            self.resets += 1

        def __call__(self, transition):
            return 2.0

    reward = Constant()
    env = ExploreEnv(scene, reward, size=16)
    env.reset(seed=0)
    env.reset()
    assert reward.resets == 2
    assert env.step(np.int64(1))[1] == 2.0


def test_window_follows_the_robot_and_stops_at_the_border():
    state = empty_map(planar_pose(0, 0, 0), size=20, cell=1.0)
    state.semantics[3, 10, 11] = True
    window = local_window(state, 10)
    assert np.argwhere(window[2]).tolist() == [[5, 5]]
    assert window[4, 5, 6] == 4
    state.pose[:2, 3] = 9.5, -9.5
    assert np.argwhere(local_window(state, 10)[2]).tolist() == [[0, 9]]


def test_wrong_names_are_told_at_once(scene):
    with pytest.raises(UnknownNameError, match="valid names"):
        ExploreEnv("nowhere-1")
    with pytest.raises(UnknownNameError, match="valid names"):
        ExploreEnv(scene, reward="none")
    with pytest.raises(ValueError, match="at least one"):
        ExploreEnv([])
