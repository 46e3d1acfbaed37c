"""Commands interrupted early, with little memory, or on one core: one line, an exit code, nothing half written."""

import os
import subprocess
import sys

import pytest

from autonerf_lab.scenes import generate_apartment
from autonerf_lab.scenes.spec import dumps

# Press Ctrl-C when a module is imported for the first time: the first seconds of a command are imports.
INTERRUPTED = """
import importlib.abc, signal, sys
class Interrupt(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == MODULE:
            signal.raise_signal(signal.SIGINT)
signal.signal(signal.SIGINT, signal.default_int_handler)  # a process in the background would ignore it
import autonerf_lab.cli
sys.meta_path.insert(0, Interrupt())
sys.exit(autonerf_lab.cli.main())
"""
LONG = {
    "demo": "demo --preset smoke --out {out}",
    "explore": "explore --preset smoke --scene dev-0 --out {out}",
    "train-policy": "train-policy --policy e2e-cur --frames 400 --out {out}",
    "bench": "bench run --preset smoke --policies random --scenes dev-0 --out {out}",
    "train-segmentation": "train-segmentation --out {out}",
}


def run(arguments, code=None, limit=None):
    """Run a command in a process, with a limit of its address space in bytes."""
    import resource

    start = ["-c", code] if code else ["-m", "autonerf_lab.cli"]
    return subprocess.run(
        [sys.executable, *start, *arguments],
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=limit and (lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit))),
    )


@pytest.mark.parametrize(
    ("command", "module"),
    [
        *((name, "autonerf_lab.cli.command_line") for name in LONG),
        *(pytest.param(name, "numba", marks=pytest.mark.slow) for name in ("demo", "explore", "train-policy")),
    ],
)
def test_ctrl_c_while_a_command_loads(command, module, tmp_path):
    result = run(LONG[command].format(out=tmp_path / "out").split(), INTERRUPTED.replace("MODULE", repr(module)))
    assert result.returncode == 130
    assert result.stderr == "\ninterrupted: run the same command again to continue\n" and not result.stdout
    assert not [path for path in tmp_path.rglob("*") if path.is_file() and path.name != "run.json"]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs limits of the address space")
@pytest.mark.slow
@pytest.mark.parametrize("megabytes", [300, 600])
def test_little_memory_is_a_one_line_error(megabytes, tmp_path):
    command = LONG["demo"].format(out=tmp_path / "out").split()
    result = run(command, limit=megabytes << 20)
    assert result.returncode == 1
    # With one core, the progress bar of the exploration comes before.
    (line,) = [line for line in result.stderr.splitlines() if line.strip() and "step/s]" not in line]
    assert line.startswith("error: out of memory")


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="needs the choice of cores")
def test_one_core_gives_the_same_scene(tmp_path):
    code = "import os, sys, autonerf_lab.cli\nos.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n"
    code += "sys.exit(autonerf_lab.cli.main())"
    result = run(["scenes", "generate", "7", "--out", str(tmp_path / "a.json")], code)
    assert (result.returncode, result.stderr) == (0, "")
    scene = generate_apartment(7)
    assert scene.spec is not None and (tmp_path / "a.json").read_text() == dumps(scene.spec)
