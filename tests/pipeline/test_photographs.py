"""``autonerf-lab fit PHOTOGRAPHS --out DIR``: what it makes, what it leaves alone, and what it refuses."""

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
    """A smoke preset of a second."""
    monkeypatch.setitem(SETTINGS, "smoke", replace(SETTINGS["smoke"], rays=256, steps=20))


def test_fit_of_photographs_on_the_command_line(folder, tmp_path, quick, capsys):
    out = tmp_path / "out"
    command = ["fit", str(folder), "--out", str(out), "--preset", "smoke", "--seed", "3"]
    assert cli.main(command) == 0
    printed = capsys.readouterr().out
    assert "15 photographs to train on, 3 held out" in printed
    assert "held_out | psnr" in printed and "nearest_view" in printed and f"field: {out / 'nerf'}" in printed
    made = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    assert made == {"nerf/nerf.json", "nerf/nerf.safetensors", "scores.json", "baselines/nearest_view.json"}
    assert load_nerf(out / "nerf").meta["seed"] == 3
    assert cli.main(["point-cloud", str(out), "--out", str(tmp_path / "x.ply")]) == 0
    assert cli.main(["video", str(out), "--out", str(tmp_path / "x.gif"), "--seconds", "0.1", "--what", "all"]) == 0
    before = (out / "scores.json").read_bytes()
    assert cli.main(command) == 1 and "holds a finished field" in capsys.readouterr().err
    assert (out / "scores.json").read_bytes() == before
    assert cli.main([*command, "--overwrite"]) == 0


def test_an_interrupted_fit_of_photographs_goes_on(folder, tmp_path, quick, monkeypatch):
    whole = photographs.fit_capture(folder, tmp_path / "whole", preset="smoke")
    monkeypatch.setattr(checkpoint, "SAVE_EVERY", 0.0)
    save, saved = checkpoint.TrainingState.save_now_and_then, []

    def tired(self, out):
        save(self, out)
        saved.append(self.step)
        if self.step == 7:
            raise KeyboardInterrupt

    monkeypatch.setattr(checkpoint.TrainingState, "save_now_and_then", tired)
    with pytest.raises(KeyboardInterrupt):
        photographs.fit_capture(folder, tmp_path / "again", preset="smoke")
    again = photographs.fit_capture(folder, tmp_path / "again", preset="smoke")
    assert saved[6:9] == [7, 8, 9]
    assert again["held_out", "psnr"] == whole["held_out", "psnr"]


def test_what_a_fit_of_photographs_does_not_touch(folder, tmp_path, capsys):
    (tmp_path / "diary").mkdir()
    (tmp_path / "diary/monday.txt").write_text("rain")
    (tmp_path / "run").mkdir()
    (tmp_path / "run/run.json").write_text("{}")
    for out, words in (("diary", "no field"), ("run", "holds a run")):
        assert cli.main(["fit", str(folder), "--out", str(tmp_path / out), "--overwrite"]) == 1
        assert words in capsys.readouterr().err
    assert cli.main(["fit", str(folder)]) == 1
    assert "--out says where their field goes" in capsys.readouterr().err
    assert cli.main(["fit", str(tmp_path / "run"), "--preset", "smoke"]) == 1
    assert "a run has its preset" in capsys.readouterr().err
    assert {path.name for path in tmp_path.rglob("*") if path.is_file()} == {"monday.txt", "run.json"}


def spoil(**changes):
    """A change of the content of transforms.json."""
    return lambda content: content.update(changes)


def frame(number, **changes):
    return lambda content: content["frames"][number].update(changes)


POSE = toy.looking((1, 2, 3), (0, 0, 0)).tolist()
SINGULAR = [[1, 0, 0, 0], [0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1]]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (spoil(frames=[]), "at least one frame"),
        (lambda content: content["frames"].__delitem__(slice(1, None)), "two different poses"),
        (lambda content: [f.update(transform_matrix=POSE) for f in content["frames"]], "two different poses"),
        (frame(1, file_path="gone.png"), "'gone.png' does not exist"),
        (frame(1, w=30, h=30), "b.png has 12x8 pixels"),
        (frame(2, transform_matrix=SINGULAR), "frame 2: 'transform_matrix' is not a rigid"),
        (frame(2, transform_matrix=[[float("nan")] * 4] * 3), "frame 2: 'transform_matrix' must be a finite number"),
        (frame(0, fl_x=float("inf")), "frame 0: 'fl_x' must be a finite number"),
        (frame(0, k1=float("nan")), "frame 0: 'k1' must be a finite number"),
    ],
)
def test_bad_captures_are_one_line_on_the_command_line(tmp_path, capsys, change, words):
    folder = make(tmp_path / "capture")
    content = json.loads((folder / "transforms.json").read_text())
    change(content)
    (folder / "transforms.json").write_text(json.dumps(content))
    assert cli.main(["fit", str(folder), "--out", str(tmp_path / "out"), "--preset", "smoke"]) == 1
    said = capsys.readouterr().err
    assert said.startswith("error: ") and said.count("\n") == 1 and words in said
    assert not (tmp_path / "out").exists()
