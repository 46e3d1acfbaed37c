"""What all tests share: no network beyond this machine, no display."""

import os
import runpy
from pathlib import Path

import pytest
from installed_plugins import Site

NO_NETWORK = Path(__file__).parent / "no_network"
collect_ignore = ["no_network"]

runpy.run_path(str(NO_NETWORK / "sitecustomize.py"))
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(NO_NETWORK), os.environ.get("PYTHONPATH")]))
os.environ["MPLBACKEND"] = "Agg"


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Site:
    (tmp_path / "site").mkdir()
    monkeypatch.syspath_prepend(tmp_path / "site")
    return Site(tmp_path / "site")
