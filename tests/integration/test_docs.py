"""Documentation site: it builds without warnings or network, is complete, and loads nothing from elsewhere."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from made_once import made_once

import autonerf_lab as lab

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:

    def build(out: Path) -> None:
        # without the pages of source files, which take a quarter of the time
        command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-t", "without_sources", "docs", out]
        result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        assert result.returncode == 0, result.stderr

    return made_once(tmp_path_factory, "site", build)


def test_the_site_is_complete(site: Path) -> None:
    sources = [*(ROOT / "docs").glob("*.md"), *(ROOT / "notebooks").glob("*.ipynb")]
    pages = {path.stem for path in site.rglob("*.html")}
    assert {path.stem for path in sources} <= pages
    reference = (site / "api/generated/autonerf_lab.html").read_text()
    assert all(f'.{name}"' in reference for name in lab.__all__ if callable(getattr(lab, name)))
    assert "Added" in (site / "changelog.html").read_text(), "the text of CHANGELOG.md is included"


def test_pages_load_nothing_from_elsewhere(site: Path) -> None:
    for path in site.rglob("*.html"):
        page = path.read_text()
        assert not re.search(r'<(script|img|iframe|link)[^>]*(src|href)="(https?:)?//', page), path.name


def test_formulas_are_mathml(site: Path) -> None:
    page = (site / "notebooks/06_nerf_from_scratch.html").read_text()
    assert page.count("<math") > 5 and "\\begin" not in page.partition("<article")[2]
