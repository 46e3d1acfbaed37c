"""Baked textures in the cache: read as they were written, replaced if anything is wrong with them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from autonerf_lab.scenes import load_scene, texture_cache
from autonerf_lab.scenes.build import build
from autonerf_lab.scenes.library import folder
from autonerf_lab.scenes.spec import read_spec
from autonerf_lab.scenes.texture_cache import cached_texture

TEXTURE = np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)


class Baker:
    """Bakes the same texture each time and counts how often."""

    def __init__(self) -> None:
        self.count = 0

    def __call__(self) -> np.ndarray:
        self.count += 1
        return TEXTURE


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(texture_cache, "user_cache_path", lambda *_, **__: tmp_path)
    return tmp_path / "textures" / "attic.png"


def test_a_texture_is_baked_once_per_specification_and_code(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bake = Baker()
    for digest, code, baked in (("a", "x", 1), ("a", "x", 1), ("b", "x", 2), ("b", "y", 3), ("b", "y", 3)):
        monkeypatch.setattr(texture_cache, "_code_digest", lambda code=code: code)
        np.testing.assert_array_equal(cached_texture("attic", digest, bake), TEXTURE)
        assert bake.count == baked
    assert list(file.parent.iterdir()) == [file]


@pytest.mark.parametrize(
    "damage",
    [
        lambda file: file.write_bytes(file.read_bytes()[:-40]),
        lambda file: file.write_bytes(b""),
        lambda file: file.write_bytes(file.read_bytes().replace(b"IDAT", b"JUNK")),
        lambda file: Image.fromarray(TEXTURE[..., 0]).save(file),
        lambda file: Image.fromarray(TEXTURE[:1]).save(file),
    ],
    ids=["cut", "empty", "junk", "grey", "other"],
)
def test_a_damaged_file_is_replaced(file: Path, damage: Callable[[Path], object]) -> None:
    bake = Baker()
    cached_texture("attic", "a", bake)
    whole = file.read_bytes()
    damage(file)
    np.testing.assert_array_equal(cached_texture("attic", "a", bake), TEXTURE)
    assert bake.count == 2 and file.read_bytes() == whole


def test_without_a_folder_every_process_bakes(file: Path) -> None:
    file.parent.write_text("not a folder")
    bake = Baker()
    for _ in range(2):
        np.testing.assert_array_equal(cached_texture("attic", "a", bake), TEXTURE)
    assert bake.count == 2


def test_frozen_scenes_read_what_was_baked(file: Path) -> None:
    baked = load_scene("val-0").texture
    assert (file.parent / "val-0.png").exists()
    np.testing.assert_array_equal(load_scene("val-0").texture, baked)
    np.testing.assert_array_equal(build(read_spec(folder() / "val-0.json")).texture, baked)
