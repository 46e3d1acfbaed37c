"""``autonerf-lab bench``: output, errors and report."""

import re

import fake_cell
import pytest

from autonerf_lab import cli
from autonerf_lab.benchmark import Grid, Outcome
from autonerf_lab.benchmark.results import open_results

POLICIES = ("random", "frontier", "modular-obs")


@pytest.fixture
def results(tmp_path):
    made = open_results(tmp_path / "out", Grid(POLICIES, ("val-0", "val-1"), 2, preset="fast"))
    for cell in made.grid.cells():
        made.write(fake_cell.finished(cell))
    return made


def bench(*arguments):
    return cli.main(["bench", *map(str, arguments)])


def test_dry_run_estimates_the_unfinished_cells(results, tmp_path, capsys):
    words = ("run", "--policies", "random,frontier,modular-obs", "--scenes", "val-0,val-1", "--starts", 2, "--out")
    assert bench(*words, tmp_path / "new", "--dry-run", "--workers", 2, "--preset", "fast") == 0
    printed = capsys.readouterr().out.splitlines()
    assert printed[0] == "val-0_random_0_semantic-nerfacto"
    assert printed[-2] == "12 cells, 12 to run, 2 at a time"
    assert re.fullmatch(
        r"about 0\.5 hours and 0\.\d\d GB, from a cell of 150 s on two otherwise idle cores", printed[-1]
    )
    assert not (tmp_path / "new").exists()
    results.discard(results.outcomes()[:10])
    assert bench(*words, results.path, "--dry-run", "--preset", "fast") == 0
    printed = capsys.readouterr().out.splitlines()
    assert printed[-2:][0] == "12 cells, 10 to run, 1 at a time"
    assert printed[-1].startswith("about 0.1 hours and ") and printed[-1].endswith("from 2 finished cells: 36 s each")
    assert printed[11].endswith("finished")
    assert bench(*words, results.path, "--dry-run", "--preset", "fast", "--workers", 2) == 0
    assert "about 0.1 hours" in capsys.readouterr().out, "the finished cells count as run with two workers"


def test_dry_run_respects_retry(results, capsys):
    words = ("run", "--policies", "random,frontier,modular-obs", "--scenes", "val-0,val-1", "--starts", 2, "--preset",
             "fast", "--dry-run", "--out", results.path)  # fmt: skip
    for cell, status in zip(results.grid.cells(), ("failed: odd", "timeout: 9 s"), strict=False):
        results.write(Outcome(cell, status))
    for more, count in ((), 0), (("--retry", "timeout"), 1), (("--retry", "failed"), 2):
        assert bench(*words, *more) == 0
        printed = capsys.readouterr().out.splitlines()
        assert f"12 cells, {count} to run" in printed[-2]
        assert printed[-1].startswith("about" if count else "all cells are finished")
    assert printed[0].endswith("semantic-nerfacto") and printed[2].endswith("finished")


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (("--models", "instant-ngp"), "no estimate: no finished cell of instant-ngp in preset fast; run one first"),
        (("--preset", "paper"), "no estimate: no finished cell of semantic-nerfacto in preset paper; run one first"),
        (
            ("--optional", "navigation"),
            "no finished cell of semantic-nerfacto with navigation in preset fast; run one first",
        ),
    ],
)
def test_dry_run_without_measurements_gives_no_estimate(more, words, tmp_path, capsys):
    chosen = () if "--preset" in more else ("--preset", "fast")
    assert bench("run", "--policies", "random", *chosen, *more, "--dry-run", "--out", tmp_path / "out") == 0
    assert words in capsys.readouterr().out


