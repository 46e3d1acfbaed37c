"""Scene files: specifications, GLB export, mesh import, semantics files and HTML pages, valid and invalid."""

import json
import re
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from autonerf_lab.errors import DataError, SceneError, UnknownNameError
from autonerf_lab.scenes import (
    export_glb,
    generate_apartment,
    import_scene,
    load_scene,
    scene_names,
    top_view,
    write_page,
)
from autonerf_lab.scenes.library import folder
from autonerf_lab.scenes.semantics_file import read_semantics
from autonerf_lab.scenes.spec import dumps, read_spec


def test_unknown_name_lists_the_valid_names() -> None:
    with pytest.raises(UnknownNameError, match=r"unknown scene 'val-7'; valid names: dev-0, .*val-4"):
        load_scene("val-7")
    with pytest.raises(UnknownNameError, match="unknown split"):
        scene_names("exam")


def test_specification_round_trip(tmp_path: Path) -> None:
    scene = generate_apartment(11)
    assert scene.spec is not None
    (tmp_path / "home.json").write_text(dumps(scene.spec))
    again = load_scene(str(tmp_path / "home.json"))
    assert np.array_equal(again.vertices, scene.vertices) and again.spec == scene.spec


@pytest.mark.parametrize("share", [0.0, 0.3, 0.999])
def test_truncated_specification_names_the_file(tmp_path: Path, share: float) -> None:
    text = (folder() / "dev-0.json").read_text()
    path = tmp_path / "cut.json"
    path.write_text(text[: int(len(text) * share)])
    with pytest.raises(SceneError, match=r"cut\.json"):
        load_scene(str(path))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: s.update(format="other"), "format"),
        (lambda s: s.update(version=99), "version"),
        (lambda s: s.pop("objects"), "objects"),
        (lambda s: s["objects"][0].update({"class": "spaceship"}), "spaceship"),
        (lambda s: s["objects"][1].update(id=0), "twice"),
        (lambda s: s["objects"][1]["parts"][0].update(m="unobtainium"), "unobtainium"),
        (lambda s: s["objects"][1]["parts"][0].update(at=[1e9, 0, 0]), "'at'"),
        (lambda s: s["objects"][1]["parts"].append({"m": "metal"}), "exactly one"),
        (lambda s: s["objects"][1]["parts"].append({"box": [1, -1, 1], "m": "metal"}), "three positive numbers"),
        (lambda s: s["materials"]["metal"].update(kind="antimatter"), "kind"),
        (lambda s: s["lights"][0].update(power="bright"), "power"),
    ],
)
def test_invalid_specification_names_the_error(tmp_path: Path, change, message: str) -> None:  # type: ignore[no-untyped-def]
    spec = read_spec(folder() / "dev-0.json")
    change(spec)
    path = tmp_path / "wrong.json"
    path.write_text(json.dumps(spec))
    with pytest.raises(SceneError, match=message) as caught:
        load_scene(str(path))
    assert "wrong.json" in str(caught.value)


def test_glb_round_trip(tmp_path: Path) -> None:
    scene = generate_apartment(11)
    back = import_scene(export_glb(scene, tmp_path / "home.glb"))
    assert len(back.faces) == len(scene.faces)
    assert np.array_equal(np.bincount(back.face_class), np.bincount(scene.face_class))
    assert np.allclose(np.ptp(back.bounds, axis=0), np.ptp(scene.bounds, axis=0), atol=1e-4)
    assert abs(back.bounds[0, 2]) < 1e-3
    first, _ = top_view(scene, 15)
    second, _ = top_view(back, 15)
    rows, cols = min(first.shape[0], second.shape[0]), min(first.shape[1], second.shape[1])
    assert np.abs(first[:rows, :cols].astype(int) - second[:rows, :cols]).mean() < 3


def test_glb_is_upright_and_semantic_colours_are_the_classes(tmp_path: Path) -> None:
    scene = generate_apartment(11)
    loaded = trimesh.load_scene(export_glb(scene, tmp_path / "classes.glb", semantic=True))
    size = np.ptp(loaded.bounds, axis=0)
    height = np.ptp(scene.bounds, axis=0)[2]
    assert np.isclose(size[1], height, atol=1e-3)  # y is up in a GLB
    assert any(node.startswith("toilet_") for node in loaded.graph.nodes_geometry)


