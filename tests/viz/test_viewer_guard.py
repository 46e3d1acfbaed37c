"""Protection of the viewer's page: a real WebSocket client, and Chromium with a page of another origin."""

import functools
import http.client
import http.server
import threading
import time
import urllib.parse
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
import viser
import websockets.sync.client
from chromium import open_page, wait
from websockets.exceptions import ConnectionClosed, InvalidStatus

from autonerf_lab.errors import MissingPackageError
from autonerf_lab.geometry import Intrinsics, planar_pose
from autonerf_lab.viz.viewer import guard
from autonerf_lab.viz.viewer.viewer import MAX_SIDE, MIN_INTERVAL, Viewer, _intrinsics

PROTOCOL: Any = f"viser-v{viser.__version__}"
CAMERA = {
    **{"wxyz": (0.5, -0.5, 0.5, -0.5), "position": (1.0, 1.5, 0.88), "fov": 1.5, "near": 0.1, "far": 100.0},
    **{"image_height": 60, "image_width": 120, "look_at": (2.0, 1.5, 0.88), "up_direction": (0.0, 0.0, 1.0)},
}


@pytest.fixture(scope="module")
def viewer() -> Iterator[Viewer]:
    with Viewer(np.stack([planar_pose(k, 0.0, 0.0) for k in range(3)]), Intrinsics.from_fov(8, 6)) as viewer:
        yield viewer


def connect(viewer: Viewer, **options: Any) -> websockets.sync.client.ClientConnection:
    address = options.pop("address", viewer.url.replace("http", "ws").rstrip("/"))
    return websockets.sync.client.connect(address, subprotocols=[PROTOCOL], max_size=None, compression=None, **options)


def status(viewer: Viewer, path: str, **headers: str) -> int:
    place = urllib.parse.urlsplit(viewer.url)
    connection = http.client.HTTPConnection(str(place.hostname), place.port, timeout=10)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    assert (answer.status == 200) == (b"<html" in answer.read())
    connection.close()
    return answer.status


def message(kind: str, **values: Any) -> bytes:
    return msgspec.msgpack.encode({"type": kind, **values})


def test_the_page_needs_the_token_and_a_host_of_this_machine(viewer: Viewer) -> None:
    place = urllib.parse.urlsplit(viewer.url)
    assert len(place.path) == 34  # 24 random bytes in base64, and two slashes
    assert status(viewer, place.path) == 200
    assert status(viewer, place.path, Host="localhost:9999") == 200  # a tunnel from another machine
    for path in ("/", "/index.html", place.path[:-2] + "/", "//" + place.path, "/" + "a" * 32 + "/"):
        assert status(viewer, path) == 403
    for host in ("evil.example", "127.0.0.1.evil.example", "evil.example:" + str(place.port), "0.0.0.0", ""):
        assert status(viewer, place.path, Host=host) == 403


def test_web_sockets_of_other_origins_are_refused(viewer: Viewer) -> None:
    place = urllib.parse.urlsplit(viewer.url)
    with connect(viewer) as socket:  # a program sends no origin
        assert socket.recv(timeout=10)
    with connect(viewer, origin=f"http://{place.netloc}") as socket:
        assert socket.recv(timeout=10)
    for origin in ("http://evil.example", "null", "http://127.0.0.1", f"https://{place.netloc}", "http://localhost:1"):
        with pytest.raises(InvalidStatus, match="403"):
            connect(viewer, origin=origin)
    with pytest.raises(InvalidStatus, match="403"):
        connect(viewer, address=f"ws://{place.netloc}/{'a' * 32}")


def test_the_number_of_browsers_is_bounded(viewer: Viewer) -> None:
    sockets = [connect(viewer) for _ in range(guard.MAX_BROWSERS)]
    with pytest.raises(InvalidStatus, match="503"):
        connect(viewer)
    sockets.pop().close()
    until = time.monotonic() + 10
    while True:  # the server needs a moment to see the end of the connection
        try:
            sockets.append(connect(viewer))
            break
        except InvalidStatus:
            assert time.monotonic() < until
            time.sleep(0.05)
    for socket in sockets:
        socket.close()


