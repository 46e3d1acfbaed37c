"""A field in the browser: fly through it, also while it is being trained. Nothing but this machine can connect.

The page is viser's. Whenever a browser's camera moves, the field is rendered from there, coarse first and finer while
the camera stays; the picture lies behind the training cameras and the points, which its depth hides where they are
behind a surface.
"""

import atexit
import io
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image as Pillow
from scipy.spatial.transform import Rotation

from autonerf_lab.data.images import data_url
from autonerf_lab.errors import DataError
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.nerf.frame import FieldFrame
from autonerf_lab.utils.extras import optional
from autonerf_lab.viz.point_cloud import point_cloud
from autonerf_lab.viz.render_image import LAYERS, paint

if TYPE_CHECKING:
    from autonerf_lab.evaluators.radiance_field import Field

Render = Callable[[np.ndarray, Intrinsics], Any]  # camera-to-world and camera -> a picture, as ``NeRF.render`` does

SECONDS = (0.1, 0.5, 2.0)  # that a picture may take: while the camera moves, when it has stopped, and when it stays
FRUSTUMS = 40
POINTS = 30_000
_LOOPBACK = "127.0.0.1"
_GL_TO_CV = np.diag([1.0, -1.0, -1.0])  # cameras of viser look along +z, y down


@dataclass
class _Shown:
    """What a browser shows."""

    view: tuple[float, str, int]  # when its camera moved, the layer, and which field
    level: int  # index into SECONDS
    at: float  # time.time()