def test_semantics_file_round_trip(tmp_path: Path) -> None:
    """After export and import, the same triangles have the same class, object and name."""
    scene = generate_apartment(11)
    back = import_scene(export_glb(scene, tmp_path / "home.glb"))
    # the file contains the objects one after the other, with their triangles in the same order
    order, read = (np.argsort(s.face_instance, kind="stable") for s in (scene, back))
    assert np.array_equal(back.face_instance[read], scene.face_instance[order])
    assert np.array_equal(back.face_class[read], scene.face_class[order])
    assert {i.id: i.name for i in back.instances} == {i.id: i.name for i in scene.instances}
    shift = back.vertices[back.faces[read]] - scene.vertices[scene.faces[order]]
    assert np.abs(shift - shift[0, 0]).max() < 1e-4  # translation to the centre only


def test_a_node_with_a_class_and_without_a_number_is_an_object(tmp_path: Path) -> None:
    """0 would be the building, and its class would be lost."""
    nodes = {"a": {"class": "chair"}, "b": {"class": "bed", "instance": 1}, "c": {"class": "background"}}
    path = tmp_path / "home.semantics.json"
    path.write_text(json.dumps({"format": "autonerf-lab semantics", "version": 1, "nodes": nodes}))
    found = read_semantics(path)
    assert [found.nodes[name][1] for name in "abc"] == [2, 1, 0] and found.names[2] == "a"


def test_semantics_per_face_of_a_mesh_with_one_node(tmp_path: Path) -> None:
    room().export(tmp_path / "room.ply")
    semantics = tmp_path / "room.semantics.json"
    header = {"format": "autonerf-lab semantics", "version": 1}
    faces = {"class": [4] * 2 + [0] * 10, "instance": [7] * 2 + [0] * 10, "names": {"7": "bunk"}}
    semantics.write_text(json.dumps({**header, "faces": faces}))
    scene = import_scene(tmp_path / "room.ply", up="y")
    assert scene.face_class.tolist() == [4] * 2 + [0] * 10
    assert [(i.id, i.class_id, i.name) for i in scene.instances] == [(7, 4, "bunk")]
    for change, message in [
        ({"faces": {**faces, "class": [4]}}, "1 classes and 12 instances; room.ply has 12 triangles"),
        ({"faces": {**faces, "class": [16] * 12}}, "integers from 0 to 15"),
        ({"faces": {**faces, "names": {"x": 1}}}, "names"),
        ({"nodes": {"bed": {"class": "spaceship"}}}, "node 'bed' has no valid class"),
        ({"nodes": {"bed": {"class": "bed", "instance": -1}}}, "needs an instance"),
        ({"nodes": []}, "'nodes'"),
        ({"version": 2}, "version 1"),
    ]:
        semantics.write_text(json.dumps({**header, **change}))
        with pytest.raises(SceneError, match=message) as caught:
            import_scene(tmp_path / "room.ply", up="y")
        assert "room.semantics.json" in str(caught.value)
    semantics.write_text("{")
    with pytest.raises(SceneError, match=r"room\.semantics\.json is not readable"):
        import_scene(tmp_path / "room.ply", up="y")


def test_a_face_with_a_vertex_of_another_mesh_is_refused(tmp_path: Path) -> None:
    """Two meshes in one file; an index of the first is one too large and would read a vertex of the second."""
    both = trimesh.Scene([room(), room()])
    data = bytearray(trimesh.exchange.gltf.export_glb(both))
    length = struct.unpack("<I", data[12:16])[0]
    document = json.loads(data[20 : 20 + length])
    index = document["accessors"][document["meshes"][0]["primitives"][0]["indices"]]
    start = 28 + length + document["bufferViews"][index["bufferView"]]["byteOffset"]
    assert index["componentType"] == 5125
    data[start : start + 4] = struct.pack("<I", 8)
    (tmp_path / "two.glb").write_bytes(data)
    with pytest.raises(SceneError, match=r"two\.glb.* vertex that does not exist"):
        import_scene(tmp_path / "two.glb")


