"""Rewards of installed packages: found by name; a broken one is skipped."""

from pathlib import Path

import gymnasium
import numpy as np
import pytest
from installed_plugins import Site, install_example, run_command, run_example_tests

from autonerf_lab.errors import RewardError, UnknownNameError
from autonerf_lab.rewards import REWARDS, available, make_reward
from autonerf_lab.utils.plugins import PluginWarning, strict

SMALL = {"scene": "train-00", "size": 16, "window": 60, "rgb": False}
GOOD = "def reward(step):\n    'One a step, steps: always.'\n    return 1.0\n"
BROKEN = {
    "missing import": ("import nobody_has_this", "ModuleNotFoundError: No module named 'nobody_has_this'"),
    "exits": ("raise SystemExit('no GPU')", "SystemExit: no GPU"),
    "no such name": ("", "AttributeError"),
    "not callable": ("reward = {}", "a reward must be callable, a dict is not"),
    "makes nothing": ("def reward(): pass", "a function that makes a reward must not return a NoneType"),
    "two arguments": ("def reward(step, more): return 1.0", "missing 1 required positional argument: 'more'"),
    "raises": ("def reward(step): return 1 / 0", "ZeroDivisionError"),
    "nan": ("def reward(step): return float('nan')", "must be finite, not nan"),
    "list": ("def reward(step): return [1.0]", "must be a number, not [1.0]"),
    "text": ("def reward(step): return '1.0'", "must be a number, not '1.0'"),
    "cannot be made": ("class reward:\n    def __init__(self): raise OSError('no camera')", "OSError: no camera"),
    "changes the map": ("def reward(step):\n    step.after.explored[:] = 1\n    return 1.0", "must not change"),
}


def install(site: Site, package: str, name: str, code: str) -> None:
    site.install(package, name, code, "reward", "rewards")


def test_the_example_is_installed_listed_and_used_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = install_example("reward_plugin", tmp_path)

    listed = run_command(target, "rewards", "--strict-plugins")
    assert listed.returncode == 0, listed.stderr
    lines = [line.split() for line in listed.stdout.splitlines()]
    assert [line[0] for line in lines] == [*REWARDS, "careful"]
    assert lines[0] == ["cov", "square", "metres", "autonerf-lab"]
    assert lines[-1] == ["careful", "square", "metres", "careful-reward"]

    monkeypatch.syspath_prepend(target)
    env = gymnasium.make("AutoNeRF/Explore-v0", reward="careful+0.1*nov", **SMALL)
    env.reset(seed=0)
    terms = [env.step(np.int64(0))[4]["reward_terms"] for _ in range(20)]
    assert all(set(step) == {"careful", "nov"} for step in terms)
    assert min(step["careful"] for step in terms) < 0 < max(step["careful"] for step in terms)  # with collisions


def test_the_test_of_the_example_passes(tmp_path: Path) -> None:
    assert "2 passed" in run_example_tests("reward_plugin", tmp_path)


@pytest.mark.parametrize("kind", BROKEN)
def test_a_broken_one_is_named_and_left_out(site: Site, kind: str) -> None:
    code, reason = BROKEN[kind]
    install(site, "bad-reward", "bad", code)
    install(site, "good-reward", "good", GOOD)
    with pytest.warns(PluginWarning) as caught:
        found = available()
    assert list(found) == [*REWARDS, "good"]
    (message,) = [str(warning.message) for warning in caught]
    assert "plug-in 'bad' (bad_reward:reward) was skipped" in message and reason in message
    with strict(), pytest.raises(PluginWarning, match="plug-in 'bad'"):
        available()


def test_the_name_of_another_is_not_taken(site: Site) -> None:
    install(site, "usurper", "cov", "raise RuntimeError('this code ran')")
    with pytest.warns(PluginWarning, match=r"plug-in 'cov' \(usurper:reward\) .* the name 'cov' is taken"):
        assert available()["cov"] is REWARDS["cov"]


def test_built_ins_and_their_sums_are_found_without_loading_any(site: Site) -> None:
    install(site, "bad-reward", "bad", "1 / 0")
    make_reward("cov+0.1*nov")  # a warning would be an error
    with pytest.warns(PluginWarning, match="'bad'"), pytest.raises(UnknownNameError, match=r"'bad'; valid names: cov"):
        make_reward("cov+bad")


def test_the_command_lists_the_rest_and_is_strict_where_asked(site: Site) -> None:
    install(site, "bad-reward", "bad", "1 / 0")
    install(site, "good-reward", "good", GOOD)
    listed = run_command(site.folder, "rewards")
    assert listed.returncode == 0 and "plug-in 'bad'" in listed.stderr and "ZeroDivisionError" in listed.stderr
    assert listed.stdout.splitlines()[-1].split() == ["good", "steps", "good-reward"]
    refused = run_command(site.folder, "rewards", "--strict-plugins")
    assert refused.returncode == 1 and not refused.stdout
    assert refused.stderr.startswith("error: plug-in 'bad'") and refused.stderr.count("\n") == 1


def test_what_goes_wrong_later_names_reward_value_and_step(site: Site) -> None:
    code = "def reward(step): return 1.0 if step.observation.step != 3 or step.after.cell != 0.2 else float('nan')"
    install(site, "late-reward", "late", code)
    for reward in ("late", "cov+late"):
        env = gymnasium.make("AutoNeRF/Explore-v0", reward=reward, **SMALL)
        env.reset(seed=0)
        for _ in range(2):
            env.step(np.int64(1))
        with pytest.raises(RewardError, match="reward 'late' returned nan at step 3, not a finite number"):
            env.step(np.int64(1))
