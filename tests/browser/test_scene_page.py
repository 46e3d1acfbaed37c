"""The 3-D page of a scene: complete in itself, and text from files is shown, never run."""

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
from autonerf_lab.scenes import Scene, generate_apartment
from autonerf_lab.scenes import scene_page as page_module
from autonerf_lab.scenes.scene_page import _widest_view


@pytest.fixture(scope="module")
def home() -> Scene:
    return generate_apartment(11)


def parts_of(text: str) -> tuple[dict, np.ndarray, Image.Image]:
    """What a browser would find in a page: the facts, the corners of the triangles, the picture."""
    facts = json.JSONDecoder().raw_decode(text, text.index("const facts = ") + len("const facts = "))[0]
    packed = re.search(r'const corners = floats\("([^"]+)"\)', text)
    picture = re.search(r'data:image/jpeg;base64,([^"]+)"', text)
    assert packed is not None and picture is not None
    corners = np.frombuffer(base64.b64decode(packed[1]), "<f4").reshape(-1, 3)
    return facts, corners, Image.open(io.BytesIO(base64.b64decode(picture[1])))


def test_every_triangle_faces_the_same_way_as_in_the_scene(tmp_path: Path, home: Scene) -> None:
    """Y up is a rotation: were it a mirror, the floor would be culled and the ceiling be seen from above."""
    facts, corners, picture = parts_of(home.page(tmp_path / "home.html").read_text())
    assert len(corners) == 3 * len(home.faces) == sum(o["count"] for o in facts["objects"])
    assert picture.size == home.texture.shape[1::-1]
    a, b, c = corners.reshape(-1, 3, 3).transpose(1, 0, 2)
    up = np.cross(b - a, c - a)[:, 1]
    height = (a + b + c)[:, 1] / 3
    top = corners[:, 1].max()
    assert up[height > top - 0.01].sum() < -5  # the ceiling looks down, so from above one sees through it
    assert up[np.abs(height) < 0.01].sum() > 5  # the floor looks up


def test_objects_have_their_names_and_classes(tmp_path: Path, home: Scene) -> None:
    facts, _, _ = parts_of(home.page(tmp_path / "home.html").read_text())
    named = {o["name"]: o["class"] for o in facts["objects"] if o["name"]}
    assert named == {i.name: i.class_id for i in home.instances}
    assert [c["name"] for c in facts["classes"]][:2] == ["background", "chair"] and len(facts["classes"]) == 16


def test_the_visitor_stands_on_free_floor(tmp_path: Path, home: Scene) -> None:
    facts, _, _ = parts_of(home.page(tmp_path / "home.html").read_text())
    (x, height, z), target = facts["eye"]
    assert 0.5 < height < 2 and np.isclose(np.hypot(target[0] - x, target[2] - z), 1)
    near = np.linalg.norm(home.vertices[:, :2] - [x, -z], axis=1) < 0.25
    between = (home.vertices[:, 2] > 0.15) & (home.vertices[:, 2] < height)
    assert not (near & between).any()


def test_the_widest_view_is_along_the_corridor() -> None:
    opaque = np.ones((20, 60), dtype=bool)
    opaque[8:12, 5:55] = False
    place, direction = _widest_view(np.array([[6, 9], [30, 9]]), opaque)  # its western end, and its middle
    assert place.tolist() == [6, 9] and direction[0] > 0.9


@pytest.mark.parametrize(
    "name", ["<img onerror=alert(1)>", "</script><script>alert(1)</script>", "/*CORNERS*/ /*PICTURE*/"]
)
def test_names_are_text(tmp_path: Path, home: Scene, name: str) -> None:
    scene = replace(home, name=name, spec=None, names={home.instances[0].id: name})
    text = scene.page(tmp_path / "home.html").read_text()
    facts, corners, _ = parts_of(text)
    assert facts["name"] == name and name in [o["name"] for o in facts["objects"]]
    assert "<" not in text[text.index("const facts") : text.index("const corners")]
    assert len(corners) == 3 * len(home.faces)


def test_a_picture_no_browser_takes_is_made_smaller(tmp_path: Path, home: Scene) -> None:
    scene = replace(home, bake=partial(np.zeros, (70_000, 4, 3), np.uint8))  # a JPEG ends at 65,500 rows
    assert parts_of(scene.page(tmp_path / "tall.html").read_text())[2].size == (4, 8192)


def test_another_viewer_in_trimesh_is_a_data_error(
    tmp_path: Path, home: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page_module, "_END_OF_LIBRARY", "not in it")
    with pytest.raises(DataError, match="trimesh"):
        home.page(tmp_path / "home.html")


def test_a_page_that_cannot_be_written_is_a_data_error(tmp_path: Path, home: Scene) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="cannot write"):
        home.page(tmp_path / "file" / "home.html")
