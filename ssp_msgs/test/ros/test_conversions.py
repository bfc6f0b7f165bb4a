"""Messages hold what the dataclasses hold, field by field, and refuse numbers without a name."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core import vocabulary
from ssp_core.cdr.messages import object_state
from ssp_core.ros import ns_from_stamp, stamp_from_ns
from ssp_msgs.msg import ObjectState as ObjectStateMsg
from ssp_msgs.msg import PhaseEvent, SessionState
from ssp_msgs.srv import ObjectCommand


@given(ns=st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1))
def test_stamp_round_trip(ns: int) -> None:
    stamp = stamp_from_ns(ns)
    assert 0 <= stamp.nanosec < 10**9
    assert ns_from_stamp(stamp) == ns


@pytest.mark.parametrize("field", ["object_class", "role", "control_state"])
def test_a_number_without_a_name_is_refused(field: str) -> None:
    message = ObjectStateMsg()
    setattr(message, field, 99)
    with pytest.raises(ValueError, match="99"):
        object_state(message)


@pytest.mark.parametrize(
    ("enum", "message", "prefix"),
    [
        (vocabulary.ObjectClass, ObjectStateMsg, "CLASS_"),
        (vocabulary.Role, ObjectStateMsg, "ROLE_"),
        (vocabulary.Phase, PhaseEvent, "PHASE_"),
        (vocabulary.SessionPhase, SessionState, "STATE_"),
        (vocabulary.Verdict, SessionState, "VERDICT_"),
        (vocabulary.ControlState, ObjectCommand.Request, ""),
    ],
)
def test_enumerations_have_the_messages_numbers(
    enum: type[vocabulary.ObjectClass], message: type, prefix: str
) -> None:
    for member in enum:
        assert getattr(message, prefix + member.name) == member.value
