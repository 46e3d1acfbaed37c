"""Homes of a given size: plans, stairs and second floors; without a size, the apartments are what they were."""

import numpy as np
import pytest
from shapely.geometry import Polygon

from autonerf_lab.errors import SceneError
from autonerf_lab.evaluators.ground_truth import faces_of_the_floor
from autonerf_lab.scenes import Scene, generate_apartment, load_scene, scene_names
from autonerf_lab.scenes.freeze import HOUSES, frozen_spec
from autonerf_lab.scenes.generator import generate_spec
from autonerf_lab.scenes.house_plan import plan_house
from autonerf_lab.scenes.inspection import problems
from autonerf_lab.scenes.layout import WALL
from autonerf_lab.scenes.library import folder
from autonerf_lab.scenes.spec import dumps
from autonerf_lab.scenes.stairs import RISERS, SLAB, cut_out, stairs_parts, stairwell_of
from autonerf_lab.simulator.raycast import RayCaster
from autonerf_lab.simulator.specular import scene_gloss


@pytest.fixture(scope="module")
def house() -> Scene:
    """House with two floors."""
    return load_scene("house-1")


def area_of(spec: dict) -> float:
    """Return the floor area without the stairwell of the second floor."""
    total = sum(Polygon(room["polygon"]).area for room in spec["rooms"])
    stairs = [o for o in spec["objects"] if o["name"] == "stairs"]
    return total - sum(stairwell_area(spec) for _ in stairs)


def stairwell_area(spec: dict) -> float:
    """Return the area of the landing's width times the depth of the stairwell, m2."""
    landing = max((o for o in spec["objects"] if o["name"] == "stairs"), key=lambda o: o["id"])["parts"]
    wide = max(part["box"][0] for part in landing)
    deep = max(part["at"][1] + part["box"][1] / 2 for part in landing if part["box"][0] == wide)
    return wide * deep


@pytest.mark.parametrize(("area", "rooms", "floors"), [(45, 2, None), (75, None, None), (None, 9, 1), (230, None, 2)])
def test_homes_have_the_size_that_was_asked_for(area: float | None, rooms: int | None, floors: int | None) -> None:
    scene = generate_apartment(5, area=area, rooms=rooms, floors=floors)
    assert scene.spec is not None and problems(scene) == []
    assert area is None or abs(area_of(scene.spec) / area - 1) < 0.015
    assert rooms is None or len(scene.spec["rooms"]) == rooms
    assert len({room.get("z", 0) for room in scene.spec["rooms"]}) == (floors or 1)


