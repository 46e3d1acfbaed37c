"""Uses of a radiance field: camera paths, point clouds, videos, and the browser viewer."""

import io
import itertools
import signal
import subprocess
import sys
import time
import urllib.parse
import urllib.request
from dataclasses import dataclass, replace
from dataclasses import field as field_of
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import imageio_ffmpeg
import msgspec
import numpy as np
import psutil
import pytest
import trimesh
import viser
import websockets.sync.client
import zstandard
from PIL import Image as Pillow
from scipy.spatial.transform import Rotation
from toy_scene import two_rooms
from viser._messages import ViewerCameraMessage

from autonerf_lab import cli
from autonerf_lab.classes import CLASS_COLORS
from autonerf_lab.data.trajectory import Trajectory
from autonerf_lab.errors import DataError, MissingPackageError, UnknownNameError
from autonerf_lab.evaluators import Rendering
from autonerf_lab.geometry import Intrinsics, planar_from_pose, planar_pose
from autonerf_lab.nerf import NeRF, fit
from autonerf_lab.nerf.field_frame import FieldFrame
from autonerf_lab.nerf.models.semantic_nerfacto import SETTINGS
from autonerf_lab.pipeline.run_folder import RunConfig, open_run
from autonerf_lab.simulator import Simulator
from autonerf_lab.viz.camera_paths import camera_path, trajectory_path
from autonerf_lab.viz.point_cloud import PointCloud, point_cloud
from autonerf_lab.viz.video import save_video
from autonerf_lab.viz.viewer.live import LiveViewer
from autonerf_lab.viz.viewer.viewer import Viewer, nerf_viewer

CAMERA, WIDE = Intrinsics.from_fov(32, 32), Intrinsics.from_fov(30, 21)
SMALL = replace(SETTINGS["smoke"], rays=256, steps=25)


@dataclass
class Wall:
    """The plane x = 3, seen by cameras looking along world +x; grey, class bed (4) for y > 0."""

    poses: np.ndarray
    intrinsics: Intrinsics = WIDE
    frame: FieldFrame = field_of(default_factory=FieldFrame)
    rendered: int = 0

    def render(self, c2w: np.ndarray, intrinsics: Intrinsics) -> Rendering:
        self.rendered += 1
        depth = np.full((intrinsics.height, intrinsics.width), 3 - c2w[0, 3], np.float32)
        y = c2w[1, 3] - intrinsics.directions()[..., 0] * depth  # image right is world -y
        opacity = np.where(np.abs(y) < 1, np.float32(0.9), np.float32(0.1))
        return Rendering(
            np.full((*depth.shape, 3), 0.5, np.float32), depth, np.where(y > 0, 4, 0).astype(np.uint8), opacity
        )


def wall(count: int = 3) -> Any:
    return Wall(np.stack([planar_pose(0.25 * k, 0.1 * k, 0.0) for k in range(count)]))


@pytest.fixture(scope="module")
def trajectory() -> Trajectory:
    sim = Simulator(two_rooms(), CAMERA, supersample=1)
    poses = np.stack([planar_pose(1 + 0.1 * k, 1.5, 0.3 * k) for k in range(20)])
    frames = [sim.render(pose) for pose in poses]
    images = np.stack([frame.rgb for frame in frames]), np.stack([frame.semantics for frame in frames])
    return Trajectory(poses, images[0], None, images[1], CAMERA, {"scene": "toy"})


@pytest.fixture(scope="module")
def field(trajectory: Trajectory) -> NeRF:
    return fit(trajectory, settings=SMALL, preset="smoke", progress=False)


# --- paths ----------------------------------------------------------------------------------------------------------


def test_camera_path_by_hand() -> None:
    """One metre is four robot steps, a right angle three: one frame per step shows the keys at frames 0, 4 and 7."""
    keys = np.stack([planar_pose(0, 0, 0), planar_pose(1, 0, 0), planar_pose(1, 0, np.pi / 2)])
    path = camera_path(keys, 8)
    np.testing.assert_allclose(path[[0, 4, 7]], keys, atol=1e-12)
    headings = [np.degrees(planar_from_pose(pose)[2]) for pose in path]
    np.testing.assert_allclose(headings, [0, 0, 0, 0, 0, 30, 60, 90], atol=1e-9)
    np.testing.assert_allclose(path[:, 0, 3].max(), 1)  # no overshoot at the corner
    assert (np.diff(path[:5, 0, 3]) > 0).all()
    twice = camera_path(keys[[0, 1, 1, 2]], 8)  # a repeated pose takes no time
    np.testing.assert_array_equal(twice, path)


