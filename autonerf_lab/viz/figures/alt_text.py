"""Figures in words: the text alternative that a notebook keeps with each picture, for readers who do not see it.

It stands in the metadata of the output, as ``alt``, where nbconvert and other makers of pages look for it.
"""

import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def describe(figure: "Figure") -> str:
    """What a figure says of itself: its titles, axes and legends, panel by panel.

    Example:
        >>> from matplotlib.figure import Figure
        >>> figure = Figure()
        >>> left, right = figure.subplots(1, 2)
        >>> _ = left.set(title="explored", xlabel="step", ylabel="m²")
        >>> _ = right.plot([1, 2], label="way")
        >>> _ = right.legend()
        >>> describe(figure)
        'Figure with 2 panels: explored, m² against step; way.'
    """
    bars = [ax for ax in figure.axes if ax.get_label() == "<colorbar>"]
    panels = [ax for ax in figure.axes if ax not in bars and ax.get_visible()]
    said = [" ".join(text.get_text().split()) for text in figure.texts]
    said += [_panel(ax) for ax in panels]
    said += [_legend(legend) for legend in figure.legends]
    said += [f"colours: {bar.get_ylabel() or bar.get_xlabel()}" for bar in bars]
    words = "; ".join(dict.fromkeys(text for text in said if text.removeprefix("colours: ")))
    return f"Figure with {len(panels)} panels: {words}." if len(panels) > 1 else f"Figure: {words or 'no text'}."


def register() -> None:
    """Make the notebook that runs this keep a text alternative with every figure; does nothing elsewhere."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    if shell is not None:
        shell.display_formatter.mimebundle_formatter.for_type_by_name("matplotlib.figure", "Figure", _bundle)


def _bundle(figure: "Figure") -> tuple[dict[str, Any], dict[str, Any]]:
    """No picture, which matplotlib's own formatter draws, but what belongs to it."""
    return {}, {"image/png": {"alt": describe(figure)}}


def _panel(ax: "Axes") -> str:
    x, y = ax.get_xlabel(), ax.get_ylabel()
    axes = f"{y} against {x}" if x and y else x or y
    return ", ".join(filter(None, (ax.get_title().replace("\n", " "), axes, _legend(ax.get_legend()))))


def _legend(legend: Any) -> str:
    return ", ".join(text.get_text() for text in legend.get_texts()) if legend is not None else ""
