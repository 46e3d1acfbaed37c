"""Alternative texts of figures in notebooks, for readers who cannot see them.

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
    """Add alternative texts to all figures of the current notebook; without IPython, do nothing."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    if shell is not None:
        shell.display_formatter.mimebundle_formatter.for_type_by_name("matplotlib.figure", "Figure", _bundle)


def _bundle(figure: "Figure") -> tuple[dict[str, Any], dict[str, Any]]:
    """Return no image (the formatter of matplotlib draws it), but its metadata."""
    return {}, {"image/png": {"alt": describe(figure)}}


def _panel(ax: "Axes") -> str:
    x, y = ax.get_xlabel(), ax.get_ylabel()
    axes = f"{y} against {x}" if x and y else x or y
    return ", ".join(filter(None, (ax.get_title().replace("\n", " "), axes, _legend(ax.get_legend()))))


def _legend(legend: Any) -> str:
    return ", ".join(text.get_text() for text in legend.get_texts()) if legend is not None else ""