def test_camera_path_is_rigid_and_stays_between_its_keys() -> None:
    rng = np.random.default_rng(0)
    keys = np.tile(np.eye(4), (9, 1, 1))
    keys[:, :3, :3] = Rotation.random(9, random_state=1).as_matrix()
    keys[:, :3, 3] = rng.normal(size=(9, 3))
    path = camera_path(keys, 400)
    rotations, positions = path[:, :3, :3], path[:, :3, 3]
    np.testing.assert_allclose(
        rotations @ rotations.transpose(0, 2, 1), np.broadcast_to(np.eye(3), rotations.shape), atol=1e-12
    )
    at = [int(np.linalg.norm(positions - key, axis=1).argmin()) for key in keys[:, :3, 3]]
    for (a, b), (start, end) in zip(itertools.pairwise(keys[:, :3, 3]), itertools.pairwise(at), strict=True):
        inside = positions[start + 1 : end]
        assert (inside >= np.minimum(a, b) - 1e-9).all() and (inside <= np.maximum(a, b) + 1e-9).all()


def test_trajectory_path_uses_the_part_with_the_longest_path() -> None:
    rotating = [planar_pose(0, 0, 0.5 * k) for k in range(50)]
    moving = [planar_pose(0.25 * k, 0.0, 0.0) for k in range(1, 41)]
    field = SimpleNamespace(poses=np.stack(rotating + moving), frame=FieldFrame())
    path = trajectory_path(field, 6 * 20)
    assert path.shape == (120, 4, 4)
    assert np.isclose(np.ptp(path[:, 0, 3]), 5.0) and np.isclose(np.ptp(path[:, 1, 3]), 0)
    everything = trajectory_path(field, 6 * 200)
    assert np.isclose(np.ptp(everything[:, 0, 3]), 10.0) and len(everything) == 1200


def test_refused_camera_paths() -> None:
    keys = np.stack([planar_pose(0, 0, 0), planar_pose(1, 0, 0)])
    with pytest.raises(DataError, match="two different poses"):
        camera_path(keys[[0, 0, 0]], 10)
    with pytest.raises(DataError, match="two or more"):
        camera_path(keys, 1)


# --- point clouds -----------------------------------------------------------------------------------------------------


def test_points_lie_on_the_surface() -> None:
    cloud = point_cloud(wall(), count=500, seed=1)
    x, y, z = cloud.points.T
    assert 150 < len(cloud) <= 500 and cloud.points.dtype == np.float32
    np.testing.assert_allclose(x, 3, atol=1e-6)
    assert (np.abs(y) < 1).all() and np.ptp(y) > 1.8 and np.ptp(z) > 2  # the whole opaque part and nothing else
    np.testing.assert_array_equal(cloud.classes, np.where(y > 0, 4, 0))
    assert (cloud.colors == 128).all()
    np.testing.assert_array_equal(cloud.points, point_cloud(wall(), count=500, seed=1).points)
    assert not np.array_equal(cloud.points, point_cloud(wall(), count=500, seed=2).points)
    assert 0 < len(point_cloud(wall(), count=7)) <= 7 and len(point_cloud(wall(1), count=10**6)) <= 30 * 21


def test_other_programs_read_the_point_cloud(field: NeRF, tmp_path: Path) -> None:
    cloud = point_cloud(field, count=2000)
    path = cloud.save(tmp_path / "x.ply")
    header = path.read_bytes()[:400].split(b"end_header")[0].decode().splitlines()
    assert header[1] == "format binary_little_endian 1.0" and header[-1] == "property uchar label"
    read: Any = trimesh.load(path)
    np.testing.assert_array_equal(read.vertices.astype(np.float32), cloud.points)
    np.testing.assert_array_equal(read.colors[:, :3], cloud.colors)
    np.testing.assert_array_equal(read.metadata["_ply_raw"]["vertex"]["data"]["label"], cloud.classes)
    open3d = pytest.importorskip("open3d")
    points = open3d.t.io.read_point_cloud(str(path)).point
    for name, ours in (("positions", cloud.points), ("colors", cloud.colors), ("label", cloud.classes[:, None])):
        np.testing.assert_array_equal(points[name].numpy(), ours)


def test_refused_point_clouds(tmp_path: Path) -> None:
    empty = PointCloud(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8), np.zeros(0, np.uint8))
    with pytest.raises(DataError, match="no points"):
        empty.save(tmp_path / "x.ply")
    with pytest.raises(DataError, match=r"x\.las.*\.ply"):
        point_cloud(wall(), 10).save(tmp_path / "x.las")
    assert not list(tmp_path.iterdir())


