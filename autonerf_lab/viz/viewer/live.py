"""Browser viewer of a radiance field during training."""

import time
from typing import TYPE_CHECKING, Any

from autonerf_lab.data.dataset import Dataset
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.nerf.field_frame import FieldFrame
from autonerf_lab.nerf.radiance_field import render
from autonerf_lab.types import Rendering
from autonerf_lab.viz.viewer.viewer import SECONDS, Viewer

if TYPE_CHECKING:
    import numpy as np

    from autonerf_lab.geometry import Intrinsics

LIVE_SECONDS = SECONDS[:2]  # without the slowest level: training waits while an image is rendered
REFRESH = 3.0  # seconds until an unchanged view is rendered again
SHARE = 0.2  # largest share of the training time spent on rendering


class LiveViewer(Viewer):
    """Viewer of a radiance field during training.

    Images are rendered in the training thread between two steps, in at most a fifth of the time; nothing is rendered
    while no browser is connected. After training, pass the result to :meth:`Viewer.show`.

    Args:
        data: trajectory or dataset to be trained on.
        port: see `Viewer`.

    Example::

        with LiveViewer(trajectory) as viewer:
            print(viewer.url)
            nerf = fit(trajectory, callback=viewer)
    """

    def __init__(self, data: Trajectory | Dataset, port: int = 0) -> None:
        data = Dataset.from_trajectory(data) if isinstance(data, Trajectory) else data
        super().__init__(data.poses, data.intrinsics[0], port, FieldFrame.from_dataset(data))
        self._set_layers(data.semantics is not None)
        self._next_draw = 0.0

    def __call__(self, step: int, model: Any) -> None:
        """Render if an image is due. Pass the viewer as ``callback`` of :func:`autonerf_lab.nerf.fit`."""
        started = time.monotonic()
        if self._thread is not None or self._stop.is_set() or started < self._next_draw:
            return

        def render_model(c2w: "np.ndarray", intrinsics: "Intrinsics") -> Rendering:
            return render(model, self.frame, c2w, intrinsics)

        if self._draw(render_model, LIVE_SECONDS, REFRESH):
            self._status.content = f"step {step}: {self._status.content}"
            self._next_draw = time.monotonic() + (time.monotonic() - started) * (1 - SHARE) / SHARE
