"""Mesh extraction and its metrics, and the table of scores."""

import json
import struct

import numpy as np
import pytest
import toy_scene
import trimesh

from autonerf_lab.errors import DataError, UnknownNameError
from autonerf_lab.evaluators import (
    DEFAULT_TASKS,
    METRICS,
    Rendering,
    Scores,
    TrueField,
    evaluate,
    export_mesh,
    extract_mesh,
    oracle_scores,
    semantic_mesh,
)
from autonerf_lab.evaluators.mesh_metrics import evaluate_mesh, nearest_on, sample_surface
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.nerf.field_frame import FieldFrame
from autonerf_lab.types import Score

BOUNDS = np.array([[-0.8, -1, -1.6], [1, 1, 1]])  # 46 x 51 x 66 nodes of 4 cm


class Ball:
    """A solid ball of radius 0.6, red above and green below; class 4; everything seen."""

    poses, intrinsics, meta = np.eye(4)[None], Intrinsics.from_fov(8, 8), {"scene": "toy", "start": None}
    frame, classes = FieldFrame(), 16

    def density(self, points):
        # The opacity of 10 cm rises evenly through the threshold, on the sphere itself: there smoothing changes nothing
        opacity = np.clip(0.6 - 4 * (np.linalg.norm(points, axis=1) - 0.6), 0, 0.999)
        return (-10 * np.log(1 - opacity)).astype(np.float32)

    def seen(self, points):
        return np.ones(len(points), bool)

    def color(self, points, directions=None):
        assert np.all(np.einsum("nd,nd->n", points, directions) < 0), "looked at from outside"
        return np.where(points[:, 2:] > 0, [[1.0, 0, 0]], [[0, 1.0, 0]]).astype(np.float32)

    def semantics(self, points):
        return np.eye(16, dtype=np.float32)[np.full(len(points), 4)]

    def render(self, c2w, intrinsics):
        flat = np.zeros((intrinsics.height, intrinsics.width), np.float32)
        return Rendering(np.zeros((*flat.shape, 3), np.float32), flat, flat.astype(np.uint8), flat)


@pytest.fixture(scope="module")
def ball():
    return extract_mesh(Ball(), voxel=0.04, bounds=BOUNDS)


def test_marching_cubes_finds_the_ball(ball):
    radius = np.linalg.norm(ball.vertices, axis=1)
    assert np.abs(radius - 0.6).max() < 0.01
    assert ball.is_watertight, "blocks are welded"
    assert ball.volume == pytest.approx(4 / 3 * np.pi * 0.6**3, rel=0.02), "and face outwards"
    assert set(ball.vertex_attributes["semantics"]) == {4}


@pytest.mark.parametrize("nodes", [3 * 51 * 66, 12 * 9 * 66, 1])  # cut along x, along x and y, into columns
def test_blocks_do_not_change_the_mesh(ball, monkeypatch, nodes):
    from autonerf_lab.evaluators import mesh

    monkeypatch.setattr(mesh, "_BLOCK_NODES", nodes)
    sliced = extract_mesh(Ball(), voxel=0.04, bounds=BOUNDS)
    assert len(sliced.faces) == len(ball.faces) and len(sliced.vertices) == len(ball.vertices)
    assert sliced.is_watertight


def test_unseen_parts_are_removed():
    class Half(Ball):
        def seen(self, points):
            return points[:, 0] <= 0

    mesh = extract_mesh(Half(), voxel=0.04, bounds=BOUNDS)
    assert mesh.vertices[:, 0].max() <= 1e-6 and not mesh.is_watertight
    # No wall is drawn where sight ends: every vertex lies on the sphere
    assert np.abs(np.linalg.norm(mesh.vertices, axis=1) - 0.6).max() < 0.01


@pytest.mark.parametrize(("width", "closed"), [(2, True), (3, False)])
def test_gaps_of_at_most_two_nodes_in_the_seen_space_are_closed(width, closed):
    class Slit(Ball):
        """Unseen between two planes, with ``width`` nodes of the grid between them."""

        def seen(self, points):
            return (points[:, 0] < 0.1) | (points[:, 0] > 0.1 + 0.04 * width)

    assert extract_mesh(Slit(), voxel=0.04, bounds=BOUNDS).is_watertight == closed


