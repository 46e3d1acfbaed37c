"""Floor plans in HouseExpo's format become valid apartments, or raise one clear error."""

import json
from pathlib import Path

import numpy as np
import pytest
from shapely.geometry import Polygon, box
from shapely.ops import unary_union

import autonerf_lab as lab
from autonerf_lab.errors import SceneError
from autonerf_lab.scenes.houseexpo import category_of, import_houseexpo
from autonerf_lab.scenes.inspection import _placement_problems, _reachability_problems
from autonerf_lab.scenes.spec import dumps

ROOMS = {
    "Living_Room": [[0, 0, 5.2, 4.4]],
    "Kitchen": [[5.32, 0, 8.4, 3.0]],
    "Hall": [[0, 4.52, 8.4, 5.9]],
    "Bedroom": [[0, 6.02, 4, 9.6], [4.12, 6.02, 8.4, 9.6]],
    "Toilet": [[5.32, 3.12, 8.4, 4.4]],
}
DOORS = [(5.1, 1, 5.4, 1.9), (2, 4.3, 2.9, 4.6), (1, 5.8, 1.9, 6.1), (6, 5.8, 6.9, 6.1), (6.5, 4.3, 7.4, 4.6)]


def outline(rects: list) -> list:
    return [list(corner) for corner in unary_union([box(*rect) for rect in rects]).exterior.coords[:-1]]


def traced(doors: list = DOORS, rooms: dict = ROOMS) -> dict:
    """Return a plan with walls of 12 cm between the rooms, and passages through them."""
    boxes = [rect for rects in rooms.values() for rect in rects]
    return {
        "id": "traced",
        "room_num": len(boxes),
        "bbox": {"min": [0, 0], "max": [8.4, 9.6]},
        "verts": outline([*boxes, *doors]),
        "room_category": rooms,
    }


def plain() -> dict:
    """Return a plan without inner walls: a slanted corner, a room with two labels, and unlabelled floor."""
    ground = box(0, 0, 9.5, 10).union(box(9, 6.5, 11, 10)).difference(Polygon([(8, 0), (9.5, 0), (9.5, 1.5)]))
    rooms = {"Living_Room": [[0, 0, 6, 5]], "Dining_Room": [[0, 0, 6, 5]], "Kitchen": [[6, 0, 9.5, 4]]}
    rooms |= {"Bedroom": [[0, 6.5, 4.5, 10]], "Bathroom": [[4.5, 6.5, 7, 10]], "Office": [[7, 6.5, 11, 10]]}
    return {"id": "plain", "verts": [list(c) for c in ground.exterior.coords[:-1]], "room_category": rooms}


def l_shaped() -> dict:
    """Return a plan whose L-shaped living room has a box that contains the kitchen and the bath."""
    ground = box(0, 0, 10, 4).union(box(0, 0, 4, 9))
    rooms = {"Living_Room": [[0, 0, 10, 9]], "Kitchen": [[6, 0, 10, 4]], "Bathroom": [[0, 6.6, 4, 9]]}
    return {"id": "L", "verts": [list(c) for c in ground.exterior.coords[:-1]], "room_category": rooms}


def written(folder: Path, plan: object) -> Path:
    path = folder / "plan.json"
    path.write_text(plan if isinstance(plan, str) else json.dumps(plan))
    return path


def doors_of(scene: lab.Scene) -> set[frozenset[str]]:
    kinds = [room["category"] for room in scene.spec["rooms"]]
    return {frozenset(kinds[k] for k in o["rooms"]) for o in scene.spec["openings"] if o["kind"] == "door"}


def test_traced_passages_are_the_doors(tmp_path):
    scene = import_houseexpo(written(tmp_path, traced()))
    kinds = sorted(room["category"] for room in scene.spec["rooms"])
    assert kinds == ["bath", "bedroom", "bedroom", "corridor", "kitchen", "living"]
    pairs = [{"living", "kitchen"}, {"living", "corridor"}, {"bedroom", "corridor"}, {"bath", "corridor"}]
    assert doors_of(scene) == {frozenset(pair) for pair in pairs}
    doors = [o for o in scene.spec["openings"] if o["kind"] == "door"]
    assert len(doors) == 5 and min(o["width"] for o in doors) >= 0.8
    for x0, y0, x1, y1 in DOORS:  # at the passages of the outline
        assert min(np.hypot(o["at"][0] - (x0 + x1) / 2, o["at"][1] - (y0 + y1) / 2) for o in doors) < 0.1
    assert sum(o["kind"] == "entrance" for o in scene.spec["openings"]) == 1
    bedroom = next(Polygon(r["polygon"]) for r in scene.spec["rooms"] if r["category"] == "bedroom")
    assert bedroom.area == pytest.approx(4.0 * 3.58, rel=0.08)


def test_rooms_without_walls_get_as_few_doors_as_join_them(tmp_path):
    scene = import_houseexpo(written(tmp_path, plain()))
    kinds = sorted(room["category"] for room in scene.spec["rooms"])
    assert kinds == ["bath", "bedroom", "corridor", "kitchen", "living", "study"]  # the corridor is unlabelled floor
    assert doors_of(scene) == {frozenset(("corridor", kind)) for kind in kinds if kind != "corridor"}


