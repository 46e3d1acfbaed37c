"""Figures in notebooks: a picture, and an alternative text for readers who cannot see it.

The text is stored as ``alt`` in the metadata of the output, from which nbconvert and similar programs read it.
"""

import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def describe(figure: "Figure") -> str:
    """Return the titles, axis labels and legends of a figure as a sentence, panel by panel.

    Example:
        >>> from matplotlib.figure import Figure
        >>> figure = Figure()
        >>> left, right = figure.subplots(1, 2)
        >>> _ = left.set(title="explored", xlabel="step", ylabel="m²")
        >>> _ = right.plot([1, 2], label="path length")
        >>> _ = right.legend()
        >>> describe(figure)
        'Figure with 2 panels: explored, m² against step; path length.'
    """
    bars = [ax for ax in figure.axes if ax.get_label() == "<colorbar>"]
    panels = [ax for ax in figure.axes if ax not in bars and ax.get_visible()]
    parts = [" ".join(text.get_text().split()) for text in figure.texts]
    parts += [_panel(ax) for ax in panels]
    parts += [_legend(legend) for legend in figure.legends]
    parts += [f"colours: {bar.get_ylabel() or bar.get_xlabel()}" for bar in bars]
    text = "; ".join(dict.fromkeys(text for text in parts if text.removeprefix("colours: ")))
    return f"Figure with {len(panels)} panels: {text}." if len(panels) > 1 else f"Figure: {text or 'no text'}."


def register() -> None:
    """Draw all figures of the current notebook, with alternative texts; without IPython, do nothing.

    IPython shows figures as pictures only after pyplot has drawn one, and most figures here are made without pyplot.
    """
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    if shell is not None:
        kind = "matplotlib.figure", "Figure"
        shell.display_formatter.mimebundle_formatter.for_type_by_name(*kind, _bundle)
        pictures = shell.display_formatter.formatters["image/png"]
        if pictures.for_type_by_name(*kind) is None:
            pictures.for_type_by_name(*kind, _picture)


def _picture(figure: "Figure") -> bytes | str | None:
    from IPython.core.pylabtools import print_figure

    return print_figure(figure, fmt="png")


def _bundle(figure: "Figure") -> tuple[dict[str, Any], dict[str, Any]]:
    """Return no image (the formatter of matplotlib draws it), but its metadata."""
    return {}, {"image/png": {"alt": describe(figure)}}


def _panel(ax: "Axes") -> str:
    x, y = ax.get_xlabel(), ax.get_ylabel()
    axes = f"{y} against {x}" if x and y else x or y
    return ", ".join(filter(None, (ax.get_title().replace("\n", " "), axes, _legend(ax.get_legend()))))


def _legend(legend: Any) -> str:
    return ", ".join(text.get_text() for text in legend.get_texts()) if legend is not None else ""