class Viewer:
    """A page that shows training cameras, and a field once there is one: see :func:`nerf_viewer`, `LiveViewer`.

    In a notebook it is a frame with the page, and a still picture, which remains when no kernel runs. The frame is
    empty where the browser runs on another machine than the kernel.

    Args:
        cameras: (T, 4, 4) camera-to-world poses of the training, world frame, user units.
        intrinsics: of these cameras.
        port: of the page; 0 takes a free one, and so does one that is in use.
        frame: the coordinates of the page, in which everything is a room's size; the world for a walk.

    Raises:
        DataError: no such port.
        MissingPackageError: the extra ``viewer`` is not installed.
    """

    def __init__(
        self, cameras: np.ndarray, intrinsics: Intrinsics, port: int = 0, frame: FieldFrame | None = None
    ) -> None:
        viser = optional("viser", "viewer")
        if not 0 <= port < 1 << 16:
            raise DataError(f"{port} is no port; choose one from 1024 to 65535, or 0 for any that is free")
        self.cameras, self.intrinsics, self.frame = cameras, intrinsics, frame or FieldFrame()
        self._render: Render | None = None
        self._generation = 0  # counts the fields that were shown
        self._rays = [20_000 * seconds for seconds in SECONDS]  # that fit into them: learned while drawing
        self._shown: dict[int, _Shown] = {}
        self._picture: np.ndarray | None = None  # the last one, (H, W, 3) uint8
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._server = viser.ViserServer(host=_LOOPBACK, port=port, verbose=False)
        self.url = f"http://{_LOOPBACK}:{self._server.get_port()}"
        atexit.register(self.close)  # a thread that renders must not outlive the interpreter
        self._furnish()

    def _furnish(self) -> None:
        """Everything on the page but the field."""
        server = self._server
        # its share button would open a tunnel through somebody else's machine
        server.gui.configure_theme(show_share_button=False, show_logo=False)
        server.request_share_url = lambda verbose=True: None
        self._layer = server.gui.add_dropdown("show", LAYERS, initial_value="rgb")
        for name, visible in (("cameras", True), ("points", False)):
            group = server.scene.add_frame(f"/{name}", show_axes=False, visible=visible)
            box = server.gui.add_checkbox(name, visible)
            box.on_update(lambda event, group=group: setattr(group, "visible", event.target.value))
        self._status = server.gui.add_markdown("no field yet")
        cameras = self.frame.enter_poses(self.cameras)
        eye = cameras[0]
        server.initial_camera.position = eye[:3, 3]
        server.initial_camera.look_at = eye[:3, 3] - eye[:3, 2]
        stride = -(-len(cameras) // FRUSTUMS)
        fov = 2 * np.arctan(self.intrinsics.height / 2 / self.intrinsics.fl_y)
        for k in range(stride // 2, len(cameras), stride):
            pose = cameras[k]
            if np.linalg.norm(pose[:3, 3] - eye[:3, 3]) < 0.2:  # it would stand in the way of the first look
                continue
            server.scene.add_camera_frustum(
                f"/cameras/{k}",
                fov,
                self.intrinsics.width / self.intrinsics.height,
                scale=0.06,
                thickness=1.5,
                thickness_units="screen",
                color=(213, 94, 0),
                wxyz=Rotation.from_matrix(pose[:3, :3] @ _GL_TO_CV).as_quat()[[3, 0, 1, 2]],
                position=pose[:3, 3],
            )

    def show(self, field: "Field") -> None:
        """Draw this field from now on, in a thread of its own.

        Rendering it elsewhere at the same time is safe as far as the field's own threads are.
        """
        image = field.render(self.cameras[0], self.intrinsics)
        self._picture = paint(image, "rgb")
        self._offer_semantics(image.semantics is not None)
        cloud = point_cloud(field, POINTS)
        if len(cloud):
            self._server.scene.add_point_cloud(
                "/points/cloud", self.frame.enter(cloud.points), cloud.colors, point_size=0.015, precision="float32"
            )
        self._render = field.render
        self._generation += 1
        if self._thread is None:
            self._thread = threading.Thread(target=self._draw_until_closed, name="viewer", daemon=True)
            self._thread.start()

    def _offer_semantics(self, known: bool) -> None:
        self._layer.options = [layer for layer in LAYERS if known or layer != "semantics"]

    def _draw_until_closed(self) -> None:
        while not self._stop.is_set():
            render = self._render
            if render is None or not self._draw(render, SECONDS):
                self._stop.wait(0.03)

    def _draw(self, render: Render, seconds: tuple[float, ...], refresh: float = np.inf) -> bool:
        """Give every browser the picture that is due; False where none was."""
        drawn = False
        for number, client in self._server.get_clients().items():
            view = (client.camera.update_timestamp, self._layer.value, self._generation)
            shown, now = self._shown.get(number), time.time()
            if shown is None or shown.view != view:
                level = 0
            elif shown.level < len(seconds) - 1:
                level = shown.level + 1
            elif now - shown.at > refresh:
                level = shown.level
            else:
                continue
            self._shown[number] = _Shown(view, level, now)
            try:
                self._send(client, render, view[1], level)
            except Exception as error:  # neither the page nor a training may end because one picture failed
                self._status.content = f"no picture: {escape(repr(error))}"
            drawn = True
        return drawn

    def _send(self, client: Any, render: Render, layer: str, level: int) -> None:
        started = time.perf_counter()
        camera = client.camera
        if not camera.image_height or not camera.image_width:
            return  # a window that is folded away
        rays = min(self._rays[level], camera.image_width * camera.image_height)
        intrinsics = _intrinsics(camera, rays)
        image = render(self.frame.leave_poses(_pose(camera)), intrinsics)
        spent = time.perf_counter() - started
        self._rays[level] = rays * float(np.clip(SECONDS[level] / spent, 0.5, 2))
        depth = np.nan_to_num(np.asarray(image.depth, np.float32)) / np.float32(self.frame.unit)
        self._picture = paint(image, layer, self.frame.unit)
        client.scene.set_background_image(self._picture, format="jpeg", jpeg_quality=90, depth=depth)
        self._status.content = f"{intrinsics.width} x {intrinsics.height} pixels in {spent:.2f} s"

    def close(self) -> None:
        """Stop drawing and take the page down. Once is enough, twice does no harm."""
        if self._stop.is_set():
            return
        self._stop.set()
        atexit.unregister(self.close)
        if self._thread is not None:
            self._thread.join()
        self._server.stop()

    def __enter__(self) -> "Viewer":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _repr_html_(self) -> str:
        page = f'<iframe src="{self.url}" width="100%" height="480" style="border: 0"></iframe>'
        if self._picture is None:
            return page
        data = io.BytesIO()
        Pillow.fromarray(self._picture).save(data, "PNG")
        return f'{page}<img src="{data_url(data.getvalue(), "png")}" alt="What the page showed last">'


def nerf_viewer(field: "Field", port: int = 0) -> Viewer:
    """Open a page on a trained field; it stays until ``close()``.

    Args:
        field: a trained NeRF.
        port: of the page; 0 takes a free one.

    Raises:
        DataError, MissingPackageError: as `Viewer`.
    """
    viewer = Viewer(field.cameras, field.intrinsics, port, field.frame)
    try:
        viewer.show(field)
    except BaseException:
        viewer.close()
        raise
    return viewer


def _pose(camera: Any) -> np.ndarray:
    """(4, 4) camera-to-world of a browser, in the coordinates of the page."""
    c2w = np.eye(4)
    c2w[:3, :3] = Rotation.from_quat(camera.wxyz[[1, 2, 3, 0]]).as_matrix() @ _GL_TO_CV
    c2w[:3, 3] = camera.position
    return c2w


def _intrinsics(camera: Any, rays: float) -> Intrinsics:
    """The camera of a browser with about so many pixels, which fill its window exactly."""
    aspect = camera.image_width / camera.image_height
    height = max(8, round(np.sqrt(rays / aspect)))
    width = max(8, round(height * aspect))
    focal = 0.5 / np.tan(camera.fov / 2)  # in heights of the window
    return Intrinsics(width, height, focal / aspect * width, focal * height, width / 2, height / 2)
