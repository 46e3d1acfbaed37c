"""``autonerf-lab fit PHOTOGRAPHS --out DIR``: outputs, resuming and errors."""

import json
from dataclasses import replace

import pytest
import toy_photos as toy
from toy_capture import make

from autonerf_lab import cli
from autonerf_lab.nerf import checkpoint, load_nerf
from autonerf_lab.nerf.models.semantic_nerfacto import SETTINGS
from autonerf_lab.pipeline import photographs


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    poses = toy.orbit(18)
    return toy.write(toy.photographs(poses), tmp_path_factory.mktemp("photographs"))


@pytest.fixture
def quick(monkeypatch):
    """Reduce the smoke preset to a second of training."""
    monkeypatch.setitem(SETTINGS, "smoke", replace(SETTINGS["smoke"], rays=256, steps=20))


def test_fit_of_photographs_on_the_command_line(folder, tmp_path, quick, capsys):
    out = tmp_path / "out"
    command = ["fit", str(folder), "--out", str(out), "--preset", "smoke", "--seed", "3"]
    assert cli.main(command) == 0
    printed = capsys.readouterr().out
    assert "15 training photographs, 3 held-out photographs" in printed
    assert "held_out | psnr" in printed and "nearest_view" in printed and f"field: {out / 'nerf'}" in printed
    made = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    assert made == {
        "outputs.json",
        "nerf/nerf.json",
        "nerf/nerf.safetensors",
        "scores.json",
        "baselines/nearest_view.json",
    }
    assert load_nerf(out / "nerf").meta["seed"] == 3
    assert cli.main(["point-cloud", str(out), "--out", str(tmp_path / "x.ply")]) == 0
    assert cli.main(["video", str(out), "--out", str(tmp_path / "x.gif"), "--seconds", "0.1", "--layer", "all"]) == 0
    before = (out / "scores.json").read_bytes()
    assert cli.main(command) == 1 and "holds a finished field" in capsys.readouterr().err
    assert (out / "scores.json").read_bytes() == before
    assert cli.main([*command, "--overwrite"]) == 0


def test_interrupted_fit_of_photographs_continues(folder, tmp_path, quick, monkeypatch):
    whole = photographs.fit_photographs(folder, tmp_path / "whole", preset="smoke")
    monkeypatch.setattr(checkpoint, "SAVE_EVERY", 0.0)
    save, saved = checkpoint.TrainingState.save_periodically, []

    def interrupt(self, out):
        save(self, out)
        saved.append(self.step)
        if self.step == 7:
            raise KeyboardInterrupt

    monkeypatch.setattr(checkpoint.TrainingState, "save_periodically", interrupt)
    with pytest.raises(KeyboardInterrupt):
        photographs.fit_photographs(folder, tmp_path / "again", preset="smoke")
    again = photographs.fit_photographs(folder, tmp_path / "again", preset="smoke")
    assert saved[6:9] == [7, 8, 9]
    assert again["held_out", "psnr"] == whole["held_out", "psnr"]


def test_other_files_are_not_changed(folder, tmp_path, capsys):
    (tmp_path / "diary").mkdir()
    (tmp_path / "diary/monday.txt").write_text("rain")
    (tmp_path / "run").mkdir()
    (tmp_path / "run/run.json").write_text("{}")
    for out, words in (("diary", "no field"), ("run", "holds a run")):
        assert cli.main(["fit", str(folder), "--out", str(tmp_path / out), "--overwrite"]) == 1
        assert words in capsys.readouterr().err
    assert cli.main(["fit", str(folder)]) == 1
    assert "give the output folder with --out" in capsys.readouterr().err
    assert cli.main(["fit", str(tmp_path / "run"), "--preset", "smoke"]) == 1
    assert "a run has its own preset" in capsys.readouterr().err
    assert {path.name for path in tmp_path.rglob("*") if path.is_file()} == {"monday.txt", "run.json"}


def top_level(**changes):
    """Return a function that changes top-level entries of transforms.json."""
    return lambda content: content.update(changes)


def frame(number, **changes):
    """Return a function that changes entries of one frame of transforms.json."""
    return lambda content: content["frames"][number].update(changes)


POSE = toy.looking((1, 2, 3), (0, 0, 0)).tolist()
SINGULAR = [[1, 0, 0, 0], [0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1]]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (top_level(frames=[]), "at least one frame"),
        (lambda content: content["frames"].__delitem__(slice(1, None)), "two different poses"),
        (lambda content: [f.update(transform_matrix=POSE) for f in content["frames"]], "two different poses"),
        (frame(1, file_path="gone.png"), "'gone.png' does not exist"),
        (frame(1, w=30, h=30), "b.png has 12x8 pixels"),
        (frame(2, transform_matrix=SINGULAR), "frame 2: 'transform_matrix' is not a rigid"),
        (frame(2, transform_matrix=[[float("nan")] * 4] * 3), "not readable JSON"),
        (frame(0, fl_x=float("inf")), "not readable JSON"),
        (frame(0, k1="0.1"), "frame 0: 'k1' must be a finite number"),
    ],
)
def test_invalid_captures_give_a_one_line_error(tmp_path, capsys, change, words):
    folder = make(tmp_path / "capture")
    content = json.loads((folder / "transforms.json").read_text())
    change(content)
    (folder / "transforms.json").write_text(json.dumps(content))
    assert cli.main(["fit", str(folder), "--out", str(tmp_path / "out"), "--preset", "smoke"]) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1 and words in error
    assert not (tmp_path / "out").exists()
