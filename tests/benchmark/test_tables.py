"""Tables of a grid: means, intervals, best values, missing values, and the values of the paper."""

import html
import math
from dataclasses import replace
from pathlib import Path

import fake_cell
import numpy as np
import pytest
from fake_results import GRID, MODEL, folder
from scipy import stats

from autonerf_lab.benchmark import Grid, Outcome, Results, paper
from autonerf_lab.benchmark.compare import METRICS as COMPARED
from autonerf_lab.benchmark.compare import compare
from autonerf_lab.benchmark.correlations import pearson
from autonerf_lab.benchmark.export import export_results
from autonerf_lab.benchmark.figures import scores_over_policies
from autonerf_lab.benchmark.paper_tables import TABLES, all_tables, table
from autonerf_lab.benchmark.results_table import load_results_table, paired_difference
from autonerf_lab.benchmark.text_table import Entry, Table, escaped
from autonerf_lab.errors import RunFolderError, UnknownNameError
from autonerf_lab.evaluators.metrics import METRICS
from autonerf_lab.types import Score


def entries(made, row):
    return dict(zip(made.header[1:], made.rows[row][1:], strict=True))


def test_our_frontier_stands_beside_that_of_the_paper_only_without_the_classical_one(tmp_path):
    values = {"frontier": [20.0] * 3, "modular-obs": [25.0] * 3}
    both = {"frontier-classic": [18.0] * 3, **values}
    for k, (runs, published) in enumerate(((values, ["19.75", "25.56"]), (both, ["19.75", "–", "25.56"]))):
        grid = Grid(tuple(runs), GRID.scenes, 1, preset="smoke")
        made = table("rendering", load_results_table(folder(tmp_path / str(k), runs, grid)))
        assert [row[2].text for row in made.rows] == published


def test_mean_interval_and_paper_by_hand(tmp_path):
    found = load_results_table(folder(tmp_path, {"frontier": [19.0, 20.0, 21.0], "modular-obs": [24.0, 25.0, 27.0]}))
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
def test_bold_only_if_the_interval_excludes_zero(tmp_path, others, bold):
    found = load_results_table(folder(tmp_path, {"frontier": [19.0, 20.0, 21.0], "modular-obs": others}))
    made = table("rendering", found)
    assert not made.rows[0][1].bold
    assert made.rows[1][1].bold == bold


def test_lower_is_better_for_lpips(tmp_path):
    values = {"frontier": [0.3, 0.4, 0.5], "modular-obs": [0.1, 0.2, 0.3]}
    found = load_results_table(folder(tmp_path, values, metric=("rendering", "lpips")))
    metric = METRICS["rendering", "lpips"]
    assert found.best(metric) == ("modular-obs", MODEL)


def test_one_scene_has_no_interval_and_no_best(tmp_path):
    grid = Grid(("frontier", "modular-obs"), ("val-0",), 1, preset="smoke")
    made = table("rendering", load_results_table(folder(tmp_path, {"frontier": [10.0], "modular-obs": [20.0]}, grid)))
    assert [(row[1].text, row[1].bold) for row in made.rows] == [("10.00", False), ("20.00", False)]


def test_nulls_and_failures_are_counted(tmp_path):
    found = load_results_table(
        folder(tmp_path, {"frontier": [None, None, None], "modular-obs": [24.0, 26.0, "failed: odd"]})
    )
    made = table("rendering", found)
    assert made.rows[0][1].text == "null"
    assert made.rows[1][1].text.endswith("(33 % null)") and made.rows[1][1].text.startswith("25.00 ± ")
    assert [outcome.status for outcome in found.unfinished] == ["failed: odd"]


def test_differences_are_paired(tmp_path):
    found = load_results_table(
        folder(tmp_path, {"frontier": [10.0, 20.0, 30.0], "modular-obs": [11.0, 21.1, "oom: 9 GB"]})
    )
    d = found.difference(("modular-obs", MODEL), ("frontier", MODEL), ("rendering", "psnr"))
    assert d.mean == pytest.approx(1.05) and d.scenes == 2
    made = entries(table("differences", found), 0)
    assert made["PSNR [dB]"].text.startswith("+1.05 ± 0.64") and made["PSNR [dB]"].bold
    assert made["mIoU [%]"].text == "–"


