"""Messages hold what the dataclasses hold, field by field, and refuse numbers without a name."""

from __future__ import annotations

import dataclasses

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core import vocabulary
from ssp_core.cdr.messages import object_state
from ssp_core.motion.reference import Reference, ReferencePoint
from ssp_core.motion.state import ObjectState, Size
from ssp_core.ros import ns_from_stamp, stamp_from_ns
from ssp_core.ros.conversions import reference_from_msg, reference_to_msg, state_to_msg
from ssp_msgs.msg import ObjectState as ObjectStateMsg
from ssp_msgs.msg import PhaseEvent, SessionState
from ssp_msgs.srv import ObjectCommand

numbers = st.floats(allow_nan=False)
stamps = st.integers(0, 2**31 * 10**9 - 1)
states = st.builds(
    ObjectState,
    object_id=st.text(max_size=8).filter(lambda s: "\0" not in s),
    object_class=st.sampled_from(vocabulary.ObjectClass),
    role=st.sampled_from(vocabulary.Role),
    stamp_ns=stamps,
    x_m=numbers,
    y_m=numbers,
    yaw_rad=numbers,
    speed_mps=numbers,
    acceleration_mps2=numbers,
    yaw_rate_radps=numbers,
    size=st.builds(Size, numbers, numbers, numbers, numbers),
    sequence=st.integers(0, 2**64 - 1),
    control_state=st.sampled_from(vocabulary.ControlState),
    position_std_m=numbers,
    reference_id=st.sampled_from(["", "ot1-1"]),
    error_longitudinal_m=numbers,
    error_lateral_m=numbers,
    error_yaw_rad=numbers,
)
references = st.builds(
    Reference,
    reference_id=st.sampled_from(["", "r"]),
    object_id=st.sampled_from(["", "ot1"]),
    event_version=st.sampled_from(["", "sha256:0"]),
    purpose=st.sampled_from(["approach", "manoeuvre"]),
    dispatched_ns=stamps,
    execute_at_ns=stamps,
    expires_at_ns=stamps,
    points=st.lists(
        st.builds(ReferencePoint, *[numbers] * len(dataclasses.fields(ReferencePoint))), max_size=3
    ).map(tuple),
)


@settings(max_examples=50, deadline=None)
@given(state=states)
def test_state_round_trip(state: ObjectState) -> None:
    message = state_to_msg(state)
    assert message.header.frame_id == "map"
    assert object_state(message) == state


@settings(max_examples=50, deadline=None)
@given(reference=references)
def test_reference_round_trip(reference: Reference) -> None:
    message = reference_to_msg(reference)
    assert message.header.frame_id == "map"
    assert reference_from_msg(message) == reference


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
