"""Saved results of the scripts in ``benchmarks/``, and the summary of an ablation with failed trainings."""

from pathlib import Path
from typing import Any

import ablation
import long_trainings
from common.output import model_settings, saved_result, slug

from autonerf_lab.utils.storage import write_json

CELL: dict[str, Any] = {"psnr": 28.0, "ssim": 0.8, "per_class_accuracy": 96.0, "miou": 90.0}
CELL |= {"depth_median_error_m": 0.02, "relative_step": None}


def test_a_result_is_found_by_its_identity(tmp_path: Path) -> None:
    identity = {"sizes": (64, 32), "settings": model_settings("semantic-nerfacto", "smoke")}
    path = tmp_path / "result.json"
    assert saved_result(path, identity) is None
    write_json(path, {"identity": identity, "scores": [1, 2]})
    found = saved_result(path, identity)
    assert found is not None and found["scores"] == [1, 2]
    assert saved_result(path, identity | {"sizes": (64,)}) is None
    write_json(path, {"rows": []})
    assert saved_result(path, identity) is None


def test_a_slug_is_a_file_name() -> None:
    assert slug("2^16 entries per level, 0.1") == "2-16-entries-per-level-0.1"
    assert slug("dev-0 runs/a/policy.safetensors cuda:0") == "dev-0-runs-a-policy.safetensors-cuda-0"


def test_differences_between_seeds_leave_failed_trainings_out() -> None:
    base: list[dict[str, Any]] = [CELL, CELL | {"psnr": 28.5}, CELL, dict.fromkeys(CELL)]  # two scenes, two seeds
    text = ablation.random_differences(base, 2)
    assert "differ by 0.50 dB, 0.000 (SSIM), 0.0 and 0.0 points, and 0.0 cm" in text
    assert ablation.random_differences(base[2:], 2) == ablation.random_differences(base, 1) == ""


def test_results_of_another_scene_are_not_in_the_table(tmp_path: Path) -> None:
    shared = {"scene": "dev-0", "policy": "frontier", "weights": None, "sizes": "fast", "views": 60}
    without_views = {key: value for key, value in shared.items() if key != "views"}
    stored = {"same": shared, "committed": without_views, "scene": shared | {"scene": "dev-1"}}
    stored |= {"policy": shared | {"policy": "random"}, "views": shared | {"views": 8}}
    for name, identity in stored.items():
        write_json(tmp_path / name / "result.json", {"identity": identity})
    found = long_trainings.comparable(tmp_path, shared)
    assert [folder.name for folder in found] == ["committed", "same"]
