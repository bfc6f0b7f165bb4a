"""ROS domains: one for each session of this host."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ssp_core.errors import HostError
from ssp_core.host.locks import folder_of_locks, open_lock
from ssp_core.host.ports import domain_ports, ports_in_use
from ssp_core.host.shared_memory import shared_ports

# Below 102 no DDS port of the domain lies in Linux's ephemeral range; the low ones are left to
# whoever chooses by hand.
DOMAINS = range(20, 101)


@contextmanager
def free_domain() -> Iterator[int]:
    """Yield a domain id that is free on this host, held by a file lock to the block's end.

    A container with a network of its own may share /dev/shm, over which participants of one domain
    reach each other; its ports aren't in /proc/net/udp.

    Raises:
        HostError: all of them are in use, or the folder of the locks can't be made.
    """
    folder = folder_of_domains()
    busy = shared_ports()
    with suppress(OSError):
        busy |= ports_in_use(Path("/proc/net/udp").read_text())
    start = os.getpid() % len(DOMAINS)
    for k in range(len(DOMAINS)):
        domain_id = DOMAINS[(start + k) % len(DOMAINS)]
        if busy.intersection(domain_ports(domain_id)):
            continue
        try:
            handle = open_lock(folder / str(domain_id))
        except OSError:  # another user's, who lets nobody read it, or nobody may make one
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
        f"all ROS domains from {DOMAINS.start} to {DOMAINS.stop - 1} are in use on this host, or "
        f"their locks in {folder} can't be opened; end other sessions, let every user make files "
        "there, or set ROS_DOMAIN_ID and start the nodes yourself"
    )


def folder_of_domains() -> Path:
    """Return the folder of the domains' locks, without which no session over ROS can be run.

    Raises:
        HostError: it can't be made.
    """
    return folder_of_locks("ssp-domains", ", or use --in-process")
