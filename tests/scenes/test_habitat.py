"""Scenes of Habitat datasets: composites, frames, units, semantics of HM3D and Matterport3D, and what is refused."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from toy_habitat import CHAIR_SIZE, block, make_dataset, room, write_glb, write_json

import autonerf_lab as lab
from autonerf_lab.errors import SceneError
from autonerf_lab.pipeline.context import find_scene
from autonerf_lab.scenes import Scene, import_scene
from autonerf_lab.scenes.class_aliases import class_of

pytestmark = pytest.mark.filterwarnings("ignore:.*no object has a name:UserWarning")  # rooms alone


def boxes(scene: Scene) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return lowest corner and size of each object in the frame of the file, z up."""
    assert scene.import_report is not None
    return {i.name: (i.center - i.size / 2 + scene.import_report.offset, i.size) for i in scene.instances}


def edit(path: Path, change: Callable[[Any], None]) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def test_a_composite_is_placed_in_habitats_frame(tmp_path: Path) -> None:
    path = make_dataset(tmp_path)
    scene = import_scene(path)
    assert scene.name == "home" and np.allclose(np.ptp(scene.bounds, axis=0), (6, 5, 2.5), atol=1e-5)
    found = boxes(scene)
    low, size = found["armchair"]
    # The quarter turn about y swaps the extent along x and z; Habitat's z is minus y here
    assert np.allclose(size, (CHAIR_SIZE[2], CHAIR_SIZE[0], CHAIR_SIZE[1]), atol=1e-5)
    assert np.allclose(low, (2 - 0.25, 3 - 0.2, 0), atol=1e-5)
    low, size = found["frl cabinet"]
    assert np.allclose(low, (4, 1 - 0.25, 0), atol=1e-5) and np.allclose(size, (0.5, 0.25, 1.0), atol=1e-5)
    report = scene.import_report
    assert report is not None and report.classes == {"chair": 1} and report.unknown == {"frl cabinet": 1}
    assert report.left_out == {"articulated objects (URDF)": 1} and not report.warnings
    assert abs(report.floor_area - 30) < 0.01 and report.floors == (0.0,) and abs(report.ceiling - 2.5) < 0.01
    assert "1 chair" in str(report) and "default of Habitat for a .glb stage" in str(report)
    assert lab.Simulator(scene, rgb=False).navigation.area > 20


def test_a_dataset_of_one_scene_and_a_stage_can_be_imported(tmp_path: Path) -> None:
    path = make_dataset(tmp_path)
    scenes = [find_scene(str(p)) for p in (path, tmp_path / "toy.scene_dataset_config.json")]
    assert scenes[0].sha256 == scenes[1].sha256
    stage = import_scene(tmp_path / "configs/stages/room.stage_config.json")
    assert not stage.instances and np.allclose(stage.bounds, scenes[0].bounds)
    write_json(path.with_name("second.scene_instance.json"), {"stage_instance": {"template_name": "room"}})
    with pytest.raises(SceneError, match=r"dataset of 2 scenes; .*: home, second"):
        import_scene(tmp_path / "toy.scene_dataset_config.json")


def test_a_translation_may_be_that_of_the_centre_of_mass(tmp_path: Path) -> None:
    path = make_dataset(tmp_path)
    edit(path, lambda content: content.update(translation_origin="com"))
    low, size = boxes(import_scene(path))["armchair"]
    assert np.allclose(low + size / 2, (2, 3, 0), atol=1e-5)  # centre of the box, below the floor by half
    edit(tmp_path / "configs/objects/8d3f.object_config.json", lambda content: content.update(COM=[0, 0.1, 0]))
    low, size = boxes(import_scene(path))["armchair"]
    assert np.allclose(low, (2 - 0.25, 3 - 0.2, -0.1), atol=1e-5)


def test_a_configuration_may_be_derived_in_the_dataset(tmp_path: Path) -> None:
    path = make_dataset(tmp_path)
    derived = {"template_handle": "big", "original_file": "configs/stages/room.stage_config.json"}
    edit(
        tmp_path / "toy.scene_dataset_config.json",
        lambda content: content["stages"].update(configs=[derived | {"attributes": {"scale": [2, 2, 1]}}]),
    )
    edit(path, lambda content: content["stage_instance"].update(template_name="big"))
    assert np.allclose(np.ptp(import_scene(path).bounds, axis=0), (12, 10, 2.5), atol=1e-5)


