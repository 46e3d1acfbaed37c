"""Protection of the viewer's page against other web pages and other users of the machine.

Every page that a browser shows can send requests to 127.0.0.1, and another user of the machine can connect to the port.
The guard therefore answers only requests whose path begins with a secret token, whose host is this machine, and whose
origin, if a browser sends one, is the page itself. It also bounds the number of browsers, and the size, the kind and
the rate of their messages.
"""

import asyncio
import contextlib
import hmac
import logging
import secrets
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from http import HTTPStatus
from typing import Any

import msgspec
from websockets.asyncio import server
from websockets.http11 import Request, Response

HOSTS = ("127.0.0.1", "localhost")  # another host name is an attacker's name for this address (DNS rebinding)
MESSAGES = ("ViewerCameraMessage", "GuiUpdateMessage")  # all others are dropped, uploads of files for example
MAX_BYTES = 1 << 16  # per message
MAX_RATE = 200.0  # messages per second and browser; more are read later, so the browser waits
MAX_BROWSERS = 8
_LOCK = threading.Lock()  # of the function that `Guard.installed` replaces

_Process = Callable[[Any, Request], Response | None]


class _Message(msgspec.Struct):
    type: str


class GuardedConnection(server.ServerConnection):
    """Connection to a browser that limits the kind and the rate of its messages."""

    admitted = False
    _next = 0.0  # time of the event loop, seconds

    async def recv(self, decode: bool | None = None) -> Any:
        """Return the next message of an allowed kind."""
        while True:
            data = await super().recv(decode)
            now = self.loop.time()
            self._next = max(self._next, now - 1) + 1 / MAX_RATE  # up to a second's messages at once
            if self._next > now:
                await asyncio.sleep(self._next - now)
            with contextlib.suppress(msgspec.MsgspecError):  # what is not a message is dropped too
                if isinstance(data, bytes) and msgspec.msgpack.decode(data, type=_Message).type in MESSAGES:
                    return data


class Guard:
    """Check of all requests to one server.

    Attributes:
        token: secret first part of the path of the page.
        active: the server asks this guard.
    """

    def __init__(self) -> None:
        self.token = secrets.token_urlsafe(24)
        self.active = False

    @contextlib.contextmanager
    def installed(self) -> Iterator[None]:
        """Context manager in which a server of `websockets` that starts gets this guard.

        viser has no option for the checks of requests, and starts its server in a thread of its own.
        """
        original = server.serve

        def serve(*args: Any, process_request: _Process, **options: Any) -> server.serve:
            self.active = True
            logger = logging.Logger("viewer", logging.CRITICAL)  # refused requests must not fill the terminal
            options |= {"create_connection": GuardedConnection, "max_size": MAX_BYTES, "logger": logger}
            return original(*args, process_request=self._checked(process_request), **options)

        with _LOCK:
            server.serve = serve  # type: ignore[assignment,misc]
            try:
                yield
            finally:
                server.serve = original  # type: ignore[misc]

    def _checked(self, process: _Process) -> _Process:
        def checked(connection: GuardedConnection, request: Request) -> Response | None:
            refusal = self._refusal(connection, request)
            if refusal is not None:
                return connection.respond(*refusal)
            is_page = not request.headers.get_all("Upgrade")
            connection.admitted = not is_page
            response = process(connection, replace(request, path=self._inner_path(request.path)[1]))
            if response is not None:
                response.headers["Referrer-Policy"] = "no-referrer"  # the address contains the token
                response.headers["X-Content-Type-Options"] = "nosniff"
            return response

        return checked

    def _refusal(self, connection: GuardedConnection, request: Request) -> tuple[HTTPStatus, str] | None:
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        if len(hosts) != 1 or hosts[0].partition(":")[0] not in HOSTS:
            return HTTPStatus.FORBIDDEN, "The host of the address must be 127.0.0.1 or localhost.\n"
        if any(origin != f"http://{hosts[0]}" for origin in origins):
            return HTTPStatus.FORBIDDEN, "The request comes from another page.\n"
        if not self._inner_path(request.path)[0]:
            return HTTPStatus.FORBIDDEN, "Use the complete address that the program printed.\n"
        if sum(getattr(other, "admitted", False) for other in connection.server.handlers) >= MAX_BROWSERS:
            return HTTPStatus.SERVICE_UNAVAILABLE, f"{MAX_BROWSERS} browsers are connected; close one.\n"
        return None

    def _inner_path(self, path: str) -> tuple[bool, str]:
        """Return True if a path begins with the token, compared in constant time, and the rest of the path."""
        first, _, rest = path.removeprefix("/").partition("/")
        given = first.partition("?")[0].encode(errors="surrogateescape")
        return hmac.compare_digest(given, self.token.encode()), f"/{rest}"
