"""Notebooks in JupyterLab in a browser: run all cells, move a slider, click on a map."""

import base64
import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import chromium
import nbformat
import numpy as np
import pytest
from chromium import Page, open_lab, open_page, wait
from PIL import Image
from toy_scene import two_rooms

from autonerf_lab.exploration import explore
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.simulator import Simulator

RUN_ALL = "notebook:run-all-cells"
PANEL = "[...jupyterapp.shell.widgets('main')].find(widget => widget.context)"
KERNEL = f"{PANEL}?.context.sessionContext.session?.kernel"
OUTPUTS = f"{PANEL}.content.widgets.flatMap(cell => cell.model.toJSON().outputs ?? [])"
SLIDER = "document.querySelector('.jp-OutputArea-output .widget-slider .noUi-base')"
# The outputs of the tour, of a short trajectory and without a field.
TOUR = (
    """
import matplotlib.pyplot as plt
from IPython.display import display

import autonerf_lab as lab
from autonerf_lab import course
from autonerf_lab.scenes import plot_scene
from autonerf_lab.types import Score
from autonerf_lab.viz import figures

scene = lab.load_scene("dev-0")
plot_scene(scene, plt.subplots(figsize=(8, 6))[1])
scene
""",
    """
trajectory = lab.load_trajectory("trajectory")
display(lab.play(trajectory).widget())
figures.trajectory_frames(trajectory)
""",
    'lab.Scores([Score("rendering", "psnr", 22.5, "dB", n=8)])',
    'course.check("00-opacity", lambda sigma, delta: sigma)',
    'course.solution("00-opacity")',
)
ROUTE = """
from autonerf_lab.course.widgets.exploration import Route
from autonerf_lab.geometry import planar_pose
from autonerf_lab.mapping import empty_map

known = empty_map(planar_pose(0, 0, 0), size=100)
known.explored[:] = True
Route(known, (-2.0, -1.5), (2.0, -1.5))
"""
IMAGE = f"{SLIDER}.closest('.jp-OutputArea-output').querySelector('img.widget-image')"


def run_all(page: Page, address: str) -> None:
    """Open a notebook, run all cells and wait for the last one."""
    page.send("Page.navigate", url=address)
    wait("the kernel starts", lambda: page.js(f"globalThis.jupyterapp && {KERNEL}?.status == 'idle'"), 120)
    # open3d imports dash, which asks for its JupyterLab extension; it is not needed here
    page.js(f"{KERNEL}.registerCommTarget('dash', () => {{}})")
    page.js(f"jupyterapp.shell.activateById({PANEL}.id)")
    wait("the notebook is in front", lambda: page.js(f"jupyterapp.commands.isEnabled('{RUN_ALL}')"))
    page.js(f"jupyterapp.commands.execute('{RUN_ALL}').finally(() => document.finished = true), 0")
    wait("all cells are run", lambda: page.js("document.finished"), 400)


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, str]]:
    """Yield the folder of a JupyterLab server, and the URL with ``%s`` for the notebook."""
    folder = tmp_path_factory.mktemp("notebooks")
    with open_lab(folder) as address:
        yield folder, address


@contextmanager
def finished(lab: tuple[Path, str], folder: Path, *cells: str) -> Iterator[Page]:
    """Yield the page of a notebook of these cells after they ran without error and warning."""
    kernel = {"kernelspec": {"name": "python3", "display_name": "Python 3"}}  # otherwise JupyterLab asks for a kernel
    notebook = nbformat.v4.new_notebook(cells=[*map(nbformat.v4.new_code_cell, cells)], metadata=kernel)
    name, address = f"{folder.name}.ipynb", lab[1]
    nbformat.write(notebook, lab[0] / name)
    with open_page(folder) as page:
        run_all(page, address % name)
        outputs = page.js(OUTPUTS)
        assert not [output for output in outputs if output["output_type"] == "error"]
        assert "Warning" not in "".join(str(output.get("text")) for output in outputs if output.get("name") == "stderr")
        yield page
        outside = [url for url in page.requests if not url.startswith((address.split("/lab/")[0], "data:", "blob:"))]
        assert outside == [] and page.errors == []


