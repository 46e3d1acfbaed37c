"""LPIPS with random weights, compared with a naive implementation in NumPy."""

import hashlib
import json
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import toy_photos
import toy_scene
from toy_lpips import CONVOLUTIONS, random_weights

from autonerf_lab.cli import main
from autonerf_lab.errors import DataError
from autonerf_lab.evaluators import NearestView, Scores, TrueField, evaluate, oracle_scores
from autonerf_lab.evaluators import lpips as lpips_module
from autonerf_lab.evaluators.lpips import Lpips
from autonerf_lab.evaluators.rendering import evaluate_rendering, simulated_views
from autonerf_lab.geometry import Intrinsics, planar_pose
from autonerf_lab.simulator import Simulator
from autonerf_lab.utils import storage


@pytest.fixture(scope="module")
def weights():
    return random_weights()


@pytest.fixture(scope="module")
def path(weights, tmp_path_factory):
    path = tmp_path_factory.mktemp("lpips") / "vgg.safetensors"
    storage.write_arrays(path, weights)
    return path


@pytest.fixture(scope="module")
def lpips(path):
    return Lpips(path)


@pytest.fixture(scope="module")
def images():
    rng = np.random.default_rng(1)
    return rng.random((2, 40, 36, 3), np.float32)


def convolve(x, weight, bias):
    """(H, W, C), zeros around it."""
    rows, cols = x.shape[:2]
    padded = np.pad(x, ((1, 1), (1, 1), (0, 0)))
    return bias + sum(padded[i : i + rows, j : j + cols] @ weight[:, :, i, j].T for i in range(3) for j in range(3))


def largest_of_four(x):
    rows, cols = x.shape[0] // 2, x.shape[1] // 2
    return x[: 2 * rows, : 2 * cols].reshape(rows, 2, cols, 2, -1).max(axis=(1, 3))


def naive(image, target, weights):
    features = [
        (2 * x.astype(np.float64) - 1 - (-0.030, -0.088, -0.188)) / (0.458, 0.448, 0.450) for x in (image, target)
    ]
    total = 0.0
    for stage, layers in enumerate(CONVOLUTIONS):
        for k, _, _ in layers:
            kernel, bias = weights[f"features.{k}.weight"].astype(np.float64), weights[f"features.{k}.bias"]
            features = [np.maximum(convolve(x, kernel, bias), 0) for x in features]
        a, b = (x / np.linalg.norm(x, axis=2, keepdims=True) for x in features)
        total += (((a - b) ** 2) @ weights[f"lin{stage}.model.1.weight"].ravel()).mean()
        features = [largest_of_four(x) for x in features]
    return total


class Installed:
    """Stands in for torchvision and for the package lpips: a network with given weights."""

    __version__ = "0.1"

    def __init__(self, weights):
        self.weights = {name: torch.from_numpy(value) for name, value in weights.items()}
        self.models = SimpleNamespace(vgg16=lambda weights: self)
        self.LPIPS = lambda **options: self

    def state_dict(self):
        return {**self.weights, "classifier.0.bias": torch.zeros(3)}


def test_the_command_writes_the_weights_of_installed_packages(weights, tmp_path, monkeypatch, capsys):
    for name in ("torchvision", "lpips"):
        monkeypatch.setitem(sys.modules, name, Installed(weights))
    file = tmp_path / "vgg.safetensors"
    assert main(["lpips-weights", str(file)]) == 1
    assert "the heads of the installed package lpips are not those of version 0.1" in capsys.readouterr().err
    assert not file.exists()
    monkeypatch.setattr(lpips_module, "HEADS_SHA256", Lpips(written(weights, tmp_path / "a")).parts["heads"])
    assert main(["lpips-weights", str(file)]) == 0
    assert capsys.readouterr().out == f"{file}: SHA-256 {Lpips(file).sha256}\n"
    monkeypatch.setitem(sys.modules, "lpips", None)
    assert main(["lpips-weights", str(file)]) == 1
    assert 'lpips is not installed: pip install "autonerf-lab[lpips]"' in capsys.readouterr().err


def written(weights, path):
    storage.write_arrays(path, weights)
    return path


def test_lpips_agrees_with_the_naive_implementation(lpips, images, weights):
    assert lpips(*images) == pytest.approx(naive(*images, weights), rel=1e-4)


def test_lpips_is_zero_for_equal_images_symmetric_and_monotone(lpips, images):
    image, noise = images
    assert lpips(image, image) == 0
    assert lpips(image, noise) == pytest.approx(lpips(noise, image), rel=1e-5)
    distances = [lpips((1 - share) * image + share * noise, image) for share in (0.05, 0.2, 0.5, 1.0)]
    assert distances[0] > 0 and distances == sorted(distances)


@pytest.mark.parametrize(
    "shapes", [((32, 32, 3), (32, 33, 3)), ((32, 32, 4),) * 2, ((32, 32),) * 2, ((15, 64, 3),) * 2]
)
def test_images_that_cannot_be_compared_are_refused(lpips, shapes):
    with pytest.raises(ValueError, match="two \\(H, W, 3\\) images of at least 16"):
        lpips(*map(np.zeros, shapes))


