"""Scenes in files: frozen ones, damaged ones, and those that other programs write."""

import json
import re
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

import autonerf_lab as lab
from autonerf_lab.errors import DataError, SceneError, UnknownNameError
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.scenes import generate_apartment, import_scene, load_scene, scene_names
from autonerf_lab.scenes.library import folder
from autonerf_lab.scenes.spec import dumps, read_spec


def test_unknown_name_lists_the_valid_ones() -> None:
    with pytest.raises(UnknownNameError, match=r"unknown scene 'val-7'; valid names: dev-0, .*val-4"):
        load_scene("val-7")
    with pytest.raises(UnknownNameError, match="unknown split"):
        scene_names("test")


def test_written_and_read_again(tmp_path: Path) -> None:
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
        (lambda s: s["objects"][1]["parts"].append({"box": [1, -1, 1], "m": "metal"}), "size"),
        (lambda s: s["materials"]["metal"].update(kind="antimatter"), "kind"),
        (lambda s: s["lights"][0].update(power="bright"), "power"),
    ],
)
def test_wrong_specification_says_what_is_wrong(tmp_path: Path, change, message: str) -> None:  # type: ignore[no-untyped-def]
    spec = read_spec(folder() / "dev-0.json")
    change(spec)
    path = tmp_path / "wrong.json"
    path.write_text(json.dumps(spec))
    with pytest.raises(SceneError, match=message) as caught:
        load_scene(str(path))
    assert "wrong.json" in str(caught.value)


def test_glb_round_trip(tmp_path: Path) -> None:
    scene = generate_apartment(11)
    back = import_scene(scene.export_glb(tmp_path / "home.glb"))
    assert len(back.faces) == len(scene.faces)
    assert np.array_equal(np.bincount(back.face_class), np.bincount(scene.face_class))
    assert np.allclose(np.ptp(back.bounds, axis=0), np.ptp(scene.bounds, axis=0), atol=1e-4)
    assert abs(back.bounds[0, 2]) < 1e-3
    first, _ = scene.top_view(15)
    second, _ = back.top_view(15)
    rows, cols = min(first.shape[0], second.shape[0]), min(first.shape[1], second.shape[1])
    assert np.abs(first[:rows, :cols].astype(int) - second[:rows, :cols]).mean() < 3


def test_glb_is_upright_and_semantic_colours_are_the_classes(tmp_path: Path) -> None:
    scene = generate_apartment(11)
    loaded = trimesh.load_scene(scene.export_glb(tmp_path / "classes.glb", semantic=True))
    size = np.ptp(loaded.bounds, axis=0)
    height = np.ptp(scene.bounds, axis=0)[2]
    assert np.isclose(size[1], height, atol=1e-3)  # y is up in a GLB
    assert any(node.startswith("toilet_") for node in loaded.graph.nodes_geometry)


def test_semantics_travel_beside_the_mesh(tmp_path: Path) -> None:
    """Exported and imported again: the same class, object and name for the same triangles."""
    scene = generate_apartment(11)
    back = import_scene(scene.export_glb(tmp_path / "home.glb"))
    # the file holds an object after the other, each with its triangles as they were
    order, read = (np.argsort(s.face_instance, kind="stable") for s in (scene, back))
    assert np.array_equal(back.face_instance[read], scene.face_instance[order])
    assert np.array_equal(back.face_class[read], scene.face_class[order])
    assert {i.id: i.name for i in back.instances} == {i.id: i.name for i in scene.instances}
    shift = back.vertices[back.faces[read]] - scene.vertices[scene.faces[order]]
    assert np.abs(shift - shift[0, 0]).max() < 1e-4  # it only moved, to the middle


def test_a_mesh_of_one_node_names_its_faces(tmp_path: Path) -> None:
    room().export(tmp_path / "room.ply")
    sidecar = tmp_path / "room.semantics.json"
    said = {"format": "autonerf-lab semantics", "version": 1}
    faces = {"class": [4] * 2 + [0] * 10, "instance": [7] * 2 + [0] * 10, "names": {"7": "bunk"}}
    sidecar.write_text(json.dumps({**said, "faces": faces}))
    scene = import_scene(tmp_path / "room.ply", up="y")
    assert scene.face_class.tolist() == [4] * 2 + [0] * 10
    assert [(i.id, i.class_id, i.name) for i in scene.instances] == [(7, 4, "bunk")]
    for change, message in [
        ({"faces": {**faces, "class": [4]}}, "1 classes and 12 instances; room.ply has 12 triangles"),
        ({"faces": {**faces, "class": [16] * 12}}, "whole numbers from 0 to 15"),
        ({"faces": {**faces, "names": {"x": 1}}}, "names"),
        ({"nodes": {"bed": {"class": "spaceship"}}}, "node 'bed' has no class"),
        ({"nodes": {"bed": {"class": "bed", "instance": -1}}}, "bad instance"),
        ({"nodes": []}, "'nodes'"),
        ({"version": 2}, "version 1"),
    ]:
        sidecar.write_text(json.dumps({**said, **change}))
        with pytest.raises(SceneError, match=message) as caught:
            import_scene(tmp_path / "room.ply", up="y")
        assert "room.semantics.json" in str(caught.value)
    sidecar.write_text("{")
    with pytest.raises(SceneError, match=r"room\.semantics\.json is not readable"):
        import_scene(tmp_path / "room.ply", up="y")


