"""Learned rewards: their training, and their values for given behaviours of the robot."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from toy_scene import to_scene, two_rooms

from autonerf_lab.errors import DataError, TrainingError
from autonerf_lab.geometry import Intrinsics, planar_pose
from autonerf_lab.rewards.conformance import blank_transition, random_transitions, run_episode, same_arrays
from autonerf_lab.rewards.cur import Curiosity
from autonerf_lab.rewards.rec import EVERY, Reconstruction
from autonerf_lab.rewards.visual_concepts import CONCEPTS, DESCRIPTOR, GRID, ORIENTATIONS, Concepts, describe
from autonerf_lab.simulator import Simulator
from autonerf_lab.types import Action, Observation


def step_of(observation, action=Action.FORWARD):
    return replace(blank_transition(), observation=observation, action=action)


def observed(rgb, depth=1.0, pose=None):
    rgb = np.asarray(rgb, np.uint8)
    flat = np.full(rgb.shape[:2], depth, np.float32)
    return Observation(rgb, flat, np.zeros(rgb.shape[:2], np.uint8), planar_pose(0, 0, 0) if pose is None else pose)


def transitions_of(*images):
    return [step_of(observed(rgb)) for rgb in images]


@pytest.mark.parametrize("reward", [Curiosity, Reconstruction])
def test_initial_values_do_not_depend_on_the_number_of_threads(reward):
    """A training process has two threads, its workers have one."""
    threads = torch.get_num_threads()
    try:
        states = []
        for count in (1, 2):
            torch.set_num_threads(count)
            states.append(reward().state_dict())
            assert torch.get_num_threads() == count
    finally:
        torch.set_num_threads(threads)
    assert same_arrays(*states)


# --- curiosity -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def two_images():
    rng = np.random.default_rng(0)
    return [np.kron(rng.integers(0, 256, (4, 4, 3)), np.ones((8, 8, 1))) for _ in range(2)]


def test_curiosity_is_the_squared_error_of_a_model_that_initially_predicts_no_change(two_images):
    reward = Curiosity()
    a, b = two_images
    values = run_episode(reward, transitions_of(a, a, b, a))
    phi = reward.collect()
    assert values[:2] == [0, 0]  # nothing came before; nothing changed
    change = np.square(phi["after"][1].astype(float) - phi["before"][1]).sum()
    assert values[2] == pytest.approx(change / 100, rel=1e-4) and values[2] == pytest.approx(values[3])
    np.testing.assert_array_equal(phi["after"][:-1], phi["before"][1:])
    image, coarse_map = np.split(phi["after"], 2, axis=1)
    assert image.mean(axis=1) == pytest.approx(0, abs=1e-6) and not coarse_map.any()  # blank map
    assert np.square(image).mean(axis=1) == pytest.approx(1, abs=1e-3)  # features cannot collapse


def test_new_ground_gives_a_prediction_error_with_an_unchanged_image(two_images):
    """One newly explored block changes the features by a column of the random matrix times its explored share."""
    reward = Curiosity()
    step = step_of(observed(two_images[0]))
    size, cell = len(step.after.explored), step.after.cell
    explored = step.after.explored.copy()
    explored[size // 2, size // 2 : size // 2 + 4] = True
    more = replace(step, after=replace(step.after, explored=explored))
    values = run_episode(reward, [step, step, more, more])
    share, middle = 4 * cell**2, 16 * 32 + 16
    column = reward.state_dict()["network.coarse_map.weight"][:, 32 * 32 + middle]
    assert values[:2] == [0, 0] and values[3] == 0
    assert values[2] == pytest.approx((share * column**2).sum() * share / 100, rel=1e-4)


def test_the_prediction_error_of_repeated_transitions_decreases(two_images):
    a, b = two_images
    rng = np.random.default_rng(1)
    new = np.kron(rng.integers(0, 256, (4, 4, 3)), np.ones((8, 8, 1)))
    reward = Curiosity()
    run_episode(reward, transitions_of(*[a, b] * 32))
    batch = reward.collect()
    losses = [reward.update(batch)["loss"] for _ in range(20)]
    assert losses[-1] < 0.1 * losses[0] and min(losses[10:]) < min(losses[:10])
    known, unknown = run_episode(reward, transitions_of(a, b, new))[1:]
    assert unknown > 5 * known


def test_the_effect_of_the_action_is_learned(two_images):
    """Two actions lead from one image to different ones, so the prediction must depend on the action."""
    a, b = two_images
    reward = Curiosity()
    steps = [step_of(observed(b if k % 2 else a), Action(k % 2)) for k in range(64)]
    rng = np.random.default_rng(0)
    run_episode(reward, [steps[k] for k in rng.integers(0, 64, 128)])
    batch = reward.collect()
    for _ in range(20):
        reward.update(batch)
    right = run_episode(reward, [steps[0], steps[1]])[1]
    wrong = run_episode(reward, [steps[0], replace(steps[1], action=Action(0))])[1]
    assert wrong > 5 * right


def test_rewards_are_in_standard_deviations_of_the_discounted_sum():
    """Statistics of four errors, computed by hand."""
    errors = np.array([1.0, 2.0, 0.0, 5.0])
    reward = Curiosity()
    reward._count_returns(errors)
    total, sums = errors.mean() / 0.01, []
    for error in errors:
        total = 0.99 * total + error
        sums.append(total)
    assert reward.state_dict()["return"] == pytest.approx([sums[-1], 4, np.mean(sums), np.var(sums)])
    assert reward._scale == pytest.approx(np.std(sums))


def test_an_error_counts_relative_to_the_mean_error_of_its_action():
    reward = Curiosity()
    ahead, left, right = (int(a) for a in (Action.FORWARD, Action.TURN_LEFT, Action.TURN_RIGHT))
    assert reward._relative(np.array([3.0]), np.array([left])) == [3.0]  # nothing is known yet
    reward._count_errors(np.array([1.0, 6.0, 3.0, 10.0]), np.array([ahead, left, ahead, left]))
    errors, actions = np.array([4.0, 4.0, 4.0]), np.array([ahead, left, right])
    assert reward._relative(errors, actions) == pytest.approx([2.0, 0.5, 4.0])
    reward._count_errors(np.full(2000, 4.0), np.full(2000, left))  # older ones fade
    assert reward._relative(errors, actions) == pytest.approx([2.0, 1.0, 4.0])


def test_depth_is_used_without_colors():
    black = np.zeros((8, 8, 3), np.uint8)
    near = step_of(observed(black))
    ramp = replace(near.observation, depth=np.tile(np.linspace(1, 5, 8, dtype=np.float32), (8, 1)))
    still, moved = run_episode(Curiosity(), [near, near, step_of(ramp)])[1:]
    assert still == 0 and moved > 0


# --- reconstruction --------------------------------------------------------------------------------------------------


def test_descriptor_of_a_synthetic_image():
    rgb = np.zeros((84, 84, 3), np.uint8)
    rgb[:, 42:] = 255, 0, 0  # the right half is red
    found = describe(observed(rgb, depth=10.0))
    assert found.shape == (DESCRIPTOR,) and found.dtype == np.float32
    light, red, blue, depth = found[: 4 * GRID**2].reshape(4, GRID, GRID)
    expected = np.tile([0, 0, 1, 1], (GRID, 1))
    np.testing.assert_allclose(light, expected / 3, atol=1e-6)
    np.testing.assert_allclose(red, expected / 2, atol=1e-6)
    np.testing.assert_allclose(blue, -expected / 4, atol=1e-6)
    np.testing.assert_allclose(depth, 1)  # all that is farther than 5 m
    edges = found[4 * GRID**2 :].reshape(GRID, GRID, ORIENTATIONS)
    assert edges[:, 1:3, 0] == pytest.approx(np.full((GRID, 2), 1 / np.sqrt(2 * GRID)), abs=1e-2)  # one vertical edge
    assert edges[..., 1:].max() == 0 == edges[:, [0, 3]].max()
    turned = describe(observed(rgb.transpose(1, 0, 2), depth=10.0))[4 * GRID**2 :].reshape(GRID, GRID, ORIENTATIONS)
    assert turned[1:3, :, ORIENTATIONS // 2].min() > 0.3


def test_concepts_converge_to_the_true_clusters():
    rng = np.random.default_rng(0)
    centres = rng.normal(size=(CONCEPTS, DESCRIPTOR)).astype(np.float32)
    concepts = Concepts(0)
    assert not concepts.known
    concepts.learn(centres)
    assert concepts.known
    for _ in range(5):
        kinds = np.tile(np.arange(CONCEPTS), 4)
        concepts.learn(centres[kinds] + 0.1 * rng.normal(size=(len(kinds), DESCRIPTOR)).astype(np.float32))
    found = concepts.probabilities(centres).argmax(axis=1)
    assert sorted(found) == list(range(CONCEPTS))  # one concept per cluster
    assert concepts.probabilities(centres).sum(axis=1) == pytest.approx(1, abs=1e-5)
    assert concepts.prior == pytest.approx(1 / CONCEPTS, abs=1e-6)
    distances = np.linalg.norm(concepts.state_dict()["centres"][found] - centres, axis=1)
    assert distances.max() < 0.1 * np.sqrt(DESCRIPTOR)  # nearer than the samples are


@pytest.fixture(scope="module")
def sim():
    return Simulator(to_scene(two_rooms()), Intrinsics.from_fov(32, 32), supersample=1)


def look(sim, pose):
    frame = sim.render(pose)
    return Observation(frame.rgb, frame.depth, frame.semantics, pose)


def episode(sim, reward, rng, choose, steps=40):
    """Run an episode with random references; ``choose`` selects the views from them."""
    reward.reset(rng)
    references = [look(sim, sim.sample_pose(rng)) for _ in range(reward.references)]
    reward.set_references(references)
    return [reward(step_of(choose(k, references))) for k in range(steps)]


@pytest.fixture(scope="module")
def trained(sim):
    """State after eight episodes at random poses, and the losses."""
    reward, rng = Reconstruction(), np.random.default_rng(0)
    losses = []
    for _ in range(8):
        episode(sim, reward, rng, lambda k, references: look(sim, sim.sample_pose(rng)))
        losses.append(reward.update(reward.collect())["loss"])
    return reward.state_dict(), losses


def total(sim, trained, choose, seed):
    reward = Reconstruction()
    reward.load_state_dict(trained[0])
    return sum(episode(sim, reward, np.random.default_rng(seed), choose))


def test_seeing_the_references_is_rewarded_more_than_standing_still(sim, trained):
    for seed in range(3):
        rng = np.random.default_rng(seed)
        shown = total(sim, trained, lambda k, references: references[k % len(references)], seed)
        around = total(sim, trained, lambda k, references: look(sim, sim.sample_pose(rng)), seed)  # noqa: B023
        still = total(sim, trained, lambda k, references: references[0], seed)
        assert shown > 2 * max(still, 0) and around > still, (shown, around, still)
        assert shown > 0.8


def test_reconstruction_is_rewarded_every_five_steps_and_resets(sim, trained):
    reward = Reconstruction()
    reward.load_state_dict(trained[0])

    def choose(k, references):
        return references[k % len(references)]

    values = episode(sim, reward, np.random.default_rng(5), choose)
    assert {k % EVERY for k, value in enumerate(values) if value} == {EVERY - 1}
    assert values == episode(
        sim, reward, np.random.default_rng(5), lambda k, references: references[k % len(references)]
    )
    # the decreases add up to the first divergence minus the last
    assert sum(values) > 0


def test_without_references_or_concepts_the_reward_is_zero(sim):
    transitions = random_transitions(np.random.default_rng(0), 20)
    reward = Reconstruction()
    assert run_episode(reward, transitions) == [0.0] * 20
    reward.reset(np.random.default_rng(0))
    assert [reward(step) for step in transitions] == [0.0] * 20


# --- both ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [Curiosity, Reconstruction])
class TestBoth:
    def test_seeds_determine_the_state_and_the_global_generator_is_unchanged(self, kind):
        torch.manual_seed(7)
        before = torch.get_rng_state()
        one, same, other = kind(seed=1), kind(seed=1), kind(seed=2)
        assert torch.equal(before, torch.get_rng_state())
        assert same_arrays(one.state_dict(), same.state_dict())
        assert not same_arrays(one.state_dict(), other.state_dict())

    def test_a_resumed_training_equals_an_uninterrupted_one(self, kind):
        episodes = [random_transitions(np.random.default_rng(k), 40) for k in range(4)]
        whole, half = kind(), kind()
        for k, transitions in enumerate(episodes):
            for reward in (whole, half):
                run_episode(reward, transitions)
                reward.update(reward.collect())
            if k == 1:
                resumed = kind(seed=9)
                resumed.load_state_dict(half.state_dict())
                half = resumed
        assert same_arrays(whole.state_dict(), half.state_dict())

    def test_loading_a_state_does_not_change_a_running_episode(self, kind):
        transitions = random_transitions(np.random.default_rng(0), 20)
        here, there = kind(), kind()
        values = [run_episode(reward, transitions[:10]) for reward in (here, there)]
        here.load_state_dict(there.state_dict())
        assert values[0] == values[1]
        assert [here(step) for step in transitions[10:]] == [there(step) for step in transitions[10:]]
        assert same_arrays(here.collect(), there.collect())

    def test_the_state_of_another_reward_is_refused(self, kind):
        reward = kind()
        state = reward.state_dict()
        name = sorted(state)[0]
        for wrong in (
            {},
            {k: v for k, v in state.items() if k != name},
            state | {"more": np.zeros(1)},
            state | {name: np.zeros(3, np.int8)},
        ):
            with pytest.raises(DataError, match="the state belongs to another reward: '"):
                reward.load_state_dict(wrong)
        assert same_arrays(reward.state_dict(), state)

    def test_a_loss_that_is_not_finite_stops_the_training(self, kind):
        reward = kind()
        run_episode(reward, random_transitions(np.random.default_rng(0), 80))
        batch = reward.collect()
        reward.update(batch)
        state = reward.state_dict()
        batch["after" if kind is Curiosity else "views"][:] = np.nan
        with pytest.raises(TrainingError, match="loss of a learned reward is nan"):
            reward.update(batch)
        kept = reward.state_dict()
        assert all(np.isfinite(v).all() for k, v in kept.items() if k.startswith("network"))
        assert state.keys() == kept.keys()

    def test_the_number_of_uncollected_samples_is_bounded(self, kind):
        reward = kind()
        assert reward._samples.maxlen is not None

    def test_batches_are_concatenated_even_if_one_is_empty(self, kind):
        full, empty = kind(), kind()
        run_episode(full, random_transitions(np.random.default_rng(0), 10))
        a, b = full.collect(), empty.collect()
        both = {name: np.concatenate([a[name], b[name]]) for name in a}
        assert same_arrays(both, a) and full.update(both) and empty.update(b) == {}
