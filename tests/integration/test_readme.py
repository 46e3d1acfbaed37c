"""Code and tables of README and manual: code runs as it stands there, with smaller settings; tables are complete."""

import ast
import importlib
import os
import re
import runpy
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import toy_photos
import tyro

from autonerf_lab.cli.command_line import _STYLE, CommandLine
from autonerf_lab.envs import ENVS
from autonerf_lab.evaluators import METRICS
from autonerf_lab.nerf import MODELS
from autonerf_lab.policies import POLICIES
from autonerf_lab.rewards import REWARDS

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "benchmarks/results/README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCKS = [
    pytest.param(code, id=f"{page.stem}-{k}")
    for page in PAGES
    for k, code in enumerate(re.findall(r"(?ms)^```python\n(.*?)^```", page.read_text()))
]
TRAJECTORY = """
import autonerf_lab as lab
from autonerf_lab.geometry import Intrinsics

scene = lab.load_scene("dev-0")
sim = lab.Simulator(scene, Intrinsics.from_fov(16, 16), supersample=1)
trajectory = lab.explore(sim, "random", steps=20, progress=False)
"""


def text_of(page: str, section: str = "") -> str:
    """Return a page, or one of its sections."""
    text = (ROOT / page).read_text()
    if section:
        found = re.search(rf"(?ms)^#+ {re.escape(section)}\n(.*?)(?=^## |\Z)", text)
        assert found, f"{page} has no section {section!r}"
        text = found[1]
    return text


def code_of(page: str, section: str = "") -> str:
    """Return the Python code of a page, or of one of its sections."""
    code = "".join(re.findall(r"(?ms)^```python\n(.*?)^```", text_of(page, section)))
    assert code
    return code


def names_in(page: str, section: str = "") -> list[str]:
    """Return the names in the first columns of the tables."""
    rows = re.findall(r"(?m)^\| (`.*?) \|", text_of(page, section))
    return [name for row in rows for name in re.findall(r"`([\w/-]+)`", row)]


def smaller(code: str, **changes: str) -> str:
    """Replace each old text, which must be there, by a new one."""
    for old, new in changes.items():
        assert old in code
        code = code.replace(old, new)
    return code


def run(code: str, folder: Path) -> str:
    """Run code in a folder with the preset for tests and the examples on the path; return what it prints."""
    path = os.pathsep.join([str(ROOT / "examples"), os.environ.get("PYTHONPATH", "")])
    env = {**os.environ, "PYTHONPATH": path, "AUTONERF_LAB_PRESET": "smoke"}
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, env=env, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) < 200


@pytest.mark.parametrize("code", BLOCKS)
def test_every_imported_name_exists(code: str) -> None:
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("autonerf_lab"):
            module = importlib.import_module(node.module or "")
            for alias in node.names:
                assert hasattr(module, alias.name), f"{node.module} has no {alias.name}"


def test_ten_lines_run(tmp_path: Path) -> None:
    camera = "Simulator(scene, lab.Intrinsics.from_fov(64, 64))"
    changes = {"steps=1500": "steps=240", 'preset="fast"': 'preset="smoke"', "Simulator(scene)": camera}
    code = smaller(code_of("README.md"), **changes)
    assert len(code.strip().splitlines()) <= 12
    assert "paper best" in run(code, tmp_path)
    assert (tmp_path / "apartment.glb").stat().st_size > 1000


def test_code_about_models_runs(tmp_path: Path) -> None:
    code = code_of("docs/fields.md", "Settings") + code_of("docs/extending.md", "A model")
    code = smaller(code, **{"steps=2000": "steps=3, seen_rays=500", '["fast"]': '["smoke"]'})
    printed = run(f"{TRAJECTORY}{code}\nprint(nerf)", tmp_path)
    assert printed.startswith("NeRF(dense-grid, scene=dev-0, 20 views, 150 steps)")
    assert (tmp_path / "my-field/nerf.json").exists() and not (tmp_path / "my-field/training.safetensors").exists()


def test_every_model_is_listed() -> None:
    assert set(names_in("docs/fields.md", "Models")) == set(MODELS)
    for name, spec in MODELS.items():
        for preset, settings in spec.settings.items():
            assert f"`{preset}`" in text_of("docs/fields.md", "Models")
            assert (settings.depth_weight > 0, settings.view_dependent) == (name.endswith("-rgbd"), True)


def test_rewards_and_environments_are_listed() -> None:
    assert names_in("docs/environments.md", "Rewards") == list(REWARDS)
    assert set(names_in("docs/environments.md", "Environments")) == set(ENVS)


