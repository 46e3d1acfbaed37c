import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

from autonerf_lab.errors import DataError, RewardError, UnknownNameError, WrongTypeError
from autonerf_lab.geometry import planar_pose
from autonerf_lab.rewards import REWARDS, LearnedReward, PrivilegedReward, evaluate, make_reward, weighted
from autonerf_lab.rewards.conformance import blank_transition, check_learned, check_reward, random_transitions
from autonerf_lab.rewards.cur import Curiosity

CHANNEL = {"cov": "explored", "obs": "occupied", "sem": "semantics", "view": "viewpoints"}
LEARNED = ("cur", "rec")


def transition_at(x, y, heading=0.0):
    """Make a transition that ends at this pose and observes nothing."""
    blank = blank_transition()
    pose = planar_pose(x, y, heading)
    return replace(blank, observation=replace(blank.observation, pose=pose))


def test_which_rewards_are_learned_and_privileged():
    made = {name: make_reward(name) for name in REWARDS}
    assert {name for name, reward in made.items() if isinstance(reward, LearnedReward)} == {"cur", "rec"}
    assert {name for name, reward in made.items() if isinstance(reward, PrivilegedReward)} == {"rec"}


@pytest.mark.parametrize("name", CHANNEL)
def test_a_reward_is_the_growth_of_its_channel_and_of_no_other(name):
    step = blank_transition(cell=0.05)
    for channel in CHANNEL.values():
        if channel != CHANNEL[name]:
            getattr(step.after, channel)[:] = True
    assert REWARDS[name](step) == 0
    mine = getattr(step.after, CHANNEL[name])
    mine.reshape(-1)[:20] = True
    getattr(step.before, CHANNEL[name]).reshape(-1)[:8] = True
    assert REWARDS[name](step) == pytest.approx(12 * 0.05**2)


def test_novelty_counts_the_steps_in_a_cell():
    reward = make_reward("nov")
    path = [(0.1, 0.1), (0.4, 0.4), (0.6, 0.1), (-0.1, 0.1), (0.3, 0.2), (0.6, 0.4)]  # cells of half a metre
    expected = [1, 1 / np.sqrt(2), 1, 1, 1 / np.sqrt(3), 1 / np.sqrt(2)]
    for _ in range(2):
        reward.reset(np.random.default_rng(0))
        assert [reward(transition_at(*position)) for position in path] == pytest.approx(expected)


def test_rewards_with_state_are_not_shared():
    one, other = make_reward("nov"), make_reward("nov")
    assert [one(transition_at(0, 0)), one(transition_at(0, 0)), other(transition_at(0, 0))] == pytest.approx(
        [1, 1 / np.sqrt(2), 1]
    )
    terms = [make_reward("cov+nov") for _ in range(2)]
    assert terms[0](transition_at(0, 0)) == terms[1](transition_at(0, 0)) == 1.0


# --- sums ------------------------------------------------------------------------------------------------------------


def test_a_sum_is_weighted_and_reports_its_terms():
    step = blank_transition(cell=0.5)
    step.after.explored[0, :4] = True

    def three(transition):
        return 3.0

    both = weighted({"cov": 2.0, "nov": 0.1, three: -1})
    assert both.terms() == {"cov": 0, "nov": 0, "three": 0}
    assert both(step) == pytest.approx(2 * 1.0 + 0.1 * 1 - 3)
    both(step)
    assert both.terms() == pytest.approx({"cov": 1.0, "nov": 1 / np.sqrt(2), "three": 3.0})
    both.reset(np.random.default_rng(0))
    assert both.terms() == {"cov": 0, "nov": 0, "three": 0}
    assert make_reward("2*cov + 0.1*nov")(step) == pytest.approx(2.1)


def test_a_sum_forwards_the_methods_of_its_terms():
    class Privileged:
        references = 3

        def __call__(self, transition):
            return 0.0

        def set_references(self, observations):
            self.count = len(observations)

    privileged = Privileged()
    both = weighted({"cov": 1.0, privileged: 1.0, "rec": 1.0})
    references = [step.observation for step in random_transitions(np.random.default_rng(0), both.references)]
    both.set_references(references)
    assert len(references) == 20 and privileged.count == 3
    assert {name.split("/")[0] for name in both.state_dict()} == {"rec"} == {n.split("/")[0] for n in both.collect()}
    plain = weighted({"cov": 1.0, "nov": 1.0})
    assert plain.references == 0 and plain.collect() == plain.state_dict() == plain.update({}) == {}
    with pytest.raises(DataError, match="no learned term of this sum has 'rec/"):
        plain.load_state_dict(both.state_dict())


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("cov+novv", UnknownNameError, "unknown reward 'novv'; valid names: cov, cur, nov, obs"),
        ("cov+x*nov", RewardError, "'x\\*nov' is neither NAME nor WEIGHT\\*NAME"),
        ("cov+nan*nov", RewardError, "weight of reward 'nov' is nan"),
        ("cov+inf*nov", RewardError, "weight of reward 'nov' is inf"),
        ("cov+0.5*cov", RewardError, "contains the term 'cov' twice"),
        ("cov+", UnknownNameError, "unknown reward ''"),
        ("cov+*nov", RewardError, "'\\*nov' is neither NAME nor WEIGHT\\*NAME"),
    ],
)
def test_a_sum_that_cannot_be_parsed_names_the_term(text, error, message):
    with pytest.raises(error, match=message):
        make_reward(text)


