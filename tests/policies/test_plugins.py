"""Policies of installed packages and importable classes; a broken plug-in is skipped."""

from pathlib import Path

import numpy as np
import pytest
from installed_plugins import Site, install_example, run_command, run_example_tests
from toy_scene import empty_room

from autonerf_lab.errors import DataError, UnknownNameError, WrongTypeError
from autonerf_lab.exploration import explore
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.policies import POLICIES, Frontier, available, check_policy, make_policy
from autonerf_lab.simulator import Simulator
from autonerf_lab.types import Action
from autonerf_lab.utils.plugins import PluginWarning, strict

POLICY = """
class policy:
    waypoint = None
    def reset(self, rng):
        self.rng = rng
    def act(self, map, observation):
        return {}
"""
BROKEN = {
    "missing import": ("import nobody_has_this", "ModuleNotFoundError: No module named 'nobody_has_this'"),
    "not callable": ("policy = {}", "a policy is registered as a class or function, not a dict"),
    "needs an argument": ("class policy:\n    def __init__(self, x): pass", "missing 1 required positional argument"),
    "no act": ("class policy:\n    waypoint = None\n    def reset(self, rng): pass", "a policy needs a method 'act'"),
    "no waypoint": (POLICY.format(0).replace("waypoint", "goal"), "a policy needs an attribute 'waypoint'"),
    "fourth action": (POLICY.format("3"), "act must return an Action (0, 1 or 2), not 3"),
    "text": (POLICY.format("'left'"), "act must return an Action (0, 1 or 2), not 'left'"),
    "raises": (POLICY.format("1 / 0"), "ZeroDivisionError"),
    "other random numbers": (
        "import numpy as np\n" + POLICY.format("int(np.random.default_rng().integers(3))"),
        "with the same seed, a policy must choose the same actions",
    ),
    "writes to the map": (POLICY.format("map.explored.fill(True) or 0"), "act must not write to the map"),
    "three coordinates": (POLICY.format("0").replace("None", "[1, 2, 3]"), "a waypoint must be two finite numbers"),
}


def install(site: Site, package: str, name: str, code: str) -> None:
    site.install(package, name, code, "policy", "policies")


def test_the_example_is_installed_and_used_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = install_example("policy_plugin", tmp_path)
    monkeypatch.syspath_prepend(target)
    with strict():
        assert list(available()) == [*POLICIES, "bounce"]
    sim = Simulator(empty_room(), Intrinsics.from_fov(16, 16), rgb=False)
    trajectory = explore(sim, "bounce", steps=60, progress=False)
    assert trajectory.meta["policy"] == "bounce" and len(set(trajectory.meta["actions"])) > 1
    by_path = explore(sim, "bounce:Bounce", steps=60, progress=False)
    assert by_path.meta["actions"] == trajectory.meta["actions"]

    result = run_command(target, "explore", "--policy", "bounce", "--preset", "smoke", "--out", str(tmp_path / "run"))
    assert result.returncode == 0, result.stderr


def test_the_test_of_the_example_passes(tmp_path: Path) -> None:
    assert "2 passed" in run_example_tests("policy_plugin", tmp_path)


@pytest.mark.parametrize("kind", BROKEN)
def test_a_broken_plugin_is_named_and_skipped(site: Site, kind: str) -> None:
    code, reason = BROKEN[kind]
    install(site, "bad-policy", "bad", code)
    install(site, "good-policy", "good", POLICY.format("int(self.rng.integers(3))"))
    with pytest.warns(PluginWarning) as caught:
        found = available()
    assert list(found) == [*POLICIES, "good"]
    (message,) = [str(warning.message) for warning in caught]
    assert "plug-in 'bad' (bad_policy:policy) was skipped" in message and reason in message
    with strict(), pytest.raises(PluginWarning, match="plug-in 'bad'"):
        make_policy("good")


def test_built_in_names_are_not_replaced(site: Site) -> None:
    install(site, "other", "frontier", "raise RuntimeError('this code ran')")
    assert isinstance(make_policy("frontier"), Frontier)
    with pytest.warns(PluginWarning, match="the name 'frontier' is taken"):
        assert available()["frontier"] is POLICIES["frontier"]


def test_unknown_names_list_plugins(site: Site) -> None:
    install(site, "good-policy", "good", POLICY.format("0"))
    with pytest.raises(UnknownNameError, match=r"unknown policy 'best'; valid names: .*frontier-classic, good, "):
        make_policy("best")


@pytest.mark.parametrize(
    ("path", "error", "message"),
    [
        ("nobody_has_this:Policy", DataError, "'nobody_has_this:Policy' cannot be imported: No module named"),
        ("autonerf_lab.policies:Missing", DataError, "cannot be imported: .*Missing"),
        (":Policy", DataError, "write module:Class"),
        ("autonerf_lab.policies:WEIGHTS", WrongTypeError, "is a .*Path, not a class"),
        ("autonerf_lab.policies.modular:Modular", DataError, "cannot be created without arguments: TypeError"),
        ("collections:Counter", WrongTypeError, "collections:Counter is not a policy: a policy needs a method 'reset'"),
    ],
)
def test_errors_of_importable_classes(path: str, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        make_policy(path)


def test_a_module_that_fails_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    for name, code, message in (
        ("half_written", "def act(:", "SyntaxError"),
        ("leaves", "raise SystemExit('no GPU')", "no GPU"),
    ):
        (tmp_path / f"{name}.py").write_text(code)
        with pytest.raises(DataError, match=f"'{name}:Policy' cannot be imported: .*{message}"):
            make_policy(f"{name}:Policy")


def test_objects_are_checked() -> None:
    policy = Frontier()
    assert make_policy(policy) is policy
    with pytest.raises(WrongTypeError, match="it is a class; pass an instance"):
        make_policy(Frontier)  # type: ignore[arg-type]
    with pytest.raises(WrongTypeError, match="dict is not a policy: a policy needs a method 'reset'"):
        make_policy({})  # type: ignore[arg-type]


def test_actions_may_be_numpy_integers() -> None:
    class Numpy:
        waypoint = np.zeros(2)

        def reset(self, rng: np.random.Generator) -> None:
            self.rng = rng

        def act(self, map: object, observation: object) -> np.integer:
            return self.rng.integers(len(Action))

    check_policy(Numpy)
