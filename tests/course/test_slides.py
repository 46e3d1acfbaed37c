"""Slides and web pages of the notebooks: their structure, and the alternative texts of figures."""

import tomllib
from importlib import import_module
from pathlib import Path

import nbformat
import pytest
from bs4 import BeautifulSoup
from nbconvert.exporters import HTMLExporter
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook, new_output

from autonerf_lab.course.notebooks import notebook_paths
from autonerf_lab.course.slides import CourseHtml, CourseSlides, slide_types

PNG = "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAQAAAC1HAwCAAAAC0lEQVR42mNk+A8AAQUBAScY42YAAAAASUVORK5CYII="
ALT = 'Figure: map of "val-0", <metres>.'


def figure(metadata):
    data = {"image/png": PNG, "text/plain": "<Figure>"}
    return new_code_cell("plot()", outputs=[new_output("display_data", data=data, metadata=metadata)])


NOTEBOOK = new_notebook(
    cells=[
        new_markdown_cell("# Title"),
        new_code_cell("import numpy as np"),
        new_markdown_cell("## 1. Part"),
        figure({"image/png": {"alt": ALT}}),
        new_markdown_cell("**Exercise**"),
        new_code_cell('course.solution("00-opacity")'),
        figure({}),
        new_code_cell("assert True"),
    ]
)


def alternative_texts(page):
    return [image.get("alt") for image in BeautifulSoup(page, "html.parser").select("img")]


@pytest.mark.parametrize("exporter", [CourseHtml, CourseSlides])
def test_alternative_texts_survive_nbconvert(exporter):
    page, _ = exporter().from_notebook_node(NOTEBOOK)
    assert alternative_texts(page) == [ALT, "No description has been provided for this image"]


def test_nbconvert_alone_loses_them():
    page, _ = HTMLExporter().from_notebook_node(NOTEBOOK)
    assert set(alternative_texts(page)) == {"No description has been provided for this image"}


def test_slide_types():
    assert slide_types(NOTEBOOK.cells) == ["slide", "skip", "slide", "subslide", "subslide", "skip", "subslide", "skip"]
    given = new_notebook(cells=[new_markdown_cell("text", metadata={"slideshow": {"slide_type": "notes"}})])
    assert slide_types(given.cells) == ["notes"]


@pytest.mark.parametrize("path", notebook_paths(), ids=lambda path: path.stem)
def test_every_notebook_has_slides(path):
    cells = nbformat.read(path, as_version=4).cells
    headings = sum(cell.source.startswith(("# ", "## ")) for cell in cells if cell.cell_type == "markdown")
    assert slide_types(cells).count("slide") == headings >= 5


def test_slides_show_no_solutions():
    notebook = nbformat.read(notebook_paths()[0], as_version=4)
    page, _ = CourseSlides().from_notebook_node(notebook)
    text = BeautifulSoup(page, "html.parser").get_text()
    assert "course.check" in text and "course.solution" not in text
    assert notebook == nbformat.read(notebook_paths()[0], as_version=4), "the notebook is unchanged"


def test_the_exporters_are_entry_points():
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    entries = project["entry-points"]["nbconvert.exporters"]
    classes = [getattr(import_module(module), name) for module, _, name in (e.partition(":") for e in entries.values())]
    assert classes == [CourseHtml, CourseSlides]
