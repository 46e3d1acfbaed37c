"""A field in the browser while it is being trained."""

import time
from typing import TYPE_CHECKING, Any

import numpy as np

from autonerf_lab.evaluators.field import Image
from autonerf_lab.geometry import Intrinsics, camera_rays
from autonerf_lab.viz.viewer import SECONDS, Viewer

if TYPE_CHECKING:
    from autonerf_lab.trajectory import Trajectory

LIVE_SECONDS = SECONDS[:2]  # a training does not wait longer
REFRESH = 3.0  # seconds after which a browser is shown what was learned since
SHARE = 0.2  # of the time of a training that pictures may take


class LiveViewer(Viewer):
    """The page of a field that is being trained.

    Pictures are rendered in the thread of the training, between two steps and in a fifth of its time at most; without
    a browser they take none. After the training, :meth:`Viewer.show` goes on with what it has become.

    Args:
        trajectory: the walk to be learned.
        port: as for `Viewer`.

    Example::

        with LiveViewer(trajectory) as viewer:
            print(viewer.url)
            nerf = fit(trajectory, callback=viewer)
    """

    def __init__(self, trajectory: "Trajectory", port: int = 0) -> None:
        super().__init__(trajectory.poses, trajectory.intrinsics, port)
        self._rest_until = 0.0

    def __call__(self, step: int, model: Any) -> None:
        """Draw, if it is time to: the ``callback`` of :func:`autonerf_lab.nerf.fit`."""
        started = time.monotonic()
        if self._thread is not None or self._stop.is_set() or started < self._rest_until:
            return

        def render(c2w: np.ndarray, intrinsics: Intrinsics) -> Image:
            return _render_model(model, c2w, intrinsics)

        if self._draw(render, LIVE_SECONDS, REFRESH):
            self._status.content = f"step {step}: {self._status.content}"
            self._rest_until = time.monotonic() + (time.monotonic() - started) * (1 - SHARE) / SHARE


def _render_model(model: Any, c2w: np.ndarray, intrinsics: Intrinsics) -> Image:
    """A picture of a model in training; all that is asked of it is ``render_rays``."""
    rays_o, rays_d = (rays.reshape(-1, 3) for rays in camera_rays(intrinsics, c2w))
    length = np.linalg.norm(rays_d, axis=1)
    origins = np.ascontiguousarray(rays_o, np.float32)
    parts = model.render_rays(origins, np.ascontiguousarray(rays_d / length[:, None], np.float32))
    color, logits, depth, opacity = map(np.asarray, parts)
    shape = intrinsics.height, intrinsics.width
    classes = logits.argmax(axis=1).astype(np.uint8)
    return Image(
        color.reshape(*shape, 3), (depth / length).reshape(shape), classes.reshape(shape), opacity.reshape(shape)
    )