def test_a_template_may_be_named_by_a_part_of_its_name(tmp_path: Path) -> None:
    """A part of a name selects the first template in alphabetical order that contains it, as in habitat-sim."""
    path = make_dataset(tmp_path)
    whole = import_scene(path)
    edit(path, lambda content: content["object_instances"][1].update(template_name="CABINET"))
    assert np.allclose(import_scene(path).bounds, whole.bounds)
    derived: list[dict[str, Any]] = [
        {"template_handle": f"room_{name}", "original_file": "configs/stages/room.stage_config.json"} for name in "ba"
    ]
    derived[0]["attributes"] = {"scale": [3, 3, 1]}
    edit(tmp_path / "toy.scene_dataset_config.json", lambda content: content["stages"].update(configs=derived))
    edit(path, lambda content: content["stage_instance"].update(template_name="oom_"))
    assert np.allclose(import_scene(path).bounds, whole.bounds)


def test_up_and_front_of_a_stage(tmp_path: Path) -> None:
    """A room with z up under a configuration that calls -z up: the ceiling becomes the floor."""
    write_glb(tmp_path / "room.glb", room(), block((1, 1, 1), (1, 1, 0), (9, 9, 9)))
    write_json(tmp_path / "a.stage_config.json", {"render_asset": "room.glb", "up": [0, 0, 1], "front": [1, 0, 0]})
    scene = import_scene(tmp_path / "a.stage_config.json")
    assert np.allclose(np.ptp(scene.bounds, axis=0), (5, 6, 2.5), atol=1e-5)  # front, x of the file, is -z: y here
    report = scene.import_report
    assert report is not None and "'up' of" in report.up


SCENE, CHAIR = "configs/scenes/home.scene_instance.json", "configs/objects/8d3f.object_config.json"


@pytest.mark.parametrize(
    ("file", "change", "message"),
    [
        (SCENE, {"template_name": "gone"}, r"stage_instance: 'gone' is not among"),
        (SCENE, {"rotation": [1, 1, 0, 0]}, r"stage_instance: 'rotation' must be a"),
        (SCENE, {"uniform_scale": -1}, r"stage_instance: 'uniform_scale' .*mirrored"),
        (SCENE, {"translation": [1e9, 0, 0]}, r"'translation' must have numbers"),
        (SCENE, {"translation": "x"}, r"Expected `array`"),
        (CHAIR, {"scale": [1, -1, 1]}, r"object_instances\[0\]: 'scale' .*mirrored"),
        (CHAIR, {"units_to_meters": 0.01}, r"differ in 'units_to_meters': 1 .*0\.01"),
        (CHAIR, {"render_asset": "gone.glb"}, r"object_instances\[0\]: 'render_asset'"),
        (CHAIR, {"render_asset": "x" * 5000}, r"object_instances\[0\]: 'render_asset' 'x+' does not exist"),
        (CHAIR, {"render_asset": "../../../a.glb"}, r"is outside"),
        (CHAIR, {"render_asset": "8d3f.object_config.json"}, r"object_instances\[0\]: 'render_asset' .*is not a mesh"),
        (CHAIR, {"render_asset": "../scenes/home.scene_instance.json"}, r"\[0\]: 'render_asset' .*is not a mesh"),
        (SCENE, {"template_name": "home.scene_instance.json"}, r"stage_instance: 'home\.scene_instance\.json' is not"),
        (CHAIR, {"up": [0, 1, 0], "front": [0, 1, 0]}, r"must be orthogonal"),
        ("configs/stages/room.stage_config.json", {"render_asset": None}, r"room\.stage_config\.json is not as"),
        ("toy.scene_dataset_config.json", {"paths": {".json": ["../.."]}}, r"'paths': '\.\./\.\.' is outside"),
        ("toy.scene_dataset_config.json", {"paths": {".json": ["x" * 5000]}}, r"'paths': 'x{80}' is not a"),
    ],
)  # fmt: skip
def test_damaged_composites_are_refused(tmp_path: Path, file: str, change: dict[str, Any], message: str) -> None:
    path = make_dataset(tmp_path / "toy")
    keys = {"home.scene_instance.json": "stage_instance", "toy.scene_dataset_config.json": "stages"}
    key = keys.get(Path(file).name)
    edit(tmp_path / "toy" / file, lambda content: (content[key] if key else content).update(change))
    with pytest.raises(SceneError, match=message):
        import_scene(path)


