"""All stages with the smoke preset on the command line."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from made_once import made_once
from PIL import Image
from toy_lpips import random_weights

from autonerf_lab import cli
from autonerf_lab.benchmark import Grid, Outcome, load_results
from autonerf_lab.benchmark.add_lpips import add_lpips
from autonerf_lab.benchmark.results import open_results
from autonerf_lab.errors import RunFolderError
from autonerf_lab.evaluators import Scores
from autonerf_lab.evaluators.lpips import Lpips
from autonerf_lab.pipeline.run_folder import STAGES
from autonerf_lab.utils import storage

ROOT = Path(__file__).parents[2]


def command(*arguments) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-m", "autonerf_lab.cli", *map(str, arguments)], capture_output=True, text=True, check=False
    )


def error_of(capsys, *arguments) -> str:
    """Run a command that fails, in this process, and return its error: a process of its own takes seconds to start."""
    capsys.readouterr()
    assert cli.main([*map(str, arguments)]) == 1
    return capsys.readouterr().err


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Run folder of a demo with the smoke preset, and its output (read-only)."""

    def demo(folder: Path) -> None:
        result = command("demo", "--preset", "smoke", "--out", folder / "run")
        assert result.returncode == 0, result.stderr
        (folder / "printed").write_text(result.stdout)

    folder = made_once(tmp_path_factory, "demo", demo)
    return folder / "run", (folder / "printed").read_text()


@pytest.fixture
def run(finished, tmp_path):
    """Copy of the run folder that a test may change."""
    return Path(shutil.copytree(finished[0], tmp_path / "run"))


def test_every_stage_wrote_its_outputs(finished):
    folder, printed = finished
    assert list(json.loads((folder / "run.json").read_text())["stages"]) == list(STAGES)
    for name in ("scene.json", "trajectory/transforms.json", "nerf/nerf.json", "scores.json", "mesh/mesh.json"):
        assert (folder / name).stat().st_size > 0
    assert printed.rstrip().endswith("run/report.html")
    assert not list(folder.rglob(".*")), "no temporary file is left"


def test_every_task_and_baseline_was_scored(finished):
    folder, _ = finished
    rows = json.loads((folder / "scores.json").read_text())["scores"]
    assert {row["task"] for row in rows} == {"rendering", "maps", "planning", "pose_refinement", "mesh"}
    assert not [row for row in rows if row["status"].startswith("failed")]
    assert {path.stem for path in (folder / "baselines").iterdir()} == {"nearest_view", "tsdf", "oracle"}
    oracle = json.loads((folder / "baselines/oracle.json").read_text())["scores"]
    by_name = {row["metric"]: row["value"] for row in oracle}
    assert by_name["free_precision"] == by_name["free_recall"] == 100


def test_report_shows_every_section(finished):
    text = (finished[0] / "report.html").read_text()
    tasks = ("rendering", "maps", "planning", "pose_refinement", "mesh")
    for section in ("trajectory", *tasks, "scores", "cost"):
        assert f'id="{section}"' in text
    assert len(text) < 20e6


def test_details_of_the_scores_are_reported(finished):
    details = json.loads((finished[0] / "scores.json").read_text())["details"]
    assert len(details["rendering"]["test_poses_x_y_heading"]) == 8
    assert sum(details["planning"]["reasons"]["PointGoal"].values()) == 10
    text = (finished[0] / "report.html").read_text()
    assert "<th>episodes</th>" in text and "<td>PointGoal</td>" in text and "<td>ObjectGoal: " in text


def test_optional_tasks_and_upstream_scores(run, capsys):
    before = (run / "scores.json").read_bytes()
    error = error_of(capsys, "evaluate", run, "--overwrite", "--optional", "navigatoin")
    assert "valid names: finetuning, navigation" in error
    assert (run / "scores.json").read_bytes() == before, "nothing is lost"
    options = ("--optional", "navigation", "--interest-regions", "--upstream")
    result = command("evaluate", run, "--overwrite", *options)
    assert result.returncode == 0, result.stderr
    header = next(line for line in result.stdout.splitlines() if line.startswith("task"))
    assert [name.strip() for name in header.split("|")][-4:] == ["nearest_view", "oracle", "tsdf", "upstream"]
    rows = json.loads((run / "scores.json").read_text())["scores"]
    assert {row["task"] for row in rows} >= {"navigation"}
    assert {row["preset"] for row in rows} == {"smoke, refine_interest=True"}
    rows = json.loads((run / "baselines/upstream.json").read_text())["scores"]
    assert {row["task"] for row in rows} == {"maps", "planning", "pose_refinement", "mesh"}
    assert not [row for row in rows if row["status"].startswith("failed")]
    assert command("report", run).returncode == 0
    assert 'id="navigation"' in (run / "report.html").read_text()


