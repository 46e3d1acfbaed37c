"""Leaderboard: ranks by hand, over the episodes that all rows have; sorting in a browser."""

import fake_cell
import pytest
from chromium import open_page, wait
from fake_grid import GRID

from autonerf_lab.benchmark import Grid, Outcome, Results, paper
from autonerf_lab.benchmark.leaderboard import leaderboard
from autonerf_lab.benchmark.report import write_report
from autonerf_lab.benchmark.results_table import load_results_table
from autonerf_lab.errors import RunFolderError
from autonerf_lab.types import Score

SCENES = ("val-0", "val-1")


def table(path, values, scenes=SCENES, preset="smoke"):
    """Results of one start per scene: policy -> PSNR and depth error per scene."""
    grid = Grid(tuple(values), scenes, 1, preset=preset)
    results = Results(path, grid)
    for cell in grid.cells():
        psnr, miou = values[cell.policy]
        rows = Score("rendering", "psnr", psnr + int(cell.scene[-1])), Score("rendering", "miou", miou)
        results.write(Outcome(cell, "ok", rows, {}))
    return load_results_table(results)


def test_rows_are_ordered_by_mean_rank_over_common_episodes(tmp_path):
    policies = {"random": (20.0, 50.0), "frontier": (28.0, 80.0), "oracle-obs": (30.0, 99.0)}  # the last has no rank
    ours = table(tmp_path / "ours", policies)
    mine = table(tmp_path / "mine", {"frontier": (29.0, 90.0)}, ("val-1", "val-2"))
    made = leaderboard({"ours": ours, "mine": mine})
    assert [row[0].text for row in made.rows] == [
        "frontier, semantic-nerfacto (mine)", "frontier, semantic-nerfacto (ours)", "random, semantic-nerfacto (ours)"
    ]  # fmt: skip
    assert [row[1].text for row in made.rows] == ["1.0", "2.0", "3.0"]
    assert [row[2].text for row in made.rows] == ["30.00", "29.00", "21.00"], "val-1 is the only common scene"
    assert made.rows[0][2 + paper.HEADLINES.index(paper.MAPS[2])].text == "–" and "1 episodes in 1 scenes" in made.note
    with pytest.raises(RunFolderError, match="no scene and start in common"):
        leaderboard({"a": ours, "b": table(tmp_path / "b", {"random": (1.0, 1.0)}, ("val-4",))})
    with pytest.raises(RunFolderError, match="several presets"):
        leaderboard({"a": ours, "b": table(tmp_path / "c", {"random": (1.0, 1.0)}, preset="fast")})


@pytest.mark.slow
def test_a_click_sorts_a_table(tmp_path):
    results = Results(tmp_path / "results", GRID)
    for cell in GRID.cells():
        results.write(fake_cell.finished(cell))
    index = write_report([results], tmp_path / "report")
    column = "[...document.querySelectorAll('#all-cells tbody tr')].map(row => row.cells[1].textContent)"
    with open_page(tmp_path) as page:
        page.send("Page.navigate", url=index.as_uri())
        wait("the page is shown", lambda: page.js("document.readyState") == "complete" and page.js(column))
        before = [float(text) for text in page.js(column)]
        for head, reverse in ((1, True), (1, False)):
            page.js(f"document.querySelectorAll('#all-cells thead th')[{head}].click()")
            assert [float(text) for text in page.js(column)] == sorted(before, reverse=reverse)
        page.js("document.querySelectorAll('#all-cells thead th')[0].click()")
        assert page.js("[...document.querySelectorAll('#all-cells tbody a')].length") == len(before)
        assert page.errors == []