def test_an_empty_sum_and_equal_names_are_refused():
    with pytest.raises(RewardError, match="at least one term"):
        weighted({})
    with pytest.raises(RewardError, match=r"two terms .* '<lambda>'"):
        weighted({lambda step: 1.0: 1.0, lambda step: 2.0: 1.0})
    with pytest.raises(RewardError, match="'cov' is '1', not a finite number"):
        weighted({"cov": "1"})


def test_an_error_in_a_sum_names_the_term_and_the_step():
    def broken(transition):
        return {}["nothing"]

    step = blank_transition()
    with pytest.raises(RewardError, match="reward 'broken' failed at step 1: KeyError: 'nothing'"):
        weighted({"cov": 1.0, broken: 1.0})(step)
    with pytest.raises(RewardError, match=r"reward 'no_float' returned .* at step 1, not a finite number"):
        weighted({"cov": 1.0, no_float: 1.0})(step)


def no_float(transition):
    return NoFloat()


def test_weights_are_any_real_numbers():
    step = blank_transition()
    assert weighted({"nov": np.float32(0.5)})(step) == weighted({"nov": torch.tensor(0.5)})(step) == 0.5
    with pytest.raises(RewardError, match="the weight of reward 'cov' is 1000000"):
        weighted({"cov": 10**400})


# --- conformance -----------------------------------------------------------------------------------------------------


def test_conformance_finds_violations():
    def changes(step):
        step.after.explored[:] = True
        return 0.0

    def paints(step):
        step.observation.rgb[:] = 0
        return 0.0

    class Counts:
        total = 0.0

        def __call__(self, step):
            self.total += 1.0
            return self.total

    for bad, message in (
        (lambda step: "1.0", "must be a number, not '1.0'"),
        (lambda step: np.ones(1), "must be a number, not array"),
        (lambda step: np.inf, "finite"),
        (changes, "must not change"),
        (paints, "must not change"),
        (Counts(), "same steps must have the same reward"),
        (Counts, "same steps must have the same reward"),
        (lambda: None, "must not return a NoneType"),
        (lambda: Counts, "must not return a class"),
        (3, "an? int is not"),
    ):
        with pytest.raises(AssertionError, match=message):
            check_reward(bad)


def test_conformance_finds_violations_of_learned_rewards():
    def variant(**methods):
        return type("Variant", (Curiosity,), methods)

    class Forgetful(Curiosity):
        def collect(self):
            samples = list(self._samples)
            batch = super().collect()
            self._samples.extend(samples)
            return batch

    class Partial(Curiosity):
        def load_state_dict(self, state):
            moments = {k: v for k, v in self.state_dict().items() if k.startswith("exp_avg")}
            super().load_state_dict(state | moments)

    for bad, message in (
        (lambda: make_reward("nov"), "collect, update"),
        (Forgetful, "must clear"),
        (Partial, "must contain everything learned"),
        (variant(load_state_dict=lambda self, state: None), "the same values"),
        (variant(update=lambda self, batch: {}), "must return its losses"),
        (variant(update=lambda self, batch: {"loss": float("nan")}), "finite float, not nan"),
        (variant(update=lambda self, batch: {"loss": 0.0}), "must change the state"),
    ):
        with pytest.raises(AssertionError, match=message):
            check_learned(bad)


@pytest.mark.parametrize("value", [2, True, 2.5, np.float32(2.5), np.float64(2.5), np.array(2), torch.tensor(2.5)])
def test_any_real_number_is_a_reward(value):
    check_reward(lambda step: value)
    number = evaluate(lambda step: value, blank_transition(), "mine")
    assert type(number) is float and number == float(value)


class NoFloat:
    def __float__(self):
        raise RuntimeError("no float")


@pytest.mark.parametrize(
    "value",
    [
        *(np.nan, np.inf, np.float32("nan"), torch.tensor(-np.inf), None, "1.0", [1.0], np.ones(1), 1j, np.array(1j)),
        *(10**400, torch.tensor(1j), NoFloat()),
    ],
)
def test_other_values_are_refused_with_the_reward_and_the_step(value):
    with pytest.raises(AssertionError, match=r"must be (a number|finite), not"):
        check_reward(lambda step: value)
    with pytest.raises(RewardError, match=r"reward 'mine' returned .* at step 1, not a finite number"):
        evaluate(lambda step: value, blank_transition(), "mine")


def test_rewards_are_found_by_name_or_passed():
    assert make_reward("obs") is REWARDS["obs"]
    assert make_reward(len) is len
    with pytest.raises(UnknownNameError, match="valid names: cov, cur, nov, obs, rec, sem, view"):
        make_reward("coverage")
    with pytest.raises(WrongTypeError, match="must be a name or a callable, not a dict"):
        make_reward({"cov": 1.0})


def test_names_do_not_import_torch():
    code = "import sys, autonerf_lab.rewards as r; r.make_reward('cov+nov'); assert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
