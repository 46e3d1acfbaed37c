"""Plug-ins of installed packages: a broken one is reported by name and left out, the others are not disturbed."""

import json
from pathlib import Path

import pytest
from installed_plugins import Site
from toy_scene import two_rooms

from autonerf_lab.errors import DataError, UnknownNameError, WrongTypeError
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.nerf import MODELS, available, fit, load_nerf, model_spec
from autonerf_lab.pipeline import check_names
from autonerf_lab.utils.plugins import PluginWarning, installed, package_of

GOOD = """
from dataclasses import replace
from autonerf_lab.nerf.model import ModelSpec
from autonerf_lab.nerf.models.instant_ngp import SETTINGS, build
SPEC = ModelSpec({"smoke": replace(SETTINGS["smoke"], steps=2, seen_rays=500)}, build)
"""


def test_a_good_one_is_listed_by_the_name_it_is_registered_by(site: Site) -> None:
    site.install("good-nerf", "good", GOOD)
    assert set(available()) == {*MODELS, "good"}
    assert model_spec("good").name == "good"
    assert package_of("models", "good") == "good-nerf"
    check_names(model="good")  # as the command line does


@pytest.mark.parametrize(
    ("code", "value", "reason"),
    [
        ("import nobody_has_this", "SPEC", "ModuleNotFoundError: No module named 'nobody_has_this'"),
        ("def f(:", "SPEC", "SyntaxError"),
        ("1 / 0", "SPEC", "ZeroDivisionError"),
        ("import sys; sys.exit('no GPU')", "SPEC", "SystemExit: no GPU"),
        ("", "SPEC", "AttributeError"),
        (GOOD, "build", "TypeError: it is a function, not a ModelSpec"),
        (GOOD, "ModelSpec", "TypeError: it is a type, not a ModelSpec"),
        ("SPEC = {}", "SPEC", "TypeError: it is a dict, not a ModelSpec"),
    ],
    ids=["missing import", "syntax", "raises", "exits", "no such name", "function", "class", "dict"],
)
def test_a_broken_one_is_named_and_left_out(site: Site, code: str, value: str, reason: str) -> None:
    site.install("bad-nerf", "bad", code, value)
    site.install("good-nerf", "good", GOOD)
    with pytest.warns(PluginWarning) as caught:
        found = available()
    assert set(found) == {*MODELS, "good"}
    (message,) = [str(warning.message) for warning in caught]
    assert f"plug-in 'bad' (bad_nerf:{value}) is left out" in message and reason in message


def test_one_that_takes_the_name_of_another_is_left_out_unread(site: Site) -> None:
    site.install("usurper", "instant-ngp", "raise RuntimeError('this code ran')")
    site.install("good-nerf", "good", GOOD)
    site.install("late-nerf", "good", GOOD)
    with pytest.warns(PluginWarning) as caught:
        found = available()
    assert set(found) == {*MODELS, "good"} and found["instant-ngp"] is MODELS["instant-ngp"]
    messages = sorted(str(warning.message) for warning in caught)
    assert len(messages) == 2 and "the name 'good' is taken" in messages[0] and "late_nerf" in messages[0]
    assert "plug-in 'instant-ngp' (usurper:SPEC)" in messages[1] and "'instant-ngp' is taken" in messages[1]


def test_a_built_in_is_found_without_loading_any(site: Site) -> None:
    site.install("bad-nerf", "bad", "1 / 0")
    assert model_spec("semantic-nerfacto").build is MODELS["semantic-nerfacto"].build  # a warning would be an error


def test_asking_for_a_broken_one_lists_what_there_is(site: Site) -> None:
    site.install("bad-nerf", "bad", "1 / 0")
    with (
        pytest.warns(PluginWarning, match="'bad'"),
        pytest.raises(UnknownNameError, match=r"model 'bad'; .*instant-ngp"),
    ):
        model_spec("bad")


def test_groups_do_not_mix(site: Site) -> None:
    site.install("other", "other", "SPEC = 1", group="rewards")
    assert set(available()) == set(MODELS)
    assert installed("rewards", {}, int) == {"other": 1}


@pytest.mark.parametrize("wrong", [None, 3, {}, MODELS["instant-ngp"].build, dict])
def test_a_model_is_a_name_or_a_spec(wrong: object) -> None:
    kind = "dict" if wrong is dict else f"a {type(wrong).__name__}"
    with pytest.raises(WrongTypeError, match=f"a name or a ModelSpec, not {kind}; ModelSpec"):
        fit(object(), wrong)


@pytest.fixture
def saved(site: Site, tmp_path: Path) -> Path:
    """A field of a plug-in's model, whose package was taken off afterwards."""
    from autonerf_lab.exploration import explore
    from autonerf_lab.simulator import Simulator

    site.install("good-nerf", "good", GOOD)
    walk = explore(Simulator(two_rooms(), Intrinsics.from_fov(12, 12), supersample=1), "random", 8, progress=False)
    field = fit(walk, "good", "smoke", progress=False)
    field.save(tmp_path / "field")
    assert load_nerf(tmp_path / "field").meta == field.meta
    site.uninstall("good-nerf")
    return tmp_path / "field"


def test_a_field_whose_package_is_gone_says_what_to_install(saved: Path) -> None:
    with pytest.raises(DataError) as caught:
        load_nerf(saved)
    message = str(caught.value)
    assert "needs the model 'good', which is not installed" in message
    assert "install the package 'good-nerf'" in message and str(saved / "nerf.json") in message
    assert "\n" not in message and "Error" not in message


def test_it_is_read_with_the_model_in_hand(saved: Path) -> None:
    assert load_nerf(saved, model=MODELS["instant-ngp"]).meta["model"] == "good"


@pytest.mark.parametrize("meta", [None, [], {}, {"model": None}, {"model": ["good"]}])
def test_a_file_that_names_no_model_is_refused(saved: Path, meta: object) -> None:
    content = json.loads((saved / "nerf.json").read_text())
    (saved / "nerf.json").write_text(json.dumps(content | {"meta": meta}))
    with pytest.raises(DataError, match=r"nerf\.json does not describe a field"):
        load_nerf(saved)


def test_names_out_of_a_file_are_quoted_and_cut(saved: Path) -> None:
    content = json.loads((saved / "nerf.json").read_text())
    content["package"], content["meta"]["model"] = "x" * 5000, "y\n" * 5000
    (saved / "nerf.json").write_text(json.dumps(content))
    with pytest.raises(DataError) as caught:
        load_nerf(saved)
    assert len(str(caught.value)) < 600 and "\n" not in str(caught.value)
