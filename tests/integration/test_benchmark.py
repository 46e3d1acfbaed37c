"""Smallest grid of real cells on the command line, also killed and continued."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest
from made_once import made_once

from autonerf_lab.benchmark import load_results
from autonerf_lab.pipeline.run_folder import STAGES

CELL = "dev-0_random_0_semantic-nerfacto"
TIMES = ["seconds"]


def command(out: Path) -> list[str]:
    words = "bench run --policies random --scenes dev-0 --starts 1 --preset smoke --baselines --out"
    return [sys.executable, "-m", "autonerf_lab.cli", *words.split(), str(out)]


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    """Results of an uninterrupted run (read-only)."""

    def bench(folder: Path) -> None:
        result = subprocess.run(command(folder / "out"), capture_output=True, text=True, check=False)
        assert result.returncode == 0, result.stderr
        assert result.stdout.splitlines()[1].split() == ["1/1", CELL, "ok"]

    return made_once(tmp_path_factory, "bench", bench) / "out"


def test_cell_has_every_score_and_few_files(finished):
    (outcome,) = load_results(finished).outcomes()
    assert list(outcome.stages) == ["scene", "explore", "fit", "evaluate", "exploration"]
    assert set(outcome.stages) - {"exploration"} <= set(STAGES)
    tasks = {row.task for row in outcome.scores}
    assert tasks == {"rendering", "maps", "planning", "pose_refinement", "mesh", "exploration", "reward"}
    assert {(row.policy, row.scene, row.start, row.model) for row in outcome.scores} == {
        ("random", "dev-0", 0, "semantic-nerfacto")
    }
    assert set(outcome.baselines) >= {"nearest_view", "oracle", "upstream"}  # and tsdf with open3d
    assert {row.policy for rows in outcome.baselines.values() for row in rows} == {"random"}
    exact = {(row.task, row.metric): row.value for row in outcome.baselines["oracle"]}
    assert exact["rendering", "miou"] == 100.0
    values = {row.metric: row.value for row in outcome.scores if row.task in ("exploration", "reward")}
    # the coverage reward counts the area after the first image
    assert 0 < values["cov"] <= values["explored_area_m2"]
    assert 0 < values["coverage_auc"] <= values["coverage"] <= 100
    for curve in outcome.curves.values():
        assert len(curve) == 50 and curve == sorted(curve)
    assert sum(file.stat().st_size for file in finished.rglob("*") if file.is_file()) < 2e6
    assert not list(finished.glob("work/*"))
    figures = {file.stem.removeprefix(f"{CELL}_") for file in finished.glob("figures/*.webp")}
    assert figures == {"maps", "paths", "rendering", "trajectory"}


def test_scores_are_exported_as_csv_and_parquet(finished):
    rows = pd.read_csv(finished / "scores.csv", keep_default_na=False, na_values={"value": [""]})
    assert len(rows) == len(load_results(finished).outcomes()[0].scores)
    psnr = rows[(rows.task == "rendering") & (rows.metric == "psnr")]
    assert 3 < psnr.value.item() < 40
    if (finished / "scores.parquet").exists():
        pd.testing.assert_frame_equal(pd.read_parquet(finished / "scores.parquet"), rows, check_dtype=False)


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs POSIX signals")
def test_killed_and_continued_run_gives_the_same_tables(finished, tmp_path):
    out = tmp_path / "out"
    run_json = out / "work" / CELL / "run/run.json"
    process = subprocess.Popen(command(out), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 300
    while not (run_json.exists() and "fit" in json.loads(run_json.read_text())["stages"]):
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.02)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    explored = json.loads(run_json.read_text())["stages"]["explore"]
    assert subprocess.run(command(out), capture_output=True, check=False).returncode == 0
    (outcome,) = load_results(out).outcomes()
    assert outcome.stages["explore"] == explored, "the stage did not run again"
    assert (out / "tables.md").read_bytes() == (finished / "tables.md").read_bytes()
    ours, theirs = (pd.read_csv(folder / "scores.csv").drop(columns=TIMES) for folder in (out, finished))
    pd.testing.assert_frame_equal(ours, theirs, check_exact=True)
