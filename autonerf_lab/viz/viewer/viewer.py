"""Browser viewer of a radiance field, also during training. The server accepts connections from this machine only.

The address of the page contains a secret token; :mod:`~autonerf_lab.viz.viewer.guard` refuses all other requests.

The page uses viser. When the camera of a browser moves, the field is rendered from there: at low resolution first, at
higher resolution while the camera rests. The image is the background of the page. Its depth hides training cameras and
points behind a surface.
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
from autonerf_lab.errors import DataError, MissingPackageError
from autonerf_lab.geometry import OPENCV_AXES, Intrinsics
from autonerf_lab.nerf.field_frame import FieldFrame
from autonerf_lab.utils.extras import optional
from autonerf_lab.viz.point_cloud import point_cloud
from autonerf_lab.viz.render_image import LAYERS, layer_image

if TYPE_CHECKING:
    from autonerf_lab.evaluators.radiance_field import RadianceField

Render = Callable[[np.ndarray, Intrinsics], Any]  # (camera-to-world, intrinsics) -> rendering, as ``NeRF.render``

SECONDS = (0.1, 0.5, 2.0)  # time budget of an image: camera moving, just stopped, resting
FRUSTUMS = 40  # largest number of drawn training cameras
POINTS = 30_000  # of the drawn point cloud
# Limits of what a browser may ask for
MAX_SIDE = 2048  # pixels of an image
MAX_ASPECT = 8.0  # of an image, width to height and height to width
FOV_RAD = (0.02, 3.0)  # vertical field of view
MIN_INTERVAL = 1 / 30  # seconds between two images
_LOOPBACK = "127.0.0.1"


@dataclass
class _ClientState:
    """Last image that was sent to a browser."""

    view: tuple[float, str, int]  # time of the last camera motion, layer, number of the field
    level: int  # index into SECONDS
    sent_at: float  # time.time()


class Viewer:
    """Page with the training cameras and, after :meth:`show`, a radiance field: see :func:`nerf_viewer`, `LiveViewer`.

    A notebook shows the page in a frame, and the last image below it, which stays without a kernel. The frame is empty
    if the browser runs on another machine than the kernel.

    Args:
        poses: (T, 4, 4) camera-to-world training poses, world frame, user units.
        intrinsics: intrinsics of these cameras.
        port: port of the page; 0, or a port in use, selects a free one.
        frame: coordinates of the page, in which every scene is the size of a room; the world frame by default.

    Raises:
        DataError: invalid port.
        MissingPackageError: the extra ``viewer`` is not installed.
    """

    def __init__(
        self, poses: np.ndarray, intrinsics: Intrinsics, port: int = 0, frame: FieldFrame | None = None
    ) -> None:
        viser = optional("viser", "viewer")
        if not 0 <= port < 1 << 16:
            raise DataError(f"{port} is not a valid port; choose one from 1024 to 65535, or 0 for any free port")
        self.poses, self.intrinsics, self.frame = poses, intrinsics, frame or FieldFrame()
        self._render: Render | None = None
        self._generation = 0  # number of fields shown so far
        self._rays = [20_000 * seconds for seconds in SECONDS]  # rays per image at each level, adapted while rendering
        self._clients: dict[int, _ClientState] = {}
        self._image: np.ndarray | None = None  # last image, (H, W, 3) uint8
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        from autonerf_lab.viz.viewer.guard import Guard  # its packages come with viser

        guard = Guard()
        with guard.installed():
            self._server = viser.ViserServer(host=_LOOPBACK, port=port, verbose=False)
        if not guard.active:
            self._server.stop()
            raise MissingPackageError(f"viser {viser.__version__} cannot be protected; pip install viser==1.1.1")
        self.url = f"http://{_LOOPBACK}:{self._server.get_port()}/{guard.token}/"
        atexit.register(self.close)  # the rendering thread must not outlive the interpreter
        self._build_page()

    def _build_page(self) -> None:
        """Add controls and training cameras."""
        server = self._server
        # the share button would open a tunnel through a third-party server
        server.gui.configure_theme(show_share_button=False, show_logo=False)
        server.request_share_url = lambda verbose=True: None
        self._layer = server.gui.add_dropdown("layer", LAYERS, initial_value="rgb")
        for name, label, visible in (("cameras", "training cameras", True), ("points", "point cloud", False)):
            group = server.scene.add_frame(f"/{name}", show_axes=False, visible=visible)
            box = server.gui.add_checkbox(label, visible)
            box.on_update(lambda event, group=group: setattr(group, "visible", event.target.value))
        self._status = server.gui.add_markdown("no radiance field yet")
        poses = self.frame.poses_to_field(self.poses)
        eye = poses[0]
        server.initial_camera.position = eye[:3, 3]
        server.initial_camera.look_at = eye[:3, 3] - eye[:3, 2]
        stride = -(-len(poses) // FRUSTUMS)
        fov = 2 * np.arctan(self.intrinsics.height / 2 / self.intrinsics.fl_y)
        for k in range(stride // 2, len(poses), stride):
            pose = poses[k]
            if np.linalg.norm(pose[:3, 3] - eye[:3, 3]) < 0.2:  # it would hide the initial view
                continue
            server.scene.add_camera_frustum(
                f"/cameras/{k}",
                fov,
                self.intrinsics.width / self.intrinsics.height,
                scale=0.06,
                thickness=1.5,
                thickness_units="screen",
                color=(213, 94, 0),
                wxyz=Rotation.from_matrix((pose @ OPENCV_AXES)[:3, :3]).as_quat()[[3, 0, 1, 2]],
                position=pose[:3, 3],
            )

    def show(self, field: "RadianceField") -> None:
        """Render this field from now on, in a separate thread.

        The caller may render the same field at the same time: fields of this package wait for each other.
        """
        image = field.render(self.poses[0], self.intrinsics)
        self._image = layer_image(image, "rgb")
        self._set_layers(image.semantics is not None)
        cloud = point_cloud(field, POINTS)
        if len(cloud):
            self._server.scene.add_point_cloud(
                "/points/cloud", self.frame.to_field(cloud.points), cloud.colors, point_size=0.015, precision="float32"
            )
        self._render = field.render
        self._generation += 1
        if self._thread is None:
            self._thread = threading.Thread(target=self._draw_until_closed, name="viewer", daemon=True)
            self._thread.start()

    def _set_layers(self, semantics: bool) -> None:
        """List the layers of the field in the dropdown."""
        self._layer.options = [layer for layer in LAYERS if semantics or layer != "semantics"]

    def _draw_until_closed(self) -> None:
        while not self._stop.is_set():
            render = self._render
            if render is None or not self._draw(render, SECONDS):
                self._stop.wait(0.03)

    def _draw(self, render: Render, seconds: tuple[float, ...], refresh: float = np.inf) -> bool:
        """Send every browser the image that is due; return False if there was none."""
        drawn = False
        clients = self._server.get_clients()
        self._clients = {number: state for number, state in self._clients.items() if number in clients}
        for number, client in clients.items():
            view = (client.camera.update_timestamp, self._layer.value, self._generation)
            state, now = self._clients.get(number), time.time()
            if state is not None and now - state.sent_at < MIN_INTERVAL:
                continue
            if state is None or state.view != view:
                level = 0
            elif state.level < len(seconds) - 1:
                level = state.level + 1
            elif now - state.sent_at > refresh:
                level = state.level
            else:
                continue
            self._clients[number] = _ClientState(view, level, now)
            try:
                self._send(client, render, view[1], level)
            except Exception as error:  # a failed image must end neither the page nor the training
                self._status.content = f"rendering failed: {escape(repr(error))}"
            drawn = True
        return drawn

    def _send(self, client: Any, render: Render, layer: str, level: int) -> None:
        started = time.perf_counter()
        camera = client.camera
        if not camera.image_height or not camera.image_width:
            return  # the window is minimised
        rays = min(self._rays[level], camera.image_width * camera.image_height, MAX_SIDE**2)
        intrinsics = _intrinsics(camera, rays)
        image = render(self.frame.poses_to_world(_pose(camera)), intrinsics)
        spent = time.perf_counter() - started
        self._rays[level] = rays * float(np.clip(SECONDS[level] / spent, 0.5, 2))
        depth = np.nan_to_num(np.asarray(image.depth, np.float32)) / np.float32(self.frame.unit)
        self._image = layer_image(image, layer, self.frame.unit)
        client.scene.set_background_image(self._image, format="jpeg", jpeg_quality=90, depth=depth)
        self._status.content = f"{intrinsics.width} x {intrinsics.height} pixels in {spent:.2f} s"

    def close(self) -> None:
        """Stop rendering and close the page; a second call does nothing."""
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
        if self._image is None:
            return page
        data = io.BytesIO()
        Pillow.fromarray(self._image).save(data, "PNG")
        return f'{page}<img src="{data_url(data.getvalue(), "png")}" alt="Last image of the viewer">'


def nerf_viewer(field: "RadianceField", port: int = 0) -> Viewer:
    """Open a page with a trained radiance field; it stays open until ``close()``.

    Args:
        field: a trained radiance field.
        port: port of the page; 0 selects a free one.

    Raises:
        DataError: see `Viewer`.
        MissingPackageError: see `Viewer`.
    """
    viewer = Viewer(field.poses, field.intrinsics, port, field.frame)
    try:
        viewer.show(field)
    except BaseException:
        viewer.close()
        raise
    return viewer


def _pose(camera: Any) -> np.ndarray:
    """Return the (4, 4) camera-to-world pose of a browser in page coordinates."""
    c2w = np.eye(4)
    c2w[:3, :3] = Rotation.from_quat(camera.wxyz[[1, 2, 3, 0]]).as_matrix() @ OPENCV_AXES[:3, :3]
    c2w[:3, 3] = camera.position
    return c2w


def _intrinsics(camera: Any, rays: float) -> Intrinsics:
    """Return intrinsics that fill the window of a browser with about ``rays`` pixels, within the limits above."""
    aspect = float(np.clip(camera.image_width / camera.image_height, 1 / MAX_ASPECT, MAX_ASPECT))
    height = int(np.clip(round(np.sqrt(rays / aspect)), 8, MAX_SIDE))
    width = int(np.clip(round(height * aspect), 8, MAX_SIDE))
    focal = 0.5 / np.tan(np.clip(camera.fov, *FOV_RAD) / 2)  # in units of the window height
    return Intrinsics(width, height, focal / aspect * width, focal * height, width / 2, height / 2)
