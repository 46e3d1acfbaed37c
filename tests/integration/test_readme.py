"""The code that the README shows about models and rewards runs as it stands there, only smaller."""

import os
import re
import subprocess
import sys
from pathlib import Path

from autonerf_lab.nerf import MODELS
from autonerf_lab.policies import POLICIES
from autonerf_lab.rewards import REWARDS

ROOT = Path(__file__).parents[2]
SECTION = re.search(r"(?ms)^### Models\n(.*?)^### ", (ROOT / "README.md").read_text())
ABOUT_REWARDS = re.search(r"(?ms)^### Rewards\n(.*?)^### ", (ROOT / "README.md").read_text())
WALK = """
import autonerf_lab as lab
from autonerf_lab.geometry import Intrinsics

sim = lab.Simulator(lab.load_scene("dev-0"), Intrinsics.from_fov(16, 16), supersample=1)
trajectory = lab.explore(sim, "random", steps=20, progress=False)
"""


def test_code_about_models_runs(tmp_path: Path) -> None:
    assert SECTION
    blocks = re.findall(r"```python\n(.*?)```", SECTION[1], re.S)
    assert len(blocks) == 2
    code, smaller = re.subn(r"steps=2000", "steps=3, seen_rays=500", "".join(blocks).replace('["fast"]', '["smoke"]'))
    assert smaller == 1
    path = os.pathsep.join([str(ROOT / "examples"), os.environ.get("PYTHONPATH", "")])
    result = subprocess.run(
        [sys.executable, "-c", f"{WALK}{code}\nprint(nerf)"],
        cwd=tmp_path, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert result.stdout.startswith("NeRF(dense-grid, scene=dev-0, 20 views, 150 steps)")
    assert (tmp_path / "my-field/nerf.json").exists() and not (tmp_path / "my-field/training.safetensors").exists()


def test_every_model_and_every_option_is_there() -> None:
    assert SECTION
    assert re.findall(r"(?m)^\| `([\w-]+)` \|", SECTION[1]) == ["semantic-nerfacto", "instant-ngp", "semantic-nerf"]
    assert len(MODELS) == 3
    for spec in MODELS.values():
        for preset, settings in spec.settings.items():
            assert f"`{preset}`" in SECTION[1]
            assert (settings.depth_weight, settings.refine_cameras, settings.view_dependent) == (0, False, True)


def test_code_about_rewards_runs_and_every_reward_is_there() -> None:
    assert ABOUT_REWARDS
    names = [name for row in re.findall(r"(?m)^\| (`.*?) \|", ABOUT_REWARDS[1]) for name in re.findall(r"`(\w+)`", row)]
    assert names == list(REWARDS)
    (code,) = re.findall(r"```python\n(.*?)```", ABOUT_REWARDS[1], re.S)
    code = code.replace("reward=", "size=16, window=60, rgb=False, reward=")
    show = "env.reset(seed=0)\nprint(sorted(env.step(0)[4]['reward_terms']))"
    result = subprocess.run([sys.executable, "-c", f"{code}\n{show}"], capture_output=True, text=True, check=False)
    assert result.stdout == "['bumps', 'cov']\n", result.stderr


def test_code_about_policies_runs_and_every_policy_is_there(tmp_path: Path) -> None:
    text = re.search(r"(?ms)^### Policies\n(.*?)^### ", (ROOT / "README.md").read_text())
    assert text and set(re.findall(r"(?m)^\| `([\w-]+)` \|", text[1])) == set(POLICIES)
    (code,) = re.findall(r"```python\n(.*?)```", text[1], re.S)
    code, smaller = re.subn("steps=1500", "steps=8", code)
    assert smaller == 1
    result = subprocess.run(
        [sys.executable, "-c", WALK + code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0 and (tmp_path / "rollouts.png").read_bytes().startswith(b"\x89PNG"), result.stderr
