"""Host addresses as people write them, and their resolution: one rule for all."""

from __future__ import annotations

import re
import socket
from typing import Any

from ssp_core.errors import HostError

_ADDRESS = re.compile(r"(?P<host>[^:/?#@\[\]\s]+|\[[0-9a-fA-F:.]+\])(:(?P<port>[0-9]{1,5}))?")


def host_and_port(text: str) -> tuple[str, int | None] | None:
    """Read ``HOST[:PORT]``; None for any other text.

    The host may be a name that has no address, and the port one that doesn't exist.

    Args:
        text: with brackets around the host where it is IPv6.

    Returns:
        The host without brackets, and the port; None: it isn't stated.
    """
    match = _ADDRESS.fullmatch(text)
    if match is None:
        return None
    return match["host"].strip("[]"), None if match["port"] is None else int(match["port"])


def resolve(
    host: str, port: int, kind: socket.SocketKind, flags: socket.AddressInfo | int = 0
) -> list[Any]:
    """Return what socket.getaddrinfo finds, at least one; a name may take a while.

    Raises:
        HostError: the host can't exist, or has no address.
    """
    try:
        return socket.getaddrinfo(host, port, type=kind, flags=flags)
    except UnicodeError:  # of the codec of names, whose words say nothing to people
        raise HostError(f"{host!r} is no name of a host") from None
    except OSError as error:
        raise HostError(f"{host!r} has no address: {error.strerror or error}") from None
