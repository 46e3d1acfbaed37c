"""Every frozen scene, and scenes of fresh seeds, have what an apartment must have."""

from typing import Any

import pytest

from autonerf_lab.scenes import generate_apartment, load_scene, scene_names
from autonerf_lab.scenes.freeze import mesh_sha256
from autonerf_lab.scenes.inspection import problems
from autonerf_lab.scenes.library import folder
from autonerf_lab.utils.storage import read_json


@pytest.mark.parametrize("seed", range(500_000, 500_025))
def test_every_invariant_holds(seed: int) -> None:
    assert problems(generate_apartment(seed)) == []


@pytest.mark.parametrize("name", scene_names())
def test_frozen_scenes_are_valid_and_unchanged(name: str) -> None:
    scene = load_scene(name)
    assert problems(scene) == []
    assert mesh_sha256(scene) == read_json(folder() / "manifest.json", dict[str, Any])["scenes"][name]["mesh_sha256"]