def test_a_repeated_picture_is_repeated(tmp_path: Path) -> None:
    """A floor with a picture of four colours, three times across and twice down, as tiles are in most files."""
    colours = np.array([[[250, 0, 0], [0, 250, 0]], [[0, 0, 250], [250, 250, 0]]], dtype=np.uint8)
    floor = trimesh.Trimesh([[0, 0, 0], [6, 0, 0], [6, 4, 0], [0, 4, 0]], [[0, 1, 2], [0, 2, 3]], process=False)
    uv = np.array([[0, 0], [3, 0], [3, 2], [0, 2]], dtype=float)
    picture = Image.fromarray(colours.repeat(8, axis=0).repeat(8, axis=1))
    floor.visual = trimesh.visual.TextureVisuals(
        uv=uv, material=trimesh.visual.material.PBRMaterial(baseColorTexture=picture)
    )
    floor.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))  # y up
    (tmp_path / "floor.glb").write_bytes(trimesh.exchange.gltf.export_glb(trimesh.Scene(floor)))
    scene = import_scene(tmp_path / "floor.glb")
    seen, _ = scene.top_view(10)
    assert seen.shape[:2] == (42, 62)  # with a margin of a pixel
    for row in range(4):
        for column in range(6):
            expected = colours[row % 2, column % 2].astype(int)
            assert np.abs(seen[10 * row + 6, 10 * column + 6] - expected).max() < 25, (row, column)


@pytest.mark.parametrize("suffix", ["glb", "obj", "ply"])
def test_a_scan_with_holes_can_be_explored(tmp_path: Path, suffix: str) -> None:
    """As a scanner would leave it: coloured corners, one triangle in twenty missing, noise under the floor."""
    scene = generate_apartment(11)
    rng = np.random.default_rng(0)
    faces = scene.faces[rng.random(len(scene.faces)) > 0.05]
    colours = rng.integers(40, 220, (len(scene.vertices), 3)).astype(np.uint8)
    mesh = trimesh.Trimesh(scene.vertices, faces, vertex_colors=colours, process=False)
    flakes = trimesh.creation.box((0.05, 0.05, 0.02))
    flakes.visual.vertex_colors = np.full((8, 4), 255, np.uint8)
    flakes.apply_translation([*scene.bounds.mean(axis=0)[:2], -0.6])
    path = tmp_path / f"scan.{suffix}"
    trimesh.util.concatenate([mesh, flakes]).export(path)
    scan = import_scene(path, up="z")
    assert (
        abs(np.ptp(scan.bounds[:, 2]) - np.ptp(scene.bounds[:, 2]) - 0.6) < 0.05 and -0.65 < scan.bounds[0, 2] < -0.55
    )
    walk = lab.explore(lab.Simulator(scan, Intrinsics.from_fov(32, 32), rgb=False), "frontier", 20, progress=False)
    assert walk.meta["explored_m2"][-1] > 5 and not walk.semantics.any()


def textured(path: Path, picture: np.ndarray, quads: list[tuple[tuple[float, ...], tuple[float, ...]]]) -> Path:
    """A GLB of rectangles on the floor: (x0, y0, x1, y1) shows the picture's (u0, v0, u1, v1), v up."""
    ends = [(0, 1), (2, 1), (2, 3), (0, 3)]
    vertices = [[place[i], place[j], 0] for place, _ in quads for i, j in ends]
    uv = np.array([[shown[i], shown[j]] for _, shown in quads for i, j in ends], dtype=float)
    faces = [[4 * k + a, 4 * k + b, 4 * k + c] for k in range(len(quads)) for a, b, c in ((0, 1, 2), (0, 2, 3))]
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.fromarray(picture))
    mesh.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))  # y up
    path.write_bytes(trimesh.exchange.gltf.export_glb(trimesh.Scene(mesh)))
    return path


