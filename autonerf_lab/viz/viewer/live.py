"""A field in the browser while it is being trained."""

import time
from typing import TYPE_CHECKING, Any

from autonerf_lab.data.dataset import Dataset
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.nerf.frame import FieldFrame
from autonerf_lab.nerf.radiance_field import Rendering, render
from autonerf_lab.viz.viewer.viewer import SECONDS, Viewer

if TYPE_CHECKING:
    import numpy as np

    from autonerf_lab.geometry import Intrinsics

LIVE_SECONDS = SECONDS[:2]  # a training does not wait longer
REFRESH = 3.0  # seconds after which a browser is shown what was learned since
SHARE = 0.2  # of the time of a training that pictures may take


class LiveViewer(Viewer):
    """The page of a field that is being trained.

    Pictures are rendered in the thread of the training, between two steps and in a fifth of its time at most; without
    a browser they take none. After the training, :meth:`Viewer.show` goes on with what it has become.

    Args:
        data: the walk or the photographs to be learned.
        port: as for `Viewer`.

    Example::

        with LiveViewer(trajectory) as viewer:
            print(viewer.url)
            nerf = fit(trajectory, callback=viewer)
    """

    def __init__(self, data: Trajectory | Dataset, port: int = 0) -> None:
        data = Dataset.of(data) if isinstance(data, Trajectory) else data
        super().__init__(data.poses, data.cameras[0], port, FieldFrame.of(data))
        self._offer_semantics(data.semantics is not None)
        self._rest_until = 0.0

    def __call__(self, step: int, model: Any) -> None:
        """Draw, if it is time to: the ``callback`` of :func:`autonerf_lab.nerf.fit`."""
        started = time.monotonic()
        if self._thread is not None or self._stop.is_set() or started < self._rest_until:
            return

        def show(c2w: "np.ndarray", intrinsics: "Intrinsics") -> Rendering:
            return render(model, self.frame, c2w, intrinsics)

        if self._draw(show, LIVE_SECONDS, REFRESH):
            self._status.content = f"step {step}: {self._status.content}"
            self._rest_until = time.monotonic() + (time.monotonic() - started) * (1 - SHARE) / SHARE
