"""Facts that several nodes tell of, as messages."""

from __future__ import annotations

from ssp_core.names import MAP_FRAME
from ssp_core.ros import stamp_from_ns
from ssp_core.safety.codes import MEANINGS
from ssp_core.world.plant import FaultFact, LimitFact
from ssp_msgs.msg import FaultEvent, SafetyEvent


def safety_event(passed: LimitFact, reaction: str = "abort") -> SafetyEvent:
    """A limit that was passed, and what follows from it: ``abort`` or ``local_stop``."""
    meaning = MEANINGS[passed.code]
    message = SafetyEvent(
        code=int(passed.code),
        limit_name=meaning.limit_name,
        source=passed.source,
        object_id=passed.object_id,
        measured=passed.measured,
        limit=passed.limit,
        unit=meaning.unit,
        reaction=reaction,
        words=passed.words,
    )
    message.header.stamp = stamp_from_ns(passed.stamp_ns)
    message.header.frame_id = MAP_FRAME
    return message


def fault_event(fault: FaultFact) -> FaultEvent:
    """A fault that begins or ends."""
    message = FaultEvent(
        source=fault.source,
        fault=fault.fault,
        target=fault.target,
        active=fault.active,
        value=fault.value,
        unit=fault.unit,
    )
    message.header.stamp = stamp_from_ns(fault.stamp_ns)
    message.header.frame_id = MAP_FRAME
    return message
