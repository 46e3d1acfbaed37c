"""Choice of a start and a goal position: by clicks on a figure, or by sliders, which also work with the keyboard."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from autonerf_lab.course.widgets.live import LiveFigure
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


class StartGoal(LiveFigure):
    """Base class of figures in which a start and a goal position are chosen.

    The figure contains one or more maps with world x and y as axes. Clicks set the start and the goal alternately.

    Args:
        low: (2,) smallest world x, y, metres.
        high: (2,) largest world x, y, metres.
        start: (2,) initial start position, world x, y, metres.
        goal: (2,) initial goal position, world x, y, metres.

    Raises:
        MissingPackageError: the extra ``notebooks`` is not installed.
    """

    def __init__(self, low: np.ndarray, high: np.ndarray, start: Iterable[float], goal: Iterable[float]) -> None:
        super().__init__()
        self._shown, self._redraw_paused = _clickable_image(), False
        self._shown.on_msg(lambda widget, position, buffers: self.click(*position))
        self.next_click = self.widgets.ToggleButtons(options=("start", "goal"), description="click sets")
        self.sliders = {
            f"{name} {axis}": self.slider(f"{name} {axis}", float(low[k]), float(high[k]), float(value))
            for name, position in {"start": start, "goal": goal}.items()
            for k, (axis, value) in enumerate(zip("xy", position, strict=True))
        }

    @property
    def start_goal(self) -> np.ndarray:
        """(2, 2) start and goal, world x, y, metres."""
        return np.array([[self.sliders[f"{name} {axis}"].value for axis in "xy"] for name in ("start", "goal")])

    def click(self, across: float, down: float) -> None:
        """Set the start or the goal to the clicked position; clicks outside the maps are ignored.

        Args:
            across: horizontal position as a fraction of the image width, from the left.
            down: vertical position as a fraction of the image height, from the top.
        """
        point = self._figure.bbox.width * across, self._figure.bbox.height * (1 - down)
        maps = [ax for ax in self._figure.axes if ax.bbox.contains(*point)]
        if not maps:
            return
        name, self._redraw_paused = self.next_click.value, True  # redraw once, not for each of the two sliders
        for axis, value in zip("xy", maps[0].transData.inverted().transform(point), strict=True):
            self.sliders[f"{name} {axis}"].value = float(value)
        self._redraw_paused = False
        self.next_click.value = "goal" if name == "start" else "start"
        self.refresh()

    def refresh(self, change: object = None) -> None:
        """Redraw the figure."""
        if not self._redraw_paused:
            super().refresh(change)

    def _show(self, png: bytes) -> None:
        self._shown.alt, self._shown.value = self._alt_text, png

    def live_part(self) -> Any:
        """Return the figure that can be clicked, with its controls."""
        return self.widget()

    def controls(self) -> list[Any]:
        """Return a toggle for the next click and sliders for x and y of the start and the goal, metres."""
        sliders = [[self.sliders[f"{name} {axis}"] for axis in "xy"] for name in ("start", "goal")]
        return [self.next_click, *(self.widgets.HBox(pair) for pair in sliders)]


def _clickable_image() -> Any:
    """Return a PNG widget that sends each click as two fractions of its size, across and down."""
    anywidget, traitlets = optional("anywidget", "notebooks"), optional("traitlets", "notebooks")
    traits = {"value": traitlets.Bytes().tag(sync=True), "alt": traitlets.Unicode().tag(sync=True)}
    return type("ClickableImage", (anywidget.AnyWidget,), {"_esm": _CLICKS, **traits})()
