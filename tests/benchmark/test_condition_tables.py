"""Tables of conditions: noise, pose sources, predicted semantics, and tasks in the mesh and in the true scene."""

import json
from dataclasses import replace

import pytest
from fake_results import GRID, MODEL, folder

from autonerf_lab.benchmark import Grid, Outcome, Results
from autonerf_lab.benchmark.grid import CONDITIONS
from autonerf_lab.benchmark.paper_tables import table
from autonerf_lab.benchmark.results import load_results, open_results
from autonerf_lab.benchmark.results_table import load_results_table, scores_frame
from autonerf_lab.errors import DataError, RunFolderError, UnknownNameError
from autonerf_lab.types import Score


def test_noise_and_pose_source_have_rows_of_their_own(tmp_path):
    values = {"frontier": [20.0] * 3, "modular-obs": [25.0] * 3}
    exact = folder(tmp_path / "exact", values)
    noisy = Grid(("modular-obs",), GRID.scenes, 1, preset="smoke", noise="ans", depth_noise="redwood")
    estimated = replace(noisy, poses="estimated")
    folders = [folder(tmp_path / str(k), {"modular-obs": [v] * 3}, g) for k, (g, v) in
               enumerate(((noisy, 15.0), (estimated, 24.0)))]  # fmt: skip
    found = load_results_table(exact, *folders)
    rows = [row[0].text for row in table("rendering", found).rows]
    assert rows == ["frontier", "modular-obs"], "never mixed with rows of the paper"
    made = table("noise", found)
    assert made.header == (
        *("modular-obs", "without noise", "paper", "odometry poses", "estimated poses", "paper"),
        *("odometry poses − without noise", "estimated poses − without noise"),
    )
    assert [entry.text for entry in made.rows[0]] == [
        *("rendering: PSNR [dB]", "25.00 ± 0.00", "25.56", "15.00 ± 0.00", "24.00 ± 0.00", "20.87"),
        *("-10.00 ± 0.00", "-1.00 ± 0.00"),
    ]
    assert made.rows[-1][0].text.startswith("trajectory: ")
    alone = table("noise", load_results_table(folders[0]))
    assert [entry.text for entry in alone.rows[0]][1:] == ["–", "25.56", "15.00 ± 0.00", "20.87"]
    assert [row[0].text for row in table("rendering", load_results_table(folders[0])).rows] == ["modular-obs"]
    frame = scores_frame(load_results_table(*folders).outcomes)
    assert frame["poses"].fillna("").tolist() == [""] * 3 + ["estimated"] * 3 and set(frame["noise"]) == {"ans"}
    assert "noise" not in scores_frame(load_results_table(exact).outcomes)
    assert noisy.cells()[0].name == f"val-0_modular-obs_0_{MODEL}_ans-redwood"


def test_noise_is_checked_and_part_of_the_fingerprint(tmp_path):
    noisy = replace(GRID, noise="ans", poses="estimated")
    open_results(tmp_path / "noisy", noisy)
    assert load_results(tmp_path / "noisy").grid == noisy
    with pytest.raises(RunFolderError, match="noise: ans, not None; poses: estimated, not None"):
        open_results(tmp_path / "noisy", GRID)
    made = open_results(tmp_path / "old", GRID)
    content = json.loads((made.path / "grid.json").read_text())
    for key in CONDITIONS:  # results of earlier releases
        del content["grid"][key]
    (made.path / "grid.json").write_text(json.dumps(content))
    assert open_results(tmp_path / "old", GRID).grid == load_results(tmp_path / "old").grid == GRID
    for change, message in (
        ({"noise": "ons"}, "noise model 'ons'"),
        ({"noise_scale": 2.0}, "needs a noise model"),
        ({"depth_noise": "red"}, "depth noise 'red'"),
    ):
        with pytest.raises((DataError, UnknownNameError), match=message):
            replace(GRID, **change).checked()


def test_predicted_semantics_are_a_row_of_their_own_beside_the_paper(tmp_path):
    metric = ("rendering", "miou")
    true = folder(tmp_path / "true", {"frontier": [80.0] * 3, "modular-obs": [90.0, 91.0, 92.0]}, metric=metric)
    grid = Grid(("modular-obs",), GRID.scenes, 1, preset="smoke", semantics="predicted")
    predicted = folder(tmp_path / "predicted", {"modular-obs": [70.0, 71.0, 72.0]}, grid, metric)
    found = load_results_table(true, predicted)
    assert found.rows[-1] == ("modular-obs", f"{MODEL}, semantics predicted") and not found.noisy
    made = table("semantics", found)
    line = next(row for row in made.rows if row[0].text == "rendering: mIoU [%]")
    assert [entry.text for entry in line[1:]] == ["91.0 ± 2.5", "83.2", "71.0 ± 2.5", "61.1", "-20.0 ± 0.0"]
    assert "modular-obs" in made.note and "Not measured" in table("semantics", load_results_table(true)).note
    d = found.difference(found.rows[-1], ("modular-obs", MODEL), metric)
    assert d.mean == pytest.approx(-20) and d.half_width == pytest.approx(0)
    assert grid.cells()[0].name == f"val-0_modular-obs_0_{MODEL}_predicted"
    assert replace(grid, semantics="true").checked().semantics is None
    with pytest.raises(UnknownNameError, match="unknown segmenter 'best'"):
        replace(grid, semantics="best").checked()


def test_scores_in_the_mesh_and_in_the_true_scene_are_compared_within_a_cell(tmp_path):
    results = Results(tmp_path, GRID)
    for k, cell in enumerate(GRID.cells()):
        scores = Score("navigation", "success", 80.0), Score("navigation", "success_true_mesh", 90.0 + k % 3)
        results.write(Outcome(cell, "ok", scores if cell.policy == "modular-obs" else (), {}))
    made = table("navigation", load_results_table(results))
    assert made.header[-2:] == (
        "Success in the mesh − Success in the true scene",
        "SPL in the mesh − SPL in the true scene",
    )
    (line,) = made.rows  # the policy without the task has none
    assert line[0].text == "modular-obs"
    assert [entry.text for entry in line[-2:]] == ["-11.0 ± 2.5, d -11.0", "–"] and line[-2].bold  # -10, -11, -12
    assert {entry.text for entry in line[1:] if entry.text[0].isalpha()} == set(), "not measured is not null"


def test_fine_tuning_is_compared_with_the_pretrained_policy(tmp_path):
    results = Results(tmp_path, GRID)
    values = {"pretrained": (90.0, 70.0), "finetuned": (91.0, 74.0), "finetuned_true_mesh": (95.0, 80.0)}
    for cell in GRID.cells():
        scores = [
            Score("finetuning", f"{score}_{stage}", pair[k])
            for stage, pair in values.items()
            for k, score in enumerate(("success", "spl"))
        ]
        results.write(Outcome(cell, "ok", tuple(scores), {}))
    made = table("finetuning", load_results_table(results))
    entries = zip(made.header, made.rows[0], strict=True)
    shown = {title: entry.text.split()[0] for title, entry in entries if "−" in title}
    assert shown == {
        "Success, fine-tuned in the mesh − Success, pre-trained": "+1.0",
        "SPL, fine-tuned in the mesh − SPL, pre-trained": "+4.0",
        "Success, fine-tuned in the true scene − Success, pre-trained": "+5.0",
        "SPL, fine-tuned in the true scene − SPL, pre-trained": "+10.0",
    }
