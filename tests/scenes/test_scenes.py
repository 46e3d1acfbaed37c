"""Generated apartments: reproducible, complete, navigable and textured everywhere; frozen scenes are unchanged."""

from dataclasses import replace

import numpy as np
import pytest
from shapely.geometry import Polygon

from autonerf_lab.classes import CLASS_NAMES
from autonerf_lab.scenes import Scene, generate_apartment, plot_scene, scene_names, top_view
from autonerf_lab.scenes.build import build
from autonerf_lab.scenes.freeze import FIRST_SEED, mesh_sha256, seed_of
from autonerf_lab.scenes.generator import STAGES, generate_spec
from autonerf_lab.scenes.layout import Layout
from autonerf_lab.scenes.library import SPLITS
from autonerf_lab.scenes.plotting import MAX_SIDE, plot_scale
from autonerf_lab.scenes.spec import dumps
from autonerf_lab.scenes.tessellation import MARGIN, pack, tessellate


@pytest.fixture(scope="module")
def apartment() -> Scene:
    return generate_apartment(7)


def test_apartments_vary_in_size_and_plan() -> None:
    """Three to eight rooms, with and without a separate kitchen, straight and L-shaped corridors."""
    specs = [generate_spec(seed) for seed in range(600_000, 600_050)]
    plans = [[room["category"] for room in spec["rooms"]] for spec in specs]
    assert {len(plan) for plan in plans} == set(range(3, 9))
    assert {"studio", "open-plan", "living"} <= {plan[-2] for plan in plans}
    assert {len(spec["rooms"][-1]["polygon"]) for spec in specs} == {4, 6}
    areas = [sum(Polygon(room["polygon"]).area for room in spec["rooms"]) for spec in specs]
    assert min(areas) < 55 and max(areas) > 120


def test_same_seed_same_apartment(apartment: Scene) -> None:
    again = generate_apartment(7)
    assert dumps(again.spec) == dumps(apartment.spec)
    assert mesh_sha256(again) == mesh_sha256(apartment)
    assert np.array_equal(again.texture, apartment.texture)


def test_other_seed_other_apartment(apartment: Scene) -> None:
    assert mesh_sha256(generate_apartment(8)) != mesh_sha256(apartment)


def test_splits_have_disjoint_seeds() -> None:
    seeds = [seed_of(name) for name in scene_names()]
    assert len(set(seeds)) == len(seeds) == 60
    assert {*FIRST_SEED, "test"} == {*SPLITS}


def test_shapes_and_ranges(apartment: Scene) -> None:
    faces = len(apartment.faces)
    assert apartment.vertices.dtype == np.float32 and apartment.faces.dtype == np.int32
    assert apartment.face_class.shape == apartment.face_instance.shape == (faces,)
    assert apartment.uv.shape == (faces, 3, 2)
    assert apartment.texture.dtype == np.uint8 and apartment.texture.shape[2] == 3
    assert 4_000 < faces < 20_000
    assert apartment.bounds[0, 2] == 0 and 2.5 <= apartment.bounds[1, 2] <= 2.7
    assert (apartment.face_class[apartment.face_instance == 0] == 0).all()


def test_instances_have_names_classes_and_boxes(apartment: Scene) -> None:
    toilet = next(i for i in apartment.instances if i.class_id == CLASS_NAMES.index("toilet"))
    assert toilet.name.startswith("toilet")
    assert 0.6 < toilet.size[2] < 1.0
    corners = apartment.vertices[apartment.faces[apartment.face_instance == toilet.id]].reshape(-1, 3)
    assert np.allclose(corners.max(axis=0), toilet.center + toilet.size / 2)


def test_floor_faces_up_and_ceiling_faces_down(apartment: Scene) -> None:
    building = apartment.face_instance == 0
    corner = apartment.vertices[apartment.faces[building]].astype(np.float64)
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    z = corner[:, :, 2]
    assert (normal[(z == 0).all(axis=1), 2] > 0).all()
    assert (normal[(z == z.max()).all(axis=1), 2] < 0).all()