def test_code_about_rewards_runs(tmp_path: Path) -> None:
    code = smaller(code_of("docs/extending.md", "A reward"), **{"reward=": "size=16, window=60, rgb=False, reward="})
    show = "env.reset(seed=0)\nprint(sorted(env.step(0)[4]['reward_terms']))"
    assert run(f"{code}\n{show}", tmp_path) == "['bumps', 'cov']\n"


def test_code_about_policies_runs(tmp_path: Path) -> None:
    assert set(names_in("docs/exploration.md", "Policies")) == set(POLICIES)
    code = smaller(code_of("docs/exploration.md", "Maps over time"), **{"steps=1500": "steps=8"})
    code += code_of("docs/extending.md", "A policy") + "print(len(trajectory))"
    assert run(TRAJECTORY + code, tmp_path) == "50\n"
    assert (tmp_path / "rollouts.png").read_bytes().startswith(b"\x89PNG")


def test_code_about_tasks_runs(tmp_path: Path) -> None:
    code = code_of("docs/extending.md", "A task")
    show = """
from autonerf_lab.evaluators import TrueField
from autonerf_lab.evaluators.conformance import check_run
from autonerf_lab.evaluators.context import EvaluationContext

field = TrueField(scene, sim)
print(check_run(OCCUPIED_SHARE, EvaluationContext(field, scene, lab.preset())).values["share"])
"""
    assert 0 < float(run(TRAJECTORY + code + show, tmp_path)) < 100


def test_code_about_segmenters_runs(tmp_path: Path) -> None:
    code = code_of("docs/extending.md", "A segmenter") + "print(blind.reset(seed=0).semantics.max())"
    assert run(TRAJECTORY + code, tmp_path) == "0\n"


def test_code_about_viewing_runs(tmp_path: Path) -> None:
    code = smaller(code_of("docs/viewing.md"), **{"frames=240": "frames=4", "[::20]": "[::5]"})
    assert "\nhttp://127.0.0.1:" in run(TRAJECTORY + code, tmp_path)
    assert (tmp_path / "flight.mp4").stat().st_size > 1000


def test_code_about_photographs_runs(tmp_path: Path) -> None:
    toy_photos.write(toy_photos.photographs(toy_photos.orbit(16)), tmp_path / "photographs")
    printed = run(f"import autonerf_lab as lab\n{code_of('docs/photographs.md')}", tmp_path)
    assert "held_out" in printed and "nearest_view" in printed


def test_every_metric_has_its_definition_and_the_values_of_the_paper() -> None:
    text = text_of("docs/evaluation.md")
    for metric in METRICS.values():
        if metric.task == "reward" or (metric.task == "exploration" and metric.name.endswith("_auc")):
            continue
        rows = [line for line in text.splitlines() if line.startswith("|") and f"`{metric.name}`" in line]
        assert rows, f"docs/evaluation.md does not define {metric.name}"
        for value in (value for value in metric.paper or () if value is not None):
            assert any(re.search(rf"\b{re.escape(f'{value:g}')}\b", row.replace(".0,", ",")) or f"{value}" in row
                       for row in rows), f"{metric.name}: {value}"  # fmt: skip


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_every_command_can_be_parsed(page: Path) -> None:
    for block in re.findall(r"(?ms)^```\n(.*?)^```", page.read_text()):
        for line in block.splitlines():
            if line.startswith("autonerf-lab "):
                arguments = shlex.split(re.sub(r"<[^>]*>", "X", line), comments=True)[1:]
                tyro.cli(CommandLine, args=arguments, config=_STYLE)


def test_links_of_the_page_on_pypi_are_absolute_or_absent() -> None:
    package_page = runpy.run_path(str(ROOT / "docs/set_owner.py"))["package_page"]
    text = "![Run](docs/demo.jpg) [`Guide`](docs/a.md#b) [up](#top) [site](https://x.org)"
    here = "https://github.com/me/lab/blob"
    assert package_page(text, None, "1.0") == " `Guide` [up](#top) [site](https://x.org)"
    assert package_page(text, "me/lab", "1.0") == (
        "![Run](https://raw.githubusercontent.com/me/lab/v1.0/docs/demo.jpg) "
        f"[`Guide`]({here}/v1.0/docs/a.md#b) [up](#top) [site](https://x.org)"
    )
    assert package_page("[a](b)", "me/lab", "1.0.dev0") == f"[a]({here}/main/b)"