def test_the_last_layer_of_cubes_is_kept_if_it_was_seen():
    class End(Ball):
        def seen(self, points):
            return points[:, 0] > 0.43

    bounds = np.array([BOUNDS[0], [0.48, 1, 1]])  # the last layer is between 0.44 and 0.48
    meshes = (extract_mesh(field, voxel=0.04, bounds=bounds, min_triangles=1) for field in (Ball(), End()))
    everything, end = ((mesh.triangles_center[:, 0] > 0.44).sum() for mesh in meshes)
    assert end == everything > 0


def test_a_surface_has_no_holes_where_sight_ends_at_it():
    class Outside(Ball):
        def seen(self, points):
            return np.linalg.norm(points, axis=1) >= 0.59

    class Inside(Ball):
        def seen(self, points):
            return np.linalg.norm(points, axis=1) <= 0.55

    assert extract_mesh(Outside(), voxel=0.04, bounds=BOUNDS).is_watertight
    assert not len(extract_mesh(Inside(), voxel=0.04, bounds=BOUNDS).faces), (
        "the far side of what is solid is no surface"
    )


def test_crumbs_are_dropped():
    class Crumb(Ball):
        def density(self, points):
            far = np.linalg.norm(points - np.array([0.85, 0.85, 0.85]), axis=1) < 0.06
            return super().density(points) + 100 * far.astype(np.float32)

        def color(self, points, directions=None):
            return np.zeros((len(points), 3), np.float32)

    assert extract_mesh(Crumb(), voxel=0.04, bounds=BOUNDS, min_triangles=1).body_count == 2
    assert extract_mesh(Crumb(), voxel=0.04, bounds=BOUNDS).body_count == 1


def test_export_is_upright_and_in_metres(ball, tmp_path):
    glb = trimesh.load(export_mesh(ball, tmp_path / "ball.glb"), force="mesh", process=False)
    ply = trimesh.load(export_mesh(semantic_mesh(ball), tmp_path / "ball.ply"), process=False)
    colors = np.asarray(glb.visual.vertex_colors)
    assert colors[glb.vertices[:, 1].argmax()][:2].tolist() == [255, 0], "up is y in glTF, and up was red"
    np.testing.assert_allclose(ply.bounds, ball.bounds, atol=1e-5)
    np.testing.assert_allclose(glb.extents, ball.extents, atol=1e-5)
    with pytest.raises(DataError, match="stl"):
        export_mesh(ball, tmp_path / "ball.stl")


def test_an_exported_glb_is_valid(ball, tmp_path):
    """What the Khronos validator checks first: lengths, alignment, names, stated bounds, indices in range."""
    for mesh in (ball, semantic_mesh(ball)):
        data = export_mesh(mesh, tmp_path / "ball.glb").read_bytes()
        total, length = struct.unpack("<I", data[8:12])[0], struct.unpack("<I", data[12:16])[0]
        assert total == len(data) and length % 4 == 0
        document, blob = json.loads(data[20 : 20 + length]), data[28 + length :]
        assert document["buffers"] == [{"byteLength": len(blob)}] and len(blob) % 4 == 0
        ends = [0] + [view["byteOffset"] + view["byteLength"] for view in document["bufferViews"]]
        starts = [view["byteOffset"] for view in document["bufferViews"]]
        assert all(s % 4 == 0 and s >= e for s, e in zip(starts, ends, strict=False)) and ends[-1] <= len(blob)
        (primitive,) = document["meshes"][0]["primitives"]
        assert set(primitive["attributes"]) == {"POSITION", "COLOR_0"}, "classes are no attribute of glTF"

        def values(accessor, dtype, width, document=document, blob=blob):
            entry = document["accessors"][accessor]
            start = document["bufferViews"][entry["bufferView"]]["byteOffset"] + entry.get("byteOffset", 0)
            found = np.frombuffer(blob, dtype, entry["count"] * width, start).reshape(-1, width)
            assert np.array_equal(found.min(axis=0), np.array(entry["min"], dtype))
            assert np.array_equal(found.max(axis=0), np.array(entry["max"], dtype))
            return found, entry

        points, position = values(primitive["attributes"]["POSITION"], "<f4", 3)
        colors, color = values(primitive["attributes"]["COLOR_0"], "u1", 4)
        faces, _ = values(primitive["indices"], "<u4", 1)
        assert position["type"] == "VEC3" and np.isfinite(points).all()
        assert color["type"] == "VEC4" and color["normalized"] and len(colors) == len(points)
        assert len(faces) == 3 * len(mesh.faces) and faces.max() == len(points) - 1
        np.testing.assert_allclose(points, mesh.vertices[:, [0, 2, 1]] * (1, 1, -1), atol=1e-6)  # y is up
        np.testing.assert_array_equal(colors, mesh.visual.vertex_colors)