def test_dry_run_of_a_damaged_or_other_folder_is_an_error(results, capsys):
    words = ("run", "--policies", "random", "--preset", "fast", "--dry-run", "--out", results.path)
    assert bench(*words) == 1
    assert "holds the results of another grid (policies: " in capsys.readouterr().err
    (results.path / "grid.json").write_text("{")
    assert bench(*words) == 1
    assert "grid.json is not readable JSON" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--policies", "frontire"], "unknown policy 'frontire'; valid names: all, "),
        (["--policies", "random", "--scenes", "vla"], "unknown scene 'vla'; valid names: all, dev"),
        (["--policies", "random", "--models", "gauss"], "unknown model 'gauss'"),
        (["--policies", "random", "--preset", "fats"], "unknown preset 'fats'"),
        (["--grid", "papers"], "unknown grid 'papers'; valid names: FILE.py, paper"),
        (["--grid", "paper", "--starts", "2"], "remove --starts"),
        ([], "no policies: give --policies"),
        (["--policies", "random", "--lpips-weights", "nowhere.safetensors"], "nowhere.safetensors does not exist"),
        (["--policies", "random", "--lpips-sha256", "00"], "give --lpips-weights too"),
        (["--policies", "random", "--workers", "-1"], "workers must be a whole number"),
        (["--policies", "random", "--timeout", "0"], "timeout must be more than 0"),
    ],
)
def test_invalid_arguments_give_a_one_line_error_and_no_files(arguments, words, tmp_path, capsys):
    assert bench("run", *arguments, "--out", tmp_path / "out") == 1
    error = capsys.readouterr().err
    assert error.startswith("error: ") and words in error and error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_compare(results, tmp_path, capsys):
    other = open_results(tmp_path / "other", Grid(("modular-obs",), ("val-0", "val-1"), 2, preset="fast"))
    for cell in other.grid.cells():
        other.write(fake_cell.finished(cell))
    assert bench("compare", results.path, other.path) == 0
    printed = capsys.readouterr().out
    assert "| modular-obs, semantic-nerfacto |" in printed
    assert re.search(r"\| rendering: PSNR \\\[dB] \| \+0\.00 ± 0\.00 \|", printed)
    assert "**Leaderboard**" in printed and "/other) |" in printed
    assert bench("compare", results.path, tmp_path / "nowhere") == 1
    assert "holds no results" in capsys.readouterr().err
    assert bench("compare", results.path) == 1
    assert "give at least two results folders" in capsys.readouterr().err


def test_report_is_self_contained(results, capsys):
    assert bench("report", results.path) == 0
    path = results.path / "report/index.html"
    assert capsys.readouterr().out.strip() == str(path)
    page = path.read_text()
    for part in ("leaderboard", "figures", "tables", "cells", "rendering", "differences"):
        assert f'id="{part}"' in page
    assert 'id="noise"' not in page and "No table noise: Not measured: the cells are without noise. Add cells" in page
    assert page.count("data:image/png") == 2
    links = re.findall(r'(?:src|href)="(?!data:|#)([^"]*)', page)
    assert {link.partition("/")[0] for link in links} == {"cells", "cards"}
    assert all((path.parent / link).is_file() for link in links)
    assert len(list(path.parent.glob("cells/*.html"))) == 12 and len(list(path.parent.glob("cards/*.md"))) == 3
    cell = next(path.parent.glob("cells/*modular-obs*.html")).read_text()
    assert re.findall(r'(?:src|href)="(?!data:|#)([^"]*)', cell) == ["../index.html"]
    assert "<td>rendering: PSNR [dB]</td>" in cell and "data:image/png" in cell
    assert 'id="details-planning"' in cell and "<td>PointGoal</td><td>7</td><td>1</td>" in cell
    card = next(path.parent.glob("cards/modular-obs*.md")).read_text()
    assert "- training: command: autonerf-lab train-policy --policy modular-obs" in card
    assert re.search(r"- SHA-256 of the model's settings: [0-9a-f]{64}\n", card) and "- reward: obs\n" in card
    (line,) = (line for line in card.splitlines() if "PSNR" in line)
    assert re.fullmatch(r"\| rendering: PSNR \\\[dB] \| [\d.]+ ± [\d.]+ \| [*]*\+[\d.]+ ± [\d.]+[*]* \| 25.56 \|", line)
    assert "12 of 12 cells" in page and "Worst" in page


def test_report_of_two_folders_has_their_common_tables(results, tmp_path, capsys):
    other = open_results(tmp_path / "other", Grid(("modular-cov",), ("val-0", "val-1"), 2, preset="fast"))
    for cell in other.grid.cells():
        other.write(fake_cell.finished(cell))
    assert bench("report", results.path, other.path, "--out", tmp_path / "report") == 0
    assert len((tmp_path / "report/scores.csv").read_text().splitlines()) > 16
    tables = (tmp_path / "report/tables.md").read_text()
    assert tables.startswith("16 of 16 cells") and "modular-cov − frontier" in tables
    assert r"\begin{tabular}" in (tmp_path / "report/tables.tex").read_text()


def test_report_lists_failed_cells(results, tmp_path):
    from autonerf_lab.benchmark import Outcome
    from autonerf_lab.benchmark.report import write_report

    cell = results.grid.cells()[0]
    results.write(Outcome(cell, "failed: <img onerror=alert(1)>"))
    page = write_report([results], tmp_path / "report").read_text()
    assert "11 of 12 cells" in page and "failed: &lt;img onerror=alert(1)&gt;" in page and "<img onerror" not in page