def test_closed_solids_have_outward_normals() -> None:
    """The divergence theorem: a closed mesh with outward faces has its volume as flux of x / 3."""
    parts = [
        {"box": [1, 2, 3], "at": [0, 0, 1], "m": "a", "yaw": 0.3},
        {"lathe": [[0, 0], [1, 0], [1, 2], [0, 2]], "n": 64, "m": "a", "tilt": 0.4},
    ]
    for part, volume in zip(parts, (6.0, 2 * 32 * np.sin(2 * np.pi / 64)), strict=True):
        entry = {"id": 1, "class": "cup", "name": "solid", "parts": [part]}
        scene = build({"name": "s", "lights": [], "materials": {"a": {"kind": "paint"}}, "objects": [entry]})
        a, b, c = scene.vertices[scene.faces].astype(np.float64).transpose(1, 0, 2)
        assert np.isclose((a * np.cross(b, c)).sum() / 6, volume, rtol=1e-5)


def test_atlas_rectangles_do_not_overlap(apartment: Scene) -> None:
    assert apartment.spec is not None
    tessellation = tessellate(apartment.spec)
    count = np.zeros(tessellation.atlas, dtype=np.int32)
    for left, top, width, height in tessellation.rect:
        count[top - MARGIN : top + height + MARGIN, left - MARGIN : left + width + MARGIN] += 1
    assert count.max() == 1


def test_pack_keeps_sizes() -> None:
    sizes = np.random.default_rng(0).integers(1, 90, (200, 2))
    rect, (rows, cols) = pack(sizes)
    assert np.array_equal(rect[:, 2:], sizes)
    assert (rect[:, 0] + rect[:, 2] < cols).all() and (rect[:, 1] + rect[:, 3] < rows).all()


def test_every_wall_has_texture(apartment: Scene) -> None:
    """Every large patch of the building varies, over a few texels and as a whole."""
    assert apartment.spec is not None
    tessellation = tessellate(apartment.spec)
    for k in np.flatnonzero((tessellation.object == 0) & (tessellation.length.min(axis=1) > 0.8)):
        left, top, width, height = tessellation.rect[k]
        grey = apartment.texture[top : top + height, left : left + width].astype(float).mean(axis=2)
        assert grey.std() > 2.0
        assert np.abs(np.diff(grey, axis=1)).mean() > 0.3
        assert 20 < grey.mean() < 252


def test_a_stage_can_be_replaced() -> None:
    def no_daylight(layout: Layout, rng: np.random.Generator) -> None:
        layout.lights = []

    spec = generate_spec(3, "dark", (*STAGES, no_daylight))
    assert spec["name"] == "dark" and spec["lights"] == []


def test_top_view_shows_the_floor(apartment: Scene) -> None:
    image, origin = top_view(apartment, 20)
    assert apartment.spec is not None
    x, y = np.mean(apartment.spec["rooms"][-1]["polygon"], axis=0)
    row = image.shape[0] - 1 - int((y - origin[1]) * 20)
    pixel = image[row, int((x - origin[0]) * 20)]
    assert tuple(pixel) != (255, 255, 255)
    assert tuple(image[0, 0]) == (255, 255, 255)


def test_plots_of_large_scenes_have_fewer_pixels(apartment: Scene) -> None:
    assert plot_scale(apartment) == 60
    hall = replace(apartment, vertices=apartment.vertices * np.float32([15, 15, 1]))
    width, height = np.ptp(hall.bounds, axis=0)[:2] * plot_scale(hall)
    assert MAX_SIDE - 50 < max(width, height) < MAX_SIDE


def test_plot_has_metres(apartment: Scene) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    ax = plot_scene(apartment)
    assert ax.get_xlabel() == "x (m)" and ax.get_title() == apartment.name
    mpl.pyplot.close(ax.figure)