def test_lpips_is_added_to_finished_cells(run, tmp_path, capsys):
    out, grid = tmp_path / "out", Grid(("frontier",), ("val-0",), 1, preset="smoke")
    (cell,) = grid.cells()
    baselines = {
        name: tuple(Scores.load(run / f"baselines/{name}.json")) for name in ("nearest_view", "oracle", "tsdf")
    }
    scores = tuple(Scores.load(run / "scores.json"))
    open_results(out, grid).write(Outcome(cell, "ok", scores, {}, baselines=baselines))
    storage.write_arrays(tmp_path / "vgg", random_weights())
    storage.write_arrays(tmp_path / "other", {k: -v for k, v in random_weights().items()})
    add = ("bench", "lpips", out, "--lpips-weights", tmp_path / "vgg")
    assert "run the grid with --save-runs" in error_of(capsys, *add)
    shutil.move(run, out / "runs" / cell.name)
    assert command(*add).returncode == 0
    results = load_results(out)
    (after,) = results.outcomes()
    assert after.baselines["tsdf"] == baselines["tsdf"]
    values = {}
    for name, old_rows in {
        "field": scores,
        "nearest_view": baselines["nearest_view"],
        "oracle": baselines["oracle"],
    }.items():
        new_rows = after.scores if name == "field" else after.baselines[name]
        ((metric, new),) = [(old.metric, new) for old, new in zip(old_rows, new_rows, strict=True) if old != new]
        assert (metric, new.status) == ("lpips", "ok")
        values[name] = new.value
    assert values["nearest_view"] != values["field"] > 0 == values["oracle"]  # the oracle renders the same images
    assert "LPIPS" in (out / "tables.md").read_text()
    assert add_lpips(results, Lpips(tmp_path / "vgg")).lpips == results.lpips
    with pytest.raises(RunFolderError, match="give the same file"):
        add_lpips(results, Lpips(tmp_path / "other"))


def test_mesh_format_and_voxel_size(run, capsys):
    assert "stl" in error_of(capsys, "mesh", run, "--overwrite", "--format", "stl")
    assert "voxel" in error_of(capsys, "mesh", run, "--overwrite", "--voxel", "-1")
    assert (run / "mesh/mesh.json").exists(), "nothing is lost"
    result = command("mesh", run, "--overwrite", "--voxel", "0.1", "--format", "ply")
    assert result.returncode == 0, result.stderr
    counts = json.loads((run / "mesh/mesh.json").read_text())
    assert counts["voxel_m"] == 0.1 and not list(run.glob("mesh/*.glb"))
    assert len(list(run.glob("mesh/*.ply"))) == (2 if counts["triangles"] else 0)


def test_finished_run_is_refused(finished, capsys):
    error = error_of(capsys, "demo", "--preset", "smoke", "--out", finished[0])
    assert re.fullmatch(r"error: .*finished run .*report\.html.*--overwrite\n", error)


def test_same_seed_gives_the_same_field(run):
    """The stage runs again in a new process."""
    before, _ = storage.read_arrays(run / "nerf/nerf.safetensors", dict)
    result = command("fit", run, "--overwrite")
    assert result.returncode == 0, result.stderr
    after, _ = storage.read_arrays(run / "nerf/nerf.safetensors", dict)  # the header has the seconds of the training
    assert after.keys() == before.keys() and all((after[name] == before[name]).all() for name in before)


def test_trajectory_of_another_scene(run, capsys):
    path = run / "trajectory/transforms.json"
    content = json.loads(path.read_text())
    content["autonerf_lab"] |= {"scene": "val-1", "scene_sha256": "0" * 64}
    path.write_text(json.dumps(content))
    assert "recorded in another scene ('val-1')" in error_of(capsys, "fit", run, "--overwrite")
    assert (run / "nerf/nerf.safetensors").exists() and (run / "report.html").exists(), "nothing is lost"


@pytest.mark.parametrize(
    ("name", "stage"),
    [
        ("trajectory/images/frame_00030.png", "fit"),
        ("trajectory/transforms.json", "fit"),
        ("nerf/nerf.safetensors", "evaluate"),
        ("scores.json", "report"),
        ("figures/evaluate_overlay.png", "report"),
    ],
)
@pytest.mark.parametrize("damage", ["missing", "cut"])
def test_error_names_the_damaged_file_and_nothing_is_lost(run, name, stage, damage, capsys):
    path = run / name
    if damage == "missing":
        path.unlink()
    else:
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    others = {p: p.read_bytes() for p in run.rglob("*") if p.is_file() and p != path}
    error = error_of(capsys, stage, run, *([] if stage == "report" else ["--overwrite"]))
    assert error.startswith("error: ") and path.name in error and error.count("\n") == 1
    assert all(p.read_bytes() == data for p, data in others.items())


def test_mesh_is_readable_by_trimesh(finished):
    import trimesh

    folder, _ = finished
    counts = json.loads((folder / "mesh/mesh.json").read_text())
    files = sorted(folder.glob("mesh/*.glb"))
    assert bool(files) == bool(counts["triangles"])
    for path in files:
        assert trimesh.load(path).bounds is not None


def test_images_of_the_trajectory_have_the_size_of_the_preset(finished):
    with Image.open(finished[0] / "trajectory/images/frame_00000.png") as image:
        assert image.size == (48, 48)


def test_the_fused_kernels_need_no_torch(tmp_path):
    """Importing torch takes seconds; exploring, fitting and evaluating with the defaults must not do it."""
    code = (
        "import sys, autonerf_lab as lab\n"
        "from autonerf_lab.geometry import Intrinsics\n"
        "scene = lab.load_scene('dev-0')\n"
        "sim = lab.Simulator(scene, Intrinsics.from_fov(16, 16))\n"
        "trajectory = lab.explore(sim, 'frontier', steps=20, progress=False)\n"
        "nerf = lab.fit(trajectory, preset='smoke', steps=5, progress=False)\n"
        "lab.evaluate(nerf, scene, preset='smoke', tasks=['rendering', 'pose_refinement'], progress=False)\n"
        "nerf.save(sys.argv[1])\n"
        "assert 'torch' not in sys.modules"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "nerf")]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