def test_a_ply_has_the_colours(ball, tmp_path):
    for mesh in (ball, semantic_mesh(ball)):
        again = trimesh.load(export_mesh(mesh, tmp_path / "ball.ply"), process=False)
        np.testing.assert_allclose(again.vertices, mesh.vertices, atol=1e-6)
        np.testing.assert_array_equal(again.visual.vertex_colors, mesh.visual.vertex_colors)


def test_an_empty_field_gives_an_empty_mesh_and_scores_that_say_so(tmp_path):
    class Air(Ball):
        def density(self, points):
            return np.zeros(len(points), np.float32)

    mesh = extract_mesh(Air(), voxel=0.1, bounds=BOUNDS)
    assert len(mesh.faces) == 0
    result = evaluate_mesh(mesh, Air(), toy_scene.two_rooms())
    assert set(result.status.values()) == {"empty mesh"} and set(result.n.values()) == {0}
    with pytest.raises(DataError, match="empty"):
        export_mesh(mesh, tmp_path / "air.ply")


def test_a_grid_that_would_not_fit_is_refused():
    with pytest.raises(DataError, match="larger voxel"):
        extract_mesh(Ball(), voxel=1e-4, bounds=BOUNDS)


def test_blocks_of_a_fine_grid_fit_in_memory_and_share_no_cube():
    from autonerf_lab.evaluators import mesh

    blocks = list(mesh._blocks([2001, 2001, 2001]))
    assert max(np.prod(last - first) for first, last in blocks) <= mesh._BLOCK_NODES
    cubes = sum(int(np.prod(last - first - 1)) for first, last in blocks)
    assert cubes == 2000**3, "each cube is in one block"


@pytest.mark.parametrize(("size", "count"), [((2001, 501, 1001), 667), ((2001, 1001, 501), 667)])
def test_a_block_has_as_many_planes_as_fit(size, count):
    """2**21 nodes are 4 planes of 501 x 1001: three layers of cubes."""
    from autonerf_lab.evaluators import mesh

    assert len(list(mesh._blocks(list(size)))) == count


def test_opacities_are_smoothed_over_the_neighbours_that_were_sampled():
    """A quarter of each neighbour and half of the node itself along an axis; nodes without a sample have no weight."""
    from autonerf_lab.evaluators import mesh

    alpha = np.zeros((5, 5, 5), np.float32)
    alpha[2:] = 1
    sampled = np.ones((5, 5, 5), bool)
    assert mesh._smooth(alpha, sampled)[:, 2, 2].tolist() == [0, 0.25, 0.75, 1, 1]
    sampled[1] = False
    assert mesh._smooth(alpha, sampled)[:, 2, 2].tolist() == [0, 0, 1, 1, 1]


