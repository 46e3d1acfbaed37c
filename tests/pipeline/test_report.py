"""The report: a self-contained page that shows the data of a run and escapes all text."""

import html.parser
import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from autonerf_lab.errors import DataError, RunFolderError
from autonerf_lab.evaluators.scores import Scores
from autonerf_lab.pipeline.gallery import Gallery, read_gallery
from autonerf_lab.pipeline.report import render, score_table, write_report
from autonerf_lab.pipeline.run_folder import STAGES, RunConfig, open_run
from autonerf_lab.types import Score

EVIL = "<img src=x onerror=alert(1)>"


@pytest.fixture
def run(tmp_path):
    """A finished run with one figure per section, one animation, and hostile names."""
    run = open_run(tmp_path, RunConfig(EVIL, "f00d", "frontier", "smoke", 0, "semantic-nerfacto"))
    rng = np.random.default_rng(0)
    gallery = Gallery(run / "figures", "evaluate")
    for section in ("rendering", "maps", "planning", "mesh"):
        image = rng.integers(0, 255, (20, 30, 3), dtype=np.uint8)
        gallery.add(
            section,
            section,
            partial(np.copy, image),
            title=EVIL,
            caption=f"About {section}",
            alt=f"A figure of {section}",
        )
    frames = [rng.integers(0, 255, (20, 30, 3), dtype=np.uint8) for _ in range(3)]
    gallery.add(
        "pose_refinement", "refine", lambda: frames, title="Refining", caption="Moves", alt="A camera that moves"
    )
    gallery.close()
    rows = [
        Score("rendering", "psnr", 22.5, "dB", n=8),
        Score("rendering", "lpips", None, status="weights_missing"),
        Score("rendering", "depth_median_error_m", 0.0834, "m", n=8),
        Score("maps", "free_recall", 76.0, "%", n=9),
        Score("mesh", "a_new_metric", 1.5, EVIL),
    ]
    Scores(rows).save(run / "scores.json")
    Scores([Score("rendering", "psnr", 14.25, "dB")]).save(run / "baselines/nearest_view.json")
    Scores([Score("rendering", "psnr", 60.0, "dB")]).save(run / "baselines/oracle.json")
    for stage in STAGES[:-1]:
        run.mark_finished(stage, 12.0, 1.25)
    return run


