"""Tables of conditions: noise, pose sources and predicted semantics beside the paper."""

import json
from dataclasses import replace

import pytest
from fake_results import GRID, MODEL, folder

from autonerf_lab.benchmark import Grid
from autonerf_lab.benchmark.grid import CONDITIONS
from autonerf_lab.benchmark.paper_tables import table
from autonerf_lab.benchmark.results import load_results, open_results
from autonerf_lab.benchmark.results_table import load_results_table, scores_frame
from autonerf_lab.errors import DataError, RunFolderError, UnknownNameError


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
