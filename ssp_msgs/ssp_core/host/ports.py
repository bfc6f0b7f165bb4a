"""The UDP ports of DDS: of which domain each is, and which are in use on this host."""

from __future__ import annotations


def domain_ports(domain_id: int) -> range:
    """Return the UDP ports that DDS participants of a domain may use (RTPS 2.2, 9.6.1.1)."""
    return range(7400 + 250 * domain_id, 7400 + 250 * (domain_id + 1))


def domain_of_port(port: int) -> int:
    """Return the domain that a DDS port belongs to."""
    return (port - 7400) // 250


def ports_in_use(proc_net_udp: str) -> set[int]:
    """Return the local UDP ports in the text of /proc/net/udp."""
    ports = set()
    for line in proc_net_udp.splitlines()[1:]:
        fields = line.split()
        if len(fields) > 1 and ":" in fields[1]:
            ports.add(int(fields[1].rsplit(":", 1)[1], 16))
    return ports