def test_a_difference_is_compared_once(tmp_path):
    """Each reference is compared with the others, but not in both directions: Holm's correction counts them all."""
    grid = replace(GRID, policies=("frontier-classic", "frontier", "modular-obs"))
    values = {"frontier-classic": [9.0, 19.0, 29.0], "frontier": [10.0, 20.0, 30.0], "modular-obs": [11.0, 21.0, 31.0]}
    found = load_results_table(folder(tmp_path, values, grid))
    assert [row[0].text for row in table("differences", found).rows] == [
        "frontier − frontier-classic",
        "modular-obs − frontier-classic",
        "modular-obs − frontier",
    ]


def test_an_oracle_is_no_competitor(tmp_path):
    grid = replace(GRID, policies=("frontier", "modular-obs", "oracle-obs"))
    values = {"frontier": [10.0, 20.0, 30.0], "modular-obs": [11.0, 21.1, 31.0], "oracle-obs": [50.0, 50.0, 50.0]}
    found = load_results_table(folder(tmp_path, values, grid))
    assert [row[1].bold for row in table("rendering", found).rows] == [False, True, False]
    assert [row[0].text for row in table("differences", found).rows] == ["modular-obs − frontier"]


def test_a_policy_is_compared_with_the_imitation_that_it_started_from(tmp_path):
    grid = replace(GRID, policies=("modular-obs", "modular-view", "runs/modular-obs-imitation.safetensors"))
    values = {name: [k + 1.0, k + 2.0, k + 3.0] for k, name in enumerate(reversed(grid.policies))}
    made = table("differences", load_results_table(folder(tmp_path, values, grid)))
    assert [row[0].text for row in made.rows] == ["modular-obs − modular-obs-imitation", "modular-obs − modular-view"]
    assert made.rows[0][1].text.startswith("+2.00 ± 0.00")


def test_a_policy_from_scratch_is_compared_with_its_twin_and_with_frontier_policies_only(tmp_path):
    grid = replace(GRID, policies=("frontier", "modular-obs", "modular-view", "runs/modular-obs-scratch.safetensors"))
    values = {name: [k + 1.0, k + 2.0, k + 3.0] for k, name in enumerate(grid.policies)}
    made = table("differences", load_results_table(folder(tmp_path, values, grid)))
    assert [row[0].text for row in made.rows] == [
        "modular-obs − frontier",
        "modular-view − frontier",
        "modular-obs − modular-obs-scratch",
        "modular-obs-scratch − frontier",
        "modular-obs − modular-view",
    ]


def test_variants_are_compared_with_each_other_only_and_paired(tmp_path):
    grid = Grid(("frontier", "modular-obs"), GRID.scenes, 1, (MODEL, "instant-ngp"), "smoke")
    results = Results(tmp_path, grid)
    values = {("modular-obs", MODEL): [25.0, 30.0, 20.0], ("modular-obs", "instant-ngp"): [24.0, 29.0, 18.9],
              ("frontier", MODEL): [50.0, 50.0, 50.0], ("frontier", "instant-ngp"): [50.0, 50.0, 50.0]}  # fmt: skip
    for cell in grid.cells():
        value = values[cell.policy, cell.model][int(cell.scene[-1])]
        results.write(Outcome(cell, "ok", (Score("rendering", "psnr", value),), {}))
    made = table("variants", load_results_table(results))
    assert [row[1].bold for row in made.rows] == [True, False, True], "walks that are not in the table do not count"
    # differences -1, -1, -1.1: their standard deviation is 0.1 / sqrt(3), that of their mean 1 / 30
    assert made.rows[2][1].text == f"-1.03 ± {4.302653 / 30:.2f}, d {-1.0333 / (0.1 / math.sqrt(3)):.1f}"