@pytest.mark.parametrize("offset", [(0, 0), (-3, 5), (0.25, -0.5)])
def test_repeated_looks_like_baked(tmp_path: Path, offset: tuple[float, float]) -> None:
    """A checker four times across and three times down, wherever in the plane of the tiles it begins."""
    u, v = offset
    checker = np.stack([np.indices((32, 32)).sum(0) // 8 % 2 * 200] * 3, axis=-1).astype(np.uint8)
    checker[..., 2] = np.arange(32) * 8
    baked = np.roll(np.tile(checker, (3, 4, 1)), (int(v * 32), -int(u * 32)), axis=(0, 1))
    first = textured(tmp_path / "tiled.glb", checker, [((0, 0, 4, 3), (u, v, u + 4, v + 3))])
    second = textured(tmp_path / "baked.glb", baked, [((0, 0, 4, 3), (0, 0, 1, 1))])
    pictures = [import_scene(path).top_view(16)[0].astype(int) for path in (first, second)]
    assert np.abs(pictures[0] - pictures[1]).max() <= 2


def test_one_repeating_face_costs_the_others_no_sharpness(tmp_path: Path) -> None:
    picture = np.random.default_rng(0).integers(0, 255, (1024, 1024, 3)).astype(np.uint8)
    quads = [((0.0, 0.0, 4.0, 4.0), (0.0, 0.0, 1.0, 1.0)), ((5.0, 0.0, 6.0, 1.0), (0.0, 0.0, 500.0, 9.0))]
    scene = import_scene(textured(tmp_path / "two.glb", picture, quads))
    assert np.array_equal(scene.texture[:1024, :1024], picture)
    spread = np.ptp(scene.uv[:2].reshape(-1, 2), axis=0) * scene.texture.shape[1::-1]
    assert np.allclose(spread, 1024, atol=1)  # it still has every texel
    assert scene.texture.size < 3 * 2048 * 4096


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_texture_coordinates_are_numbers(tmp_path: Path, value: float) -> None:
    path = textured(tmp_path / "odd.glb", np.zeros((4, 4, 3), np.uint8), [((0, 0, 4, 3), (0, 0, value, 1))])
    with pytest.raises(SceneError, match=r"odd\.glb: a texture coordinate is not a finite number"):
        import_scene(path)


def sheet(x: float, y: float, z: float, down: bool = False) -> trimesh.Trimesh:
    """A horizontal grid of 0.3 m cells from the origin to (x, y)."""
    columns, rows = round(x / 0.3), round(y / 0.3)
    vertices = [[0.3 * i, 0.3 * j, z] for j in range(rows + 1) for i in range(columns + 1)]
    corner = [j * (columns + 1) + i for j in range(rows) for i in range(columns)]
    faces = [f for a in corner for f in ([a, a + 1, a + columns + 2], [a, a + columns + 2, a + columns + 1])]
    return trimesh.Trimesh(vertices, np.array(faces)[:, ::-1] if down else faces, process=False)


def part_of(mesh: trimesh.Trimesh, share: float) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces[np.random.default_rng(0).random(len(mesh.faces)) < share])


def sloped(mesh: trimesh.Trimesh, rise: float) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices + mesh.vertices[:, :1] * [0, 0, rise / 6], mesh.faces)


FLOOR, CEILING = sheet(6, 6, 0), sheet(6, 6, 2.5, down=True)


@pytest.mark.parametrize(
    ("meshes", "tolerance"),
    [
        pytest.param([FLOOR], 1e-6, id="no ceiling"),
        pytest.param([part_of(FLOOR, 0.15), CEILING], 1e-6, id="more ceiling than floor"),
        pytest.param([part_of(FLOOR, 0.15), sheet(4.2, 4.2, 0.75), CEILING], 1e-6, id="more table than floor"),
        pytest.param([FLOOR, CEILING, sheet(2.4, 2.1, -1.2)], 1e-6, id="reflections below"),
        pytest.param([FLOOR, CEILING, sheet(6, 6, -0.2, down=True)], 1e-6, id="underside of the slab"),
        pytest.param([sheet(6, 6, 0, down=True), sheet(6, 6, 2.5)], 1e-6, id="inside out"),
        pytest.param([sloped(sheet(6, 6, -0.1), 0.2), CEILING], 0.05, id="sloped by 20 cm"),
    ],
)
def test_the_floor_is_found(tmp_path: Path, meshes: list[trimesh.Trimesh], tolerance: float) -> None:
    walls = [trimesh.creation.box(bounds=[[x, 0, 0], [x + 0.1, 6, 2.5]]) for x in (0, 5.9)]
    mesh = trimesh.util.concatenate([*meshes, *walls])
    mesh.export(tmp_path / "scan.ply")
    scene = import_scene(tmp_path / "scan.ply")
    assert abs(mesh.bounds[0, 2] - scene.bounds[0, 2]) <= tolerance


