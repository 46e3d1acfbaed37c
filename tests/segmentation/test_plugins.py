"""Segmenters of installed packages: found by name; a broken one is skipped."""

from pathlib import Path

import pytest
from installed_plugins import Site, install_example, run_example_tests

from autonerf_lab.segmentation import SEGMENTERS, available, make_segmenter
from autonerf_lab.utils.plugins import PluginWarning, strict

SEGMENTER = """
import numpy as np
from autonerf_lab.segmentation import Segmentation
class segmenter:
    def reset(self, rng):
        self.rng = rng
    def __call__(self, rgb, depth=None, truth=None):
        labels = np.zeros(rgb.shape[:-1], np.uint8)
        return {}
"""
GOOD = "Segmentation(labels, np.ones(labels.shape, np.float32))"
BROKEN = {
    "missing import": ("import nobody_has_this", "ModuleNotFoundError"),
    "not callable": ("segmenter = {}", "is registered as a class or function, not a dict"),
    "no reset": (SEGMENTER.format(GOOD).replace("reset", "start"), "a segmenter needs a method 'reset'"),
    "labels only": (SEGMENTER.format("labels"), "must return a Segmentation, not a ndarray"),
    "seventeenth class": (SEGMENTER.format(GOOD.replace("labels,", "labels + 16,", 1)), "labels must be 0 to 15"),
    "percent": (SEGMENTER.format(GOOD.replace("np.ones", "90 * np.ones")), "confidences must be in [0, 1]"),
    "half size": (SEGMENTER.format(GOOD.replace("labels,", "labels[..., ::2],", 1)), "labels of (2, 48, 48) images"),
    "other random numbers": (
        SEGMENTER.format("Segmentation(np.random.default_rng().integers(16, size=labels.shape, dtype=np.uint8), "
                         "np.ones(labels.shape, np.float32))"),
        "with the same seed, a segmenter must return the same labels",
    ),
    "writes to the image": (SEGMENTER.format(f"rgb.fill(0) or {GOOD}"), "must not write to its inputs"),
}  # fmt: skip


def install(site: Site, package: str, name: str, code: str) -> None:
    site.install(package, name, code, "segmenter", "segmenters")


def test_the_example_is_installed_and_its_test_passes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = install_example("segmenter_plugin", tmp_path)
    monkeypatch.syspath_prepend(target)
    with strict():
        assert list(available()) == [*SEGMENTERS, "green-plants"]
    assert type(make_segmenter("green-plants")).__name__ == "GreenPlants"


def test_the_test_of_the_example_passes(tmp_path: Path) -> None:
    assert "2 passed" in run_example_tests("segmenter_plugin", tmp_path)


@pytest.mark.parametrize("kind", BROKEN)
def test_a_broken_plugin_is_named_and_skipped(site: Site, kind: str) -> None:
    code, reason = BROKEN[kind]
    install(site, "bad-segmenter", "bad", code)
    install(site, "good-segmenter", "good", SEGMENTER.format(GOOD))
    with pytest.warns(PluginWarning) as caught:
        found = available()
    assert list(found) == [*SEGMENTERS, "good"]
    (message,) = [str(warning.message) for warning in caught]
    assert "plug-in 'bad' (bad_segmenter:segmenter) was skipped" in message and reason in message
