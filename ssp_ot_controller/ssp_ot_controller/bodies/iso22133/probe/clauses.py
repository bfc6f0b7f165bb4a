"""Clauses of a probe, and how each is judged by what was sent and what came. No I/O, no clock."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import pairwise

import numpy as np

from ssp_core.clock import NS_PER_S, ns_to_seconds
from ssp_core.safety.contradiction import HOLDS_S
from ssp_core.vocabulary import ControlState
from ssp_ot_controller.bodies.iso22133.framing import RejectedBytes
from ssp_ot_controller.bodies.iso22133.link import ReceivedMessage
from ssp_ot_controller.bodies.iso22133.messages import (
    DecodedMessage,
    Dres,
    DriveDirection,
    Grem,
    Monr,
    Osem,
    ReadyToArm,
    ResponseCode,
)
from ssp_ot_controller.bodies.iso22133.probe.motion import (
    LAG_S,
    ends_run,
    keeps_to_way,
    runs,
    starts,
    stops,
    unheard,
)
from ssp_ot_controller.bodies.iso22133.probe.readings import (
    is_not_ahead,
    knows_its_place,
    states_its_motion,
    stays_fresh,
)
from ssp_ot_controller.bodies.iso22133.probe.steps import (
    LIMITS,
    Finding,
    Judge,
    ProbeClause,
    Step,
    silent,
    within,
)
from ssp_ot_controller.bodies.iso22133.probe_report import (
    CLOCK,
    START_TIME,
    STATE_AGE,
    STOP_ON_ABORT,
    STOP_ON_HEARTBEAT_LOSS,
    Outcome,
    Row,
    Stage,
)
from ssp_ot_controller.bodies.iso22133.states import state_of, state_text
from ssp_ot_controller.bodies.iso22133.units import nearest_utc_ns

C = ControlState
# Frames of each direction that are kept as evidence of a clause.
_MOST_EVIDENCE = 4
_NEEDED = ("time_of_week_ns", "x_m", "y_m", "yaw_rad", "speed_mps")
# States of an object that nobody leads, or that was disarmed.
_UNARMED = (C.INIT, C.OFF, C.DISARMED, C.ABORTING)
# Steps in which heartbeats are withheld.
_UNHEARD = ("arm_loss", "loss")


def rows_of(steps: Mapping[str, Step], stages: Iterable[Stage], ended: str) -> tuple[Row, ...]:
    """Return a row for each clause.

    Args:
        steps: by their names, in their order.
        stages: those that were asked for.
        ended: why the probe ended before its last step; for those that were never reached.
    """
    stages_to_run = set(stages)
    rows = []
    for clause in CLAUSES:
        step = steps.get(clause.step)
        if clause.stage not in stages_to_run:
            finding = Finding(Outcome.NOT_RUN, "its stage was not asked for")
        elif step is None:
            finding = Finding(Outcome.NOT_RUN, ended)
        else:
            finding = clause.judge(step, clause, steps)
        rows.append(
            Row(
                clause=clause.id,
                stage=clause.stage,
                title=clause.title,
                verdict=finding.verdict,
                sent=tuple(data.hex() for data in finding.sent[:_MOST_EVIDENCE]),
                came=tuple(data.hex() for data in finding.came[:_MOST_EVIDENCE]),
                measured=None if finding.measured is None else round(finding.measured, 6),
                bound=clause.bound,
                unit=clause.unit,
                text=finding.text,
            )
        )
    return tuple(rows)


def _names(values: Iterable[str]) -> str:
    return ", ".join(sorted(set(values)))


# -- reports, in every step, and answers ----------------------------------------------------------


def _connected(step: Step, clause: ProbeClause, _: Mapping[str, Step]) -> Finding:
    if "connected" not in step.marks:
        return Finding(Outcome.FAIL, step.problem)
    return within(clause, ns_to_seconds(step.marks["connected"] - step.begin_ns))


def _first_report(step: Step, clause: ProbeClause, _: Mapping[str, Step]) -> Finding:
    osem, monrs = step.last_sent(Osem), step.monrs()
    if osem is None or not monrs:
        return silent(step)
    first = monrs[0][0]
    waited_s = ns_to_seconds(first.stamp_ns - osem.stamp_ns)
    return within(clause, waited_s, sent=(osem.data,), came=(first.data,))


def _frames(step: Step, clause: ProbeClause, steps: Mapping[str, Step]) -> Finding:
    if not step.came:
        return Finding(Outcome.FAIL, "no frame came")
    messages = [r for one in steps.values() for r in one.came]
    bad = [(r, r.outcome) for r in messages if isinstance(r.outcome, RejectedBytes)]
    text = _names(f"{o.reason.value}: {o.text}" for _, o in bad[:_MOST_EVIDENCE])
    return within(clause, len(bad), text, came=tuple(r.data for r, _ in bad))


def _rate(step: Step, clause: ProbeClause, _: Mapping[str, Step]) -> Finding:
    osem, monrs = step.last_sent(Osem), step.monrs()
    if osem is None or not isinstance(osem.message, Osem) or len(monrs) < 2:
        return silent(step)
    span_s = ns_to_seconds(monrs[-1][0].stamp_ns - monrs[0][0].stamp_ns)
    rate_hz = (len(monrs) - 1) / max(span_s, 1e-9)
    asked_hz = osem.message.monr_rate_hz
    text = f"{rate_hz:.1f} Hz, asked for {asked_hz} Hz"
    return within(clause, 100.0 * (rate_hz / asked_hz - 1.0), text, sent=(osem.data,))


def _pause(step: Step, clause: ProbeClause, steps: Mapping[str, Step]) -> Finding:
    if len(step.monrs()) < 2:
        return silent(step)
    # Without heartbeats an object may cease to report.
    report_series = [one.monrs() for name, one in steps.items() if name not in _UNHEARD]
    pauses = [
        (ns_to_seconds(after[0].stamp_ns - before[0].stamp_ns), after[0])
        for monrs in report_series
        for before, after in pairwise(monrs)
    ]
    middle, late = np.percentile([pause_s for pause_s, _ in pauses], (50, 99)) * 1e3
    text = f"median {middle:.1f} ms, p99 {late:.1f} ms"
    worst_s, received = max(pauses, key=lambda pair: pair[0])
    return within(clause, worst_s, text, came=(received.data,))


def _all_monrs(steps: Mapping[str, Step]) -> list[tuple[ReceivedMessage, Monr]]:
    return [pair for one in steps.values() for pair in one.monrs()]


def _age(step: Step, clause: ProbeClause, steps: Mapping[str, Step]) -> Finding:
    ages = [
        (ns_to_seconds(r.stamp_ns - nearest_utc_ns(m.time_of_week_ns, r.stamp_ns)), r)
        for r, m in _all_monrs(steps)
        if m.time_of_week_ns is not None
    ]
    if not ages:
        return silent(step) if not step.monrs() else Finding(Outcome.FAIL, "no MONR states a time")
    values = [age_s for age_s, _ in ages]
    text = f"{1e3 * min(values):.1f} to {1e3 * max(values):.1f} ms; negative: its clock is ahead"
    worst, received = max(ages, key=lambda pair: abs(pair[0]))
    return within(clause, worst, text, came=(received.data,))


def _fields(step: Step, clause: ProbeClause, steps: Mapping[str, Step]) -> Finding:
    if not step.monrs():
        return silent(step)
    monrs, names = _all_monrs(steps), list(Monr.__dataclass_fields__)
    absent = {n for n in names if any(getattr(m, n) is None for _, m in monrs)}
    lacking = [r for r, m in monrs if any(getattr(m, n) is None for n in _NEEDED)]
    text = f"unavailable: {_names(absent)}" if absent else "all are available"
    return within(clause, len(absent & set(_NEEDED)), text, came=tuple(r.data for r in lacking))


def _values(step: Step, clause: ProbeClause, steps: Mapping[str, Step]) -> Finding:
    if not step.monrs():
        return silent(step)
    odd: dict[str, bytes] = {}
    for received, monr in _all_monrs(steps):
        if isinstance(received.outcome, DecodedMessage):
            odd.update(dict.fromkeys(received.outcome.odd, received.data))
        for name, kind in (("drive_direction", DriveDirection), ("ready_to_arm", ReadyToArm)):
            value = getattr(monr, name)
            if value is not None and value not in frozenset(kind):
                odd.setdefault(f"{name} {value}", received.data)
        if state_of(monr.state) is None:
            odd.setdefault(f"state {monr.state}", received.data)
    return within(clause, len(odd), _names(odd), came=tuple(odd.values()))


def _counter(step: Step, clause: ProbeClause, steps: Mapping[str, Step]) -> Finding:
    if len(step.monrs()) < 2:
        return silent(step)
    missing = standing = count = 0
    for one in steps.values():
        # By UDP alone: frames of both sockets are read in no common order.
        headers = [
            r.outcome.header for r, _ in one.monrs() if isinstance(r.outcome, DecodedMessage)
        ]
        others = sum(isinstance(r.outcome, DecodedMessage) and not r.udp for r in one.came)
        jumps = np.diff([h.counter for h in headers]) % 256
        missing += max(0, int(np.sum(np.maximum(jumps - 1, 0))) - others)
        standing += int(np.sum(jumps == 0))
        count += len(headers)
    text = f"{standing} times it stood" if standing else f"of {count}"
    return within(clause, missing + standing, text)


def _ids(step: Step, clause: ProbeClause, steps: Mapping[str, Step]) -> Finding:
    osem = step.last_sent(Osem)
    monrs = _all_monrs(steps)
    headers = [r.outcome.header for r, _ in monrs if isinstance(r.outcome, DecodedMessage)]
    if osem is None or not isinstance(osem.message, Osem) or not headers:
        return silent(step)
    device_id, carried = osem.message.device_id, {h.transmitter_id for h in headers}
    others = len(carried - {device_id})
    text = f"given {device_id}, the headers carry {_names(map(str, carried))}"
    return within(clause, others, text, sent=(osem.data,), came=(monrs[0][0].data,))


def _acknowledge(step: Step, clause: ProbeClause, _: Mapping[str, Step]) -> Finding:
    requests = [s for s in step.sent if s.header.acknowledge]
    if not requests:
        return Finding(Outcome.FAIL, step.problem or "no message asked for one")
    answers = {
        (r.outcome.message.message_id, r.outcome.message.counter): (r, r.outcome.message)
        for r in step.came
        if isinstance(r.outcome, DecodedMessage) and isinstance(r.outcome.message, Grem)
    }
    unanswered = [s for s in requests if (s.header.message_id, s.header.counter) not in answers]
    refused = [
        f"{s.message.__class__.__name__.upper()} answered by {answer[1].response}"
        for s in requests
        if (answer := answers.get((s.header.message_id, s.header.counter)))
        and answer[1].response != ResponseCode.OK
    ]
    problems = [
        f"no answer to {s.message.__class__.__name__.upper()}" for s in unanswered
    ] + refused
    answer_bytes = tuple(r.data for r, _ in answers.values())
    sent = tuple(s.data for s in unanswered or requests)
    return within(clause, len(problems), _names(problems), sent=sent, came=answer_bytes)


def _identity(step: Step, _clause: ProbeClause, _: Mapping[str, Step]) -> Finding:
    for r in step.came:
        if isinstance(r.outcome, DecodedMessage) and isinstance(r.outcome.message, Dres):
            d = r.outcome.message
            text = f"{d.vendor} {d.product}, firmware {d.firmware}, {d.name}"
            return Finding(Outcome.INFO, text, came=(r.data,))
    return Finding(Outcome.INFO, "DREQ wasn't answered: its firmware is unknown")


# -- states ---------------------------------------------------------------------------------------


def _reaches(*wanted: ControlState) -> Judge:
    """Make a judge of whether the object reports one of these states after the step's stimulus.

    Once it does, it reports no other one until the step ends.
    """

    def judge(step: Step, clause: ProbeClause, _: Mapping[str, Step]) -> Finding:
        since_ns = step.marks.get("stimulus", step.begin_ns)
        after = [(r, m.state) for r, m in step.monrs_in_order() if r.stamp_ns >= since_ns]
        if not after:
            return silent(step)
        stimulus = tuple(s.data for s in step.sent if s.stamp_ns >= since_ns)[:1]
        first: tuple[ReceivedMessage, int | None] | None = None
        for received, number in after:
            if state_of(number) in wanted:
                first = first or (received, number)
            elif first is not None:
                text = f"was {state_text(first[1])}, then {state_text(number)}"
                return Finding(Outcome.FAIL, text, sent=stimulus, came=(received.data,))
        if first is None:
            received, number = after[-1]
            state = state_of(number)
            text = f"is {'unknown' if state is None else state.name}"
            return Finding(Outcome.FAIL, text, sent=stimulus, came=(received.data,))
        waited_s = ns_to_seconds(first[0].stamp_ns - since_ns)
        return within(clause, waited_s, sent=stimulus, came=(first[0].data,))

    return judge


def _stays(target_state: ControlState) -> Judge:
    def judge(step: Step, _clause: ProbeClause, _: Mapping[str, Step]) -> Finding:
        if not step.monrs():
            return silent(step)
        # The first tenth of a second may show what came before.
        since_ns = step.begin_ns + NS_PER_S // 10
        after = [(r, state_of(m.state)) for r, m in step.monrs_in_order() if r.stamp_ns >= since_ns]
        for received, state in after:
            if state is not target_state:
                text = f"is {'unknown' if state is None else state.name}"
                return Finding(Outcome.FAIL, text, came=(received.data,))
        return Finding(Outcome.PASS if after else Outcome.FAIL)

    return judge


def _disarmed(step: Step, clause: ProbeClause, _: Mapping[str, Step]) -> Finding:
    finding = _reaches(C.DISARMED)(step, clause, {})
    if finding.verdict is Outcome.FAIL and finding.text == f"is {C.ABORTING.name}":
        text = "an earlier abort is latched: that needs an all clear"
        return Finding(Outcome.INFO, text, came=finding.came)
    return finding


def _disarms(step: Step, clause: ProbeClause, _: Mapping[str, Step]) -> Finding:
    """Check that the object isn't ARMED in its last report after lost heartbeats, or hangs up."""
    since_ns = step.marks.get("stimulus", step.begin_ns)
    for received, monr in step.monrs_in_order():
        is_odd = state_of(monr.state) not in (C.ARMED, *_UNARMED)
        if is_odd and received.stamp_ns >= since_ns:
            text = f"is {state_text(monr.state)}"
            return Finding(Outcome.FAIL, text, came=(received.data,))
    if "lost" in step.marks:
        waited_s = ns_to_seconds(step.marks["lost"] - step.marks["stimulus"])
        return within(clause, waited_s, "ended the connection")
    return _reaches(*_UNARMED)(step, clause, {})