def test_modular_policies_stand_against_end_to_end_ones_and_the_power_is_said(tmp_path):
    grid = Grid(("modular-cov", "modular-obs", "e2e-nov"), GRID.scenes, 1, preset="smoke")
    values = {"modular-cov": [3.0, 5.0, 4.0], "modular-obs": [4.0, 6.0, 5.2], "e2e-nov": [1.0, 2.0, 3.0]}
    made = table("differences", load_results_table(folder(tmp_path, values, grid)))
    assert [row[0].text for row in made.rows] == [
        *("modular-cov − e2e-nov", "modular-obs − e2e-nov"),
        "modular-cov − modular-obs",  # a family of its own
    ]
    assert entries(made, 0)["PSNR [dB]"].text == f"+2.00 ± {4.302653 / math.sqrt(3):.2f}, d 2.0"  # 2, 3, 1
    errors = [np.std(d, ddof=1) / math.sqrt(3) for d in ([2, 3, 1], [3, 4, 2.2], [-1, -1, -1.2])]
    # t(0.975, 2), t(0.8, 2), and t(1 - 0.025 / 2, 2) for the first family, of two differences
    plain, corrected = (np.median([(t + 1.060660) * e for t, e in zip(ts, errors, strict=True)])
                        for ts in ([4.302653] * 3, [6.205347, 6.205347, 4.302653]))  # fmt: skip
    assert made.note.endswith(
        f"80 % (median, in brackets after correction for the number of differences): PSNR [dB] {plain:.2f}"
        f" ({corrected:.2f})."
    )
    one = Grid(grid.policies, ("val-0",), 1, preset="smoke")
    alone = table("differences", load_results_table(folder(tmp_path / "one", values, one)))
    assert alone.rows and not alone.note, "a single scene has no interval"


def test_differences_are_corrected_for_their_number(tmp_path):
    """Differences 1, 1.3 and 1.9: p is 3.4 %, and 6.8 % as the smaller one of two."""
    values = {"frontier": [20.0, 20.0, 20.0], "modular-obs": [21.0, 21.3, 21.9], "modular-cov": [20.0, 20.1, 19.9]}
    for policies, bold in ((("frontier", "modular-obs"), True), (("frontier", "modular-obs", "modular-cov"), False)):
        grid = Grid(policies, GRID.scenes, 1, preset="smoke")
        results = folder(tmp_path / f"{len(policies)}", values, grid)
        made = entries(table("differences", load_results_table(results)), 0)["PSNR [dB]"]
        assert made == Entry("+1.40 ± 1.14, d 3.1", bold)


def test_each_reference_has_a_family_of_its_own(tmp_path):
    """Differences of 1, 1.3 and 1.9: p is 3.4 %; a second difference from another policy leaves it as it is."""
    values = {"frontier": [20.0] * 3, "random": [20.0, 20.5, 19.8], "modular-obs": [21.0, 21.3, 21.9]}
    grid = Grid(tuple(values), GRID.scenes, 1, preset="smoke")
    made = table("differences", load_results_table(folder(tmp_path, values, grid)))
    assert [row[0].text for row in made.rows] == ["modular-obs − frontier", "frontier − random", "modular-obs − random"]
    assert made.rows[0][1] == Entry("+1.40 ± 1.14, d 3.1", bold=True)


def test_the_true_geometry_is_the_last_row(tmp_path):
    grid = replace(GRID, policies=("frontier", "modular-obs"), baselines=True)
    results = Results(tmp_path, grid)
    for k, cell in enumerate(grid.cells()):
        recall = Score("maps", "free_recall", 20.0 + k)
        baselines = {"oracle": (replace(recall, value=98.0),)} if cell.policy == "modular-obs" else {}
        results.write(Outcome(cell, "ok", (recall,), {}, baselines=baselines))
    made = table("maps", load_results_table(results))
    assert [row[0].text for row in made.rows] == ["frontier", "modular-obs", "true geometry (oracle)"]
    assert [entry.text for entry in made.rows[2][1:] if entry.text != "–"] == ["98.0 ± 0.0"]