def test_the_sha256_is_checked(path):
    sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
    assert Lpips(path, sha256.upper()).sha256 == sha256
    with pytest.raises(DataError, match=f"vgg.safetensors has the SHA-256 {sha256}, not {'0' * 64}"):
        Lpips(path, "0" * 64)


def test_backbone_and_heads_have_separate_hashes(weights, lpips, tmp_path):
    """A second file with the same backbone, other heads, another order and an extra tensor."""
    others = {name: value * (0.5 if name.startswith("lin") else 1) for name, value in reversed(weights.items())}
    storage.write_arrays(tmp_path / "other.safetensors", {"classifier.0.bias": np.zeros(3), **others}, {"by": "me"})
    other = Lpips(tmp_path / "other.safetensors")
    assert other.parts["backbone"] == lpips.parts["backbone"]
    assert other.parts["heads"] != lpips.parts["heads"] and other.sha256 != lpips.sha256


@pytest.mark.parametrize(
    ("name", "array", "said"),
    [
        ("lin2.model.1.weight", None, "lin2.model.1.weight is missing"),
        ("features.5.weight", np.zeros((128, 64, 3, 1), np.float32), "not floats of \\(128, 64, 3, 3\\)"),
        ("features.28.bias", np.zeros(512, np.int32), "features.28.bias is int32"),
        ("features.0.bias", np.full(64, np.nan, np.float32), "features.0.bias holds a value that is not finite"),
    ],
)
def test_a_file_without_the_weights_is_refused(weights, tmp_path, name, array, said):
    changed = {**weights, name: array}
    if array is None:
        del changed[name]
    storage.write_arrays(tmp_path / "other.safetensors", changed)
    with pytest.raises(DataError, match=f"other.safetensors: .*{said}"):
        Lpips(tmp_path / "other.safetensors")


def test_a_file_of_something_else_is_refused(tmp_path):
    (tmp_path / "vgg.pth").write_bytes(b"PK\x03\x04 a state of torch is a zip of pickles")
    with pytest.raises(DataError, match=r"vgg\.pth is damaged, not a readable safetensors file"):
        Lpips(tmp_path / "vgg.pth")


def test_scores_name_the_weights_they_came_from(path, lpips, tmp_path):
    scene = toy_scene.two_rooms()
    scores = oracle_scores(scene, "smoke", tasks=["rendering"], lpips_weights=path)
    assert 0 <= scores["rendering", "lpips"] < 1e-4, "the same images but for their rounding"
    assert [row.status for row in scores if row.metric == "lpips"] == ["ok"]
    assert len(scores.artifacts["rendering"]["lpips"]) == 8
    scores.save(tmp_path / "scores.json")
    weights = Scores.load(tmp_path / "scores.json").weights
    assert weights == {"lpips": lpips.sha256} | {f"lpips_{part}": value for part, value in lpips.parts.items()}
    without = evaluate(TrueField(scene, views=1), scene, "smoke", tasks=["rendering"], progress=False)
    without.save(tmp_path / "without.json")
    assert without["rendering", "lpips"] is None and "weights" not in json.loads(
        (tmp_path / "without.json").read_text()
    )
    (tmp_path / "bad.json").write_text('{"scores": [], "weights": ["lpips"]}')
    with pytest.raises(DataError, match=r"bad\.json is not as expected.*weights"):
        Scores.load(tmp_path / "bad.json")


def test_photographs_have_an_lpips_score(lpips):
    data = toy_photos.photographs(toy_photos.orbit(2))
    scores = evaluate(NearestView(data), data, progress=False, trajectory=data, lpips_weights=lpips)
    assert scores["held_out", "lpips"] == scores.baselines["nearest_view"]["held_out", "lpips"] == 0
    assert scores.weights == scores.baselines["nearest_view"].weights and scores.weights["lpips"] == lpips.sha256


def test_small_images_have_no_lpips(lpips):
    sim = Simulator(toy_scene.two_rooms(), Intrinsics.from_fov(12, 12), supersample=1)
    views = simulated_views(sim, planar_pose(2.0, 1.0, 0.0)[None])
    result = evaluate_rendering(TrueField(sim.scene, sim, views=1), views, lpips=lpips)
    assert result.values["lpips"] is None and result.status["lpips"] == "images under 16 pixels"
    assert result.values["ssim"] == pytest.approx(1)


def test_the_command_line_looks_at_the_file_first(tmp_path, capsys):
    for command in (["demo", "--out", str(tmp_path / "run")], ["evaluate", str(tmp_path / "run")]):
        assert main([*command, "--lpips-weights", str(tmp_path / "none.safetensors")]) == 1
        assert "none.safetensors does not exist" in capsys.readouterr().err
    assert main(["demo", "--out", str(tmp_path / "run"), "--lpips-sha256", "00"]) == 1
    assert "give --lpips-weights too" in capsys.readouterr().err
    assert main(["fit", str(tmp_path / "run"), "--lpips-weights", "x"]) == 1
    assert "`autonerf-lab evaluate`" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
