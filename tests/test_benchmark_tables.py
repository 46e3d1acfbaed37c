"""Tables say what the cells say, no more: means, intervals, what is best, what is missing, and the paper's figures."""

import html
import math

import fake_cell
import pytest

from autonerf_lab.benchmark import Grid, Outcome, Results, paper
from autonerf_lab.benchmark.collect import collect, paired
from autonerf_lab.benchmark.correlations import pearson
from autonerf_lab.benchmark.table import Entry, Table
from autonerf_lab.benchmark.tables import TABLES, all_tables, number, table
from autonerf_lab.errors import RunFolderError, UnknownNameError
from autonerf_lab.evaluators.scores import PAPER
from autonerf_lab.types import Score

MODEL = "semantic-nerfacto"
GRID = Grid(("frontier", "modular-obs"), ("val-0", "val-1", "val-2"), 1, preset="smoke")


def folder(path, values, grid=GRID, metric=("rendering", "psnr")):
    """Results whose cells have one score each; a string is the status of a cell without."""
    results = Results(path, grid)
    for cell in grid.cells():
        value = values[cell.policy][int(cell.scene[-1])]
        if isinstance(value, str):
            results.write(Outcome(cell, value))
        else:
            results.write(Outcome(cell, "ok", (Score(*metric, value),), {}))
    return results


def entries(made, row):
    return dict(zip(made.header[1:], made.rows[row][1:], strict=True))


def test_mean_interval_and_paper_by_hand(tmp_path):
    found = collect(folder(tmp_path, {"frontier": [19.0, 20.0, 21.0], "modular-obs": [24.0, 25.0, 27.0]}))
    made = table("rendering", found)
    assert [row[0].text for row in made.rows] == ["frontier", "modular-obs"]
    # t(0.975, 2) = 4.302653; the standard error of 19, 20, 21 is 1 / sqrt(3)
    assert made.rows[0][1].text == f"20.00 ± {4.302653 / math.sqrt(3):.2f}"
    assert made.header[1:3] == ("PSNR [dB]", "paper")
    assert [row[2].text for row in made.rows] == ["19.75", "25.56"]


@pytest.mark.parametrize(
    ("others", "bold"),
    [
        ([18.9, 20.1, 21.0], False),  # differences -0.1, 0.1, 0: nothing to say
        ([24.0, 25.0, 26.1], True),  # 5, 5, 5.1: clear
        ([24.0, 20.1, 21.0], False),  # 5, 0.1, 0: a difference in the mean that the interval does not carry
    ],
)
def test_bold_only_where_the_interval_says_so(tmp_path, others, bold):
    found = collect(folder(tmp_path, {"frontier": [19.0, 20.0, 21.0], "modular-obs": others}))
    made = table("rendering", found)
    assert not made.rows[0][1].bold
    assert made.rows[1][1].bold == bold


def test_less_is_better_where_it_is(tmp_path):
    values = {"frontier": [0.3, 0.4, 0.5], "modular-obs": [0.1, 0.2, 0.3]}
    found = collect(folder(tmp_path, values, metric=("rendering", "lpips")))
    column = next(c for c in paper.RENDERING if c.metric == "lpips")
    assert found.best(column) == ("modular-obs", MODEL)


def test_one_scene_has_no_interval_and_no_best(tmp_path):
    grid = Grid(("frontier", "modular-obs"), ("val-0",), 1, preset="smoke")
    made = table("rendering", collect(folder(tmp_path, {"frontier": [10.0], "modular-obs": [20.0]}, grid)))
    assert [(row[1].text, row[1].bold) for row in made.rows] == [("10.00", False), ("20.00", False)]


def test_nulls_and_failures_are_counted(tmp_path):
    found = collect(folder(tmp_path, {"frontier": [None, None, None], "modular-obs": [24.0, 26.0, "failed: odd"]}))
    made = table("rendering", found)
    assert made.rows[0][1].text == "null"
    assert made.rows[1][1].text.endswith("(33 % null)") and made.rows[1][1].text.startswith("25.00 ± ")
    assert [outcome.status for outcome in found.missing] == ["failed: odd"]


def test_differences_are_paired(tmp_path):
    found = collect(folder(tmp_path, {"frontier": [10.0, 20.0, 30.0], "modular-obs": [11.0, 21.1, "oom: 9 GB"]}))
    d = found.difference(("modular-obs", MODEL), ("frontier", MODEL), ("rendering", "psnr"))
    assert d.mean == pytest.approx(1.05) and d.scenes == 2
    made = entries(table("differences", found), 0)
    assert made["PSNR [dB]"].text.startswith("+1.05 ± 0.64") and made["PSNR [dB]"].bold
    assert made["mIoU [%]"].text == "–"


