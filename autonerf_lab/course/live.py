"""Controls with a picture that follows them, and a picture that stays when no kernel runs."""

import io
from abc import ABC, abstractmethod
from typing import Any

from matplotlib.figure import Figure

from autonerf_lab.viz.extras import optional

_DPI = 80


class Live(ABC):
    """Something to play with in a notebook.

    A notebook shows the controls with their picture, and below them the same picture once more as a plain PNG: that is
    what remains of the cell where no kernel runs.

    Raises:
        MissingPackageError: the extra ``notebooks`` is not installed.
    """

    def __init__(self) -> None:
        self.widgets = optional("ipywidgets", "notebooks")
        self._shown = self.widgets.Image(format="png", layout={"max_width": "100%"})

    @abstractmethod
    def figure(self) -> Figure:
        """The picture of the present state."""

    @abstractmethod
    def controls(self) -> list[Any]:
        """What the student handles, of ipywidgets."""

    @property
    def picture(self) -> bytes:
        """The picture that is shown, a PNG."""
        return bytes(self._shown.value)

    def refresh(self, change: object = None) -> None:
        """Draw the picture again; also what a control calls when it was changed."""
        data = io.BytesIO()
        self.figure().savefig(data, format="png", dpi=_DPI, facecolor="white")
        self._shown.value = data.getvalue()

    def widget(self) -> Any:
        """The controls and the picture, without the one that stays."""
        return self.widgets.VBox([self._shown, *self.controls()])

    def still(self) -> Any:
        """The picture that stays."""
        from IPython.display import Image

        return Image(self.picture, format="png")

    def _ipython_display_(self) -> None:
        from IPython.display import display

        display(self.widget(), self.still())


def plain(text: str) -> str:
    r"""Text for matplotlib that is shown as it is: names come from anywhere, and a dollar sign begins a formula.

    Example:
        >>> print(plain("a$b"))
        a\$b
    """
    return text.replace("$", r"\$")
