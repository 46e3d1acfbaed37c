"""The course as a static site: every notebook is run once and becomes a page that loads nothing from elsewhere.

    python docs/book.py [NOTEBOOK ...] [--out build/book]

Sizes are those of ``AUTONERF_LAB_PRESET``. What a run brought is kept beside the pages until the notebook, the package,
its apartments or the preset change, so that an interrupted build goes on, and another one only writes the pages.
"""

import argparse
import hashlib
import html
import os
import tempfile
from pathlib import Path
from typing import Any

import nbformat
from jinja2 import pass_context
from latex2mathml.converter import convert
from nbclient import NotebookClient
from nbconvert import HTMLExporter
from nbconvert.filters.markdown_mistune import IPythonRenderer, MarkdownWithMath
from nbformat import NotebookNode

from autonerf_lab import preset
from autonerf_lab.utils import storage

ROOT = Path(__file__).resolve().parents[1]
CELL_TIMEOUT = 3600  # seconds
GIF = "image/gif"
WIDGET = "application/vnd.jupyter.widget-view+json"
START = """# AutoNeRF Lab: the course

A robot explores an apartment that it has never seen, and its walk becomes a neural map. These pages show the notebooks
of the course as they ran, with preset `{preset}`. Sliders and buttons need the notebook itself: `make lab` opens it.

"""


def state_of_package() -> bytes:
    """A hash of everything that a notebook computes with."""
    files = [path for name in ("autonerf_lab", "data") for path in sorted((ROOT / name).rglob("*")) if path.is_file()]
    state = hashlib.sha256(preset().name.encode())
    for path in files:
        if "__pycache__" not in path.parts:
            state.update(str(path.relative_to(ROOT)).encode() + hashlib.sha256(path.read_bytes()).digest())
    return state.digest()


def executed(path: Path, folder: Path, state: bytes) -> NotebookNode:
    """The notebook with its outputs, from the folder where it has been run before."""
    kept = folder / f"{path.stem}-{hashlib.sha256(state + path.read_bytes()).hexdigest()[:16]}.ipynb"
    if not kept.exists():
        print(f"running {path.name}", flush=True)
        notebook = nbformat.read(path, as_version=4)
        environment = {name: value for name, value in os.environ.items() if name != "MPLBACKEND"}
        with tempfile.TemporaryDirectory() as place:
            client = NotebookClient(
                notebook,
                timeout=CELL_TIMEOUT,
                kernel_name="python3",
                store_widget_state=False,
                coalesce_streams=True,  # of a progress bar, its end
                resources={"metadata": {"path": place}},
            )
            client.execute(env=environment)
        for old in folder.glob(f"{path.stem}-*.ipynb"):
            old.unlink()
        storage.write_bytes(kept, nbformat.writes(notebook).encode())
    return nbformat.read(kept, as_version=4)


def for_pages(notebook: NotebookNode) -> NotebookNode:
    """What is there without a kernel: a widget's picture without its controls, and films, which nbconvert omits."""
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.outputs = [output for output in cell.outputs if WIDGET not in output.get("data", {})]
            for output in cell.outputs:
                if GIF in output.get("data", {}):
                    source = f"data:{GIF};base64,{output.data[GIF].strip()}"
                    shown = {"alt": "", **output.metadata.get(GIF, {}), "src": source}  # alt and width, as in Jupyter
                    attributes = " ".join(f'{name}="{html.escape(str(value))}"' for name, value in shown.items())
                    output.data["text/html"] = f"<img {attributes}>"
    return notebook


def title_of(notebook: NotebookNode) -> str:
    """The first heading."""
    return str(notebook.cells[0].source.splitlines()[0].lstrip("# "))


class Renderer(IPythonRenderer):
    """Markdown whose formulas are MathML, which browsers draw by themselves."""

    def block_math(self, body: str) -> str:
        """A formula of its own."""
        return convert(body, display="block")

    def inline_math(self, body: str) -> str:
        """A formula in a line."""
        return convert(body)


class Pages(HTMLExporter):
    """nbconvert's pages with links to the next one, and without what they would load."""

    def __init__(self) -> None:
        super().__init__(template_name="book", extra_template_basedirs=[str(ROOT / "docs")])

    @pass_context
    def markdown2html(self, context: Any, source: str) -> str:
        """HTML of a cell of text."""
        return MarkdownWithMath(renderer=Renderer(escape=False)).render(source)

    def page(self, notebook: NotebookNode, **links: tuple[str, str] | None) -> bytes:
        """One page; ``previous`` and ``next`` are an address and a title each."""
        resources = {"metadata": {"name": title_of(notebook)}, "links": links}
        return self.from_notebook_node(notebook, resources=resources)[0].encode()


def build(notebooks: list[Path], out: Path) -> None:
    """Run what is not yet run, and write all pages."""
    folder, state, pages = out / ".executed", state_of_package(), Pages()
    folder.mkdir(parents=True, exist_ok=True)
    book = {f"{path.stem}.html": for_pages(executed(path, folder, state)) for path in notebooks}
    contents = [(name, title_of(notebook)) for name, notebook in book.items()]
    lines = "".join(f"- [{name[:2]} {title}]({name})\n" for name, title in contents)
    start = nbformat.v4.new_notebook(cells=[nbformat.v4.new_markdown_cell(START.format(preset=preset().name) + lines)])
    storage.write_bytes(out / "index.html", pages.page(start, previous=None, next=contents[0]))
    around = [None, *contents, None]
    for k, (name, notebook) in enumerate(book.items()):
        storage.write_bytes(out / name, pages.page(notebook, previous=around[k], next=around[k + 2]))
    print(out / "index.html")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("notebooks", nargs="*", type=Path, help="default: all of the course")
    parser.add_argument("--out", type=Path, default=ROOT / "build/book")
    arguments = parser.parse_args()
    build(arguments.notebooks or sorted((ROOT / "notebooks").glob("*.ipynb")), arguments.out)
