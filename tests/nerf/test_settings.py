"""Settings that grow with the explored area of a house, and limits of settings."""

from types import SimpleNamespace

import numpy as np
import pytest

from autonerf_lab.errors import DataError
from autonerf_lab.nerf.fit import _explored_area
from autonerf_lab.nerf.hash_grid import HashGrid
from autonerf_lab.nerf.models import MODELS
from autonerf_lab.nerf.settings import (
    APARTMENT,
    HashSettings,
    OccupancySettings,
    Settings,
    SurfaceSettings,
    scaled_to_area,
)


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


@pytest.mark.parametrize("name", MODELS)
def test_tables_stop_growing_at_the_largest_that_settings_allow(name):
    """The limit is 2**24 entries in all: 2**20 in each of 10 levels, 2**22 in each of 4."""
    grown = [scaled_to_area(MODELS[name].settings["fast"], area) for area in (950.0, 1e5)]
    if isinstance(grown[0], HashSettings):
        assert [settings.log2_entries for settings in grown] == [20, 20]
    if name == "semantic-nerfacto":
        assert [settings.proposal_log2_entries for settings in grown] == [18, 22]


@pytest.mark.parametrize(
    ("kind", "change", "words"),
    [
        (Settings, {"refine_planar": "no"}, "refine_planar must be True, False or None, not 'no'"),
        (Settings, {"refine_planar": 0}, "refine_planar must be True, False or None"),
        (SurfaceSettings, {"truncation": 40.0}, "truncation must be from 0.001 to 20, not 40"),
        (SurfaceSettings, {"voxel": 0.0004}, r"voxel must be from 0.001 to truncation=0.09, not 0.0004"),
        (SurfaceSettings, {"voxel": 1.0}, "voxel must be from 0.001 to truncation=0.09"),
        (OccupancySettings, {"depth_weight": 1.0, "cell": 40.0}, "cell must be from 0.002 to 20"),
    ],
    ids=str,
)
def test_settings_that_distances_in_millimetres_cannot_hold_are_refused(kind, change, words):
    with pytest.raises(DataError, match=words):
        kind(**change)
    for value in (True, False, None):
        assert kind(refine_planar=value).refine_planar is value


def test_every_level_of_a_huge_scene_is_hashed():
    """The finest level has (2.5 million)**3 corners, more than int64 holds."""
    grid = HashGrid.build(np.array([5e4] * 3), 0.8, 0.02, 10, 18)
    assert grid.masks.tolist() == [2**18 - 1] * 10 and grid.entries == 10 * 2**18