@pytest.mark.parametrize("document", [[], 1, {"accessors": [1]}, {"accessors": [{"count": float("inf")}]}])
def test_glb_with_unexpected_json_is_a_scene_error(tmp_path: Path, document: object) -> None:
    text = json.dumps(document).encode().ljust(64)
    (tmp_path / "odd.glb").write_bytes(struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text), len(text), b"JSON") + text)
    with pytest.raises(SceneError, match=r"odd\.glb"):
        import_scene(tmp_path / "odd.glb")


@pytest.mark.parametrize("semantic", [False, True])
def test_exported_glb_is_valid(tmp_path: Path, semantic: bool) -> None:
    """First checks of the Khronos validator: lengths, alignment, targets, bounds and index ranges."""
    scene = generate_apartment(11)
    data = export_glb(scene, tmp_path / "home.glb", semantic=semantic).read_bytes()
    total, length = struct.unpack("<I", data[8:12])[0], struct.unpack("<I", data[12:16])[0]
    assert total == len(data) and length % 4 == 0
    document, blob = json.loads(data[20 : 20 + length]), data[28 + length :]
    assert document["buffers"] == [{"byteLength": len(blob)}] and len(blob) % 4 == 0
    end = 0
    for view in document["bufferViews"]:
        assert view["byteOffset"] % 4 == 0 and view["byteOffset"] >= end  # no overlap
        end = view["byteOffset"] + view["byteLength"]
    assert end <= len(blob)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for mesh in document["meshes"]:
        (primitive,) = mesh["primitives"]
        assert ("TEXCOORD_0" in primitive["attributes"]) is not semantic
        accessors = [document["accessors"][a] for a in primitive["attributes"].values()]
        assert {document["bufferViews"][a["bufferView"]]["target"] for a in accessors} == {34962}
        assert len({a["count"] for a in accessors}) == 1
        indices = document["accessors"][primitive["indices"]]
        view = document["bufferViews"][indices["bufferView"]]
        used = np.frombuffer(blob, "<u4", indices["count"], view["byteOffset"])
        assert view["target"] == 34963 and used.max() == accessors[0]["count"] - 1 and len(used) % 3 == 0
        position = document["accessors"][primitive["attributes"]["POSITION"]]
        offset = document["bufferViews"][position["bufferView"]]["byteOffset"]
        points = np.frombuffer(blob, "<f4", 3 * position["count"], offset).reshape(-1, 3)
        assert np.isfinite(points).all()
        assert np.array_equal(points.min(axis=0), np.float32(position["min"]))
        assert np.array_equal(points.max(axis=0), np.float32(position["max"]))
        low, high = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))
    assert np.allclose(high - low, np.ptp(scene.bounds, axis=0)[[0, 2, 1]], atol=1e-5)  # y is up
    assert len({node["name"] for node in document["nodes"]}) == len(document["nodes"])


def test_page_is_self_contained(tmp_path: Path) -> None:
    scene = generate_apartment(11)
    text = write_page(scene, tmp_path / "home.html").read_text()
    assert len(text) < 8e6 and "THREE" in text and "chair" in text
    assert not re.findall(r"<(?:script|img|link)[^>]*(?:src|href)=", text)  # no external resources
    assert not [u for u in re.findall(r"fetch\(.{0,40}", text) if "http" in u]
    assert "/*" + "CORNERS" not in text and "/*" + "FACTS" not in text


@pytest.mark.filterwarnings("ignore:.*no object has a name:UserWarning")
def test_page_escapes_names(tmp_path: Path) -> None:
    room().export(tmp_path / "room.ply")
    scene = replace(import_scene(tmp_path / "room.ply", up="y"), name="</script><img src=x onerror=alert(1)>")
    text = write_page(scene, tmp_path / "room.html").read_text()
    assert "<img src=x" not in text and "\\u003cimg src=x" in text