def test_tables_without_values_are_named_but_not_printed(tmp_path):
    found = load_results_table(folder(tmp_path / "a", {"frontier": [1.0] * 3, "modular-obs": [2.0] * 3}))
    export_results(found, tmp_path)
    text = (tmp_path / "tables.md").read_text()
    printed = {made.name for made in all_tables(found) if f"**{escaped(made.title)}**" in text}
    assert printed == {"rendering", "differences"}
    assert "- No table navigation: Not measured in these cells. Add it with" in text


def test_a_score_that_is_null_in_all_cells_has_no_column(tmp_path):
    results = Results(tmp_path, GRID)
    for cell in GRID.cells():
        scores = Score("rendering", "psnr", 20.0), Score("rendering", "lpips", None, "", "weights_missing")
        results.write(Outcome(cell, "ok", scores, {}))
    made = table("rendering", load_results_table(results))
    assert "LPIPS" not in made.header and "SSIM" in made.header
    assert made.note == "LPIPS is left out: no cell has a value (weights_missing)."


def test_rows_of_two_folders_in_one_table(tmp_path):
    mine = Grid(("/runs/modular-bumps/policy.safetensors",), GRID.scenes, 1, preset="smoke")
    results = [
        folder(tmp_path / "a", {"frontier": [1.0, 2.0, 3.0], "modular-obs": [2.0, 3.0, 4.0]}),
        folder(tmp_path / "b", {mine.policies[0]: [5.0, 6.0, 7.0]}, mine),
    ]
    made = table("rendering", load_results_table(*results))
    assert [row[0].text for row in made.rows] == ["frontier", "modular-obs", "modular-bumps"]
    with pytest.raises(RunFolderError, match="both hold val-0_frontier_0"):
        load_results_table(results[0], results[0])
    with pytest.raises(RunFolderError, match="several presets"):
        load_results_table(
            results[0], folder(tmp_path / "c", {mine.policies[0]: [5.0] * 3}, Grid(mine.policies, mine.scenes, 1))
        )
    for k, digest in enumerate(("01", "02")):
        results[k].fingerprint = {"weights": {"modular-obs": digest}}
    with pytest.raises(RunFolderError, match=r"differ in weights of modular-obs: 01, not 02; compare the folders"):
        load_results_table(*results)
    one, two = load_results_table(results[0]), load_results_table(results[1])
    d = paired_difference(two, two.rows[0], one, one.rows[0], ("rendering", "psnr"))
    assert (d.mean, d.half_width) == (4.0, 0.0)


def test_every_table_can_be_made_of_anything(tmp_path):
    grid = Grid(("random", "frontier", "modular-obs"), ("val-0", "val-1"), 2, (MODEL, "instant-ngp"), "smoke")
    results = Results(tmp_path, grid)
    empty = all_tables(load_results_table(results))
    assert [t.name for t in empty] == list(TABLES)
    assert all(t.note for t in empty if t.name != "differences")
    assert table("rendering", load_results_table(results)).rows[0][1].text == "–"
    for cell in grid.cells():
        results.write(fake_cell.finished(cell))
    for made in all_tables(load_results_table(results)):
        assert {len(row) for row in made.rows} == {len(made.header)}, made.name
        assert html.escape(made.title) in made.html() and made.name in made.latex() and made.rows[0][0].text
    variants = table("variants", load_results_table(results))
    words = [f"{MODEL}, modular-obs", "instant-ngp, modular-obs", f"instant-ngp − {MODEL}, modular-obs"]
    assert [row[0].text for row in variants.rows] == words
    assert [row[2].text for row in variants.rows] == ["25.56", "24.92", "–"]
    with pytest.raises(UnknownNameError, match="correlations"):
        table("rendring", load_results_table(results))


