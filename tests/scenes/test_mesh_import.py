"""Imported scans: repeated textures, holes in floors, detection of the floor, and exploration."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

import autonerf_lab as lab
from autonerf_lab.errors import SceneError
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.scenes import generate_apartment, import_scene, top_view
from autonerf_lab.scenes.mesh_file import load_parts

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*the highest surface is only 0.00 m:UserWarning"),  # floors alone
    pytest.mark.filterwarnings("ignore:.*no object has a name:UserWarning"),
]


def test_repeated_texture(tmp_path: Path) -> None:
    """Floor with a texture of four colours, repeated three times across and twice down."""
    colors = np.array([[[250, 0, 0], [0, 250, 0]], [[0, 0, 250], [250, 250, 0]]], dtype=np.uint8)
    floor = trimesh.Trimesh([[0, 0, 0], [6, 0, 0], [6, 4, 0], [0, 4, 0]], [[0, 1, 2], [0, 2, 3]], process=False)
    uv = np.array([[0, 0], [3, 0], [3, 2], [0, 2]], dtype=float)
    image = Image.fromarray(colors.repeat(8, axis=0).repeat(8, axis=1))
    floor.visual = trimesh.visual.TextureVisuals(
        uv=uv, material=trimesh.visual.material.PBRMaterial(baseColorTexture=image)
    )
    floor.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))  # y up
    (tmp_path / "floor.glb").write_bytes(trimesh.exchange.gltf.export_glb(trimesh.Scene(floor)))
    scene = import_scene(tmp_path / "floor.glb")
    seen, _ = top_view(scene, 10)
    assert seen.shape[:2] == (42, 62)  # with a margin of a pixel
    for row in range(4):
        for column in range(6):
            expected = colors[row % 2, column % 2].astype(int)
            assert np.abs(seen[10 * row + 6, 10 * column + 6] - expected).max() < 25, (row, column)


@pytest.mark.parametrize("suffix", ["glb", "obj", "ply"])
def test_a_scan_with_holes_can_be_explored(tmp_path: Path, suffix: str) -> None:
    """Scan with vertex colours, every twentieth triangle missing and noise below the floor."""
    scene = generate_apartment(11)
    rng = np.random.default_rng(0)
    faces = scene.faces[rng.random(len(scene.faces)) > 0.05]
    colors = rng.integers(40, 220, (len(scene.vertices), 3)).astype(np.uint8)
    mesh = trimesh.Trimesh(scene.vertices, faces, vertex_colors=colors, process=False)
    flakes = trimesh.creation.box((0.05, 0.05, 0.02))
    flakes.visual.vertex_colors = np.full((8, 4), 255, np.uint8)
    flakes.apply_translation([*scene.bounds.mean(axis=0)[:2], -0.6])
    path = tmp_path / f"scan.{suffix}"
    trimesh.util.concatenate([mesh, flakes]).export(path)
    scan = import_scene(path, up="z")
    assert (
        abs(np.ptp(scan.bounds[:, 2]) - np.ptp(scene.bounds[:, 2]) - 0.6) < 0.05 and -0.65 < scan.bounds[0, 2] < -0.55
    )
    trajectory = lab.explore(
        lab.Simulator(scan, Intrinsics.from_fov(32, 32), rgb=False), "frontier", 20, progress=False
    )
    assert trajectory.meta["explored_m2"][-1] > 5 and not trajectory.semantics.any()


def textured(path: Path, image: np.ndarray, quads: list[tuple[tuple[float, ...], tuple[float, ...]]]) -> Path:
    """Write a GLB of rectangles on the floor: (x0, y0, x1, y1) shows (u0, v0, u1, v1) of the image, v up."""
    ends = [(0, 1), (2, 1), (2, 3), (0, 3)]
    vertices = [[rect[i], rect[j], 0] for rect, _ in quads for i, j in ends]
    uv = np.array([[shown[i], shown[j]] for _, shown in quads for i, j in ends], dtype=float)
    faces = [[4 * k + a, 4 * k + b, 4 * k + c] for k in range(len(quads)) for a, b, c in ((0, 1, 2), (0, 2, 3))]
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.fromarray(image))
    mesh.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0]))  # y up
    path.write_bytes(trimesh.exchange.gltf.export_glb(trimesh.Scene(mesh)))
    return path


@pytest.mark.parametrize("offset", [(0, 0), (-3, 5), (0.25, -0.5)])
def test_repeated_texture_equals_one_large_image(tmp_path: Path, offset: tuple[float, float]) -> None:
    """Checkerboard repeated four times across and three times down, with different offsets."""
    u, v = offset
    checker = np.stack([np.indices((32, 32)).sum(0) // 8 % 2 * 200] * 3, axis=-1).astype(np.uint8)
    checker[..., 2] = np.arange(32) * 8
    large = np.roll(np.tile(checker, (3, 4, 1)), (int(v * 32), -int(u * 32)), axis=(0, 1))
    first = textured(tmp_path / "tiled.glb", checker, [((0, 0, 4, 3), (u, v, u + 4, v + 3))])
    second = textured(tmp_path / "large.glb", large, [((0, 0, 4, 3), (0, 0, 1, 1))])
    images = [top_view(import_scene(path), 16)[0].astype(int) for path in (first, second)]
    assert np.abs(images[0] - images[1]).max() <= 2


def test_one_repeating_face_does_not_reduce_the_resolution_of_others(tmp_path: Path) -> None:
    image = np.random.default_rng(0).integers(0, 255, (1024, 1024, 3)).astype(np.uint8)
    quads = [((0.0, 0.0, 4.0, 4.0), (0.0, 0.0, 1.0, 1.0)), ((5.0, 0.0, 6.0, 1.0), (0.0, 0.0, 500.0, 9.0))]
    scene = import_scene(textured(tmp_path / "two.glb", image, quads))
    assert np.array_equal(scene.texture[:1024, :1024], image)
    spread = np.ptp(scene.uv[:2].reshape(-1, 2), axis=0) * scene.texture.shape[1::-1]
    assert np.allclose(spread, 1024, atol=1)  # full resolution
    assert scene.texture.size < 3 * 2048 * 4096


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_texture_coordinates_must_be_finite(tmp_path: Path, value: float) -> None:
    path = textured(tmp_path / "odd.glb", np.zeros((4, 4, 3), np.uint8), [((0, 0, 4, 3), (0, 0, value, 1))])
    with pytest.raises(SceneError, match=r"odd\.glb: a texture coordinate is not a finite number"):
        import_scene(path)


def sheet(x: float, y: float, z: float, down: bool = False) -> trimesh.Trimesh:
    """Return a horizontal grid of 0.3 m cells from the origin to (x, y)."""
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


def test_base_colour_multiplies_the_texture(tmp_path: Path) -> None:
    """Base colours of glTF are linear: half of the light is 186 of 255 in sRGB (with a gamma of 2.2)."""
    factor = [0.5, 0.0, 1.0, 1.0]
    image = Image.fromarray(np.full((4, 4, 3), 200, np.uint8))
    materials = {
        "textured": trimesh.visual.material.PBRMaterial(baseColorTexture=image, baseColorFactor=factor),
        "plain": trimesh.visual.material.PBRMaterial(baseColorFactor=factor),
    }
    for name, expected in (("textured", [146, 0, 200]), ("plain", [186, 0, 255])):
        floor = trimesh.Trimesh([[0, 0, 0], [4, 0, 0], [4, 0, -3], [0, 0, -3]], [[0, 1, 2], [0, 2, 3]], process=False)
        floor.visual = trimesh.visual.TextureVisuals(uv=np.zeros((4, 2)), material=materials[name])
        (tmp_path / f"{name}.glb").write_bytes(trimesh.exchange.gltf.export_glb(trimesh.Scene(floor)))
        parts = load_parts(tmp_path / f"{name}.glb")
        color = parts[0]["image"][0, 0] if name == "textured" else parts[0]["color"][0, 0]
        assert np.abs(color.astype(int) - expected).max() <= 1, name
