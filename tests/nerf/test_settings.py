"""Settings that grow with the explored area of a house."""

from types import SimpleNamespace

import pytest

from autonerf_lab.nerf.fit import _explored_area
from autonerf_lab.nerf.models import MODELS
from autonerf_lab.nerf.settings import APARTMENT, HashSettings, scaled_to_area


@pytest.mark.parametrize("name", MODELS)
def test_apartments_keep_the_settings_of_the_preset(name):
    settings = MODELS[name].settings["fast"]
    assert scaled_to_area(settings, 0.0) is scaled_to_area(settings, APARTMENT) is settings
    assert scaled_to_area(settings, 1.001 * APARTMENT).steps == pytest.approx(settings.steps, rel=0.003)


def test_steps_and_tables_grow_by_the_rule():
    """The factor g is 2 * 320 / 160 - 1 = 3, and twice the area has twice the entries."""
    grown = scaled_to_area(HashSettings(steps=1000, far=10.0), 320.0)
    assert (grown.steps, grown.log2_entries, grown.seen_rays) == (3000, 19, 1_200_000)
    assert grown.far == pytest.approx(10 * 3**0.5)
    assert scaled_to_area(HashSettings(steps=1000, depth_weight=1.0), 320.0).steps == 2000


@pytest.mark.parametrize(
    ("meta", "area"),
    [({"explored_m2": [3, 200.5]}, 200.5), ({}, 0), ({"explored_m2": []}, 0), ({"explored_m2": ["x"]}, 0)],
)
def test_the_explored_area_is_that_of_the_trajectory(meta, area):
    assert _explored_area(SimpleNamespace(meta=meta, metric=True)) == area
    assert _explored_area(SimpleNamespace(meta=meta, metric=False)) == 0