def test_rows_of_two_folders_in_one_table(tmp_path):
    mine = Grid(("/runs/modular-bumps/policy.safetensors",), GRID.scenes, 1, preset="smoke")
    results = [
        folder(tmp_path / "a", {"frontier": [1.0, 2.0, 3.0], "modular-obs": [2.0, 3.0, 4.0]}),
        folder(tmp_path / "b", {mine.policies[0]: [5.0, 6.0, 7.0]}, mine),
    ]
    made = table("rendering", collect(*results))
    assert [row[0].text for row in made.rows] == ["frontier", "modular-obs", "modular-bumps"]
    with pytest.raises(RunFolderError, match="both hold val-0_frontier_0"):
        collect(results[0], results[0])
    with pytest.raises(RunFolderError, match="several presets"):
        collect(results[0], folder(tmp_path / "c", {mine.policies[0]: [5.0] * 3}, Grid(mine.policies, mine.scenes, 1)))
    one, two = collect(results[0]), collect(results[1])
    d = paired(two, two.rows[0], one, one.rows[0], ("rendering", "psnr"))
    assert (d.mean, d.half) == (4.0, 0.0)


def test_every_table_can_be_made_of_anything(tmp_path):
    grid = Grid(("random", "frontier", "modular-obs"), ("val-0", "val-1"), 2, (MODEL, "instant-ngp"), "smoke")
    results = Results(tmp_path, grid)
    empty = all_tables(collect(results))
    assert [t.name for t in empty] == list(TABLES)
    assert all(t.note for t in empty if t.name != "differences")
    assert table("rendering", collect(results)).rows[0][1].text == "–"
    for cell in grid.cells():
        results.write(fake_cell.finished(cell))
    for made in all_tables(collect(results)):
        assert {len(row) for row in made.rows} == {len(made.header)}, made.name
        assert html.escape(made.title) in made.html() and made.name in made.latex() and made.rows[0][0].text
    variants = table("variants", collect(results))
    assert [row[0].text for row in variants.rows] == [f"{MODEL}, modular-obs", "instant-ngp, modular-obs"]
    assert [row[2].text for row in variants.rows] == ["25.56", "24.92"]
    with pytest.raises(UnknownNameError, match="correlations"):
        table("rendring", collect(results))


def test_correlations_of_the_modular_policies_by_scene(tmp_path):
    policies = ("frontier", "modular-cov", "modular-obs")
    grid = Grid(policies, ("val-0",), 2, preset="smoke")
    results = Results(tmp_path, grid)
    numbers = {("modular-cov", 0): (1, 1), ("modular-cov", 1): (2, 2), ("modular-obs", 0): (3, 3),
               ("modular-obs", 1): (4, 4.1), ("frontier", 0): (9, -9), ("frontier", 1): (7, 100)}  # fmt: skip
    for cell in grid.cells():
        x, y = numbers[cell.policy, cell.start]
        results.write(Outcome(cell, "ok", (Score("reward", "cov", x), Score("rendering", "psnr", y)), {}))
    made = table("correlations", collect(results))
    assert made.header[:3] == ("", "val-0", "paper 0") and made.note.startswith("0 to 4 points")
    assert [e.text for e in made.rows[0]] == ["PSNR, cov", "1.00", "0.73", "0.77", "0.95", "0.48", "–"]
    assert made.rows[1][1].text == "–"


def test_pearson_by_hand():
    # deviations (-1, 0, 1) and (-1, 1, 0): r = 1 / 2
    r, p = pearson([1.0, 2.0, 3.0], [1.0, 3.0, 2.0])
    assert r == pytest.approx(0.5) and p == pytest.approx(2 / 3, abs=1e-6)
    assert pearson([1.0, 2.0], [1.0, 2.0]) is None


def test_text_is_escaped():
    made = Table("t", "<b>&_", ("", "x|y"), ((Entry("<img onerror=1>"), Entry("5 % ± 1", bold=True)),), "100 %_")
    assert "<img" not in made.html() and "&lt;img onerror=1&gt;" in made.html() and "<b>5 % ± 1</b>" in made.html()
    assert r"x\|y" in made.markdown() and r"\<img" in made.markdown()
    assert r"\textbf{5 \% $\pm$ 1}" in made.latex() and r"\&\_" in made.latex()


def test_figures_of_the_paper_agree_with_those_beside_a_run():
    """The best of each column, and the frontier row, stand in another module too."""
    columns = {column.key: column for columns in (paper.RENDERING, paper.MAPS, paper.PLANNING, paper.POSE)
               for column in columns}  # fmt: skip
    for key, (best, frontier) in PAPER.items():
        values = [by[key] for by in paper.BY_POLICY.values()]
        assert (max(values) if columns[key].better > 0 else min(values)) == pytest.approx(best)
        assert paper.BY_POLICY["frontier"][key] == pytest.approx(frontier)
    assert number(paper.BY_POLICY["modular-obs"]["pose_refinement", "translation_error_m"], paper.POSE[2]) == "7.65"
    strongest = [r for (reward, _), rs in paper.CORRELATIONS.items() if reward == "obs" for r in rs]
    assert strongest.count("-") == 15 and len(strongest) == 40
