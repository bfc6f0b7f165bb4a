"""Conflicts of the VUT with an object that isn't the initiator of the event.

An event has one initiator, and the conflict is the initiator's. Others that are there may hide and
hold up, but a conflict with one of them before the initiator's is another event.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from ssp_core.geometry import Polyline
from ssp_core.motion.encounter import Encounter, encounter, is_conflict
from ssp_core.motion.event import Instant, Thresholds


@dataclass(frozen=True, slots=True)
class Intrusion:
    """A conflict of the VUT with an object that isn't the initiator.

    Args:
        object_id: the object.
        t_s: time at which it begins.
        ttc_s: TTC then; inf where the arrivals make the conflict.
        arrival_gap_s: gap of the predicted arrivals then.
    """

    object_id: str
    t_s: float
    ttc_s: float
    arrival_gap_s: float

    def text(self, thresholds: Thresholds) -> str:
        """Name the object, the time, and the quantity with its threshold."""
        if thresholds.ttc_s is not None and self.ttc_s < thresholds.ttc_s:
            quantity = f"TTC {self.ttc_s:.2f} s, under {thresholds.ttc_s:g} s"
        else:
            quantity = f"arrival gap {self.arrival_gap_s:.2f} s, under {thresholds.arrival_gap_s} s"
        return f"{self.object_id} is in conflict with the VUT at {self.t_s:.2f} s ({quantity})"


def intrusion_of(
    object_id: str, t_s: float, meeting: Encounter, thresholds: Thresholds
) -> Intrusion | None:
    """Return the conflict with an object that isn't the initiator at an instant; None without one.

    Args:
        object_id: the object.
        t_s: time of the instant.
        meeting: of the VUT and the object.
        thresholds: of the conflict.
    """
    if not is_conflict(meeting, thresholds.ttc_s, thresholds.arrival_gap_s):
        return None
    return Intrusion(object_id, t_s, meeting.ttc_s, meeting.arrival_gap_s)


def first_intrusions(
    of_each: Iterable[Iterable[Instant]],
    path: Polyline,
    thresholds: Thresholds,
    before_s: float | None,
) -> Iterator[Intrusion]:
    """Yield the first conflict with each of some objects that aren't the initiator.

    Args:
        of_each: the instants of each object, in time order.
        path: the VUT's path, frame map.
        thresholds: of the conflict.
        before_s: the initiator's conflict begins then, and nothing later counts; None: none begins.
    """
    end_s = math.inf if before_s is None else before_s
    for instants in of_each:
        for now in instants:
            if now.t_s >= end_s:
                break
            meeting = encounter(now.vut, now.other, path)
            intrusion = intrusion_of(now.other.object_id, now.t_s, meeting, thresholds)
            if intrusion is not None:
                yield intrusion
                break
