"""Headless Chromium driven by its DevTools protocol, and a JupyterLab server for it."""

import base64
import json
import os
import secrets
import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
import websocket

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
NO_BUILD = "--ServerApp.tornado_settings={'page_config_data': {'buildCheck': False}}"  # same option as `make lab`
MISSING = "no browser: install the Debian package chromium (sudo apt-get install --no-install-recommends chromium)"


def chromium() -> str:
    """Return the browser command; fail with the package to install if there is none."""
    found = next(filter(None, map(shutil.which, NAMES)), None)
    assert found is not None, MISSING
    return found


def wait(what: str, condition: Callable[[], Any], seconds: float = 60) -> Any:
    """Wait until the condition is true and return its value."""
    end = time.monotonic() + seconds
    while not (value := condition()):
        assert time.monotonic() < end, f"{what}: not within {seconds:g} s"
        time.sleep(0.1)
    return value


class Page:
    """Page of the browser; records requested URLs and console errors."""

    def __init__(self, address: str, timeout: float = 60) -> None:
        self.timeout, self.requests, self.errors = timeout, list[str](), list[str]()
        self._socket = websocket.create_connection(address, timeout=timeout, suppress_origin=True)
        self._number = 0
        for domain in ("Runtime", "Log", "Network", "Page"):
            self.send(f"{domain}.enable")
        self.send("Emulation.setFocusEmulationEnabled", enabled=True)  # JupyterLab needs a focused page

    def send(self, method: str, **params: Any) -> dict[str, Any]:
        """Send one command and return its result; record events that arrive before it."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": params}))
        end = time.monotonic() + self.timeout
        while (message := json.loads(self._socket.recv())).get("id") != self._number:
            assert time.monotonic() < end, f"{method}: no answer within {self.timeout:g} s"
            self._record(message)
        assert "error" not in message, f"{method}: {message}"
        return message["result"]

    def js(self, code: str) -> Any:
        """Evaluate a JavaScript expression; await a promise."""
        options = {"awaitPromise": True, "returnByValue": True, "userGesture": True}
        result = self.send("Runtime.evaluate", expression=code, **options)
        assert "exceptionDetails" not in result, f"{code}: {result['exceptionDetails']}"
        return result["result"].get("value")

    def click(self, x: float, y: float) -> None:
        """Click the left button at a point of the window, pixels."""
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            button = {} if kind == "mouseMoved" else {"button": "left", "clickCount": 1}
            self.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, **button)

    def screenshot(self) -> bytes:
        """Return a PNG of the window."""
        return base64.b64decode(self.send("Page.captureScreenshot", format="png")["data"])

    def close(self) -> None:
        """Close the connection; the browser keeps running."""
        self._socket.close()

    def _record(self, message: dict[str, Any]) -> None:
        params = message.get("params", {})
        match message.get("method"):
            case "Network.requestWillBeSent":
                self.requests.append(params["request"]["url"])
            case "Runtime.exceptionThrown":
                details = params["exceptionDetails"]
                self.errors.append(details.get("exception", {}).get("description", details["text"]))
            case "Runtime.consoleAPICalled" if params["type"] in ("error", "assert"):
                self.errors.append(" ".join(str(a.get("value", a.get("description"))) for a in params["args"]))
            case "Log.entryAdded" if params["entry"]["level"] == "error":
                self.errors.append(f"{params['entry']['text']} {params['entry'].get('url', '')}".strip())


@contextmanager
def open_page(folder: Path) -> Iterator[Page]:
    """Open a blank page of a new browser with its profile in the folder; only loopback addresses resolve."""
    profile = folder / "chromium"
    command = [
        chromium(), "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run",
        "--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1", "--disable-background-networking",
        "--remote-debugging-port=0", f"--user-data-dir={profile}", "--window-size=1200,1000", "about:blank",
    ]  # fmt: skip
    with _process(command, folder / "chromium.log"):
        ready = profile / "DevToolsActivePort"
        port = int(wait("the browser starts", lambda: ready.exists() and ready.read_text()).split()[0])
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list", timeout=60) as answer:
            pages = [target for target in json.load(answer) if target["type"] == "page"]
        page = Page(pages[0]["webSocketDebuggerUrl"])
        try:
            yield page
        finally:
            page.close()


@contextmanager
def open_lab(folder: Path, **env: str) -> Iterator[str]:
    """Start JupyterLab in a folder, with all its files inside; yield the URL with ``%s`` for the notebook name."""
    home, token = folder / ".jupyter-home", secrets.token_hex(16)
    settings = {
        "apputils-extension/notification": {"fetchNews": "false", "checkForUpdates": False},
        "notebook-extension/tracker": {"windowingMode": "none"},  # render all cells, also outside the window
    }
    for name, values in settings.items():
        file = home / "settings" / "@jupyterlab" / f"{name}.jupyterlab-settings"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(values))
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    command = [
        sys.executable, "-m", "jupyterlab", "--allow-root", "--no-browser", "--expose-app-in-browser",
        f"--ServerApp.root_dir={folder}", "--ServerApp.ip=127.0.0.1", f"--ServerApp.port={port}",
        "--ServerApp.port_retries=0", f"--IdentityProvider.token={token}",
        "--LabApp.extension_manager=readonly", NO_BUILD,
    ]  # fmt: skip
    folders = {
        "JUPYTER_CONFIG_DIR": "config", "JUPYTER_DATA_DIR": "data", "JUPYTER_RUNTIME_DIR": "runtime",
        "JUPYTERLAB_SETTINGS_DIR": "settings", "JUPYTERLAB_WORKSPACES_DIR": "workspaces", "IPYTHONDIR": "ipython",
    }  # fmt: skip
    env = {**os.environ, **{name: str(home / path) for name, path in folders.items()}, **env}
    env.pop("MPLBACKEND", None)  # let kernels use the inline backend
    with _process(command, folder / ".lab.log", env=env) as server:

        def answers() -> bool:
            assert server.poll() is None, (folder / ".lab.log").read_text()
            with socket.socket() as probe:
                return probe.connect_ex(("127.0.0.1", port)) == 0

        wait("JupyterLab starts", answers, 120)
        yield f"http://127.0.0.1:{port}/lab/tree/%s?reset&token={token}"


@contextmanager
def _process(command: list[str], log: Path, env: dict[str, str] | None = None) -> Iterator[subprocess.Popen[bytes]]:
    """Run a process; terminate it and all its children at the end."""
    with log.open("wb") as out, subprocess.Popen(command, stdout=out, stderr=out, env=env) as process:
        try:
            yield process
        finally:
            processes = []
            if process.poll() is None:
                processes = [psutil.Process(process.pid), *psutil.Process(process.pid).children(recursive=True)]
                process.terminate()
            _, alive = psutil.wait_procs(processes, timeout=20)
            for remaining in alive:
                remaining.kill()
