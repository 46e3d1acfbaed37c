"""Plug-ins of installed packages: a broken plug-in is reported by name and skipped; the others are loaded."""

from pathlib import Path

import pytest
from installed_plugins import Site
from toy_scene import two_rooms

from autonerf_lab.errors import DataError, UnknownNameError, WrongTypeError
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.nerf import MODELS, available, fit, load_nerf, model_spec
from autonerf_lab.pipeline import check_arguments
from autonerf_lab.utils.plugins import PluginWarning, load_plugins, package_name_of
from autonerf_lab.utils.storage import read_arrays, write_arrays

GOOD = """
from dataclasses import replace
from autonerf_lab.nerf.model import ModelSpec
from autonerf_lab.nerf.models.instant_ngp import SETTINGS, build
SPEC = ModelSpec({"smoke": replace(SETTINGS["smoke"], steps=2, seen_rays=500)}, build)
"""


def test_valid_plugin_is_listed_by_its_registered_name(site: Site) -> None:
    site.install("good-nerf", "good", GOOD)
    assert set(available()) == {*MODELS, "good"}
    assert model_spec("good").name == "good"
    assert package_name_of("models", "good") == "good-nerf"
    check_arguments(model="good")  # the command line uses this check


@pytest.mark.parametrize(
    ("code", "value", "reason"),
    [
        ("import missing_package", "SPEC", "ModuleNotFoundError: No module named 'missing_package'"),
        ("def f(:", "SPEC", "SyntaxError"),
        ("1 / 0", "SPEC", "ZeroDivisionError"),
        ("import sys; sys.exit('no GPU')", "SPEC", "SystemExit: no GPU"),
        ("class Stop(BaseException): pass\nraise Stop('now')", "SPEC", "Stop: now"),
        ("", "SPEC", "AttributeError"),
        (GOOD, "build", "TypeError: it is a function, not a ModelSpec"),
        (GOOD, "ModelSpec", "TypeError: it is a type, not a ModelSpec"),
        ("SPEC = {}", "SPEC", "TypeError: it is a dict, not a ModelSpec"),
    ],
    ids=["missing import", "syntax", "raises", "exits", "no exception", "no such name", "function", "class", "dict"],
)
def test_broken_plugin_is_reported_and_skipped(site: Site, code: str, value: str, reason: str) -> None:
    site.install("bad-nerf", "bad", code, value)
    site.install("good-nerf", "good", GOOD)
    with pytest.warns(PluginWarning) as caught:
        found = available()
    assert set(found) == {*MODELS, "good"}
    (message,) = [str(warning.message) for warning in caught]
    assert f"plug-in 'bad' (bad_nerf:{value}) was skipped" in message and reason in message


def test_plugin_with_a_taken_name_is_skipped_without_loading(site: Site) -> None:
    site.install("usurper", "instant-ngp", "raise RuntimeError('this code ran')")
    site.install("good-nerf", "good", GOOD)
    site.install("late-nerf", "good", GOOD)
    with pytest.warns(PluginWarning) as caught:
        found = available()
    assert set(found) == {*MODELS, "good"} and found["instant-ngp"] is MODELS["instant-ngp"]
    messages = sorted(str(warning.message) for warning in caught)
    assert len(messages) == 2 and "the name 'good' is taken" in messages[0] and "late_nerf" in messages[0]
    assert "plug-in 'instant-ngp' (usurper:SPEC)" in messages[1] and "'instant-ngp' is taken" in messages[1]


def test_built_in_model_is_found_without_loading_plugins(site: Site) -> None:
    site.install("bad-nerf", "bad", "1 / 0")
    assert model_spec("semantic-nerfacto").build is MODELS["semantic-nerfacto"].build  # a warning would be an error


def test_request_of_a_broken_plugin_lists_the_valid_names(site: Site) -> None:
    site.install("bad-nerf", "bad", "1 / 0")
    with (
        pytest.warns(PluginWarning, match="'bad'"),
        pytest.raises(UnknownNameError, match=r"model 'bad'; .*instant-ngp"),
    ):
        model_spec("bad")


def test_groups_are_separate(site: Site) -> None:
    site.install("other", "other", "SPEC = 1", group="rewards")
    assert set(available()) == set(MODELS)
    assert load_plugins("rewards", {}, int) == {"other": 1}


@pytest.mark.parametrize("wrong", [None, 3, {}, MODELS["instant-ngp"].build, dict])
def test_model_must_be_a_name_or_a_spec(wrong: object) -> None:
    kind = "dict" if wrong is dict else f"a {type(wrong).__name__}"
    with pytest.raises(WrongTypeError, match=f"a name or a ModelSpec, not {kind}; create one with ModelSpec"):
        fit(object(), wrong)


@pytest.fixture
def saved(site: Site, tmp_path: Path) -> Path:
    """Field of a plug-in model whose package was uninstalled afterwards."""
    from autonerf_lab.exploration import explore
    from autonerf_lab.simulator import Simulator

    site.install("good-nerf", "good", GOOD)
    sim = Simulator(two_rooms(), Intrinsics.from_fov(12, 12), supersample=1)
    trajectory = explore(sim, "random", 8, progress=False)
    field = fit(trajectory, "good", "smoke", progress=False)
    field.save(tmp_path / "field")
    assert load_nerf(tmp_path / "field").meta == field.meta
    site.uninstall("good-nerf")
    return tmp_path / "field"


def test_field_of_an_uninstalled_package_names_the_package(saved: Path) -> None:
    with pytest.raises(DataError) as caught:
        load_nerf(saved)
    message = str(caught.value)
    assert "needs the model 'good', which is not installed" in message
    assert "install the package 'good-nerf'" in message and str(saved / "nerf.safetensors") in message
    assert "\n" not in message and "Error" not in message


def test_field_is_loaded_with_a_given_model(saved: Path) -> None:
    assert load_nerf(saved, model=MODELS["instant-ngp"]).meta["model"] == "good"


@pytest.mark.parametrize("meta", [None, [], {}, {"model": None}, {"model": ["good"]}])
def test_file_without_a_model_name_is_refused(saved: Path, meta: object) -> None:
    arrays, header = read_arrays(saved / "nerf.safetensors", dict)
    write_arrays(saved / "nerf.safetensors", arrays, header | {"meta": meta})
    with pytest.raises(DataError, match=r"nerf\.safetensors (does not describe a field|is not as expected)"):
        load_nerf(saved)


def test_names_from_a_file_are_quoted_and_shortened(saved: Path) -> None:
    arrays, header = read_arrays(saved / "nerf.safetensors", dict)
    header["package"], header["meta"]["model"] = "x" * 5000, "y\n" * 5000
    write_arrays(saved / "nerf.safetensors", arrays, header)
    with pytest.raises(DataError) as caught:
        load_nerf(saved)
    assert len(str(caught.value)) < 600 and "\n" not in str(caught.value)
