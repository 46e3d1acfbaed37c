"""Exporters of nbconvert for a lecture: slides and web pages that keep the alternative texts of figures.

They are entry points of nbconvert::

    jupyter nbconvert --execute --to autonerf-slides notebooks/06_nerf_from_scratch.ipynb
    jupyter nbconvert --execute --to autonerf-html notebooks/06_nerf_from_scratch.ipynb

The templates of nbconvert replace the alternative text of a figure by "No description has been provided".
"""

import copy
from typing import Any

from nbconvert.exporters import HTMLExporter, SlidesExporter
from traitlets import Bool, default

_SKIPPED = ("course.solution(",)  # the students look for the solution themselves
_KINDS = {"png": "image/png", "jpg": "image/jpeg"}
_WITH_ALT = """\
{%% block data_%(name)s scoped %%}
{%%- set alt = output | get_metadata('alt', '%(kind)s') -%%}
{%%- set shown = super() -%%}
{{ shown if alt is none else shown | replace('<img ', '<img alt="' ~ (alt | escape_html) ~ '" ', 1) }}
{%%- endblock %%}
"""
TEMPLATE = "{%- extends 'index.html.j2' -%}\n" + "".join(
    _WITH_ALT % {"name": name, "kind": kind} for name, kind in _KINDS.items()
)


def slide_types(cells: list[Any]) -> list[str]:
    """Return the slide type of each cell of a notebook.

    A heading starts a slide. Text and code follow below it, one cell per slide. The imports, the solutions and the
    final check are left out. A type in the metadata of a cell is kept.

    Args:
        cells: Cells of nbformat 4.
    """
    code = [index for index, cell in enumerate(cells) if cell.cell_type == "code"]
    types = []
    for index, cell in enumerate(cells):
        if given := cell.metadata.get("slideshow", {}).get("slide_type"):
            types.append(given)
        elif cell.cell_type == "markdown":
            types.append("slide" if cell.source.startswith(("# ", "## ")) else "subslide")
        else:
            left_out = index in (code[0], code[-1]) or cell.source.startswith(_SKIPPED)
            types.append("skip" if left_out else "subslide")
    return types


class CourseHtml(HTMLExporter):
    """Web page of a notebook with the alternative texts of its figures."""

    export_from_notebook = "Web page with alternative texts"

    @default("raw_template")
    def _with_alternative_texts(self) -> str:
        return TEMPLATE


class CourseSlides(SlidesExporter):
    """Slides of a notebook (reveal.js) with the alternative texts of its figures.

    Slides taller than the screen scroll.
    """

    export_from_notebook = "Slides with alternative texts"
    reveal_scroll = Bool(True, help="Scroll slides that are taller than the screen.").tag(config=True)

    @default("raw_template")
    def _with_alternative_texts(self) -> str:
        return TEMPLATE

    def from_notebook_node(self, nb: Any, resources: Any = None, **kw: Any) -> Any:
        """Set the slide types of the cells, then convert."""
        notebook = copy.deepcopy(nb)
        for cell, kind in zip(notebook.cells, slide_types(notebook.cells), strict=True):
            cell.metadata["slideshow"] = {"slide_type": kind}
        return super().from_notebook_node(notebook, resources, **kw)