def test_a_face_may_not_borrow_from_another_mesh(tmp_path: Path) -> None:
    """Two meshes in one file; the first points one vertex too far, where the second would have one."""
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
def test_json_of_another_shape_is_one_error(tmp_path: Path, document: object) -> None:
    text = json.dumps(document).encode().ljust(64)
    (tmp_path / "odd.glb").write_bytes(struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text), len(text), b"JSON") + text)
    with pytest.raises(SceneError, match=r"odd\.glb"):
        import_scene(tmp_path / "odd.glb")


@pytest.mark.parametrize("semantic", [False, True])
def test_exported_glb_keeps_the_rules_of_the_format(tmp_path: Path, semantic: bool) -> None:
    """What the Khronos validator checks first: lengths, alignment, targets, stated bounds, indices in range."""
    scene = generate_apartment(11)
    data = scene.export_glb(tmp_path / "home.glb", semantic=semantic).read_bytes()
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


def test_a_page_needs_nothing_but_itself(tmp_path: Path) -> None:
    scene = generate_apartment(11)
    text = scene.page(tmp_path / "home.html").read_text()
    assert len(text) < 8e6 and "THREE" in text and "chair" in text
    assert not re.findall(r"<(?:script|img|link)[^>]*(?:src|href)=", text)  # nothing is loaded
    assert not [u for u in re.findall(r"fetch\(.{0,40}", text) if "http" in u]
    assert "/*" + "CORNERS" not in text and "/*" + "FACTS" not in text


def test_a_page_shows_names_and_does_not_run_them(tmp_path: Path) -> None:
    room().export(tmp_path / "room.ply")
    scene = replace(import_scene(tmp_path / "room.ply", up="y"), name="</script><img src=x onerror=alert(1)>")
    text = scene.page(tmp_path / "room.html").read_text()
    assert "<img src=x" not in text and "\\u003cimg src=x" in text


def room() -> trimesh.Trimesh:
    """An empty room of 4 x 3 x 2.5 m, y up, with coloured corners."""
    mesh = trimesh.creation.box((4, 2.5, 3))
    mesh.visual.vertex_colors = np.array([[200, 40 * k % 256, 90, 255] for k in range(8)], dtype=np.uint8)
    return mesh


@pytest.mark.parametrize("suffix", ["glb", "obj", "ply"])
def test_vertex_coloured_room_is_imported(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"room.{suffix}"
    room().export(path)
    scene = import_scene(path, up="y")
    assert np.allclose(np.ptp(scene.bounds, axis=0), (4, 3, 2.5), atol=1e-5)
    assert abs(scene.bounds[0, 2]) < 1e-6
    assert (scene.face_class == 0).all()
    # the texture at a corner's coordinate is the corner's colour
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
def test_bad_meshes_are_refused(tmp_path: Path, kind: str, message: str) -> None:
    with pytest.raises(SceneError, match=message) as caught:
        import_scene(broken(tmp_path, kind))
    assert f"{kind}.ply" in str(caught.value)


def glb(document: dict) -> bytes:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    return struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text), len(text), b"JSON") + text


@pytest.mark.parametrize("uri", ["../secret.bin", "http://example.org/a.bin", "/etc/passwd", "other.bin"])
def test_glb_may_not_point_elsewhere(tmp_path: Path, uri: str) -> None:
    path = tmp_path / "far.glb"
    path.write_bytes(glb({"asset": {"version": "2.0"}, "buffers": [{"uri": uri, "byteLength": 4}]}))
    with pytest.raises(SceneError, match="refers to"):
        import_scene(path)


def test_obj_may_not_leave_its_folder(tmp_path: Path) -> None:
    path = tmp_path / "far.obj"
    path.write_text("mtllib ../../secret.mtl\nv 0 0 0\nv 4 0 0\nv 4 0 3\nf 1 2 3\n")
    with pytest.raises(SceneError, match="refers to"):
        import_scene(path)


@pytest.mark.parametrize("content", [b"", b"glTF", b"\0" * 100, glb({"accessors": [{"count": 3_000_000_000}]})])
def test_damaged_glb_is_one_error(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "bad.glb"
    path.write_bytes(content)
    with pytest.raises(SceneError, match=r"bad\.glb"):
        import_scene(path)


def test_other_formats_and_missing_files(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="only"):
        import_scene(tmp_path / "scene.fbx")
    with pytest.raises(SceneError, match="cannot be read"):
        import_scene(tmp_path / "missing.glb")


def test_export_to_an_impossible_place_is_a_data_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="cannot write"):
        generate_apartment(11).export_glb(tmp_path / "file" / "home.glb", semantic=True)
