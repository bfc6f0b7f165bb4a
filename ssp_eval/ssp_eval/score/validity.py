"""When an output counts at all (METHOD 5.3, 5.4): v_txt, v_trj and z."""

from __future__ import annotations

from ssp_eval.records import BehaviourRecord, Slot
from ssp_eval.score.thresholds import Thresholds
from ssp_vla_bridge.core.trajectory import Trajectory, check_trajectory


def text_valid(record: BehaviourRecord | None) -> bool:
    """v_txt of METHOD 5.3: there is a text and it isn't blank."""
    return record is not None and bool(record.text.strip())


def valid_trajectory(record: BehaviourRecord | None, thresholds: Thresholds) -> Trajectory | None:
    """The record's trajectory if v_trj = 1 (METHOD 5.3, 5.4), else None.

    What the record says under ``invalid`` decides nothing.
    """
    if record is None or record.trajectory is None:
        return None
    failures = check_trajectory(record.trajectory, thresholds.support_end_s, thresholds.tolerance)
    return None if failures else record.trajectory


def slot_given(slot: Slot | None, text: str) -> bool:
    """z of METHOD 5.3: a value, and at least one non-empty span inside a text that isn't blank."""
    if slot is None or not text.strip():
        return False
    return any(0 <= start < end <= len(text) for start, end in slot.evidence)
