"""3-D page of a scene: self-contained, and names from files are escaped."""

import base64
import io
import json
import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from autonerf_lab.errors import DataError
from autonerf_lab.scenes import Scene, generate_apartment, write_page
from autonerf_lab.scenes import scene_page as page_module
from autonerf_lab.scenes.scene_page import _widest_view


@pytest.fixture(scope="module")
def home() -> Scene:
    return generate_apartment(11)


def parts_of(text: str) -> tuple[dict, np.ndarray, Image.Image]:
    """Return the contents of a page: facts, corners of the triangles, texture."""
    facts = json.JSONDecoder().raw_decode(text, text.index("const facts = ") + len("const facts = "))[0]
    packed = re.search(r'const corners = floats\("([^"]+)"\)', text)
    texture = re.search(r'data:image/jpeg;base64,([^"]+)"', text)
    assert packed is not None and texture is not None
    corners = np.frombuffer(base64.b64decode(packed[1]), "<f4").reshape(-1, 3)
    return facts, corners, Image.open(io.BytesIO(base64.b64decode(texture[1])))


def test_triangles_keep_their_orientation(tmp_path: Path, home: Scene) -> None:
    """Conversion to y up is a rotation: a mirrored scene would hide the floor and show the ceiling from above."""
    facts, corners, texture = parts_of(write_page(home, tmp_path / "home.html").read_text())
    assert len(corners) == 3 * len(home.faces) == sum(o["count"] for o in facts["objects"])
    assert texture.size == home.texture.shape[1::-1]
    a, b, c = corners.reshape(-1, 3, 3).transpose(1, 0, 2)
    up = np.cross(b - a, c - a)[:, 1]
    height = (a + b + c)[:, 1] / 3
    top = corners[:, 1].max()
    assert up[height > top - 0.01].sum() < -5  # the ceiling faces down and is culled from above
    assert up[np.abs(height) < 0.01].sum() > 5  # the floor faces up


def test_objects_have_their_names_and_classes(tmp_path: Path, home: Scene) -> None:
    facts, _, _ = parts_of(write_page(home, tmp_path / "home.html").read_text())
    named = {o["name"]: o["class"] for o in facts["objects"] if o["name"]}
    assert named == {i.name: i.class_id for i in home.instances}
    assert [c["name"] for c in facts["classes"]][:2] == ["background", "chair"] and len(facts["classes"]) == 16


def test_the_inside_view_starts_on_free_floor(tmp_path: Path, home: Scene) -> None:
    facts, _, _ = parts_of(write_page(home, tmp_path / "home.html").read_text())
    (x, height, z), target = facts["eye"]
    assert 0.5 < height < 2 and np.isclose(np.hypot(target[0] - x, target[2] - z), 1)
    near = np.linalg.norm(home.vertices[:, :2] - [x, -z], axis=1) < 0.25
    between = (home.vertices[:, 2] > 0.15) & (home.vertices[:, 2] < height)
    assert not (near & between).any()


def test_the_widest_view_is_along_the_corridor() -> None:
    opaque = np.ones((20, 60), dtype=bool)
    opaque[8:12, 5:55] = False
    position, direction = _widest_view(np.array([[6, 9], [30, 9]]), opaque)  # western end and middle
    assert position.tolist() == [6, 9] and direction[0] > 0.9


@pytest.mark.parametrize(
    "name", ["<img onerror=alert(1)>", "</script><script>alert(1)</script>", "/*CORNERS*/ /*TEXTURE*/"]
)
def test_names_are_escaped(tmp_path: Path, home: Scene, name: str) -> None:
    scene = replace(home, name=name, spec=None, names={home.instances[0].id: name})
    text = write_page(scene, tmp_path / "home.html").read_text()
    facts, corners, _ = parts_of(text)
    assert facts["name"] == name and name in [o["name"] for o in facts["objects"]]
    assert "<" not in text[text.index("const facts") : text.index("const corners")]
    assert len(corners) == 3 * len(home.faces)


def test_a_texture_too_large_for_browsers_is_shrunk(tmp_path: Path, home: Scene) -> None:
    scene = replace(home, bake=partial(np.zeros, (70_000, 4, 3), np.uint8))  # JPEG allows at most 65,500 rows
    assert parts_of(write_page(scene, tmp_path / "tall.html").read_text())[2].size == (4, 8192)


def test_an_unknown_viewer_of_trimesh_is_a_data_error(
    tmp_path: Path, home: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page_module, "_END_OF_LIBRARY", "not in it")
    with pytest.raises(DataError, match="trimesh"):
        write_page(home, tmp_path / "home.html")


def test_a_page_that_cannot_be_written_is_a_data_error(tmp_path: Path, home: Scene) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="cannot write"):
        write_page(home, tmp_path / "file" / "home.html")
