"""Fingerprints of grids: they change with the content behind each name, and with nothing else."""

from dataclasses import replace
from pathlib import Path

import pytest

from autonerf_lab.benchmark import Grid, fingerprint
from autonerf_lab.benchmark.fingerprint import differences, find_conflict, grid_fingerprint
from autonerf_lab.benchmark.results import load_results
from autonerf_lab.nerf import models
from autonerf_lab.policies import weights_sha256
from autonerf_lab.presets import preset

GRID = Grid(("random", "modular-obs"), ("dev-0",), 1, ("semantic-nerfacto", "instant-ngp"), preset="smoke")
COMMITTED = Path(__file__).parents[2] / "benchmarks/results/val-0.1/policies"


def test_the_settings_of_a_model_change_its_fingerprint(monkeypatch: pytest.MonkeyPatch) -> None:
    before = grid_fingerprint(GRID)["settings"]
    assert before == grid_fingerprint(GRID)["settings"] and len(set(before.values())) == 2
    found = models.available()
    spec = found["semantic-nerfacto"]
    settings = {**spec.settings, "smoke": replace(spec.settings["smoke"], distortion_weight=0.003)}
    changed = {**found, "semantic-nerfacto": replace(spec, settings=settings)}
    monkeypatch.setattr(models, "available", lambda: changed)
    after = grid_fingerprint(GRID)["settings"]
    assert after["semantic-nerfacto"] != before["semantic-nerfacto"] and after["instant-ngp"] == before["instant-ngp"]
    # Another preset of the same model has other settings
    assert grid_fingerprint(replace(GRID, preset="fast"))["settings"]["instant-ngp"] != before["instant-ngp"]


def test_parts_without_content_are_left_out() -> None:
    grid = replace(GRID, models=("semantic-nerfacto", "of-another-package"), scenes=("dev-0", "no-such-scene"))
    found = grid_fingerprint(grid)
    assert list(found["settings"]) == ["semantic-nerfacto"] and list(found["scene_files"]) == ["dev-0"]
    assert list(found["weights"]) == ["modular-obs"] and list(found["sizes"]) == ["smoke"]
    assert grid_fingerprint(grid, lpips="12")["weights"] == {**found["weights"], "LPIPS": "12"}


def test_sizes_of_the_finetuning_count_if_the_grid_has_this_task(monkeypatch: pytest.MonkeyPatch) -> None:
    grids = GRID, replace(GRID, optional=("finetuning",))
    before = [grid_fingerprint(grid)["sizes"]["smoke"] for grid in grids]
    changed = replace(preset("smoke"), finetuning_frames=123)
    monkeypatch.setattr(fingerprint, "preset", lambda name: changed)
    after = [grid_fingerprint(grid)["sizes"]["smoke"] for grid in grids]
    assert before[0] == after[0] and before[1] != after[1] and before[0] != before[1]


def test_the_order_of_settings_does_not_matter() -> None:
    one, other = {"a": 1, "b": {"c": 2, "d": 3}}, {"b": {"d": 3, "c": 2}, "a": 1}
    assert fingerprint._settings_sha256(one) == fingerprint._settings_sha256(other)
    assert fingerprint._settings_sha256(one) != fingerprint._settings_sha256({"a": 1, "b": {"c": 3, "d": 2}})


def test_differences_of_names_come_before_those_of_contents() -> None:
    stored = {"starts": 2, "policies": ["random"], "weights": {"a": "0123456789", "b": "1"}, "old": 1}
    assert differences(stored, stored) == []
    assert differences(stored, {**stored, "starts": 3, "weights": {}}) == ["starts: 2, not 3"]
    assert differences(stored, {"weights": {"a": "0123456780", "c": "2"}}) == [
        "weights of a: 01234567, not 01234567",
        "weights of b: 1, not none",
        "weights of c: none, not 2",
    ]
    assert differences({}, {"scene_files": {"dev-0": "12"}}) == ["scene files of dev-0: none, not 12"]
    (text,) = differences({"policies": ["x" * 74, "yyyy"]}, {"policies": ["x" * 75, "yyyy"]})
    short, long = "x" * 74 + ", yyyy", "x" * 75 + ", yyyy"
    assert len(short) == 80 and text == f"policies: {short}, not {long[:77]}..."


def test_a_conflict_is_a_name_with_two_contents() -> None:
    folders = {Path("a"): {"weights": {"x": "1"}}, Path("b"): {"weights": {"y": "2"}}, Path("c"): {"sizes": {"x": "3"}}}
    assert find_conflict(folders) == "", "no name is in two folders"
    folders[Path("d")] = {"weights": {"y": "4"}}
    assert find_conflict(folders) == "b and d differ in weights of y: 2, not 4"


def test_the_committed_results_say_which_weights_they_have() -> None:
    """Weights that are not those of the package belong to the named older version."""
    recorded = load_results(COMMITTED).fingerprint["weights"]
    learned = {"modular-cov", "modular-obs", "modular-sem", "modular-view", "e2e-cov"}
    assert set(recorded) == learned
    assert {name for name, digest in recorded.items() if weights_sha256(name) != digest} == learned
    text = " ".join((COMMITTED.parents[1] / "README.md").read_text().split())
    assert "The learned policies have the weights of version 0.1.0" in text


@pytest.mark.parametrize("reward", ["cov", "obs", "sem", "view"])
def test_the_table_of_trainings_is_that_of_the_shipped_weights(reward: str) -> None:
    """Rows of the policies trained by imitation and PPO in the table of ``policy_training.py``."""
    kept = COMMITTED.parents[2] / f"policy_training/modular-{reward}-ppo.safetensors"
    assert weights_sha256(str(kept)) == weights_sha256(f"modular-{reward}")