def image_pixels(page: Page) -> np.ndarray:
    """Return the pixels of the image beside the slider, as the browser shows them."""
    data = page.js(
        f"""(async () => {{
            const bytes = new Uint8Array(await (await fetch({IMAGE}.src)).arrayBuffer());
            return btoa(Array.from(bytes, byte => String.fromCharCode(byte)).join(""));
        }})()"""
    )
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB"))


def test_slider_changes_the_image(lab: tuple[Path, str], tmp_path: Path) -> None:
    sim = Simulator(two_rooms(), Intrinsics.from_fov(24, 24), supersample=1)
    explore(sim, "frontier", steps=13, seed=1, progress=False).save(lab[0] / "trajectory")
    with finished(lab, tmp_path, *TOUR) as page:
        widths = "[...document.querySelectorAll('.jp-RenderedImage img')].map(image => image.naturalWidth)"
        images = wait("the figures are shown", lambda: page.js(f"{widths}.length >= 2 && {widths}"))
        assert min(images) > 300
        wait("the image is shown", lambda: page.js(f"{SLIDER} && {IMAGE}.naturalWidth"))
        page.js(f"{SLIDER}.scrollIntoView({{block: 'center'}})")
        before = image_pixels(page)
        x, y, width, height = page.js(f"(b => [b.x, b.y, b.width, b.height])({SLIDER}.getBoundingClientRect())")
        page.click(x + 0.8 * width, y + 0.5 * height)
        wait("the image changes", lambda: not np.array_equal(image_pixels(page), before))
        assert image_pixels(page).std() > 0


def test_clicks_on_a_map_move_start_and_goal_in_turn(lab: tuple[Path, str], tmp_path: Path) -> None:
    with finished(lab, tmp_path, ROUTE) as page:
        wait("the image is shown", lambda: page.js(f"{SLIDER} && {IMAGE}?.naturalWidth"))
        readouts = f"[...{SLIDER}.closest('.jp-OutputArea-output').querySelectorAll('.widget-readout')]"
        values = f"{readouts}.map(shown => parseFloat(shown.textContent.replace('−', '-')))"
        assert page.js(values)[:4] == [-2.0, -1.5, 2.0, -1.5]
        assert page.js(f"{IMAGE}.clientWidth <= {IMAGE}.naturalWidth"), "a stretched image is blurred"
        box = f"{IMAGE}.parentElement"
        assert page.js(f"{box}.scrollWidth == {box}.clientWidth"), "no horizontal scrolling"
        for first in (0, 2):
            before = image_pixels(page)
            page.js(f"{IMAGE}.scrollIntoView({{block: 'center'}})")
            x, y, width, height = page.js(f"(b => [b.x, b.y, b.width, b.height])({IMAGE}.getBoundingClientRect())")
            page.click(x + 0.5 * width, y + (0.4 + 0.1 * first) * height)
            wait("the image changes", lambda before=before: not np.array_equal(image_pixels(page), before))
            found = page.js(values)[first : first + 2]
            assert abs(found[0]) < 0.5 and found[1] == pytest.approx(0.5 - first / 2, abs=0.5)
        assert page.js(f"{IMAGE}.alt").startswith("Figure: ")
        assert page.js("document.querySelector('.jp-RenderedImage img').naturalWidth") > 300, "a static image stays"


def test_errors_and_requests_of_a_page_are_recorded(tmp_path: Path) -> None:
    script = (
        "console.error('oh'); fetch('http://127.0.0.1:9/x').catch(() => 0); setTimeout(() => { throw Error('no') })"
    )
    with open_page(tmp_path) as page:
        page.send("Page.navigate", url=f"data:text/html,<script>{script}</script>")
        wait("the page reports errors", lambda: page.js("1") and len(page.errors) >= 3)
        assert "oh" in page.errors and any("Error: no" in text for text in page.errors)
        assert "http://127.0.0.1:9/x" in page.requests


def test_missing_browser_names_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    with pytest.raises(AssertionError, match="install the Debian package chromium"):
        chromium.chromium()