# A table: id, step, title, judge, bound and unit.
CLAUSES: tuple[ProbeClause, ...] = (
    ProbeClause("listen.tcp", "listen", "accepts a connection", _connected, 2.0, "s"),
    ProbeClause("listen.report", "listen", "MONR after OSEM and HEAB", _first_report, 1.0, "s"),
    ProbeClause("listen.frames", "listen", "header, version, CRC are right", _frames, 0, "frames"),
    ProbeClause("listen.rate", "listen", "MONR at the rate of the OSEM, off by", _rate, 10.0, "%"),
    ProbeClause("listen.pause", "listen", "longest pause between MONR", _pause, 0.3, "s"),
    ProbeClause("listen.age", "listen", "MONR are recent on arrival", _age, 0.3, "s"),
    ProbeClause(
        "listen.fields", "listen", "time, place, yaw, speed are stated", _fields, 0, "fields"
    ),
    ProbeClause(
        "listen.values", "listen", "no value outside its enumeration", _values, 0, "values"
    ),
    ProbeClause("listen.counter", "listen", "no gap in the counter of MONR", _counter, 0, "MONR"),
    ProbeClause("listen.ids", "listen", "transmitter is the OSEM's device id", _ids, 0, "others"),
    ProbeClause("connect.acknowledge", "listen", "GREM when requested", _acknowledge, 0, "lack"),
    ProbeClause("connect.disarmed", "listen", "DISARMED after the connection", _disarmed, 2.0, "s"),
    ProbeClause("connect.identity", "connect", "DRES to a DREQ", _identity),
    ProbeClause(
        "connect.reconnect", "reconnect", "DISARMED when connected again", _disarmed, 2.0, "s"
    ),
    ProbeClause("arm.arm", "arm", "ARMED after OSTM arm", _reaches(C.ARMED), 2.0, "s"),
    ProbeClause(
        "arm.disarm", "disarm", "DISARMED after OSTM disarm", _reaches(C.DISARMED), 1.0, "s"
    ),
    ProbeClause(
        "arm.abort", "arm_abort", "ABORTING after HEAB abort", _reaches(C.ABORTING), 1.0, "s"
    ),
    ProbeClause("arm.latch", "latch", "stays ABORTING with HEAB ready", _stays(C.ABORTING)),
    ProbeClause(
        "arm.all_clear", "all_clear", "DISARMED after clear", _reaches(C.DISARMED), 1.0, "s"
    ),
    ProbeClause("arm.heartbeat_loss", "arm_loss", "not ARMED without HEAB", _disarms, 1.0, "s"),
    ProbeClause("arm.reconnect", "arm_again", "not ARMED when connected again", _disarms, 2.0, "s"),
    ProbeClause(START_TIME, "normal_stop", "starts at the time of the STRT", starts, 0.3, "s"),
    ProbeClause("move.way", "normal_stop", "follows the path of the TRAJ", keeps_to_way, 1.0, "m"),
    ProbeClause(
        "move.motion",
        "normal_stop",
        "speed and yaw contradict its motion",
        states_its_motion,
        HOLDS_S,
        "s",
    ),
    ProbeClause(
        STATE_AGE,
        "normal_stop",
        "newest usable MONR is never older",
        stays_fresh,
        LIMITS.state_age_s,
        "s",
    ),
    ProbeClause(
        CLOCK,
        "normal_stop",
        "stamps are ahead of the reading",
        is_not_ahead,
        LIMITS.clock_offset_s,
        "s",
    ),
    ProbeClause(
        "move.position", "normal_stop", "states no bad positioning", knows_its_place, 0, "MONR"
    ),
    ProbeClause("move.running", "normal_stop", "RUNNING while it drives", runs, LAG_S, "s"),
    ProbeClause("move.postrun", "normal_stop", "POSTRUN while it stops", ends_run, LAG_S, "s"),
    ProbeClause(
        "move.normal_stop", "normal_stop", "slower after normal stop, stands", stops, 1.0, "s"
    ),
    ProbeClause("move.rest", "rest", "DISARMED when it stands", _reaches(C.DISARMED), 2.0, "s"),
    ProbeClause(STOP_ON_ABORT, "abort", "slower after HEAB abort, stands", stops, 1.0, "s"),
    ProbeClause(
        STOP_ON_HEARTBEAT_LOSS, "loss", "slower after last HEAB, stands", unheard, 1.0, "s"
    ),
)