def test_messages_are_bounded_in_size_kind_and_rate(viewer: Viewer) -> None:
    with connect(viewer) as socket:
        for data in (b"\xc1", b"", "text", message("FileTransferPart", content=b"x"), message("NoSuchMessage")):
            socket.send(data)  # dropped: without the guard each of them ends the connection or is kept
        socket.send(message("ViewerCameraMessage", **CAMERA))
        wait("the camera arrives", lambda: len(viewer._server.get_clients()) == 1, 10)
        count = 3 * int(guard.MAX_RATE)
        started = time.monotonic()
        for k in range(count):
            socket.send(message("ViewerCameraMessage", **{**CAMERA, "fov": 1 + k / 1000}))
        (client,) = viewer._server.get_clients().values()
        wait("the last camera", lambda: client.camera.fov == 1 + (count - 1) / 1000, 20)
        assert time.monotonic() - started > 1.8  # only those of one second are read at once
        socket.send(b"x" * (guard.MAX_BYTES + 1))
        with pytest.raises(ConnectionClosed, match="1009"):
            while True:
                socket.recv(timeout=10)


@pytest.mark.parametrize("width", [1, 10**9, float("inf")])
@pytest.mark.parametrize("height", [1, 10**9])
@pytest.mark.parametrize("fov", [0.0, -1.0, 3.2, 1e300])
def test_sizes_that_a_browser_asks_for_are_clamped(width: float, height: float, fov: float) -> None:
    camera = SimpleNamespace(image_width=width, image_height=height, fov=fov)
    found = _intrinsics(camera, min(1e6, width * height))
    assert 8 <= found.width <= MAX_SIDE and 8 <= found.height <= MAX_SIDE
    assert np.isfinite([found.fl_x, found.fl_y]).all() and found.fl_x > 0 and found.fl_y > 0


def test_images_are_rendered_at_a_bounded_rate(viewer: Viewer, monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[float] = []
    monkeypatch.setattr(viewer, "_send", lambda *arguments: sent.append(time.time()))
    with connect(viewer) as socket:
        socket.send(message("ViewerCameraMessage", **CAMERA))
        wait("the browser", viewer._server.get_clients, 10)
        (client,) = viewer._server.get_clients().values()
        until = time.monotonic() + 1
        while time.monotonic() < until:  # a browser whose camera moves all the time
            client.camera._state.update_timestamp += 1
            viewer._draw(lambda c2w, intrinsics: None, (0.1,))
    assert 2 <= len(sent) <= 1 / MIN_INTERVAL + 2
    wait("the browser leaves", lambda: not viewer._server.get_clients(), 10)
    viewer._draw(lambda c2w, intrinsics: None, (0.1,))
    assert viewer._clients == {}


def test_a_server_that_does_not_ask_the_guard_is_not_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guard.Guard, "installed", lambda self: nullcontext())
    before = threading.active_count()
    with pytest.raises(MissingPackageError, match="cannot be protected"):
        Viewer(np.eye(4)[None], Intrinsics.from_fov(8, 6))
    wait("the server stops", lambda: threading.active_count() <= before, 10)


def test_a_browser_shows_the_page_and_a_page_of_another_origin_gets_nothing(viewer: Viewer, tmp_path: Path) -> None:
    (tmp_path / "www").mkdir()
    (tmp_path / "www/index.html").write_text("<html><title>evil</title></html>")
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(tmp_path / "www"))
    evil = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=evil.serve_forever, daemon=True).start()
    opens = "new Promise(done => {{ const s = new WebSocket({0!r}, {1!r}); s.onopen = () => done('open');"
    opens += " s.onerror = () => done('refused'); }})"
    socket = viewer.url.replace("http", "ws").rstrip("/")
    try:
        with open_page(tmp_path) as page:
            page.send("Page.navigate", url=viewer.url)
            wait("the page connects", viewer._server.get_clients, 60)
            assert page.js(opens.format(socket, PROTOCOL)) == "open"
            page.send("Page.navigate", url=f"http://127.0.0.1:{evil.server_port}/")
            wait("the other page", lambda: page.js("document.title") == "evil")
            assert page.js(opens.format(socket, PROTOCOL)) == "refused"  # even with the token
            assert page.js(f"fetch({viewer.url!r}).then(() => 'read', () => 'refused')") == "refused"
    finally:
        evil.shutdown()
        evil.server_close()