class Page(html.parser.HTMLParser):
    """HTML parser that collects tags and checks that all are closed."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.open = [], []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "img", "br", "source"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_page_is_valid_and_self_contained(run):
    path = write_report(run)
    text = path.read_text()
    page = Page(text)
    assert "<script" not in text and "http" not in text
    for tag, attributes in page.tags:
        assert not any(name.startswith("on") for name in attributes)
        for name in ("src", "srcset"):
            if name in attributes:
                assert attributes[name].startswith("data:image/")
        if tag == "a":
            assert attributes["href"].startswith(("#", "mesh/"))
        if tag == "img":
            assert attributes["alt"] and attributes["width"] == "30"
    assert sum(tag == "img" for tag, _ in page.tags) == 5


def test_text_from_files_is_shown_and_not_run(run):
    text = render(run)
    assert EVIL not in text
    assert text.count("&lt;img src=x onerror=alert(1)&gt;") >= 5


def test_animation_has_a_still_for_paper(run):
    page = Page(render(run))
    still = [attributes for tag, attributes in page.tags if tag == "source"]
    assert [s["media"] for s in still] == ["print, (prefers-reduced-motion: reduce)"]
    assert still[0]["srcset"].startswith("data:image/png")


def test_scores_are_compared_with_the_paper_and_the_baselines(run):
    text = re.sub(r"\s+", " ", render(run))
    assert "22.50</td> <td>25.56</td><td>19.75</td><td>14.25</td><td>60.00</td>" in text
    assert "<th>nearest<br>view</th><th>oracle</th>" in text and "<b>oracle</b>, the true geometry" in text
    assert 'colspan="7"' in text and "tsdf" not in text, "baselines that were not scored have no column"
    assert "no weights</td>" in text
    assert "8.3</td>" in text  # metres become centimetres
    assert "60 s" in text or ">60<" in text  # five stages of 12 s


def test_missing_extras_are_explained(run):
    assert "--lpips-weights FILE" in render(run) and "open3d" not in render(run)
    Scores([Score("mesh", "a_new_metric", None, status="open3d_missing")]).save(run / "baselines/tsdf.json")
    text = render(run)
    assert "<td>no open3d</td>" in text and 'pip install "autonerf-lab[open3d]"' in text


def test_table_keeps_the_order_of_the_rows():
    rows = [Score("maps", "free_recall", 1.0), Score("rendering", "psnr", 2.0), Score("maps", "free_precision", 3.0)]
    table = score_table(Scores(rows), {})
    assert [(task["title"], len(task["rows"])) for task in table] == [("Maps", 2), ("Rendering", 1)]


def test_sections_need_a_figure_or_a_score(run):
    assert 'id="trajectory"' not in render(run) and 'id="planning"' in render(run)
    (run / "figures/evaluate.json").unlink()
    text = render(run)
    assert 'id="planning"' not in text and 'id="maps"' in text, "maps have scores"


def test_unfinished_run_names_the_missing_stage(tmp_path):
    run = open_run(tmp_path, RunConfig("val-0", "f00d", "frontier", "smoke"))
    with pytest.raises(RunFolderError, match="run `autonerf-lab evaluate` first"):
        write_report(run)


@pytest.mark.parametrize("damage", ["missing", "cut", "foreign"])
def test_damaged_figure_is_named(run, damage):
    path = run / "figures/evaluate_maps.png"
    data = path.read_bytes()
    if damage == "missing":
        path.unlink()
    else:
        path.write_bytes(data[:20] if damage == "cut" else b"GIF89a" + data)
    with pytest.raises(DataError, match=r"evaluate_maps\.png"):
        render(run)


@pytest.mark.parametrize("name", ["../secret.png", "/etc/passwd", "report.html", "a/b.png", 5])
def test_list_of_figures_cannot_reach_outside(run, name):
    import json

    path = run / "figures/evaluate.json"
    content = json.loads(path.read_text())
    content["figures"][0]["file"] = name
    path.write_text(json.dumps(content))
    with pytest.raises(DataError, match=r"evaluate\.json"):
        read_gallery(run / "figures", "evaluate")


def test_matplotlib_figures_are_drawn_and_closed(tmp_path):
    import matplotlib.pyplot as plt

    gallery = Gallery(tmp_path, "fit")
    gallery.add("maps", "plot", partial(plt.figure, figsize=(1, 1)), title="t", caption="c", alt="a")
    assert (tmp_path / "fit_plot.png").read_bytes().startswith(b"\x89PNG")
    assert not plt.get_fignums()


def test_a_gallery_draws_only_the_chosen_figures_and_no_empty_animation(tmp_path):
    drawn = []

    def draw(name, image):
        return lambda: drawn.append(name) or image

    gallery = Gallery(tmp_path, "evaluate", only=["wanted", "empty"])
    for name, image in (("wanted", np.zeros((2, 2, 3), np.uint8)), ("unwanted", None), ("empty", [])):
        gallery.add("maps", name, draw(name, image), title="t", caption="c", alt="a")
    gallery.close()
    assert drawn == ["wanted", "empty"]
    assert [figure.file for figure in read_gallery(tmp_path, "evaluate")] == ["evaluate_wanted.png"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["evaluate.json", "evaluate_wanted.png"]


def test_noise_and_alignment_are_stated(run):
    run.config = replace(run.config, noise="ans", noise_scale=2.0, poses="estimated")
    scores = Scores([Score("trajectory", "ate_m", 0.0123, "m", n=9)])
    moved = {"x_m": 0.5, "y_m": -0.25, "heading_rad": np.pi / 180}
    scores.details["trajectory"] = {"pose_source": "estimated", "alignment": moved}
    scores.save(run / "scores.json")
    text = render(run)
    assert "first aligned with the apartment" in text and "Poses of the exploration" in text and "Noise scale" in text
    assert re.search(r"estimated</td>\s*<td[^>]*>0.500</td>\s*<td[^>]*>-0.250</td>\s*<td[^>]*>1.000<", text)