def test_the_axis_that_points_up_is_found(tmp_path: Path) -> None:
    scene = import_scene(write_glb(tmp_path / "z.glb", room()))
    assert np.allclose(np.ptp(scene.bounds, axis=0), (6, 5, 2.5), atol=1e-5)
    assert scene.import_report is not None and scene.import_report.up.startswith("z, although .glb files have y up")
    upright = room()
    upright.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))
    again = import_scene(write_glb(tmp_path / "y.glb", upright))
    assert np.allclose(again.bounds, scene.bounds, atol=1e-5)
    assert again.import_report is not None and again.import_report.up.startswith("y, as .glb files have it")
    forced = import_scene(tmp_path / "z.glb", up="y")
    assert np.allclose(np.ptp(forced.bounds, axis=0), (6, 2.5, 5), atol=1e-5)


def test_a_stage_with_negative_units_is_refused(tmp_path: Path) -> None:
    make_dataset(tmp_path)
    path = tmp_path / "configs/stages/room.stage_config.json"
    edit(path, lambda content: content.update(units_to_meters=-1))
    with pytest.raises(SceneError, match=r"room\.stage_config\.json: 'units_to_meters' .*mirrored"):
        import_scene(path)


@pytest.mark.filterwarnings("default:.*no object has a name")
def test_a_scene_in_which_nothing_is_named_is_a_warning(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="no object has a name: all surfaces are background"):
        scene = import_scene(write_glb(tmp_path / "room.glb", room()))
    assert "warning:     no object has a name" in str(scene.import_report)


def change_json(path: Path, change: Callable[[Any], None]) -> None:
    """Change the JSON chunk of a GLB file."""
    data = path.read_bytes()
    length = int.from_bytes(data[12:16], "little")
    content = json.loads(data[20 : 20 + length])
    change(content)
    head = json.dumps(content).encode()
    path.write_bytes(data[:12] + len(head).to_bytes(4, "little") + data[16:20] + head + data[20 + length :])


def test_nodes_that_are_no_trees_are_refused(tmp_path: Path) -> None:
    meshes = room(), block((1, 1, 1), (1, 1, 0), (9, 9, 9)), block((1, 1, 1), (3, 1, 0), (9, 9, 9))

    def children(**of: list[int]) -> Callable[[Any], None]:
        def change(content: Any) -> None:
            for name, nodes in of.items():
                content["nodes"][int(name[1:])]["children"] = nodes

        return change

    for change, message in (
        (children(n1=[2], n2=[1]), "node [12] is its own ancestor"),
        (children(n2=[2]), "node 2 is its own ancestor"),
        (children(n0=[2], n1=[2]), "node 2 is a child of nodes 0 and 1"),
    ):
        change_json(write_glb(tmp_path / "a.glb", *meshes), change)
        with pytest.raises(SceneError, match=rf"a\.glb .*{message}"):
            import_scene(tmp_path / "a.glb")


def test_an_implausible_unit_is_a_warning(tmp_path: Path) -> None:
    small = room()
    small.apply_scale(0.25)
    with pytest.warns(UserWarning) as caught:
        scene = import_scene(write_glb(tmp_path / "small.glb", small))
    texts = [str(warning.message) for warning in caught]
    assert any("floor has only 1.9 m2" in text for text in texts) and any("only 0.62 m above" in text for text in texts)
    assert scene.import_report is not None and str(scene.import_report).count("warning:") == 3


