"""Poses by COLMAP, with a stand-in for pycolmap that registers the photographs it is told to."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from autonerf_lab.errors import DataError, MissingPackageError
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
