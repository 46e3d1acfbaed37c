"""Command line: help, errors and exit codes."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
import trimesh

from autonerf_lab import __version__, cli, pipeline
from autonerf_lab.errors import DataError

COMMANDS = (
    "demo",
    "scenes",
    "explore",
    "refine-poses",
    "play",
    "fit",
    "evaluate",
    "episodes",
    "mesh",
    "report",
    "export",
    "adopt",
    "point-cloud",
    "video",
    "view",
    "train-odometry",
    "train-policy",
    "rewards",
    "bench",
    "course",
)


def run(*arguments, cwd=None):
    return subprocess.run(
        [sys.executable, "-m", "autonerf_lab.cli", *arguments], capture_output=True, text=True, check=False, cwd=cwd
    )


def test_help_is_fast():
    started = time.perf_counter()
    result = run("--help")
    assert result.returncode == 0
    assert all(command in result.stdout for command in COMMANDS)
    assert time.perf_counter() - started < 10  # typically 0.5 s; a heavy import takes several seconds


def test_help_imports_nothing_heavy():
    code = (
        "import sys, autonerf_lab.cli as c\n"
        "try: c.main(['--help'])\nexcept SystemExit: pass\n"
        "assert not {'torch', 'numba', 'pandas', 'trimesh', 'matplotlib'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help(command, capsys):
    with pytest.raises(SystemExit) as stopped:
        cli.main([command, "--help"])
    assert stopped.value.code == 0
    assert "usage: autonerf-lab" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["demo", "--policy", "frontire"], "unknown policy 'frontire'; valid names: e2e-cov, "),
        (
            ["demo", "--model", "gauss"],
            "unknown model 'gauss'; valid names: instant-ngp, instant-ngp-rgbd, semantic-nerf, semantic-nerfacto, ",
        ),
        (["demo", "--preset", "fats"], "unknown preset 'fats'; valid names: fast, paper, smoke"),
        (["demo", "--scene", "val-9"], "unknown scene 'val-9'; valid names: dev-0, "),
        (["explore", "--scene", "nowhere.glb", "--out", "x"], "nowhere.glb"),
        (["fit", "nowhere"], "nowhere holds no run"),
        (["report", "nowhere"], "nowhere holds no run"),
        (["scenes", "show", "val-9"], "unknown scene 'val-9'"),
        (["scenes", "generate", "1", "--out", "apartment.txt"], "apartment.txt"),
        (["demo", "--steps", "0"], "steps (--steps) must be more than 0 and less than 1048576, not 0"),
        (["demo", "--fov", "180"], "hfov_deg (--fov) must be more than 0 and less than 180, not 180.0"),
        (["explore", "--map-size", "10", "--out", "x"], "map_size (--map-size) must be more than 40"),
        (["train-policy", "--frames", "inf"], "'inf' is not a whole number from 0 on"),
        (["train-segmentation", "--steps", "nan"], "'nan' is not a whole number from 1 on"),
        (["train-policy", "--policy", "e2e-cov", "--demonstrations", "3"], "e2e policies have no teacher"),
        (["demo", "--device", "gpu"], "device 'gpu' is not available on this machine"),
        (["bench", "run", "--out", "x", "--policies", "random", "--device", "gpu"], "device 'gpu' is not available"),
    ],
)
def test_error_is_one_line_and_exit_code_one(arguments, words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.main(arguments) == 1
    captured = capsys.readouterr()
    assert captured.err.startswith("error: ") and captured.err.count("\n") == 1
    assert words in captured.err
    assert not list(Path().iterdir())


def test_debug_shows_the_traceback(capsys):
    assert cli.main(["fit", "nowhere", "--debug"]) == 1
    assert "Traceback" in capsys.readouterr().err


def test_ctrl_c_says_how_to_continue(monkeypatch, capsys):
    def interrupted(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(pipeline, "run_pipeline", interrupted)
    assert cli.main(["demo"]) == 130
    assert "run the same command again" in capsys.readouterr().err


def test_version(capsys):
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out == f"autonerf-lab {__version__}\n"
    assert run("--version").returncode == 0


def test_wrong_arguments_are_exit_code_two():
    assert run("dmeo").returncode == 2


def test_full_disk_is_a_one_line_error(monkeypatch, capsys):
    def full(*args, **kwargs):
        raise DataError("cannot write runs/demo/run.json: No space left on device; free some space")

    monkeypatch.setattr(pipeline, "run_pipeline", full)
    assert cli.main(["demo"]) == 1
    assert "No space left" in capsys.readouterr().err


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_full_standard_output_is_a_one_line_error():
    with open("/dev/full", "w") as full:
        command = [sys.executable, "-m", "autonerf_lab.cli", "scenes", "list"]
        result = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert result.returncode == 1
    assert result.stderr == "error: cannot write the output of the command: No space left on device\n"


def test_paths_with_any_letters_work_in_the_c_locale(tmp_path):
    out = tmp_path / "Wohnung ä 房间 \N{HOUSE BUILDING}" / ("x" * 200) / ("y" * 200) / "scene.json"
    words = [sys.executable, "-m", "autonerf_lab.cli", "scenes", "generate", "7", "--out", str(out)]
    environment = {**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    result = subprocess.run(words, capture_output=True, env=environment, check=False)
    assert (result.returncode, result.stderr) == (0, b"") and out.exists()
    too_long = [*words[:-1], str(tmp_path / ("z" * 300) / "scene.json")]
    result = subprocess.run(too_long, capture_output=True, env=environment, check=False)
    assert result.returncode == 1 and result.stderr.count(b"\n") == 1
    assert result.stderr.startswith(b"error: cannot write") and b"File name too long" in result.stderr


def test_scenes_list(capsys):
    assert cli.main(["scenes", "list"]) == 0
    names = capsys.readouterr().out.split()
    assert len(names) == 60 and {"train-24", "dev-4", "val-0", "test-19", "house-4"} <= set(names)


def test_scene_is_exported_and_imported(tmp_path, capsys):
    spec, glb, image = (str(tmp_path / name) for name in ("a.json", "a.glb", "a.png"))
    assert cli.main(["scenes", "generate", "7", "--out", spec]) == 0
    assert cli.main(["scenes", "show", spec, "--out", image]) == 0
    assert Path(image).read_bytes().startswith(b"\x89PNG")
    assert cli.main(["scenes", "export", spec, "--out", glb]) == 0
    assert cli.main(["scenes", "import", glb]) == 0
    assert "triangles" in capsys.readouterr().out


@pytest.mark.parametrize("arguments", ["scenes list", "rewards --help"])
def test_broken_pipe_is_not_an_error(arguments):
    command = f"{sys.executable} -m autonerf_lab.cli {arguments} | head -n 1"
    result = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)
    assert result.stderr == "" and result.stdout.count("\n") == 1


def test_a_warning_is_one_line(tmp_path):
    box = trimesh.creation.box((5, 4, 2.5))
    box.invert()
    box.export(tmp_path / "room.ply")
    shown = run("scenes", "show", str(tmp_path / "room.ply"))
    assert shown.returncode == 0
    assert shown.stderr == (
        f"warning: {tmp_path / 'room.ply'}: no object has a name: all surfaces are background; "
        "name the nodes, or add a semantics file\n"
    )
