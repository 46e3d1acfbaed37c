"""What all tests share: no network beyond this machine, no display."""

import os
import runpy
from pathlib import Path

import pytest
from installed_plugins import Site

import autonerf_lab  # noqa: F401 - sets OMP_WAIT_POLICY, which torch reads when it loads; a test may load torch first

NO_NETWORK = Path(__file__).parent / "no_network"
collect_ignore = ["no_network"]

runpy.run_path(str(NO_NETWORK / "sitecustomize.py"))
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(NO_NETWORK), os.environ.get("PYTHONPATH")]))
os.environ["MPLBACKEND"] = "Agg"

# Tests that train, render for long, open a browser or run a notebook; `make test-fast` leaves them out.
SLOW = (
    *("benchmark", "browser", "cli", "conformance/test_models.py", "course", "integration", "nerf/test_fit.py"),
    *(
        "nerf/test_photographs.py",
        "nerf/test_same_bits.py",
        "pipeline",
        "training",
        "viz",
        "evaluators/test_finetuning.py",
    ),
    *("evaluators/test_navigation.py", "evaluators/test_upstream.py", "evaluators/test_walls.py"),
    "bundle_adjustment/test_refine.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark tests by their folder: ``-m "not slow"``, ``-m browser``; slow tests run first.

    Two workers share short tests evenly at the end; with a long one there, the other worker would wait for it.
    """
    root = Path(__file__).parent
    assert all((root / name).exists() for name in SLOW)
    for item in items:
        if item.path.is_relative_to(root):
            folder = item.path.relative_to(root)
            if folder.parts[0] in ("browser", "conformance", "integration"):
                item.add_marker(folder.parts[0])
            if any(item.path.is_relative_to(root / name) for name in SLOW):
                item.add_marker("slow")
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)  # stable: a file stays together


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Site:
    (tmp_path / "site").mkdir()
    monkeypatch.syspath_prepend(tmp_path / "site")
    return Site(tmp_path / "site")