def test_samples_are_uniform_and_distances_exact():
    triangles = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 5], [3, 0, 5], [0, 3, 5.0]]])
    points, face = sample_surface(triangles, 20_000, np.random.default_rng(0))
    assert np.mean(face == 1) == pytest.approx(0.9, abs=0.01)
    assert points[face == 0][:, :2].mean(axis=0) == pytest.approx([1 / 3, 1 / 3], abs=0.02)
    distance, which = nearest_on(np.array([[0.2, 0.2, 0.3], [-1, 0, 5]]), triangles)
    np.testing.assert_allclose(distance, [0.3, 1.0], atol=1e-12)
    assert which.tolist() == [0, 1]


def test_distances_to_triangles_of_very_different_sizes_agree_with_a_search_over_all():
    rng = np.random.default_rng(1)
    corners, size = rng.uniform(-2, 2, (300, 1, 3)), rng.choice([0.01, 0.3, 4.0], (300, 1, 1))
    triangles = corners + size * rng.normal(size=(300, 3, 3))
    points = rng.uniform(-4, 4, (40, 3))
    every = trimesh.triangles.closest_point(np.tile(triangles, (40, 1, 1)), np.repeat(points, 300, axis=0))
    expected = np.linalg.norm(every.reshape(40, 300, 3) - points[:, None], axis=2)
    distance, which = nearest_on(points, triangles)
    np.testing.assert_allclose(distance, expected.min(axis=1), atol=1e-12)
    assert (which == expected.argmin(axis=1)).all()


class Square:
    """A scene of one square of side 1 m at z = 0."""

    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    spec = None


def square(x=(0.0, 1.0), z=0.0, slope=0.0):
    """Return a square as a mesh: its range of x, its height at x = 0, and its slope along x."""
    a, b = x
    height = [z + slope * a, z + slope * b, z + slope * b, z + slope * a]
    corners = np.column_stack([[a, b, b, a], [0, 0, 1, 1], height])
    return trimesh.Trimesh(corners, Square.faces, process=False)


@pytest.mark.parametrize(("height", "ratio"), [(0.03, 100.0), (0.0499, 100.0), (0.0501, 0.0)])
def test_metrics_of_a_raised_square_by_hand(height, ratio):
    result = evaluate_mesh(square(z=height), Ball(), Square, samples=50)
    for suffix in ("", "_all"):
        assert result.values["completion_m" + suffix] == pytest.approx(height)
        assert result.values["completion_ratio" + suffix] == ratio
        assert result.values["normal_consistency" + suffix] == pytest.approx(1)
    assert result.values["accuracy_m"] == pytest.approx(height) and result.artifact["limit"] == 0.1
    assert set(result.n.values()) == {50} and result.status == {} and len(result.artifact["points"]) == 50


def test_normal_consistency_is_the_cosine_of_the_angle():
    """A slope of 0.75 has the normal (-0.6, 0, 0.8); either orientation counts."""
    for mesh in (square(slope=0.75), square(slope=-0.75)):
        assert evaluate_mesh(mesh, Ball(), Square, samples=50).values["normal_consistency"] == pytest.approx(0.8)
    mesh = square(slope=0.75)
    mesh.invert()
    assert evaluate_mesh(mesh, Ball(), Square, samples=50).values["normal_consistency"] == pytest.approx(0.8)


def test_completion_is_over_what_was_seen_and_over_everything():
    """Half of the square is reconstructed. Distances to it rise from 0 to 0.5 m over the other half: mean 1/8."""

    class Near(Ball):
        def seen(self, points):
            return points[:, 0] < 0.5

    values = (result := evaluate_mesh(square(x=(0.0, 0.5)), Near(), Square, samples=20_000)).values
    assert values["completion_m"] == pytest.approx(0, abs=1e-6) and values["completion_ratio"] == 100
    assert values["completion_m_all"] == pytest.approx(1 / 8, abs=0.005)
    assert values["completion_ratio_all"] == pytest.approx(55, abs=1)  # 50 cm and the next 5 cm
    assert values["accuracy_m"] == pytest.approx(0, abs=1e-6)
    assert result.n["completion_m"] == pytest.approx(10_000, abs=300) and result.n["completion_m_all"] == 20_000

    class Blind(Ball):
        def seen(self, points):
            return np.zeros(len(points), bool)

    blind = evaluate_mesh(square(), Blind(), Square, samples=20)
    missing = {"completion_m", "completion_ratio", "normal_consistency"}
    assert blind.status == dict.fromkeys(missing, "nothing seen") and blind.values["completion_ratio_all"] == 100


