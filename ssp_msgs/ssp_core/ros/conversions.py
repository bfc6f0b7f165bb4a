"""Facts that several nodes tell of, as messages."""

from __future__ import annotations

from ssp_core.names import MAP_FRAME
from ssp_core.ros import stamp_from_ns
from ssp_core.safety.body_status import BodyStatus
from ssp_core.safety.codes import MEANINGS
from ssp_core.world.plant import FaultFact, LimitFact
from ssp_msgs.msg import BodyStatus as BodyStatusMsg
from ssp_msgs.msg import FaultEvent, SafetyEvent

# What is longer is cut; so many sentences are taken.
_LONGEST_SENTENCE = 1000
_MOST_SENTENCES = 20


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


def body_status_message(status: BodyStatus, now_ns: int) -> BodyStatusMsg:
    """What the process of an object tells of its body."""
    message = BodyStatusMsg(
        object_id=status.object_id,
        no_state=list(status.no_state),
        cannot_arm=list(status.cannot_arm),
        lasting=status.lasting,
    )
    message.header.stamp = stamp_from_ns(now_ns)
    message.header.frame_id = MAP_FRAME
    return message


def body_status_of(message: BodyStatusMsg) -> BodyStatus:
    """The inverse of ``body_status_message``, with bounded texts."""
    no_state, cannot_arm = (
        tuple(text[:_LONGEST_SENTENCE] for text in texts[:_MOST_SENTENCES])
        for texts in (message.no_state, message.cannot_arm)
    )
    name = message.object_id[:_LONGEST_SENTENCE]
    return BodyStatus(name, no_state, cannot_arm, message.lasting)
