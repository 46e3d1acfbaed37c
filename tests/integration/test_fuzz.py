"""A few mutants of every file format; ``benchmarks/fuzz.py`` runs any number of them."""

import fuzz
import pytest

NAMES = (
    *("scene.json", "semantics.json", "mesh.glb", "mesh.ply", "mesh.obj", "trajectory", "photographs", "rgb.png"),
    *("depth.png", "classes.png", "nerf.safetensors", "training.safetensors", "policy.json"),
    *("policy.safetensors", "checkpoint.safetensors", "imitation.safetensors"),
    *("run.json", "outputs.json", "grid.json", "cell.json"),
    *("scores.json", "figures.json"),
)


@pytest.fixture(scope="module")
def formats(tmp_path_factory: pytest.TempPathFactory) -> dict[str, fuzz.Format]:
    found = {form.name: form for form in fuzz.make_formats(tmp_path_factory.mktemp("fuzz"))}
    assert tuple(found) == NAMES
    return found


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", NAMES)
def test_mutants_load_or_raise_an_error_of_the_package(formats: dict[str, fuzz.Format], name: str) -> None:
    assert fuzz.attack(formats[name], mutants=40, first=0, seed=1)["violations"] == 0