def annotated(folder: Path) -> Path:
    """Write a room of HM3D with a sofa, a picture and a wall, and return the path of its mesh."""
    sofa, picture = block((2, 1, 0.8), (1, 1, 0), (90, 90, 90)), block((1, 0.02, 1), (3, 4.9, 1), (90, 90, 90))
    path = write_glb(folder / "00800-abc.basis.glb", room(), sofa, picture)
    colors = [(1, 2, 3), (255, 0, 0), (0, 255, 16)]
    write_glb(
        folder / "00800-abc.semantic.glb",
        *(
            trimesh.Trimesh(m.vertices, m.faces, vertex_colors=np.tile([*c, 255], (8, 1)), process=False)
            for m, c in zip((room(), sofa, picture), colors, strict=True)
        ),
    )
    lines = ["HM3D Semantic Annotations", '1,010203,"wall",0', '7,FF0000,"sofa, long",0', '9,00FF10,"picture",-1', ""]
    (folder / "00800-abc.semantic.txt").write_text("\n".join(lines))
    return path


def test_hm3d_semantics(tmp_path: Path) -> None:
    path = annotated(tmp_path)
    scene = import_scene(path, aliases={"sofa, long": "couch"})
    assert sorted((i.name, i.class_id) for i in scene.instances) == [("picture", 0), ("sofa, long", 2)]
    sofa = next(i for i in scene.instances if i.class_id == 2)
    assert np.allclose(sofa.size, (2, 1, 0.8), atol=1e-5)
    assert scene.import_report is not None and scene.import_report.unknown == {"picture": 1}
    painted = import_scene(tmp_path / "00800-abc.semantic.glb", aliases={"sofa, long": "couch"})
    assert np.array_equal(painted.face_class, scene.face_class)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('1,0102,"wall",0', r"semantic\.txt: line 2 must be id,HEXCOLOUR"),
        ('3,FF0000,"bed",0', r"line 3 has the colour FF0000 of object 3"),
    ],
)
def test_damaged_annotations_are_refused(tmp_path: Path, line: str, message: str) -> None:
    path = annotated(tmp_path)
    text = tmp_path / "00800-abc.semantic.txt"
    text.write_text(text.read_text().replace('1,010203,"wall",0', line))
    with pytest.raises(SceneError, match=message):
        import_scene(path)
    (tmp_path / "00800-abc.semantic.glb").unlink()
    text.write_text('HM3D Semantic Annotations\n1,010203,"wall",0\n')
    with pytest.raises(SceneError, match=r"needs the mesh 00800-abc\.semantic\.glb"):
        import_scene(path)


HOUSE = """ASCII 1.1
H home label 0 0 0 0 0 3 3 1 0 1  0 0 0 0 0  0 0 0 6 5 2.5  0 0 0 0 0
C 0 1 wall 1 wall 0 0 0 0 0
C 1 156 coffee#table 5 table 0 0 0 0 0
C 2 28 sofa 10 sofa 0 0 0 0 0
O 0 0 0  0 0 0  1 0 0  0 1 0  1 1 1  0 0 0 0 0 0 0 0
O 1 0 2  0 0 0  1 0 0  0 1 0  1 1 1  0 0 0 0 0 0 0 0
O 2 0 1  0 0 0  1 0 0  0 1 0  1 1 1  0 0 0 0 0 0 0 0
O 3 0 -1  0 0 0  1 0 0  0 1 0  1 1 1  0 0 0 0 0 0 0 0
"""


def matterport(folder: Path) -> Path:
    """Write a room of Matterport3D with a sofa, a coffee table and a box of no category; return its path."""
    low = {1: (1, 1, 0), 2: (4, 1, 0), 3: (4, 3, 0)}
    meshes = [room(), *(block((1, 0.8, 0.6), at, (90, 90, 90)) for at in low.values())]
    path = write_glb(folder / "17DRP5sb8fy.glb", *meshes)
    (folder / "17DRP5sb8fy.house").write_text(HOUSE)
    joined = trimesh.util.concatenate(meshes)
    lines = ["ply", "format ascii 1.0", f"element vertex {len(joined.vertices)}"]
    lines += [f"property float {axis}" for axis in "xyz"] + [f"element face {len(joined.faces)}"]
    lines += ["property list uchar int vertex_indices", "property int object_id", "end_header"]
    lines += [" ".join(map(str, vertex)) for vertex in joined.vertices.tolist()]
    lines += [f"3 {a} {b} {c} {k // 12}" for k, (a, b, c) in enumerate(joined.faces.tolist())]  # 12 triangles each
    (folder / "17DRP5sb8fy_semantic.ply").write_text("\n".join(lines) + "\n")
    return path


