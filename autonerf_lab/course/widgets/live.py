"""Controls with a picture that follows them, and a picture that stays when no kernel runs."""

import io
import threading
from abc import ABC, abstractmethod
from typing import Any

from matplotlib.figure import Figure

from autonerf_lab.utils.extras import OWN_SIZE, optional
from autonerf_lab.viz.figures.alt_text import describe

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
        self._shown = self.widgets.Image(format="png", layout=OWN_SIZE)

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
        self._figure = self.figure()
        self._figure.savefig(data, format="png", dpi=_DPI, facecolor="white")
        self._words = describe(self._figure)
        self._show(data.getvalue())

    def _show(self, picture: bytes) -> None:
        self._shown.value = picture

    def slider(
        self, name: str, low: float, high: float, value: float, step: float = 0.05, while_dragged: bool = False
    ) -> Any:
        """A slider that draws the picture again when it is let go, or ``while_dragged``; of integers if ``step`` is."""
        options = {"min": low, "max": high, "value": value, "step": step, "description": name}
        kind = self.widgets.IntSlider if isinstance(step, int) else self.widgets.FloatSlider
        slider = kind(**options, continuous_update=while_dragged)
        slider.observe(self.refresh, "value")
        return slider

    def widget(self) -> Any:
        """The controls and the picture, without the one that stays."""
        return self.widgets.VBox([self._shown, *self.controls()])

    def still(self) -> Any:
        """The picture that stays."""
        from IPython.display import Image

        return Image(self.picture, format="png", alt=self._words)

    def _ipython_display_(self) -> None:
        from IPython.display import display

        display(self.widget(), self.still())


class Background(Live):
    """Something that goes on in the background from "train on" until "stop".

    Raises:
        MissingPackageError: the extra ``notebooks`` is not installed.
    """

    def __init__(self) -> None:
        super().__init__()
        self.stopped, self._thread, self.error = threading.Event(), threading.Thread(), ""
        self.buttons = {name: self.widgets.Button(description=name) for name in ("train on", "stop")}
        self.buttons["train on"].on_click(self._train_on)
        self.buttons["stop"].on_click(self.stop)

    @abstractmethod
    def work(self) -> None:
        """Go on until ``stopped`` is set."""

    def stop(self, button: object = None) -> None:
        """End what "train on" began, and wait until the present step is done."""
        self.stopped.set()
        if self._thread.ident is not None:
            self._thread.join()

    def controls(self) -> list[Any]:
        """The buttons: one trains in the background, the other ends that."""
        return [self.widgets.HBox(list(self.buttons.values()))]

    def say_error(self, figure: Figure) -> None:
        """Below the picture, what ended the work."""
        if self.error:
            figure.supxlabel(plain(self.error), color="#D55E00", fontsize=10, wrap=True)

    def _train_on(self, button: object) -> None:
        if not self._thread.is_alive():
            self.stopped.clear()
            self._thread = threading.Thread(target=self._in_background, daemon=True)
            self._thread.start()

    def _in_background(self) -> None:
        try:
            self.work()
        except Exception as error:  # what is trained is code of the student's
            self.error = f"{type(error).__name__}: {error}"
            self.refresh()


def plain(text: str) -> str:
    r"""Text for matplotlib that is shown as it is: names come from anywhere, and a dollar sign begins a formula.

    Example:
        >>> print(plain("a$b"))
        a\$b
    """
    return text.replace("$", r"\$")
