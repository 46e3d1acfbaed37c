"""Python imports this at start-up when its folder is on PYTHONPATH: no address but loopback can be reached.

``conftest.py`` puts the folder there for every process that a test starts, kernels of notebooks included, and runs this
file for the process of the tests itself.
"""

import socket
from typing import Any


class NetworkBlockedError(OSError):
    """The tests run without a network, as the package promises to."""


def block() -> None:
    """Make every socket refuse addresses that are not on this machine."""

    def guarded(name: str) -> Any:
        original = getattr(socket.socket, name)

        def method(self: socket.socket, *args: Any) -> Any:
            # the address is the last argument of sendto, the only one of the others
            if self.family in (socket.AF_INET, socket.AF_INET6) and not _loopback(args[-1]):
                raise NetworkBlockedError(f"a test tried to reach {args[-1]!r}")
            return original(self, *args)

        return method

    for name in ("connect", "connect_ex", "sendto"):
        setattr(socket.socket, name, guarded(name))


def _loopback(address: Any) -> bool:
    host = str(address[0])
    return host in ("localhost", "::1") or host.startswith("127.")


block()
