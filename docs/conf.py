"""Settings of the documentation site. ``make docs`` builds it without a network, with warnings as errors.

Notebooks are shown without outputs. ``make docs ARGS="-D nb_execution_mode=cache"`` runs them first, with the preset of
``AUTONERF_LAB_PRESET``, and saves the outputs in ``build/notebook-cache`` until the code of a notebook changes. Remove
that folder after a change of the package.
"""

import importlib
import inspect
import json
import os
import pkgutil
import re
import shutil
import tomllib
import warnings
from pathlib import Path
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.addnodes import toctree
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

import autonerf_lab
from autonerf_lab import course

ROOT = Path(__file__).resolve().parents[1]
# Pages whose text is a file elsewhere in the repository.
PAGES = {
    "ablation": "benchmarks/ablation.md",
    "changelog": "CHANGELOG.md",
    "committed_grid": "benchmarks/results/README.md",
    "committed_tables": "benchmarks/results/val-0.1/tables.md",
    "house_tables": "benchmarks/results/houses/tables.md",
    "finetuning_tables": "benchmarks/results/finetuning/tables.md",
    "test_models": "benchmarks/results/test-models/tables.md",
    "test_tables": "benchmarks/results/test/tables.md",
    "variant_tables": "benchmarks/results/variants/tables.md",
    "contributing": "CONTRIBUTING.md",
    "evaluator_plugin": "examples/evaluator_plugin/README.md",
    "policy_plugin": "examples/policy_plugin/README.md",
    "reward_plugin": "examples/reward_plugin/README.md",
    "segmenter_plugin": "examples/segmenter_plugin/README.md",
}
_PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

project = "AutoNeRF Lab"
author = "The AutoNeRF Lab authors"
project_copyright = f"2026, {author}"
version = release = _PROJECT["version"]

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "myst_nb",
    "sphinx_copybutton",
]
if not tags.has("without_sources"):  # noqa: F821 - Sphinx defines it
    extensions.append("sphinx.ext.viewcode")
templates_path = ["_templates"]
exclude_patterns = ["_templates"]
suppress_warnings = ["ref.python"]  # a short name in an annotation that several modules define

html_theme = "furo"
html_title = f"{project} {version}"
html_math_renderer = "mathml"
html_theme_options = {"source_repository": _PROJECT["urls"]["Repository"] + "/"} if "urls" in _PROJECT else {}
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

autosummary_generate = True
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False

myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3
nb_execution_mode = "off"
nb_execution_timeout = 3600  # seconds for a cell
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_cache_path = str(ROOT / "build/notebook-cache")
nb_ipywidgets_js: dict[str, dict[str, str]] = {}  # nothing is loaded from elsewhere
nb_mime_priority_overrides = [
    ("html", "application/vnd.jupyter.widget-view+json", None),  # a widget needs a kernel: show its figure instead
    ("html", "image/gif", 5),
]

warnings.simplefilter("ignore")  # of Python, by packages that are imported; Sphinx's own are errors


def public_names() -> tuple[dict[str, list[str]], dict[str, list[str]]]:
    """Return the public names of each package: those its ``__init__`` defines, and paths of those it imports."""
    own, imported = {}, {}
    for module in pkgutil.walk_packages(autonerf_lab.__path__, "autonerf_lab."):
        package = importlib.import_module(module.name) if module.ispkg else None
        if hasattr(package, "__all__"):
            own[module.name], imported[module.name] = [], []
            for member in (getattr(package, name) for name in package.__all__):
                if inspect.isfunction(member) or inspect.isclass(member):
                    if member.__module__ == module.name:
                        own[module.name].append(member.__name__)
                    else:
                        imported[module.name].append(f"{member.__module__}.{member.__qualname__}")
    members = [getattr(autonerf_lab, name) for name in autonerf_lab.__all__]
    imported["autonerf_lab"] = [f"{m.__module__}.{m.__qualname__}" for m in members if not inspect.ismodule(m)]
    return own | {"autonerf_lab": []}, imported


_OWN, _IMPORTED = public_names()
_NAVIGATION: dict[tuple[Any, ...], str] = {}  # HTML of the navigation by folder of the page and options
autosummary_context = {
    "own": _OWN,
    "public": {package: names for package, names in _IMPORTED.items() if names},
    # Compiled loops, answers to exercises and commands: not for use from Python.
    "hidden": ["autonerf_lab.nerf.kernels", "autonerf_lab.course.exercises", "autonerf_lab.cli"],
}