def room() -> trimesh.Trimesh:
    """An empty room of 4 x 3 x 2.5 m, y up, with vertex colours."""
    mesh = trimesh.creation.box((4, 2.5, 3))
    mesh.visual.vertex_colors = np.array([[200, 40 * k % 256, 90, 255] for k in range(8)], dtype=np.uint8)
    return mesh


@pytest.mark.filterwarnings("ignore:.*no object has a name:UserWarning")
@pytest.mark.parametrize("suffix", ["glb", "obj", "ply"])
def test_vertex_coloured_room_is_imported(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"room.{suffix}"
    room().export(path)
    scene = import_scene(path, up="y")
    assert np.allclose(np.ptp(scene.bounds, axis=0), (4, 3, 2.5), atol=1e-5)
    assert abs(scene.bounds[0, 2]) < 1e-6
    assert (scene.face_class == 0).all()
    # the texture at the uv of a corner is the vertex colour
    uv = scene.uv[0, 0]
    texel = scene.texture[int(uv[1] * scene.texture.shape[0]), int(uv[0] * scene.texture.shape[1])]
    assert abs(int(texel[0]) - 200) <= 1 and abs(int(texel[2]) - 90) <= 1


def broken(tmp_path: Path, kind: str) -> Path:
    path = tmp_path / f"{kind}.ply"
    mesh = room()
    if kind == "nan":
        mesh.vertices[3, 1] = np.nan
    elif kind == "millimetres":
        mesh.apply_scale(1000)
    elif kind == "tiny":
        mesh.apply_scale(0.001)
    elif kind == "points":
        mesh = trimesh.PointCloud(mesh.vertices)
    elif kind == "wall":
        mesh = trimesh.Trimesh([[0, 0, 0], [4, 0, 0], [4, 0, 3], [0, 0, 3]], [[0, 1, 2], [0, 2, 3]], process=False)
    mesh.export(path)
    if kind == "cut":
        path.write_bytes(path.read_bytes()[:-60])
    return path


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("nan", "not finite"),
        ("millimetres", "check the unit"),
        ("tiny", "check the unit"),
        ("points", "no triangles"),
        ("wall", "measures|no floor"),
        ("cut", "cannot be read|no triangles|does not exist"),
    ],
)
def test_invalid_meshes_are_refused(tmp_path: Path, kind: str, message: str) -> None:
    with pytest.raises(SceneError, match=message) as caught:
        import_scene(broken(tmp_path, kind))
    assert f"{kind}.ply" in str(caught.value)


def glb(document: dict) -> bytes:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    return struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text), len(text), b"JSON") + text


@pytest.mark.parametrize("uri", ["../secret.bin", "http://example.org/a.bin", "/etc/passwd", "other.bin"])
def test_glb_with_external_references_is_refused(tmp_path: Path, uri: str) -> None:
    path = tmp_path / "far.glb"
    path.write_bytes(glb({"asset": {"version": "2.0"}, "buffers": [{"uri": uri, "byteLength": 4}]}))
    with pytest.raises(SceneError, match="refers to"):
        import_scene(path)


def test_obj_that_refers_outside_its_folder_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "far.obj"
    path.write_text("mtllib ../../secret.mtl\nv 0 0 0\nv 4 0 0\nv 4 0 3\nf 1 2 3\n")
    with pytest.raises(SceneError, match="refers to"):
        import_scene(path)


@pytest.mark.parametrize("content", [b"", b"glTF", b"\0" * 100, glb({"accessors": [{"count": 3_000_000_000}]})])
def test_damaged_glb_is_a_scene_error(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "bad.glb"
    path.write_bytes(content)
    with pytest.raises(SceneError, match=r"bad\.glb"):
        import_scene(path)


def test_other_formats_and_missing_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="only"):
        import_scene(tmp_path / "scene.fbx")
    with pytest.raises(SceneError, match="does not exist"):
        import_scene(tmp_path / "missing.glb")


def test_export_to_an_invalid_path_is_a_data_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="cannot write"):
        export_glb(generate_apartment(11), tmp_path / "file" / "home.glb", semantic=True)
