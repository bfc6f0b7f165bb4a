"""The report of a live object's process on its body (BodyStatus.msg)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from ssp_core.clock import ns_to_seconds

# Told twice a second; what was told longer ago is forgotten.
PERIOD_S = 0.5
FORGOTTEN_S = 2.0


@dataclass(frozen=True, slots=True)
class BodyStatus:
    """The obstacles to seeing and arming one object, as sentences; empty: none.

    Args:
        no_state: why no states are made of what its body says.
        cannot_arm: all that keeps it from being armed.
        lasting: one of ``cannot_arm`` stays as long as the process runs as it was started.
    """

    object_id: str
    no_state: tuple[str, ...] = ()
    cannot_arm: tuple[str, ...] = ()
    lasting: bool = False


_NO_PROCESS = "its object_target was never heard: it doesn't run, or can't be reached"


def known_bodies(
    object_ids: Iterable[str], reports: Mapping[str, tuple[BodyStatus, int]], steady_ns: int
) -> dict[str, BodyStatus]:
    """Say of each object of a live run what is known of its body, or that its process is silent.

    Args:
        object_ids: of the live run.
        reports: by object, what its process said last, and when, ns on the steady clock.
        steady_ns: now, on the steady clock.
    """
    statuses = {}
    for object_id in object_ids:
        status, at_ns = reports.get(object_id, (None, 0))
        silent_s = ns_to_seconds(steady_ns - at_ns)
        if status is None:
            statuses[object_id] = BodyStatus(object_id, (_NO_PROCESS,))
        elif silent_s > FORGOTTEN_S:
            text = f"its object_target has said nothing for {silent_s:.0f} s"
            statuses[object_id] = BodyStatus(object_id, (text,))
        else:
            statuses[object_id] = status
    return statuses
