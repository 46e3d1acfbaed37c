"""Alternative texts of figures, and class colours for colour-blind readers."""

import subprocess
import sys

import numpy as np
import pytest
from matplotlib.figure import Figure
from skimage.color import deltaE_ciede2000, rgb2lab

from autonerf_lab.classes import CLASS_COLORS, CLASS_NAMES
from autonerf_lab.viz.alt_text import describe
from autonerf_lab.viz.figures.style import empty_figure


def test_each_text_of_a_figure_occurs_once():
    figure = Figure()
    figure.suptitle("a trajectory\nin dev-0")
    left, right = figure.subplots(1, 2)
    left.set(title="colour")
    left.plot([1, 2], label="path")
    left.legend()
    right.set(title="colour", xlabel="step")
    figure.legend(handles=left.lines, labels=["chair"])
    figure.colorbar(right.imshow([[0, 1]]), ax=right, label="metres")
    assert (
        describe(figure)
        == "Figure with 2 panels: a trajectory in dev-0; colour, path; colour, step; chair; colours: metres."
    )


def test_figures_of_one_panel_and_without_words():
    figure = Figure()
    figure.subplots().set_ylabel("m")
    assert describe(figure) == "Figure: m."
    assert describe(Figure()) == "Figure: no text."
    assert describe(empty_figure("nothing to see")) == "Figure: nothing to see."


@pytest.mark.parametrize("pyplot", [True, False], ids=["after pyplot", "without pyplot"])
def test_notebooks_show_figures_and_store_their_alternative_texts(pyplot: bool):
    """Pyplot tells IPython to draw figures, with its first one; most figures of the package are made without it."""
    after_pyplot = "from IPython.core.pylabtools import select_figure_formats as show; show(shell, ['png'])"
    code = """
import sys
import autonerf_lab.viz
assert "IPython" not in sys.modules and "matplotlib" not in sys.modules
from IPython.core.interactiveshell import InteractiveShell
shell = InteractiveShell.instance()
from importlib import reload
reload(autonerf_lab.viz)
PYPLOT
from autonerf_lab.viz.figures.style import empty_figure
data, metadata = shell.display_formatter.format(empty_figure("a <b>"))
assert data["image/png"] and metadata == {"image/png": {"alt": "Figure: a <b>."}}, metadata
"""
    subprocess.run([sys.executable, "-c", code.replace("PYPLOT", after_pyplot if pyplot else "")], check=True)


# Machado, Oliveira and Fernandes (2009), severity 1: linear RGB as seen without one kind of cone
SEEN_BY = {
    "all cones": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
APART = 9.9  # CIEDE2000; two patches side by side differ visibly from about 2


def differences(eyes: str) -> np.ndarray:
    """Return the (16, 16) CIEDE2000 differences between the class colours."""
    colors = CLASS_COLORS / 255
    linear = np.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)
    linear = np.clip(linear @ np.transpose(SEEN_BY[eyes]), 0, 1)
    seen = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    lab = rgb2lab(seen[None])[0]
    return deltaE_ciede2000(lab[:, None], lab[None])


@pytest.mark.parametrize("eyes", SEEN_BY)
def test_classes_can_be_told_apart_by_their_colours(eyes):
    rows, columns = np.nonzero(np.triu(differences(eyes) < APART, 1))
    assert [(CLASS_NAMES[a], CLASS_NAMES[b]) for a, b in zip(rows, columns, strict=True)] == []


def test_simulated_colour_blindness_keeps_greys_and_reduces_red_green_contrast():
    for matrix in SEEN_BY.values():
        np.testing.assert_allclose(np.sum(matrix, axis=1), 1, atol=1e-5)
    green_and_orange = CLASS_NAMES.index("potted plant"), CLASS_NAMES.index("oven")
    assert differences("deuteranopia")[green_and_orange] < 0.6 * differences("all cones")[green_and_orange]
