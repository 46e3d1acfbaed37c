"""Start and goal on a map: clicked on the picture, or set by sliders, which the keyboard moves too."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from autonerf_lab.course.widgets.live import Live
from autonerf_lab.utils.extras import optional

_CLICKS = """
function render({ model, el }) {
  const image = document.createElement("img");
  image.className = "widget-image";
  image.style.maxWidth = "100%";
  image.style.cursor = "crosshair";
  const show = () => {
    URL.revokeObjectURL(image.src);
    image.src = URL.createObjectURL(new Blob([model.get("value")], { type: "image/png" }));
    image.alt = model.get("alt");
  };
  image.addEventListener("click", (event) => {
    const box = image.getBoundingClientRect();
    model.send([(event.clientX - box.x) / box.width, (event.clientY - box.y) / box.height]);
  });
  model.on("change:value", show);
  show();
  el.appendChild(image);
  return () => { model.off("change:value", show); URL.revokeObjectURL(image.src); };
}
export default { render };
"""


class Ends(Live):
    """Choose a start and a goal in a picture with one or several maps, whose axes are the world's x and y.

    A click sets the end whose turn it is, and then it is the other's turn.

    Args:
        low: (2,) world x, y, the least that can be chosen.
        high: (2,) the most.
        start: (2,) where the way begins.
        goal: (2,) where it ends.

    Raises:
        MissingPackageError: the extra ``notebooks`` is not installed.
    """

    def __init__(self, low: np.ndarray, high: np.ndarray, start: Iterable[float], goal: Iterable[float]) -> None:
        super().__init__()
        self._shown, self._held = _picture(), False
        self._shown.on_msg(lambda widget, place, buffers: self.click(*place))
        self.turn = self.widgets.ToggleButtons(options=("start", "goal"), description="click: the")
        self.sliders = {
            f"{end} {axis}": self.slider(f"{end} {axis}", float(low[k]), float(high[k]), float(value))
            for end, place in {"start": start, "goal": goal}.items()
            for k, (axis, value) in enumerate(zip("xy", place, strict=True))
        }

    @property
    def ends(self) -> np.ndarray:
        """(2, 2) world x, y of start and goal."""
        return np.array([[self.sliders[f"{end} {axis}"].value for axis in "xy"] for end in ("start", "goal")])

    def click(self, across: float, down: float) -> None:
        """A click at shares of the picture's width and height, from its upper left; beside the maps it does nothing."""
        point = self._figure.bbox.width * across, self._figure.bbox.height * (1 - down)
        maps = [ax for ax in self._figure.axes if ax.bbox.contains(*point)]
        if not maps:
            return
        end, self._held = self.turn.value, True  # one new picture for both sliders
        for axis, value in zip("xy", maps[0].transData.inverted().transform(point), strict=True):
            self.sliders[f"{end} {axis}"].value = float(value)
        self._held = False
        self.turn.value = "goal" if end == "start" else "start"
        self.refresh()

    def refresh(self, change: object = None) -> None:
        """Draw the picture again."""
        if not self._held:
            super().refresh(change)

    def _show(self, picture: bytes) -> None:
        self._shown.alt, self._shown.value = self._words, picture

    def controls(self) -> list[Any]:
        """Whose turn it is to be clicked, and sliders: x and y of both ends, metres."""
        sliders = [[self.sliders[f"{end} {axis}"] for axis in "xy"] for end in ("start", "goal")]
        return [self.turn, *(self.widgets.HBox(pair) for pair in sliders)]


def _picture() -> Any:
    """A PNG that says where it was clicked on: a message of two shares, across and down."""
    anywidget, traitlets = optional("anywidget", "notebooks"), optional("traitlets", "notebooks")
    traits = {"value": traitlets.Bytes().tag(sync=True), "alt": traitlets.Unicode().tag(sync=True)}
    return type("Picture", (anywidget.AnyWidget,), {"_esm": _CLICKS, **traits})()
