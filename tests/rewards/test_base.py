"""Interface of rewards: units, values, errors that name the reward."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from autonerf_lab.errors import RewardError
from autonerf_lab.rewards.base import (
    evaluate,
    instantiate,
    name_of,
    newly_set_area,
    reset_reward,
    to_float,
    unit_of,
)
from autonerf_lab.rewards.conformance import blank_transition


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("Area, square metres.", "square metres"),
        ("Area, square metres: of the floor, and more.", "square metres"),
        ("Area.", ""),
        ("Area, square metres", ""),  # no full stop
        ("Area.\n\nMore, metres.", ""),  # only the first line counts
        ("Area of the floor, metres, more.", "more"),
        (None, ""),
    ],
)
def test_the_unit_is_in_the_first_line_of_the_docstring(text: str | None, unit: str) -> None:
    def reward(transition: object) -> float:
        return 1.0

    reward.__doc__ = text
    assert unit_of(reward) == unit


def test_entries_without_required_arguments_are_called() -> None:
    class Counter:
        def __init__(self, start: int = 3) -> None:
            self.start = start

        def __call__(self, transition: object) -> float:
            return 0.0

    def plain(transition: object) -> float:
        return 0.0

    made = instantiate(Counter)
    assert isinstance(made, Counter) and made.start == 3 and instantiate(plain) is plain
    assert instantiate(min) is min, "a function without a signature"


def test_names_in_messages() -> None:
    assert name_of("cov") == "cov" and name_of(len) == "len" and name_of(SimpleNamespace()) == "SimpleNamespace"


def test_reset_is_optional_and_its_errors_name_the_reward() -> None:
    reset_reward(len, np.random.default_rng(0), "mine")
    calls = []
    reset_reward(SimpleNamespace(reset=calls.append), rng := np.random.default_rng(0), "mine")
    assert calls == [rng]

    def fail(error: Exception) -> SimpleNamespace:
        def reset(rng: object) -> None:
            raise error

        return SimpleNamespace(reset=reset)

    with pytest.raises(RewardError, match="reward 'mine' failed in reset: ValueError: no map"):
        reset_reward(fail(ValueError("no map")), rng, "mine")
    with pytest.raises(RewardError, match=r"^already named$"):
        reset_reward(fail(RewardError("already named")), rng, "mine")


def test_values_are_finite_numbers() -> None:
    step = blank_transition()
    assert evaluate(lambda step: np.float32(2.5), step, "mine") == 2.5
    for value in (np.nan, -np.inf, None, "1", [1.0], np.ones(1), 1j):
        with pytest.raises(RewardError, match=r"reward 'mine' returned .* at step 1, not a finite number"):
            evaluate(lambda step, value=value: value, step, "mine")

    def broken(step: object) -> float:
        return 1 / 0

    with pytest.raises(RewardError, match="reward 'mine' failed at step 1: ZeroDivisionError: division by zero"):
        evaluate(broken, step, "mine")

    def named(step: object) -> float:
        raise RewardError("term 'a' failed")

    with pytest.raises(RewardError, match=r"^term 'a' failed$"):
        evaluate(named, step, "mine")


@pytest.mark.parametrize(
    ("value", "number"),
    [
        *((2, 2.0), (True, 1.0), (2.5, 2.5), (np.float16(0.5), 0.5), (np.array(3, np.uint8), 3.0), (np.bool_(1), 1.0)),
        *((torch.tensor(2), 2.0), (torch.tensor([2.0]), None), (torch.tensor(1j), None), (np.array(1j), None)),
        *(
            (b"1", None),
            (bytearray(b"1"), None),
            (np.array("1"), None),
            (np.datetime64(1, "s"), None),
            (object(), None),
        ),
        (10**400, None),
    ],
)
def test_numbers_are_converted_and_other_values_are_not(value: object, number: float | None) -> None:
    assert to_float(value) == number


def test_the_new_area_by_hand() -> None:
    """Five cells of 20 cm more, in two channels: 5 x 0.04 m²."""
    before, after = np.zeros((2, 4, 4), bool), np.zeros((2, 4, 4), bool)
    before[0, 0] = after[0, :2] = after[1, 3, 3] = True
    assert newly_set_area(before, after, SimpleNamespace(cell=0.2)) == pytest.approx(5 * 0.04)
    assert newly_set_area(after, after, SimpleNamespace(cell=0.2)) == 0.0