def test_distances_of_a_translated_mesh():
    scene = toy_scene.two_rooms()
    field = TrueField(scene, views=1)
    mesh = trimesh.Trimesh(scene.vertices + np.array([0, 0, 0.04]), scene.faces, process=False)
    values = evaluate_mesh(mesh, field, scene, samples=5000).values
    assert 0.005 < values["accuracy_m"] < 0.04, "floors moved by 4 cm, walls onto themselves"
    assert values["completion_ratio"] > 99.5 and values["normal_consistency"] > 0.97


def test_more_triangles_than_samples_do_not_increase_the_distance():
    scene = toy_scene.two_rooms()
    vertices, faces = trimesh.remesh.subdivide_to_size(scene.vertices.astype(float), scene.faces, 0.1)
    fine = trimesh.Trimesh(vertices, faces, process=False)
    samples = len(fine.faces) // 20
    values = evaluate_mesh(fine, TrueField(scene, views=1), scene, samples=samples).values
    assert values["completion_m_all"] < 1e-3 and values["accuracy_m"] < 1e-3


def test_all_tasks_of_the_true_geometry():
    scores = oracle_scores(toy_scene.two_rooms(), "smoke")
    assert [(s.task, s.metric) for s in scores] == [key for key in METRICS if key[0] in DEFAULT_TASKS]
    assert {s.metric for s in scores if s.status != "ok"} == {"lpips"}
    assert scores["maps", "free_accuracy"] == 100.0 and scores["mesh", "completion_ratio"] > 99
    assert {s.preset for s in scores} == {"smoke"} and set(scores.artifacts) == set(DEFAULT_TASKS)


def test_a_task_that_fails_fails_alone():
    class Sick(TrueField):
        def render(self, c2w, intrinsics):
            raise RuntimeError("no light")

    scores = evaluate(
        Sick(toy_scene.two_rooms(), views=1), toy_scene.two_rooms(), "smoke", 0, ["rendering", "mesh"], False
    )
    assert scores["rendering", "psnr"] is None and scores["mesh", "completion_ratio"] > 99
    assert scores[0].status == "failed: RuntimeError: no light" and "failed" in scores.table()


def test_wrong_scene_and_unknown_task():
    class Elsewhere(Ball):
        meta = {"scene": "another"}  # noqa: RUF012

    with pytest.raises(DataError, match="'another'"):
        evaluate(Elsewhere(), toy_scene.two_rooms(), "smoke")
    with pytest.raises(UnknownNameError, match="rendering"):
        evaluate(Ball(), toy_scene.two_rooms(), "smoke", tasks=["rendring"])


def test_scores_are_saved_loaded_and_escaped(tmp_path):
    scores = Scores([Score("rendering", "psnr", 20.5, "dB", n=3), Score("maps", "<img>", None, status="<b>bad</b>")])
    scores.save(tmp_path / "scores.json")
    assert list(Scores.load(tmp_path / "scores.json")) == list(scores)
    assert "<img>" not in scores._repr_html_() and "<b>" not in scores._repr_html_()
    assert scores.to_frame().loc[0, "value"] == 20.5
    assert "weights" not in scores.table(oracle=[Score("rendering", "psnr", 58.9)]) and "58.9" in scores.table(
        oracle=[Score("rendering", "psnr", 58.9)]
    )
    for bad in (
        "[]",
        '{"scores": 3}',
        '{"scores": [{"task": 1}]}',
        '{"scores": [{"task": 1, "metric": 2, "value": "x"}]}',
    ):
        (tmp_path / "bad.json").write_text(bad)
        with pytest.raises(DataError, match=r"bad\.json"):
            Scores.load(tmp_path / "bad.json")
