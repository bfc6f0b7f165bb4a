"""Joining a Ray cluster or starting one, and saying in one line why there is none.

Ray itself goes on for minutes where nobody answers at its address, or something else does; so it
is first looked whether a server of gRPC, which a cluster's head is, answers there at all.
"""

from __future__ import annotations

import importlib
import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from ssp_core.errors import HostError

ADDRESS = "RAY_ADDRESS"
# Who speaks HTTP/2, as gRPC does, answers this with settings of his own at once (RFC 9113, 3.4).
_PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes((0, 0, 0, 4, 0, 0, 0, 0, 0))
_SETTINGS = 4
_FRAME_HEAD = 9
_ANSWER_S = 5.0
_HERE = frozenset({"localhost", "127.0.0.1", "::1"})
_REMEDY = f"set {ADDRESS} to the address of one, or use --engine processes"


def import_ray() -> Any:
    """The module.

    Raises:
        HostError: it isn't installed; with the remedy.
    """
    try:
        return importlib.import_module("ray")
    except ImportError as error:
        raise HostError(
            f"Ray can't be imported ({error}); install the extra with "
            "`python -m pip install 'ssp[ray]'`, or use --engine processes"
        ) from error


@contextmanager
def joined(ray: Any, workers: int) -> Iterator[None]:
    """Within the block this process is in the cluster that RAY_ADDRESS names, or in one of its own.

    Args:
        ray: the module.
        workers: processors of a cluster that is started here.

    Raises:
        HostError: there is no cluster, or it fails while it is used.
    """
    own = not ray.is_initialized()
    try:
        if own:
            _join(ray, workers)
        yield
    except (ray.exceptions.RayError, ConnectionError) as error:
        raise HostError(
            f"the Ray cluster failed ({first_line(error)}); what is answered is stored, so give "
            "the same command again"
        ) from error
    finally:
        if own:
            with suppress(ray.exceptions.RayError, ConnectionError):
                ray.shutdown()


def _join(ray: Any, workers: int) -> None:
    address = os.environ.get(ADDRESS, "")
    where: dict[str, Any] = {} if address else {"address": "local", "num_cpus": workers}
    if address not in ("", "auto", "local"):
        look_for(address, ray.util.get_node_ip_address)
    try:
        ray.init(include_dashboard=False, log_to_driver=False, configure_logging=False, **where)
    except Exception as error:  # it raises whatever it met on its way, also plain Exception
        what = f"no Ray cluster can be joined at {address}" if address else "Ray can't be started"
        raise HostError(f"{what} ({first_line(error)}); {_REMEDY}") from error


def look_for(address: str, own_ip: Any = lambda: "") -> None:
    """Looks in a few seconds whether somebody answers at an address as the head of a cluster would.

    Args:
        address: ``host:port``, or ``ray://host:port``.
        own_ip: this machine's address, as the head of a cluster on it may have bound that alone.

    Raises:
        HostError: nobody does.
    """
    host, _, port = address.rpartition("://")[2].rpartition(":")
    host = host.strip("[]")
    if not host or not port.isascii() or not port.isdigit() or int(port) > 65535:
        raise HostError(f"{ADDRESS}={address} is no address (HOST:PORT); {_REMEDY}")
    problem = _why_silent(host, int(port))
    if problem and host in _HERE and (own := own_ip()) not in _HERE:
        problem = problem if not own or _why_silent(own, int(port)) else ""
    if problem:
        raise HostError(f"no Ray cluster answers at {address} ({problem}); {_REMEDY}")


def _why_silent(host: str, port: int) -> str:
    """Why this is no server of gRPC; empty where it is one, or where TLS hides what it is."""
    try:
        with socket.create_connection((host, port), _ANSWER_S) as line:
            if os.environ.get("RAY_USE_TLS", "0") not in ("", "0"):
                return ""
            line.sendall(_PREFACE)
            end_s = time.monotonic() + _ANSWER_S
            read = b""
            while len(read) < _FRAME_HEAD:
                line.settimeout(max(0.01, end_s - time.monotonic()))
                if not (more := line.recv(_FRAME_HEAD - len(read))):
                    return "what listens there is no Ray"
                read += more
    except TimeoutError:
        return f"no answer within {_ANSWER_S:g} s"
    except (OSError, UnicodeError) as error:
        return getattr(error, "strerror", None) or str(error)
    return "" if read[3] == _SETTINGS else "what listens there is no Ray"


def first_line(error: BaseException) -> str:
    """The first line of what an error says, or its kind."""
    return next(iter(str(error).strip().splitlines()), type(error).__name__)