# --- videos -----------------------------------------------------------------------------------------------------------


def test_video_has_every_frame_and_an_even_size(tmp_path: Path) -> None:
    path = camera_path(wall().poses, 9)
    file = save_video(wall(), path, tmp_path / "new" / "flight.mp4", fps=12, layer="all", progress=False)
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", str(file), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    result = subprocess.run(command, capture_output=True, check=True)
    frames = np.frombuffer(result.stdout, np.uint8).reshape(-1, 22, 90, 3)
    facts = next(line for line in result.stderr.decode().splitlines() if "Video:" in line)
    assert len(frames) == 9
    assert all(fact in facts for fact in ("h264", "yuv420p", "90x22", "12 fps"))
    grey, classes = frames[0][:, :30].astype(int), frames[0][:, 60:].astype(int)
    assert np.abs(grey - 128).max() < 12  # tolerance of the codec
    left = classes[5:15, 2:8] - CLASS_COLORS[4].astype(int)
    assert np.abs(left).max() < 30 and classes[5:15, 22:28].min() > 190
    assert [f.name for f in file.parent.iterdir()] == ["flight.mp4"]


def test_gif(tmp_path: Path) -> None:
    file = save_video(wall(), camera_path(wall().poses, 5), tmp_path / "a.gif", 10, "depth", progress=False)
    with Pillow.open(file) as gif:
        assert gif.n_frames == 5 and gif.size == (30, 22) and gif.info["duration"] == 100


@pytest.mark.parametrize("name", ["flight.mp4", "flight.gif"])
def test_interrupted_video_leaves_the_old_file(tmp_path: Path, name: str) -> None:
    class Interrupted(Wall):
        def render(self, c2w: np.ndarray, intrinsics: Intrinsics) -> Rendering:
            if self.rendered == 3:
                raise KeyboardInterrupt
            return super().render(c2w, intrinsics)

    (tmp_path / name).write_bytes(b"an older video")
    with pytest.raises(KeyboardInterrupt):
        save_video(Interrupted(wall().poses), camera_path(wall().poses, 9), tmp_path / name, progress=False)
    assert [f.name for f in tmp_path.iterdir()] == [name] and (tmp_path / name).read_bytes() == b"an older video"


def test_refused_videos(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    field, path = wall(), camera_path(wall().poses, 4)
    with pytest.raises(DataError, match=r"flight\.avi: unknown extension; a video is saved as \.mp4 or \.gif"):
        save_video(field, path, tmp_path / "flight.avi")
    with pytest.raises(UnknownNameError, match="'flow'; valid names: all, depth, opacity, rgb, semantics"):
        save_video(field, path, tmp_path / "flight.mp4", layer="flow")
    with pytest.raises(DataError, match="needs frames"):
        save_video(field, path[:0], tmp_path / "flight.mp4")
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="cannot write"):
        save_video(field, path, tmp_path / "file" / "flight.mp4", progress=False)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(MissingPackageError, match=r'pip install "autonerf-lab\[viewer\]"'):
        save_video(field, path, tmp_path / "flight.mp4")
    assert field.rendered == 0  # all errors are raised before any rendering


# --- viewer -----------------------------------------------------------------------------------------------------------


class Browser:
    """Stand-in for the page of viser: sends its camera pose and receives images."""

    def __init__(self, viewer: Viewer) -> None:
        protocol: Any = f"viser-v{viser.__version__}"
        address = viewer.url.replace("http", "ws")
        self.socket = websockets.sync.client.connect(address, subprotocols=[protocol], max_size=None, compression=None)

    def look(self, x: float) -> None:
        facing = 0.5, -0.5, 0.5, -0.5  # towards world +x in OpenCV axes: right is -y, down is -z
        message = ViewerCameraMessage(
            facing, (x, 1.5, 0.88), np.pi / 2, 0.1, 100.0, 60, 120, (x + 1, 1.5, 0.88), (0.0, 0.0, 1.0)
        )
        self.socket.send(msgspec.msgpack.encode(message.as_serializable_dict()))

    def image(self, seconds: float = 10) -> np.ndarray:
        until = time.monotonic() + seconds
        while True:
            frame = self.socket.recv(timeout=max(until - time.monotonic(), 0.01))
            assert isinstance(frame, bytes)
            packed = frame[16 : 16 + int.from_bytes(frame[8:16], "little")]
            for message in msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(packed))["messages"]:
                if message["type"] == "BackgroundImageMessage" and message["rgb_data"]:
                    return np.asarray(Pillow.open(io.BytesIO(message["rgb_data"])))


