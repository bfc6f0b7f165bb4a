"""A ROS domain of one's own, so that sessions on one host don't hear each other."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ssp_core.errors import HostError

# Below 102 no DDS port of the domain lies in Linux's ephemeral range; the low ones are left to
# whoever chooses by hand.
DOMAINS = range(20, 101)


def domain_ports(domain_id: int) -> range:
    """UDP ports that DDS participants of a domain may use (RTPS 2.2, 9.6.1.1)."""
    return range(7400 + 250 * domain_id, 7400 + 250 * (domain_id + 1))


def domain_of_port(port: int) -> int:
    """The domain that a DDS port belongs to."""
    return (port - 7400) // 250


def ports_in_use(proc_net_udp: str) -> set[int]:
    """Local UDP ports in the text of /proc/net/udp."""
    ports = set()
    for line in proc_net_udp.splitlines()[1:]:
        fields = line.split()
        if len(fields) > 1 and ":" in fields[1]:
            ports.add(int(fields[1].rsplit(":", 1)[1], 16))
    return ports


@contextmanager
def free_domain() -> Iterator[int]:
    """A domain id that nobody on this host uses, held by a file lock until the end of the block.

    Raises:
        HostError: all of them are in use.
    """
    folder = Path(tempfile.gettempdir()) / "ssp-domains"
    if not folder.is_dir():
        folder.mkdir(exist_ok=True)
        folder.chmod(0o1777)  # for all users, as the host's domains are
    try:
        busy = ports_in_use(Path("/proc/net/udp").read_text())
    except OSError:
        busy = set()
    start = os.getpid() % len(DOMAINS)
    for k in range(len(DOMAINS)):
        domain_id = DOMAINS[(start + k) % len(DOMAINS)]
        if busy.intersection(domain_ports(domain_id)):
            continue
        try:
            handle = os.open(folder / str(domain_id), os.O_CREAT | os.O_RDWR, 0o666)
        except PermissionError:  # another user's
            continue
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            continue
        try:
            yield domain_id
        finally:
            os.close(handle)
        return
    raise HostError(
        f"all ROS domains from {DOMAINS.start} to {DOMAINS.stop - 1} are in use on this host; "
        "end other sessions or set ROS_DOMAIN_ID and start the nodes yourself"
    )
