"""Messages for facts that several nodes publish."""

from __future__ import annotations

import time

from ssp_core.names import MAP_FRAME
from ssp_core.ros import stamp_from_ns
from ssp_core.safety.body_status import BodyStatus
from ssp_core.safety.object_rules import ObjectRules
from ssp_msgs.msg import BodyStatus as BodyStatusMsg
from ssp_msgs.msg import ObjectRules as ObjectRulesMsg

# What is longer is cut; so many sentences are taken.
_LONGEST_SENTENCE = 1000
_MOST_SENTENCES = 20


def body_status_message(status: BodyStatus, now_ns: int) -> BodyStatusMsg:
    """Convert the report of an object's process on its body."""
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
    """Convert what ``body_status_message`` made back, with bounded texts."""
    no_state, cannot_arm = (
        tuple(text[:_LONGEST_SENTENCE] for text in texts[:_MOST_SENTENCES])
        for texts in (message.no_state, message.cannot_arm)
    )
    name = message.object_id[:_LONGEST_SENTENCE]
    return BodyStatus(name, no_state, cannot_arm, message.lasting)


def rules_to_msg(rules: ObjectRules, object_id: str, participant: str) -> ObjectRulesMsg:
    """Convert the rules of an object, as the node that leads it publishes them now."""
    message = ObjectRulesMsg(
        object_id=object_id,
        participant=participant,
        software=rules.software,
        digest=rules.digest,
        names=list(rules.values),
        values=list(rules.values.values()),
    )
    message.header.stamp = stamp_from_ns(time.time_ns())
    return message


def rules_from_msg(message: ObjectRulesMsg) -> tuple[str, ObjectRules]:
    """Read an object's id and its rules; ValueError for a message that contradicts itself."""
    values = dict(zip(message.names, message.values, strict=True))
    rules = ObjectRules(message.software, values)
    if rules.digest != message.digest:
        raise ValueError(f"the rules of {message.object_id} are not those of their digest")
    return message.object_id, rules