def test_baselines_of_the_same_cells_are_columns(tmp_path):
    grid = replace(GRID, policies=("modular-obs",), baselines=True)
    results = Results(tmp_path, grid)
    for k, cell in enumerate(grid.cells()):
        psnr, success = (Score(*key, 20.0 + k) for key in (("rendering", "psnr"), ("planning", "pointgoal_success")))
        baselines = {"oracle": (replace(psnr, value=50.0), success), "upstream": (replace(success, value=40.0 + k),)}
        results.write(Outcome(cell, "ok", (psnr, success), {}, baselines=baselines))
    made = table("baselines", load_results_table(results))
    rows = {row[0].text: [entry.text for entry in row[1:]] for row in made.rows}
    assert made.header == (f"modular-obs, {MODEL}", "field", "upstream", "oracle", "paper")
    assert rows["rendering: PSNR [dB]"] == ["21.00 ± 2.48", "–", "50.00 ± 0.00", "25.56"]
    assert rows["planning: PointGoal success [%]"] == ["21.0 ± 2.5", "41.0 ± 2.5", "21.0 ± 2.5", "38.2"]
    assert rows["mesh: Accuracy [cm]"] == ["–", "–", "–", "–"]
    plain = load_results_table(folder(tmp_path / "plain", {"frontier": [1.0] * 3, "modular-obs": [2.0] * 3}))
    assert table("baselines", plain).note == "Not measured in these cells. Add them with --baselines."


def test_correlations_of_the_modular_policies_by_scene(tmp_path):
    policies = ("frontier", "modular-cov", "modular-obs", "modular-mine")
    grid = Grid(policies, ("val-0",), 3, preset="smoke")
    results = Results(tmp_path, grid)
    numbers = {("modular-cov", 0): (1, 1), ("modular-cov", 1): (2, 2), ("modular-cov", 2): (3, 3),
               ("modular-obs", 0): (4, 4.1), ("modular-obs", 1): (5, 5), ("modular-obs", 2): (6, 6),
               **{("frontier", k): (9 - k, 100 * k) for k in range(3)},
               **{("modular-mine", k): (5 + k, -5 - k) for k in range(3)}}  # fmt: skip
    for cell in grid.cells():
        x, y = numbers[cell.policy, cell.start]
        results.write(Outcome(cell, "ok", (Score("reward", "cov", x), Score("rendering", "psnr", y)), {}))
    made = table("correlations", load_results_table(results))
    assert made.header[:3] == ("", "val-0", "paper 0") and made.note.startswith("0 to 6 points")
    assert f"trajectories of the modular policies, fields of {MODEL}." in made.note
    assert [e.text for e in made.rows[0]] == ["PSNR, cov", "1.00", "0.73", "0.77", "0.95", "0.48", "–"]
    assert made.rows[1][1].text == "–"


def test_correlations_of_all_policies_where_there_is_no_modular_one(tmp_path):
    grid = Grid(("frontier", "modular-mine"), ("val-0",), 3, preset="smoke")
    results = Results(tmp_path, grid)
    for k, cell in enumerate(grid.cells()):
        results.write(Outcome(cell, "ok", (Score("reward", "cov", k), Score("rendering", "psnr", k)), {}))
    made = table("correlations", load_results_table(results))
    assert made.rows[0][1].text == "1.00" and "0 to 6 points per scene: trajectories of all policies" in made.note


def test_compare_has_every_score_and_refuses_other_presets(tmp_path):
    keys = [("navigation", "success"), ("finetuning", "spl_finetuned")]
    both = []
    for k in range(2):
        made = Results(tmp_path / str(k), GRID)
        for cell in GRID.cells():
            made.write(Outcome(cell, "ok", tuple(Score(*key, 50.0 + k) for key in keys), {}))
        both.append(load_results_table(made))
    assert [row[1].text for row in compare(*both).rows] == ["+1.0 ± 0.0", "+1.0 ± 0.0"]
    assert {m.key for m in COMPARED} >= {m.key for m in (*paper.NAVIGATION, *paper.FINETUNING)}
    with pytest.raises(RunFolderError, match="the first folder has preset smoke, the second fast"):
        compare(both[0], replace(both[1], preset="fast"))