def test_viewer_listens_on_loopback_only() -> None:
    with nerf_viewer(wall()) as viewer:
        port = urllib.parse.urlsplit(viewer.url).port
        listening = [c.laddr for c in psutil.Process().net_connections("tcp") if c.status == psutil.CONN_LISTEN]
        assert [address.ip for address in listening if address.port == port] == ["127.0.0.1"]
        with urllib.request.urlopen(viewer.url) as answer:
            assert b"<html" in answer.read()
    viewer.close()  # a second time
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(viewer.url)


def test_browser_sees_the_field_from_its_camera_at_rising_resolution() -> None:
    class Recorder(Wall):
        def render(self, c2w: np.ndarray, intrinsics: Intrinsics) -> Rendering:
            seen.append((c2w, intrinsics))
            return super().render(c2w, intrinsics)

    seen: list[tuple[np.ndarray, Intrinsics]] = []
    field: Any = Recorder(wall().poses)
    with nerf_viewer(field) as viewer:
        browser = Browser(viewer)
        seen.clear()
        browser.look(1.0)
        while browser.image().shape[:2] != (60, 120):  # full resolution of the window
            pass
        sizes = [intrinsics.width * intrinsics.height for _, intrinsics in seen]
        assert sizes == sorted(sizes) and sizes[0] < sizes[-1] == 60 * 120
        np.testing.assert_allclose(seen[0][0], planar_pose(1.0, 1.5, 0.0), atol=1e-12)
        np.testing.assert_allclose([seen[-1][1].fl_x, seen[-1][1].fl_y], 30)
        browser.look(2.0)
        browser.image()
        assert seen[-1][0][0, 3] == 2.0
        browser.socket.close()


def test_notebook_keeps_the_last_image() -> None:
    with nerf_viewer(wall()) as viewer:
        page = viewer._repr_html_()
        assert f'src="{viewer.url}"' in page and 'src="data:image/png;base64,' in page


def test_viewer_does_not_change_the_training(trajectory: Trajectory, field: NeRF) -> None:
    with LiveViewer(trajectory) as viewer:
        browser = Browser(viewer)
        browser.look(1.0)
        watched = fit(trajectory, settings=SMALL, preset="smoke", progress=False, callback=viewer)
        assert browser.image().shape[2] == 3
        viewer.show(watched)
        browser.image()
        browser.socket.close()
    here, there = field.render(trajectory.poses[3]), watched.render(trajectory.poses[3])
    np.testing.assert_array_equal(here.rgb, there.rgb)
    np.testing.assert_array_equal(here.depth, there.depth)


def test_failed_rendering_does_not_end_the_training(trajectory: Trajectory) -> None:
    class Broken:
        def render_rays(self, rays_o: np.ndarray, rays_d: np.ndarray) -> None:
            raise ValueError("no rays today")

    with LiveViewer(trajectory) as viewer:
        browser = Browser(viewer)
        browser.look(1.0)
        until = time.monotonic() + 10
        while "no rays today" not in viewer._status.content:
            assert time.monotonic() < until
            viewer(1, Broken())
        browser.socket.close()


def test_refused_viewers(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(DataError, match="70000 is not a valid port"):
        nerf_viewer(wall(), port=70_000)
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(MissingPackageError, match=r'viser is not installed: pip install "autonerf-lab\[viewer\]"'):
        nerf_viewer(wall())


# --- the command line -----------------------------------------------------------------------------------------------


def test_field_commands(field: NeRF, tmp_path: Path, capsys: Any) -> None:
    run = open_run(tmp_path / "run", RunConfig("toy", "0", "frontier", "smoke", 0, "semantic-nerfacto"))
    assert cli.main(["point-cloud", str(run.path), "--out", str(tmp_path / "x.ply")]) == 1
    assert "run `autonerf-lab fit` first" in capsys.readouterr().err
    field.save(run / "nerf")
    run.mark_finished("fit", 1.0, None)
    assert cli.main(["point-cloud", str(run.path), "--out", str(tmp_path / "x.ply")]) == 0
    video = ["video", str(run.path), "--out", str(tmp_path / "x.gif"), "--seconds", "0.25", "--height", "16"]
    assert cli.main(video) == 0
    assert (tmp_path / "x.ply").exists() and (tmp_path / "x.gif").exists()

    command = [sys.executable, "-m", "autonerf_lab.cli", "view", str(run.path)]
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # background processes ignore SIGINT
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        signal.signal(signal.SIGINT, before)
        try:
            assert process.stdout is not None
            assert any("(stop with Ctrl-C)" in line for line in process.stdout)
            process.send_signal(signal.SIGINT)
            assert process.wait(20) == 0
        finally:
            process.kill()
