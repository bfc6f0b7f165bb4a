"""Facts of the simulated world as messages."""

from __future__ import annotations

from ssp_core import ros
from ssp_msgs.msg import FaultEvent
from ssp_ot_controller.sil.fault_schedule import FaultChange


def fault_to_msg(change: FaultChange, source: str, now_ns: int) -> FaultEvent:
    """A fault that begins or ends.

    Args:
        change: what.
        source: node that injects it.
        now_ns: session time.
    """
    message = FaultEvent(
        source=source,
        fault=f"{change.number} {change.kind}",
        target=change.target,
        active=change.active,
        value=change.value,
        unit=change.unit,
    )
    message.header.stamp = ros.stamp_from_ns(now_ns)
    return message