@pytest.mark.parametrize(
    ("said", "kept"),
    [
        ("failed: one\n\ttwo\x1b[31m\u2028three", "failed: one two [31m three"),
        ("failed: " + "x" * 999, "failed: " + "x" * 289 + "..."),
    ],
)
def test_a_status_is_one_printable_line(tmp_path, said, kept):
    results = folder(tmp_path, {"frontier": [said] * 3, "modular-obs": [1.0] * 3})
    assert load_results_table(results).unfinished[0].status == kept and len(kept) <= 300


def test_statuses_are_escaped_in_tables(tmp_path):
    results = folder(tmp_path, {"frontier": ["failed: <b>|*a*_b_"] * 3, "modular-obs": [1.0] * 3})
    export_results(load_results_table(results), tmp_path)
    text = (tmp_path / "tables.md").read_text()
    assert r"- val-0\_frontier\_0\_semantic-nerfacto: failed: \<b>\|\*a\*\_b\_" in text.splitlines()


def test_pearson_by_hand():
    # deviations (-2, -1, 0, 1, 2) and (-2, -1, 1, 0, 2): r = 9 / 10, t = 0.9 sqrt(3 / 0.19) with 3 degrees of freedom
    r, p = pearson([1.0, 2.0, 3.0, 4.0, 5.0], [1.0, 2.0, 4.0, 3.0, 5.0])
    assert r == pytest.approx(0.9) and p == pytest.approx(2 * stats.t.sf(0.9 * math.sqrt(3 / 0.19), 3))
    assert pearson([1.0, 2.0, 3.0, 4.0], [1.0, 2.0, 3.0, 4.0]) is None


def test_text_is_escaped():
    made = Table("t", "<b>&_", ("", "x|y"), ((Entry("<img onerror=1>"), Entry("5 % ± 1", bold=True)),), "100 %_")
    assert "<img" not in made.html() and "&lt;img onerror=1&gt;" in made.html() and "<b>5 % ± 1</b>" in made.html()
    assert r"x\|y" in made.markdown() and r"\<img" in made.markdown()
    assert r"\textbf{5 \% $\pm$ 1}" in made.latex() and r"\&\_" in made.latex()


def test_values_of_the_paper_agree_with_the_metric_registry():
    """The registry has the best value of each metric and that of the frontier policy."""
    for metric in METRICS.values():
        if metric.paper is None:
            continue
        best, frontier = metric.paper
        values = [by[metric.key] for by in paper.BY_POLICY.values() if metric.key in by]
        assert (max(values) if metric.better > 0 else min(values)) == pytest.approx(best)
        published = paper.BY_POLICY["frontier-classic"].get(metric.key)
        assert published == (frontier if frontier is None else pytest.approx(frontier))
    assert paper.POSE[2].format(paper.BY_POLICY["modular-obs"][paper.POSE[2].key]) == "7.65"
    strongest = [r for (reward, _), rs in paper.CORRELATIONS.items() if reward == "obs" for r in rs]
    assert strongest.count("-") == 15 and len(strongest) == 40


def test_a_wide_interval_does_not_squeeze_the_scores_of_the_figure(tmp_path: Path) -> None:
    """The interval of two scenes, 20 and 30 dB, is 25 ± 63.5 dB; the paper has 25.56 and 19.75 dB."""
    grid = Grid(("frontier", "modular-obs"), ("val-0", "val-1"), 1, preset="smoke")
    found = load_results_table(folder(tmp_path, {"frontier": [20.0, 30.0], "modular-obs": [28.0, 28.0]}, grid))
    psnr = scores_over_policies(found).axes[0]
    assert psnr.get_title() == "PSNR [dB]"
    assert psnr.get_xlim() == pytest.approx((19.75 - 0.3 * 10.25, 30 + 0.3 * 10.25))
