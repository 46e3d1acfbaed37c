"""Poses by COLMAP: with a stand-in for pycolmap that registers what it is told to, and with pycolmap if installed."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation
from toy_photos import looking

from autonerf_lab.data.dataset import load_dataset
from autonerf_lab.errors import DataError, MissingPackageError
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.pipeline import colmap_poses


def stand_in(registered: list[str], calls: list[str]) -> Any:
    """Return the functions of pycolmap that are used."""

    def write(folder: Path) -> None:
        for name in ("cameras", "images"):
            (folder / f"{name}.bin").write_bytes(b"model")

    def mapping(*args: Any, next_image_callback: Any) -> dict[int, Any]:
        calls.append("mapping")
        images = {k: SimpleNamespace(name=name) for k, name in enumerate(registered)}
        whole = SimpleNamespace(images=images, num_reg_images=lambda: len(images), write_binary=write)
        part = SimpleNamespace(images={}, num_reg_images=lambda: 0, write_binary=None)
        return {0: part, 1: whole} if registered else {}

    return SimpleNamespace(
        logging=SimpleNamespace(minloglevel=0),
        set_random_seed=lambda seed: None,
        FeatureExtractionOptions=SimpleNamespace,
        ImageReaderOptions=SimpleNamespace,
        CameraMode=SimpleNamespace(SINGLE=0),
        Device=SimpleNamespace(cpu=0),
        extract_features=lambda base, folder, names, mode, reader, options, device: calls.append(
            f"{names[0]} camera {reader.existing_camera_id}"
        ),
        match_exhaustive=lambda base, device: calls.append("matching"),
        incremental_mapping=mapping,
    )


@pytest.fixture
def photographs(tmp_path: Path) -> Path:
    (tmp_path / "photos").mkdir()
    for t in range(6):
        Image.fromarray(np.zeros((4, 6 if t else 8, 3), np.uint8)).save(tmp_path / f"photos/{t}.jpg")
    return tmp_path / "photos"


def test_photographs_that_do_not_register_are_named(
    photographs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = [f"{t}.jpg" for t in range(6)]
    calls: list[str] = []
    for missing, message in (
        (names[1:3], "2 of 6 photographs did not register: 1.jpg, 2.jpg"),
        (names, "no photograph"),
    ):
        registered = [name for name in names if name not in missing]
        monkeypatch.setattr(colmap_poses, "optional", lambda *args, r=registered: stand_in(r, calls))
        with pytest.raises(DataError, match=message):
            colmap_poses.estimate_poses(photographs, tmp_path / "work", progress=False)
    monkeypatch.setattr(colmap_poses, "optional", lambda *args: stand_in(names[1:], calls))
    with pytest.warns(UserWarning, match=r"1 of 6 photographs did not register: 0\.jpg; they are left out"):
        model = colmap_poses.estimate_poses(photographs, tmp_path / "work", progress=False)
    assert (model / "images.bin").is_file() and (model / "cameras.bin").is_file()
    calls.clear()
    assert colmap_poses.estimate_poses(photographs, tmp_path / "work") == model and not calls, (
        "a finished model is kept"
    )
    Image.new("RGB", (64, 48), "red").save(photographs / "6.jpg")
    monkeypatch.setattr(colmap_poses, "optional", lambda *args: stand_in([*names, "6.jpg"], calls))
    assert colmap_poses.estimate_poses(photographs, tmp_path / "work", progress=False) == model and calls, (
        "but not for other photographs"
    )


def test_photographs_of_one_size_share_a_camera(
    photographs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[str] = []
    monkeypatch.setattr(colmap_poses, "optional", lambda *args: stand_in([f"{t}.jpg" for t in range(6)], calls))
    colmap_poses.estimate_poses(photographs, tmp_path / "work", progress=False)
    assert calls[:3] == ["0.jpg camera -1", "1.jpg camera -1", "2.jpg camera 2"] and calls[6:] == [
        "matching",
        "mapping",
    ]


def test_too_few_photographs_and_a_missing_package(photographs: Path, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="holds 0 photographs"):
        colmap_poses.estimate_poses(tmp_path, tmp_path / "work")
    try:
        import pycolmap  # noqa: F401
    except ImportError:
        with pytest.raises(MissingPackageError, match=r"autonerf-lab\[colmap\]"):
            colmap_poses.estimate_poses(photographs, tmp_path / "work")


def photograph(c2w: np.ndarray, camera: Intrinsics, tiles: np.ndarray) -> np.ndarray:
    """Return the image of a wall at y = 3 and a floor at z = 0, with random tiles of 12.5 cm."""
    u, v = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    x, y = (u - camera.cx) / camera.fl_x, (v - camera.cy) / camera.fl_y
    rays = np.dstack([x, -y, -np.ones_like(x)]) @ c2w[:3, :3].T
    with np.errstate(divide="ignore"):
        wall, floor = (3 - c2w[1, 3]) / rays[..., 1], -c2w[2, 3] / rays[..., 2]
    on_wall = (wall > 0) & ((wall < floor) | (floor <= 0))
    points = c2w[:3, 3] + np.where(on_wall, wall, floor)[..., None] * rays
    column, row = (np.floor(points[..., k] * 8).astype(int) % 64 for k in (0, 2))
    depth_row = np.floor(points[..., 1] * 8).astype(int) % 64
    return tiles[on_wall.astype(int), np.where(on_wall, row, depth_row), column]


@pytest.mark.slow
def test_pycolmap_finds_the_poses_and_the_focal_length(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    rng = np.random.default_rng(0)
    tiles = rng.integers(0, 256, (2, 64, 64, 3), dtype=np.uint8)
    camera = Intrinsics.from_fov(256, 192, hfov_deg=70)
    (tmp_path / "photos").mkdir()
    eyes = [(x, 0.2 * np.sin(3 * x), 1.2 + 0.2 * np.cos(5 * x)) for x in np.linspace(-1, 1, 10)]
    true = np.stack([looking(eye, (0.5 * eye[0], 3, 0.6)) for eye in eyes])
    for t, c2w in enumerate(true):
        Image.fromarray(photograph(c2w, camera, tiles)).save(tmp_path / f"photos/{t:02d}.png")
    Image.fromarray(rng.integers(0, 256, (192, 256, 3), dtype=np.uint8)).save(tmp_path / "photos/noise.png")
    with pytest.warns(UserWarning, match=r"1 of 11 photographs did not register: noise\.png; they are left out"):
        model = colmap_poses.estimate_poses(tmp_path / "photos", tmp_path / "work", progress=False)
    data = load_dataset(tmp_path / "photos", colmap=model)
    assert data.names == [f"{t:02d}.png" for t in range(10)]
    assert all(abs(found.fl_x / camera.fl_x - 1) < 0.02 for found in data.intrinsics)
    found, expected = (poses[:, :3, 3] - poses[:, :3, 3].mean(axis=0) for poses in (data.poses, true))
    found *= np.linalg.norm(expected) / np.linalg.norm(found)  # COLMAP's scale and origin are arbitrary
    rotation, _ = Rotation.align_vectors(expected, found)
    assert np.abs(rotation.apply(found) - expected).max() < 0.02
    turned = rotation.as_matrix() @ data.poses[:, :3, :3]
    assert (Rotation.from_matrix(turned.transpose(0, 2, 1) @ true[:, :3, :3]).magnitude() < np.deg2rad(1)).all()
