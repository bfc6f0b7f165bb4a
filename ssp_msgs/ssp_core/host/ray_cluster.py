"""The Ray cluster on which a campaign runs: one that is joined, or one that is started here."""

from __future__ import annotations

import importlib
import os
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from ssp_core.addresses import resolve
from ssp_core.errors import HostError

ADDRESS = "RAY_ADDRESS"
# Its server has 30 s to start unless this says otherwise; a busy machine takes longer.
_SERVER_START = "RAY_gcs_server_port_wait_time_s"
_SERVER_START_S = "180"
_ANSWER_S = 5.0
_HERE = frozenset({"localhost", "127.0.0.1", "::1"})
_REMEDY = f"set {ADDRESS} to the address of one, or use --engine processes"


def import_ray() -> Any:
    """Return the module ray.

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
    """Join the cluster that RAY_ADDRESS names, or start one, for the duration of the block.

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
            f"the Ray cluster failed ({first_line(error)}); what is done is stored, so give "
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
    check_folder(Path.cwd())
    ours = not address and _SERVER_START not in os.environ
    if ours:
        os.environ[_SERVER_START] = _SERVER_START_S
    try:
        ray.init(include_dashboard=False, log_to_driver=False, configure_logging=False, **where)
    except Exception as error:  # it raises whatever it met on its way, also plain Exception
        what = f"no Ray cluster can be joined at {address}" if address else "Ray can't be started"
        raise HostError(f"{what} ({first_line(error)}); {_REMEDY}") from error
    finally:
        if ours:
            del os.environ[_SERVER_START]


def check_folder(folder: Path) -> None:
    """Refuse to start workers in a folder that holds a module of the same name as one of theirs.

    Ray has its workers look for modules there before all packages.

    Raises:
        HostError: names the file that would run instead.
    """
    for file in sorted((*folder.glob("*.py"), *folder.glob("*/__init__.py"))):
        name = file.parent.name if file.name == "__init__.py" else file.stem
        ours = getattr(sys.modules.get(name), "__file__", None)
        if name == "__main__" or ours is None or not file.exists():
            continue
        if not file.samefile(ours):
            raise HostError(
                f"{file} would run in Ray's workers instead of {ours}; give the command in "
                "another folder, or use --engine processes"
            )


def look_for(address: str, own_ip: Callable[[], str] = lambda: "") -> None:
    """Check within a few seconds that an address accepts connections.

    Args:
        address: HOST:PORT, with or without a scheme.
        own_ip: this machine's address, as the head of a cluster on it may have bound that alone.

    Raises:
        HostError: it accepts none, or is no address.
    """
    host, _, port = address.rpartition("://")[2].rpartition(":")
    host = host.strip("[]")
    if not host or not port.isascii() or not port.isdigit() or int(port) > 65535:
        raise HostError(f"{ADDRESS}={address} is no address (HOST:PORT); {_REMEDY}")
    problem = ""
    for name in (host, *((own_ip(),) if host in _HERE else ())):
        try:
            resolve(name, int(port), socket.SOCK_STREAM)
            socket.create_connection((name, int(port)), _ANSWER_S).close()
            return
        except TimeoutError:
            problem = problem or f"no answer within {_ANSWER_S:g} s"
        except (OSError, HostError) as error:
            problem = problem or getattr(error, "strerror", None) or str(error)
    raise HostError(f"no Ray cluster answers at {address} ({problem}); {_REMEDY}")


def first_line(error: BaseException) -> str:
    """Return the first line of what an error says, or its kind."""
    return next(iter(str(error).strip().splitlines()), type(error).__name__)