def test_matterport_semantics(tmp_path: Path) -> None:
    path = matterport(tmp_path)
    scene = import_scene(path)
    assert sorted((i.name, i.class_id) for i in scene.instances) == [("coffee table", 0), ("sofa", 2)]
    sofa = next(i for i in scene.instances if i.class_id == 2)
    assert np.allclose(sofa.size, (1, 0.8, 0.6), atol=1e-5) and (scene.face_instance == 0).sum() == 24
    painted = import_scene(tmp_path / "17DRP5sb8fy_semantic.ply")
    assert sorted((i.name, *i.center.round(5)) for i in painted.instances) == sorted(
        (i.name, *i.center.round(5)) for i in scene.instances
    )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("ASCII 1.1", "ASCII 1.0", r"8fy\.house must begin with the line 'ASCII 1\.1'"),
        ("O 1 0 2 ", "O 1 0 x ", r"house: line 7 is damaged: 'O 1 0 x"),
        ("O 1 0 2 ", "O 1 0 9 ", r"house: line 7 has the category 9, which does not exist"),
        ("C 0 1 wall 1", "C 0 \nC 8 1 wall 1", r"house: line 3 is damaged"),
    ],
)
def test_damaged_houses_are_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = matterport(tmp_path)
    (tmp_path / "17DRP5sb8fy.house").write_text(HOUSE.replace(old, new))
    with pytest.raises(SceneError, match=message):
        import_scene(path)


def test_a_house_needs_the_objects_of_its_triangles(tmp_path: Path) -> None:
    path = matterport(tmp_path)
    mesh = tmp_path / "17DRP5sb8fy_semantic.ply"
    mesh.write_text(mesh.read_text().replace("object_id", "segment_id"))
    with pytest.raises(SceneError, match=r"8fy_semantic\.ply has no property 'object_id'"):
        import_scene(path)
    mesh.unlink()
    with pytest.raises(SceneError, match=r"8fy\.house needs the mesh 17DRP5sb8fy_semantic\.ply beside it"):
        import_scene(path)


@pytest.mark.parametrize("extension", ["KHR_texture_basisu", "KHR_draco_mesh_compression"])
def test_compressed_files_are_refused_with_the_way_out(tmp_path: Path, extension: str) -> None:
    path = write_glb(tmp_path / "basis.glb", room())
    change_json(path, lambda content: content.update(extensionsUsed=[extension]))
    with pytest.raises(SceneError, match=rf"basis\.glb uses {extension}, which is not supported; .*gltf-transform"):
        import_scene(path)


def test_names_of_nodes_are_translated(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    scene.add_geometry(room(), node_name="walls")
    scene.add_geometry(block((2, 1, 0.8), (1, 1, 0), (9, 9, 9)), node_name="Sofa.001")
    scene.add_geometry(block((1, 1, 1), (4, 3, 0), (9, 9, 9)), node_name="piano")
    (tmp_path / "home.glb").write_bytes(trimesh.exchange.gltf.export_glb(scene))
    imported = import_scene(tmp_path / "home.glb")
    assert [i.class_id for i in imported.instances] == [2]
    assert imported.import_report is not None and "piano" in imported.import_report.unknown
    write_json(tmp_path / "names.json", {"Piano": "dining table"})
    assert {i.class_id for i in import_scene(tmp_path / "home.glb", aliases=tmp_path / "names.json").instances} == {
        2,
        7,
    }
    write_json(tmp_path / "names.json", {"piano": "instrument"})
    with pytest.raises(SceneError, match=r"names\.json: 'piano' stands for 'instrument', which is no class"):
        import_scene(tmp_path / "home.glb", aliases=tmp_path / "names.json")


@pytest.mark.parametrize(
    ("name", "expected"),
    [("sofa", 2), ("TVStand_3", 0), ("tv", 6), ("coffee table", 0), ("kitchen table", 7), ("Fridge|+01.2", 0),
     ("side by side refrigerator", 10), ("toilet paper", 0), ("DiningTable", 7), ("", 0)],
)  # fmt: skip
def test_aliases(name: str, expected: int) -> None:
    assert class_of(name) == expected
