"""Facts of the session as messages."""

from __future__ import annotations

from collections.abc import Sequence

from ssp_core.names import MAP_FRAME
from ssp_core.ros import stamp_from_ns
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.codes import MEANINGS
from ssp_msgs.msg import LinkStatus, PhaseEvent, SafetyEvent, SessionState, TriggerEvent
from ssp_scenario_manager.core import outbox
from ssp_scenario_manager.core.link_report import LinkLine


def session_state_to_msg(change: outbox.StateChanged, spec: RunSpec | None) -> SessionState:
    message = SessionState()
    message.header.stamp = stamp_from_ns(change.stamp_ns)
    message.header.frame_id = MAP_FRAME
    message.state = int(change.state)
    message.previous = int(change.previous)
    message.event = change.event
    message.reason = change.reason
    message.verdict = int(change.verdict)
    message.reasons = list(change.reasons)
    if spec is not None:
        message.run_id = spec.run_id
        message.scenario = spec.scenario
        message.event_version = spec.event_version
    return message


def trigger_to_msg(fired: outbox.Triggered, dispatch_ns: int, processing_s: float) -> TriggerEvent:
    message = TriggerEvent()
    message.header.stamp = stamp_from_ns(fired.stamp_ns)
    message.header.frame_id = MAP_FRAME
    message.trigger_id = fired.trigger_id
    message.condition = fired.condition
    message.threshold = fired.threshold
    message.sample_stamps = [stamp_from_ns(s.stamp_ns) for s in fired.samples]
    message.sample_values = [s.value for s in fired.samples]
    message.crossing_time = stamp_from_ns(fired.crossing_ns)
    message.dispatch_time = stamp_from_ns(dispatch_ns)
    message.processing = processing_s
    message.object_ids = [r.object_id for r in fired.references]
    message.reference_ids = [r.reference_id for r in fired.references]
    return message


def phase_to_msg(began: outbox.PhaseBegan) -> PhaseEvent:
    message = PhaseEvent()
    message.header.stamp = stamp_from_ns(began.stamp_ns)
    message.header.frame_id = MAP_FRAME
    message.phase = int(began.phase)
    message.evidence = began.evidence
    message.provisional = began.phase.is_provisional
    return message


def limit_to_msg(passed: outbox.LimitPassed, source: str) -> SafetyEvent:
    violation = passed.violation
    meaning = MEANINGS[violation.code]
    message = SafetyEvent()
    message.header.stamp = stamp_from_ns(violation.stamp_ns)
    message.header.frame_id = MAP_FRAME
    message.code = int(violation.code)
    message.limit_name = meaning.limit_name
    message.source = source
    message.object_id = violation.object_id
    message.measured = violation.measured
    message.limit = violation.limit
    message.unit = meaning.unit
    message.reaction = "abort"
    return message


def link_status_to_msg(lines: Sequence[LinkLine], now_ns: int) -> LinkStatus:
    message = LinkStatus(
        object_ids=[line.object_id for line in lines],
        clock_offset=[line.offset_s for line in lines],
        delay=[line.delay_s for line in lines],
        state_age=[line.state_age_s for line in lines],
        states_received=[line.received for line in lines],
        states_lost=[line.lost for line in lines],
    )
    message.header.stamp = stamp_from_ns(now_ns)
    return message
