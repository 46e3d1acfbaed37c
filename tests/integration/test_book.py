"""The course as a site: linked pages that load nothing, and notebooks that are run once."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import nbformat
import pytest
from chromium import open_page, wait

ROOT = Path(__file__).parents[2]
FIGURE = """
import io
import os
from IPython.display import Image as Show
from PIL import Image
from matplotlib import pyplot as plt
import autonerf_lab.viz
import ipywidgets
open(os.environ["RUNS"], "a").write("ran\\n")
fig, ax = plt.subplots()
ax.set_title("a curve")
display(ipywidgets.IntSlider())
Image.new("RGB", (2, 2)).save(film := io.BytesIO(), "gif")
display(Show(film.getvalue(), format="gif", width=20, alt="A film <here>"))
"""


def write(path: Path, *cells: tuple[str, str]) -> Path:
    make = {"text": nbformat.v4.new_markdown_cell, "code": nbformat.v4.new_code_cell}
    nbformat.write(nbformat.v4.new_notebook(cells=[make[kind](source) for kind, source in cells]), path)
    return path


@pytest.fixture
def notebooks(tmp_path: Path) -> list[Path]:
    formula = "# One & all\n\nThe ray $r(t) = o + t\\,d$ and $$\\begin{pmatrix} 1 & x_2 \\end{pmatrix} < 3.$$"
    return [
        write(tmp_path / "00_one.ipynb", ("text", formula), ("code", FIGURE)),
        write(
            tmp_path / "01_two.ipynb",
            ("text", "# Two"),
            ("code", "import os; print(os.getenv('AUTONERF_LAB_PRESET'))"),
        ),
    ]


@pytest.fixture
def build(tmp_path: Path, notebooks: list[Path]) -> Callable[[], str]:
    def run() -> str:
        env = {**os.environ, "AUTONERF_LAB_PRESET": "smoke", "RUNS": str(tmp_path / "runs")}
        command = [sys.executable, ROOT / "docs/book.py", *notebooks, "--out", tmp_path / "book"]
        result = subprocess.run(command, env=env, capture_output=True, text=True, check=False, timeout=240)
        return result.stdout if result.returncode == 0 else result.stderr

    return run


def test_pages_are_linked_and_load_nothing(build, tmp_path, notebooks):
    book = tmp_path / "book"
    assert "index.html" in build()
    pages = {path.name: path.read_text() for path in book.glob("*.html")}
    assert set(pages) == {"index.html", "00_one.html", "01_two.html"}
    for name, page in pages.items():
        links = [link for link in re.findall(r'<a [^>]*href="([^"]+)"', page) if not link.startswith("#")]
        assert links and all((book / link).exists() for link in links), name
        assert not re.search(r'<(script|img|iframe|link)[^>]*(src|href)="(?!data:)', page), name
    one, two = pages["00_one.html"], pages["01_two.html"]
    assert 'href="01_two.html" rel="next">Two →<' in one and 'href="00_one.html" rel="prev">← One &amp; all<' in two
    assert "<title>One &amp; all</title>" in one and one.count("<math") == 2 and "\\begin" not in one
    assert 'alt="Figure: a curve."' in one and "IntSlider(" not in one
    assert 'alt="A film &lt;here&gt;" src="data:image/gif;base64,R0lG' in one
    assert "<pre>smoke\n</pre>" in two

    with open_page(tmp_path) as page:
        page.send("Page.navigate", url=(book / "00_one.html").as_uri())
        wait("the page is drawn", lambda: page.js("document.readyState == 'complete' && document.images.length"))
        assert page.js("document.images[0].naturalWidth") == 2, "the film is drawn"
        assert page.js("document.images[0].clientWidth") == 20, "as large as in Jupyter"
        assert page.js("document.images[1].naturalWidth") > 300
        assert page.js("document.querySelector('mtr').getBoundingClientRect().width") > 10, "the formula is drawn"
        assert {url.split(":")[0] for url in page.requests} <= {"file", "data"} and page.complaints == []


def test_what_is_run_is_kept_and_what_is_changed_is_run_again(build, tmp_path, notebooks):
    runs = tmp_path / "runs"
    nbformat.write(nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("1 / 0")]), notebooks[1])
    assert "ZeroDivisionError" in build(), "the first was run before the second failed"
    write(notebooks[1], ("text", "# Two"))
    assert build() == f"running 01_two.ipynb\n{tmp_path / 'book/index.html'}\n"
    assert runs.read_text() == "ran\n"
    write(notebooks[0], ("text", "# One"), ("code", FIGURE + "1"))
    assert "running 00_one.ipynb" in build() and runs.read_text() == "ran\nran\n"
    assert len(list((tmp_path / "book/.executed").iterdir())) == 2