@pytest.mark.parametrize(
    ("size", "message"),
    [
        ({"floors": 3}, "1 or 2 floors"),
        ({"floors": 0}, "1 or 2 floors"),
        ({"rooms": 1}, "has 2 to 14 rooms"),
        ({"rooms": 7, "floors": 2}, r"2 floor\(s\) has 8 to 14 rooms"),
        ({"area": 301}, "40 to 300 m2"),
        ({"area": 60, "rooms": 14}, "area=60: 14 rooms need 161 to 300 m2"),
        ({"area": 90, "floors": 2}, "a home with 2 floors need"),
    ],
)
def test_impossible_sizes_are_refused(size: dict, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        generate_spec(0, **size)


@pytest.mark.parametrize("name", ["train-04", "house-1"])
def test_the_generator_still_makes_the_frozen_scenes(name: str) -> None:
    assert dumps(frozen_spec(name)) == (folder() / f"{name}.json").read_text(encoding="utf-8")


def test_the_houses_have_their_sizes() -> None:
    for name, (area, rooms, floors) in zip(scene_names("house"), HOUSES, strict=True):
        spec = load_scene(name).spec
        assert spec is not None and len(spec["rooms"]) == rooms
        assert len({room.get("z", 0) for room in spec["rooms"]}) == floors
        assert abs(area_of(spec) / area - 1) < 0.015
    assert sum(floors == 2 for *_, floors in HOUSES) == 2


def test_rooms_of_a_plan_do_not_overlap() -> None:
    for seed, rooms, floors in ((0, 14, 1), (1, 13, 2), (2, 10, 1)):
        for floor in plan_house(240, rooms, floors, np.random.default_rng(seed)).floors:
            shapes = [room.shape for room in floor]
            for k, shape in enumerate(shapes):
                assert all(shape.distance(other) > WALL - 0.03 for other in shapes[:k])


def test_steps_of_the_stairs_have_equal_heights() -> None:
    parts = stairs_parts(2.1, 3.2, 2.88)
    tops = sorted({round(p["at"][2] + p["box"][2], 4) for p in parts if p["m"] == "wood_table" and "tilt" not in p})
    np.testing.assert_allclose(tops, 0.18 * np.arange(1, RISERS + 1), atol=1e-9)


def test_a_stairwell_reaches_to_the_wall_face_of_the_corridor() -> None:
    """Corridor along x at y = 0 ... 2 with stairs above its left end, 2 m wide and 3 m deep."""
    corridor = [(0.06, 0.06), (7.94, 0.06), (7.94, 1.94), (1.94, 1.94), (1.94, 4.94), (0.06, 4.94)]
    rect, inward = stairwell_of(corridor, (0.0, 2.0, 2.0, 5.0))
    np.testing.assert_allclose(rect, (0.06, 1.94, 1.94, 4.94))
    assert inward.tolist() == [0, 1]
    assert sum((x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in cut_out([(0, 0, 8, 5)], rect)) == pytest.approx(40 - 5.64)


def test_the_second_floor_is_seen_through_the_stairwell(house: Scene) -> None:
    """From the foot of the upper flight, a ray upwards meets the ceiling of the second floor."""
    assert house.spec is not None
    stairs, railing = (next(o for o in house.spec["objects"] if o["name"] == n) for n in ("stairs", "railing"))
    lift = house.spec["height"] + SLAB
    assert railing["at"][2] == pytest.approx(lift) and house.bounds[1, 2] == pytest.approx(lift + house.spec["height"])
    c, s = np.cos(stairs["yaw"]), np.sin(stairs["yaw"])
    wide = max(part["box"][0] for part in stairs["parts"])
    first = np.array([-wide / 4, 0.1])  # in front of the first step, under the railing's left half
    x, y = np.array(stairs["at"][:2]) + np.array([[c, -s], [s, c]]) @ first
    caster = RayCaster(house.vertices[house.faces])
    up = caster.cast(np.array([[x, y, 0.5]]), np.array([[0.0, 0.0, 1.0]])).t[0] + 0.5
    assert up == pytest.approx(lift + house.spec["height"], abs=1e-3)


def test_a_house_is_scored_on_the_floor_of_the_robot(house: Scene) -> None:
    own = faces_of_the_floor(house)
    assert 0.4 < own.mean() < 0.8
    lift = min(room["z"] for room in house.spec["rooms"] if "z" in room)  # type: ignore[index]
    assert house.vertices[house.faces[~own], 2].min() >= lift - 0.01
    assert faces_of_the_floor(load_scene("train-04")).all()


def test_highlights_are_those_of_the_lamps_of_the_same_floor(house: Scene) -> None:
    assert house.spec is not None
    gloss = scene_gloss(house)
    lifts = np.array([room.get("z", 0.0) for room in house.spec["rooms"]])
    middle = house.vertices[house.faces, 2].mean(axis=1)
    lit = gloss.room >= 0
    assert lit.mean() > 0.95
    above = middle[lit] - lifts[gloss.room[lit]]
    assert above.min() > -0.2 and above.max() < house.spec["height"] + 0.2
    for room, lift in enumerate(lifts):
        lamps = gloss.lamps[gloss.first[room] : gloss.first[room + 1], 2]
        assert ((lamps > lift) & (lamps <= lift + house.spec["height"])).all()
