"""Python imports this at start-up when its folder is on PYTHONPATH: Python's sockets connect to loopback only.

The methods `connect`, `connect_ex`, `sendto` and `sendmsg` of Python's sockets are replaced. The resolution of names,
servers, sockets of compiled code and other programs, the browser for example, are not covered.

``conftest.py`` puts the folder there for every process that a test starts, kernels of notebooks included, and runs this
file for the process of the tests itself.
"""

import ipaddress
import socket
from typing import Any


class NetworkBlockedError(OSError):
    """The tests run without a network, as the package promises to."""


def block() -> None:
    """Make every socket refuse addresses that are not on this machine."""

    def guarded(name: str) -> Any:
        original = getattr(socket.socket, name)

        def method(self: socket.socket, *args: Any) -> Any:
            # the address is the last argument; that of sendmsg may be missing on a connected socket
            address = args[-1] if name != "sendmsg" or len(args) == 4 else None
            if self.family in (socket.AF_INET, socket.AF_INET6) and address is not None and not _loopback(address):
                raise NetworkBlockedError(f"a test tried to reach {address!r}")
            return original(self, *args)

        return method

    for name in ("connect", "connect_ex", "sendto", "sendmsg"):
        if hasattr(socket.socket, name):  # Windows has no sendmsg
            setattr(socket.socket, name, guarded(name))


def _loopback(address: Any) -> bool:
    host = str(address[0])
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:  # another host name, such as 127.example.org
        return False


block()
