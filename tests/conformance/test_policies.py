"""Every built-in policy passes the checks that a plug-in must pass, and acts in a simulated scene."""

import numpy as np
import pytest
from toy_scene import empty_room, two_rooms

from autonerf_lab.exploration import explore, visible_map
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.mapping import empty_map, update
from autonerf_lab.policies import POLICIES, PrivilegedPolicy, check_policy, make_policy
from autonerf_lab.simulator import Simulator
from autonerf_lab.types import Action

CAMERA = Intrinsics.from_fov(48, 48)


@pytest.fixture(scope="module")
def sim():
    return Simulator(two_rooms(), CAMERA, rgb=False)


@pytest.mark.parametrize("name", POLICIES)
def test_every_built_in_policy_conforms(name: str) -> None:
    check_policy(POLICIES[name])


@pytest.mark.parametrize("name", POLICIES)
def test_every_policy_conforms_on_a_rollout(name, sim):
    """Valid actions, equal for equal seeds, waypoints of two coordinates, map unchanged."""
    policy = make_policy(name)
    rollouts = []
    for _ in range(2):
        policy.reset(np.random.default_rng(3))
        if isinstance(policy, PrivilegedPolicy):
            policy.set_visible_map(visible_map(sim, 100))
        observation = sim.reset(seed=1)
        state = empty_map(observation.pose)
        actions = []
        for _ in range(60):
            state = update(state, observation, CAMERA)
            before = state.explored.copy(), state.viewpoints.copy()
            actions.append(policy.act(state, observation))
            assert actions[-1] in list(Action)
            assert policy.waypoint is None or policy.waypoint.shape == (2,)
            np.testing.assert_array_equal(state.explored, before[0])
            np.testing.assert_array_equal(state.viewpoints, before[1])
            observation = sim.step(actions[-1])
        rollouts.append(actions)
    assert rollouts[0] == rollouts[1]


@pytest.mark.parametrize("name", POLICIES)
def test_a_rollout_in_a_closed_room_has_all_steps(name):
    sim = Simulator(empty_room(3.0, 2.0), CAMERA, supersample=1)
    trajectory = explore(sim, name, 120, seed=0, progress=False)
    assert len(trajectory) == 120 and len(set(trajectory.meta["actions"])) > 1