def test_a_box_inside_a_box_is_cut_out_of_it(tmp_path):
    scene = import_houseexpo(written(tmp_path, l_shaped()))
    areas = {room["category"]: Polygon(room["polygon"]).area for room in scene.spec["rooms"]}
    assert set(areas) == {"living", "kitchen", "bath"}
    assert areas["living"] == pytest.approx(60 - 16 - 9.6, rel=0.08) and areas["kitchen"] == pytest.approx(16, rel=0.08)


@pytest.mark.parametrize("plan", [traced(), plain(), l_shaped()], ids=lambda plan: plan["id"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_every_room_can_be_reached(tmp_path, plan, seed):
    scene = import_houseexpo(written(tmp_path, plan), seed)
    assert _reachability_problems(scene) == [] and _placement_problems(scene) == []


def test_an_imported_plan_can_be_explored_and_saved(tmp_path):
    path = written(tmp_path, traced())
    scene = lab.import_scene(path)
    with pytest.raises(SceneError, match="is a floor plan: leave out up and aliases"):
        lab.import_scene(path, up="y")
    assert dumps(scene.spec) == dumps(import_houseexpo(path).spec) != dumps(import_houseexpo(path, seed=1).spec)
    sim = lab.Simulator(scene, lab.geometry.Intrinsics.from_fov(32, 32), rgb=False)
    trajectory = lab.explore(sim, "frontier", steps=20, progress=False)
    assert len(trajectory) == 20 and trajectory.meta["explored_m2"][-1] > 5
    saved = tmp_path / "furnished.json"
    saved.write_text(dumps(scene.spec))
    assert len(lab.load_scene(str(saved)).faces) == len(scene.faces)


def test_labels_map_to_categories():
    names = ["Living_Room", "Dining_Room", "Kitchen", "Toilet", "Guest_Room", "Office", "Hallway", "Garage", "Room"]
    kinds = ["living", "living", "kitchen", "bath", "bedroom", "study", "corridor", "corridor", "study"]
    assert [category_of(name) for name in names] == kinds


BAD = {
    "truncated": (json.dumps(traced())[:200], "not readable JSON"),
    "nested": ("[" * 100_000, "not readable JSON"),
    "a list": ([1, 2], "not a floor plan"),
    "no outline": ({"room_category": {}}, "'verts'"),
    "two points": ({**traced(), "verts": [[0, 0], [1, 1]]}, "2 points"),
    "a word": ({**traced(), "verts": [[0, 0], [9, "x"], [9, 9]]}, r"verts\[1\]"),
    "not a number": (json.dumps(traced()).replace("9.6", "NaN"), "not readable JSON"),
    "kilometres": ({**traced(), "verts": [[0, 0], [5000, 0], [5000, 5000], [0, 5000]]}, "metres"),
    "no ground": (
        {**traced(), "verts": [[0, 0], [5, 5], [0, 0], [5, 5]]},
        "no floor area|no valid|not a valid outline|measures",
    ),
    "a bent box": ({**traced(), "room_category": {"Kitchen": [[0, 0, 1]]}}, "a box of 'Kitchen'"),
    "no boxes": ({**traced(), "room_category": {"Kitchen": 3}}, "must be a list of boxes"),
    "a town": ({**traced(), "room_category": {"Kitchen": [[0, 0, 1, 1]] * 65}}, "more than 64 rooms"),
    "two on one ground": (
        {**plain(), "room_category": {"Kitchen": [[0, 0, 6, 5]], "Bedroom": [[3, 0, 9.5, 5]]}},
        "'Kitchen' and 'Bedroom' overlap by 15.0 m2|'Bedroom' and 'Kitchen' overlap by 15.0 m2",
    ),
    "no door": (
        {**traced(), "verts": outline([*ROOMS["Living_Room"], *ROOMS["Kitchen"], (5, 0, 5.4, 0.4)])},
        "no door",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_an_invalid_plan_is_a_scene_error(tmp_path, name):
    content, message = BAD[name]
    path = written(tmp_path, content)
    with pytest.raises(SceneError, match=message) as caught:
        import_houseexpo(path)
    assert str(path) in str(caught.value)


def test_error_names_a_missing_plan(tmp_path):
    with pytest.raises(SceneError, match=r"nothing\.json"):
        import_houseexpo(tmp_path / "nothing.json")


def test_random_damage_raises_only_scene_errors(tmp_path):
    """Change one character at random: the import returns a scene or raises SceneError."""
    rng = np.random.default_rng(0)
    text = json.dumps(traced())
    for _ in range(60):
        k = int(rng.integers(len(text)))
        changed = text[:k] + str(rng.choice(list('0123456789.-eE[]{},:"x '))) + text[k + 1 :]
        try:
            import_houseexpo(written(tmp_path, changed))
        except SceneError:
            continue
