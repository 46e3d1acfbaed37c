"""Base classes of the widgets: controls, a figure that follows them, and a static copy that needs no kernel."""

import io
import threading
import time
from abc import ABC, abstractmethod
from typing import Any

from matplotlib.figure import Figure

from autonerf_lab.utils.extras import NATURAL_SIZE, optional
from autonerf_lab.viz.alt_text import describe
from autonerf_lab.viz.figures.style import ORANGE

_DPI = 80
_SECONDS = 2.0  # between two drawings of a running task: a drawing takes half a second


class LiveFigure(ABC):
    """Interactive figure of a notebook.

    A notebook shows the controls, and below them the figure as a static PNG, which is replaced when a control changes.
    Without a running kernel only the static PNG is visible.

    Raises:
        MissingPackageError: the extra ``notebooks`` is not installed.
    """

    def __init__(self) -> None:
        self.widgets = optional("ipywidgets", "notebooks")
        self._shown = self.widgets.Image(format="png", layout=NATURAL_SIZE)
        self._static: Any = None  # handle of the displayed static image
        self.error = ""  # what went wrong, shown below the figure

    @abstractmethod
    def figure(self) -> Figure:
        """Draw the current state."""

    @abstractmethod
    def controls(self) -> list[Any]:
        """Return the ipywidgets controls."""

    @property
    def png(self) -> bytes:
        """PNG file of the current figure."""
        return bytes(self._shown.value)

    def refresh(self, change: object = None) -> None:
        """Redraw the figure; also the callback of the controls, which pass ``change``."""
        data = io.BytesIO()
        self._figure = self.figure()
        self._figure.savefig(data, format="png", dpi=_DPI, facecolor="white")
        self._alt_text = describe(self._figure)
        self._show(data.getvalue())
        if self._static is not None:
            self._static.update(self.static_image())

    def draw_error(self, figure: Figure) -> None:
        """Write the error below the figure, if there is one."""
        if self.error:
            figure.supxlabel(escape_dollars(self.error), color=ORANGE, fontsize=10, wrap=True)

    def _show(self, png: bytes) -> None:
        self._shown.value = png

    def slider(
        self, name: str, low: float, high: float, value: float, step: float = 0.05, continuous: bool = False
    ) -> Any:
        """Return a slider that redraws the figure.

        Args:
            name: label.
            low: smallest value.
            high: largest value.
            value: initial value.
            step: increment; an integer gives a slider of integers.
            continuous: redraw while the slider is dragged, not only when it is released.
        """
        options = {"min": low, "max": high, "value": value, "step": step, "description": name}
        kind = self.widgets.IntSlider if isinstance(step, int) else self.widgets.FloatSlider
        slider = kind(**options, continuous_update=continuous)
        slider.observe(self.refresh, "value")
        return slider

    def widget(self) -> Any:
        """Return the figure with its controls, without the static PNG."""
        return self.widgets.VBox([self._shown, *self.controls()])

    def live_part(self) -> Any:
        """Return the widget above the static PNG: the controls alone, because the static PNG follows them."""
        return self.widgets.VBox(self.controls())

    def static_image(self) -> Any:
        """Return the current figure as a static PNG with alternative text."""
        from IPython.display import Image

        return Image(self.png, format="png", alt=self._alt_text)

    def _ipython_display_(self) -> None:
        from IPython.display import display

        display(self.live_part())
        self._static = display(self.static_image(), display_id=True)


class BackgroundTask(LiveFigure):
    """Interactive figure of a task that runs in a background thread between "train on" and "stop".

    Raises:
        MissingPackageError: the extra ``notebooks`` is not installed.
    """

    def __init__(self) -> None:
        super().__init__()
        self.stopped, self._thread = threading.Event(), threading.Thread()
        self._drawn = 0.0  # time of the last drawing of the running task, seconds
        self.buttons = {name: self.widgets.Button(description=name) for name in ("train on", "stop")}
        self.buttons["train on"].on_click(self._start)
        self.buttons["stop"].on_click(self.stop)

    @abstractmethod
    def work(self) -> None:
        """Run the task until ``stopped`` is set."""

    def stop(self, button: object = None) -> None:
        """Stop the background thread and wait until the current step has ended."""
        self.stopped.set()
        if self._thread.ident is not None:
            self._thread.join()

    def controls(self) -> list[Any]:
        """Return the buttons "train on" and "stop"."""
        return [self.widgets.HBox(list(self.buttons.values()))]

    def refresh_while_running(self) -> None:
        """Redraw the figure, unless the last of these drawings is less than two seconds old."""
        if time.perf_counter() - self._drawn >= _SECONDS:
            self.refresh()
            self._drawn = time.perf_counter()

    def _start(self, button: object) -> None:
        if not self._thread.is_alive():
            self.stopped.clear()
            self.error = ""
            self._thread = threading.Thread(target=self._run_in_thread, daemon=True)
            self._thread.start()

    def _run_in_thread(self) -> None:
        try:
            self.work()
        except Exception as error:  # the task may run code written by the student
            self.error = f"{type(error).__name__}: {error}"
            self.refresh()


def escape_dollars(text: str) -> str:
    r"""Escape dollar signs, which would start a formula in a matplotlib text.

    Example:
        >>> print(escape_dollars("a$b"))
        a\$b
    """
    return text.replace("$", r"\$")