def copy_notebooks() -> None:
    """Copy the notebooks into the source folder, where Sphinx looks for pages."""
    folder = ROOT / "docs/notebooks"
    folder.mkdir(exist_ok=True)
    sources = {path.name: path for path in (ROOT / "notebooks").glob("*.ipynb")}
    for copy in folder.glob("*.ipynb"):
        if copy.name not in sources:
            copy.unlink()
    for name, path in sources.items():
        shutil.copy2(path, folder / name)


def exercise_page() -> str:
    """Return the objectives, minutes, exercises, points and hints of all notebooks, read from them and the checker."""
    lines = []
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        text = json.loads(path.read_text(encoding="utf-8"))["cells"][0]["source"]
        title, *rest = "".join(text).splitlines()
        facts = " ".join(rest).partition("**You will learn**")[2].partition("**Run it**")[0]
        goals, _, needs = facts.partition("**You need**")
        needs, _, minutes = needs.partition("**Minutes**:")
        exercises = [one for name, one in course.EXERCISES.items() if name[:2] == path.name[:2]]
        points = sum(len(one.cases) for one in exercises)
        lines += [f"## {path.name[:2]} {title.removeprefix('# ')}", "", f"* **Objectives**: {goals.strip()}"]
        lines += [f"* **Prerequisites**: {needs.strip()}", f"* **Minutes**: {minutes.partition('.')[0].strip()}"]
        lines += [f"* **Points**: {points}", ""]
        for one in exercises:
            lines += [f"**`{one.name}`**, {len(one.cases)} points. {one.question}", ""]
            lines += [*(f"* {mistake.hint}" for mistake in one.mistakes), ""]
    return "\n".join(lines)


def read_page(app: Sphinx, docname: str, source: list[str]) -> None:
    """Replace a page of ``PAGES`` by its file, under its own title if the file has none, and adapt the links."""
    page = Path(app.env.doc2path(docname))
    path = ROOT / PAGES.get(docname, page)
    if path.suffix == ".md":
        app.env.note_dependency(path)
        text = path.read_text() if docname in PAGES else source[0]
        if not text.startswith("# "):
            text = source[0].splitlines()[0] + "\n\n" + text
        if docname == "exercises":
            text += "\n" + exercise_page()
        source[0] = re.sub(r"\]\(([^)\s]+)\)", lambda m: f"]({_target(m[1], path.parent, page.parent)})", text)


def _target(link: str, base: Path, page: Path) -> str:
    """Return a link of a file in ``base`` as seen from a page in ``page``."""
    if re.match(r"[a-z]+:|#", link):
        return link
    name, sharp, anchor = link.partition("#")
    path = (base / name).resolve()
    docname = {ROOT / file: docname for docname, file in PAGES.items()}.get(path)
    return os.path.relpath(ROOT / f"docs/{docname}.md" if docname else path, page) + sharp + anchor


def inline_math(translator: HTML5Translator, node: nodes.math) -> None:
    """Write a formula as MathML, which browsers draw by themselves."""
    translator.body.append(convert(node.astext()))
    raise nodes.SkipNode


def block_math(translator: HTML5Translator, node: nodes.math_block) -> None:
    """Write a displayed formula as MathML."""
    translator.body.append(f'<div class="math">{convert(node.astext(), display="block")}</div>')
    raise nodes.SkipNode


def leave_modules_out(app: Sphinx, doctree: nodes.document) -> None:
    """Remove the modules of the reference from the navigation; the tables of the packages link them.

    The side bar of every page would list them all, which also takes most of the time of a build.
    """
    if app.env.docname.startswith("api/"):
        for node in [*doctree.findall(toctree)]:
            node.parent.remove(node)


def share_navigation(app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: nodes.document) -> None:
    """Render the navigation once for all pages of a folder of the reference: it contains none of them."""
    if page.startswith(("api/generated/", "_modules/")):
        render = context["toctree"]

        def toctree(**options: Any) -> str:
            key = (os.path.dirname(page), *sorted(options.items()))
            if key not in _NAVIGATION:
                _NAVIGATION[key] = render(**options)
            return _NAVIGATION[key]

        context["toctree"] = toctree


def setup(app: Sphinx) -> None:
    """Prepare the source folder, and register what is above."""
    shutil.rmtree(ROOT / "docs/api/generated", ignore_errors=True)  # no pages of modules that no longer exist
    copy_notebooks()
    app.connect("source-read", read_page)
    app.connect("doctree-read", leave_modules_out, priority=100)  # before Sphinx collects the navigation
    app.connect("html-page-context", share_navigation, priority=100)  # before the theme asks for the navigation
    app.add_html_math_renderer("mathml", inline_renderers=(inline_math, None), block_renderers=(block_math, None))
