"""The address of a CARLA server."""

from __future__ import annotations

from dataclasses import dataclass

from ssp_core.addresses import host_and_port
from ssp_core.errors import InputError

DEFAULT_PORT = 2000
SCHEME = "carla://"


def _is_host(name: str) -> bool:
    """Tell whether a resolver takes the name: no part of it is empty or over 63 characters."""
    try:
        name.encode("idna")
    except UnicodeError:
        return False
    return True


@dataclass(frozen=True, slots=True)
class CarlaAddress:
    """Host and RPC port of a server; its streams come from the next port."""

    host: str
    port: int

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{host}:{self.port}"


def parse_address(text: str, field: str) -> CarlaAddress:
    """Read ``HOST[:PORT]``, with or without ``carla://`` in front.

    Args:
        text: as a person wrote it.
        field: the argument or option that the text was given to.

    Raises:
        InputError: it is none.
    """
    host, port = host_and_port(text.removeprefix(SCHEME)) or ("", None)
    port = DEFAULT_PORT if port is None else port
    # The next port is the streams'.
    if not host or not 1 <= port < 65_535 or not _is_host(host):
        raise InputError(
            "is no address of a CARLA server",
            field=field,
            value=text,
            remedy=f"write HOST or HOST:PORT, with a port from 1 to 65534 (default {DEFAULT_PORT})",
        )
    return CarlaAddress(host, port)
