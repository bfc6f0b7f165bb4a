"""The triggers, tracking and states in a run's bag, for result.json and people."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from ssp_core import names
from ssp_core.bag.reading.reader import BagReader, object_states
from ssp_core.bag.types import typestore
from ssp_core.cdr.messages import stamp_ns
from ssp_core.cdr.references import Acknowledgement, decode_ack, decode_reference
from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.errors import SspError
from ssp_core.geometry import FloatArray
from ssp_core.motion.reference import Reference, sample
from ssp_core.motion.state import ObjectState
from ssp_core.names import absolute
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.link_quality import LossCounter
from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_scenario_manager.run.kept_session import KeptSession
from ssp_scenario_manager.session import outbox
from ssp_scenario_manager.session.messages import encode_trigger

SCHEMA = "ssp.measured/1"
_TRIGGER = "ssp_msgs/msg/TriggerEvent"
# States of so long before the dispatch show the noise, so many at least.
BEFORE_S = 2.0
LEAST_STATES = 5
SIGMAS = 4.0
# Of a normal distribution: its standard deviation over its median absolute deviation.
MAD_TO_SIGMA = 1.4826
# After execute_at; who hasn't moved by then doesn't.
WITHIN_S = 5.0
# By which a motion shows, with units and with the least half width of its noise band.
QUANTITIES = ("speed", "acceleration", "lateral acceleration")
UNITS = ("m/s", "m/s^2", "m/s^2")
FLOORS = (0.02, 0.05, 0.05)


def differences(states: Sequence[ObjectState], previous: Reference | None) -> FloatArray:
    """Return the states minus reference, by quantity, shape (n, 3).

    Args:
        states: of the object, in order.
        previous: reference that it tracked; None: it stood, and was to stand.
    """
    rows = []
    for state in states:
        row = [
            state.speed_mps,
            state.acceleration_mps2,
            state.speed_mps * state.yaw_rate_radps,
        ]
        if previous is not None:
            point = sample(previous, state.stamp_ns)
            row[0] -= point.speed_mps
            row[1] -= point.acceleration_mps2
            row[2] -= point.speed_mps**2 * point.curvature_1pm
        rows.append(row)
    return np.array(rows, dtype=np.float64).reshape(-1, len(QUANTITIES))


def bands(
    states: Sequence[ObjectState], previous: Reference | None, until_ns: int
) -> tuple[FloatArray, FloatArray] | None:
    """Return the middles and half widths of the noise before an instant; None: too few states.

    Both are by quantity, shape (3,).

    Args:
        states: of the object, in order.
        previous: as in ``differences``.
        until_ns: the instant, session time.
    """
    name = previous.reference_id if previous is not None else ""
    begin_ns = until_ns - seconds_to_ns(BEFORE_S)
    before = [
        state
        for state in states
        if begin_ns <= state.stamp_ns <= until_ns and state.reference_id == name and state.is_finite
    ]
    if len(before) < LEAST_STATES:
        return None
    deviations = differences(before, previous)
    middle = np.median(deviations, axis=0)
    sigma = MAD_TO_SIGMA * np.median(np.abs(deviations - middle), axis=0)
    return middle, np.maximum(SIGMAS * sigma, FLOORS)


def onset(
    states: Sequence[ObjectState],
    previous: Reference | None,
    noise: tuple[FloatArray, FloatArray],
    dispatched_ns: int,
    execute_at_ns: int,
) -> tuple[ObjectState, int] | None:
    """Find the first of two states in a row outside the noise band, and the furthest quantity.

    Args:
        states: of the object, in order of their stamps.
        previous: reference that it tracked before.
        noise: as ``bands`` gives it.
        dispatched_ns: looked at are later states.
        execute_at_ns: of the new reference; looked at are states up to ``WITHIN_S`` later.
    """
    latest_ns = execute_at_ns + seconds_to_ns(WITHIN_S)
    later = [s for s in states if s.is_finite and dispatched_ns < s.stamp_ns <= latest_ns]
    middle, half = noise
    widths = np.abs(differences(later, previous) - middle) / half
    widest = widths.max(axis=1, initial=0.0)
    twice = np.flatnonzero((widest[:-1] > 1.0) & (widest[1:] > 1.0))
    if len(twice) == 0:
        return None
    first = int(twice[0])
    return later[first], int(np.argmax(widths[first]))


def tracking(states: Iterable[ObjectState], purposes: Mapping[str, str]) -> dict[str, Any] | None:
    """Return tracking errors that an object reports of itself, over the run and by reference, m.

    Args:
        states: of one object in order; counted are those in state RUNNING with a reference. An
            object that aborts brakes as it must, and its distance to a reference says nothing.
        purposes: of references by id.

    Returns:
        None where it never tracked anything.
    """
    counted = [s for s in states if s.reference_id and s.control_state is ControlState.RUNNING]
    if not counted:
        return None
    of = dict.fromkeys(state.reference_id for state in counted)
    return {
        **_errors(counted),
        "by_reference": [
            {
                "reference_id": name,
                "purpose": purposes.get(name),
                **_errors([state for state in counted if state.reference_id == name]),
            }
            for name in of
        ],
    }


def _errors(states: Sequence[ObjectState]) -> dict[str, Any]:
    """Return root mean squares, and the largest in size, without errors that are no number."""
    errors = np.array([(s.error_lateral_m, s.error_longitudinal_m) for s in states])
    finite = errors[np.isfinite(errors).all(axis=1)]
    rms = np.sqrt((finite**2).mean(axis=0)) if len(finite) else np.zeros(2)
    most = np.abs(finite).max(axis=0, initial=0.0)
    return {
        "states": len(finite),
        "not_finite": len(errors) - len(finite),
        "lateral_rms_m": round(float(rms[0]), 4),
        "lateral_max_m": round(float(most[0]), 4),
        "longitudinal_rms_m": round(float(rms[1]), 4),
        "longitudinal_max_m": round(float(most[1]), 4),
    }


def receipt(states: Sequence[ObjectState]) -> dict[str, int]:
    """Count the states of one object, in the order in which they were recorded.

    These are all of them, missing sequence numbers, and those that came after one with a later
    stamp.
    """
    counter, latest_ns, late = LossCounter(), -1, 0
    for state in states:
        counter.see(state.sequence)
        late += state.stamp_ns < latest_ns
        latest_ns = max(latest_ns, state.stamp_ns)
    return {"received": counter.received, "lost": counter.lost, "out_of_order": late}


@dataclass(frozen=True)
class ReportInput:
    """The data read from the bag.

    Args:
        started_ns: session time at which the run began; 0 where it didn't.
        firings: decoded TriggerEvent messages in order.
        references: by id, as first sent.
        acks: by reference id, the first answer.
        states: by object id, in the order of recording.
    """

    started_ns: int
    firings: Sequence[Any]
    references: dict[str, Reference]
    acks: dict[str, Acknowledgement]
    states: Mapping[str, Sequence[ObjectState]]

    @classmethod
    def of(cls, bag: BagReader, spec: RunSpec) -> ReportInput:
        """Read all of it. Raise InputError for a damaged bag."""
        targets = [target.id for target in spec.targets]
        starts = [
            stamp_ns(message.header.stamp)
            for message in _decoded(bag, names.SESSION_STATE)
            if message.state == int(SessionPhase.RUNNING)
        ]
        references: dict[str, Reference] = {}
        acks: dict[str, Acknowledgement] = {}
        for target in targets:
            for message in bag.messages([absolute(names.reference_topic(target))]):
                sent = decode_reference(message.data)
                references.setdefault(sent.reference_id, sent)
            for message in bag.messages([absolute(names.ack_topic(target))]):
                ack = decode_ack(message.data)
                acks.setdefault(ack.reference_id, ack)
        return cls(
            started_ns=starts[0] if starts else 0,
            firings=list(_decoded(bag, names.TRIGGER_EVENT)),
            references=references,
            acks=acks,
            states=object_states(bag, [names.VUT_ID, *targets]),
        )

    @classmethod
    def of_session_record(cls, session_record: KeptSession, spec: RunSpec) -> ReportInput:
        """Take what a session's bag holds from the session itself."""
        targets = {target.id for target in spec.targets}
        facts = list(session_record.facts())
        references: dict[str, Reference] = {}
        for fact in facts:
            if isinstance(fact, Reference) and fact.object_id in targets:
                references.setdefault(fact.reference_id, fact)
        acks: dict[str, Acknowledgement] = {}
        stamped: dict[str, list[tuple[int, ObjectState]]] = {
            name: [] for name in (names.VUT_ID, *targets)
        }
        for report in session_record.reports():
            for ack in report.acks:
                if ack.object_id in targets:
                    acks.setdefault(ack.reference_id, ack)
            # An array of states is one message, of the stamp of its newest one.
            newest_ns = max((one.stamp_ns for one in report.target_states), default=0)
            for one in (*report.vut_states, *report.target_states):
                in_one = spec.states_in_one and one.object_id in targets
                at_ns = newest_ns if in_one else one.stamp_ns
                stamped[one.object_id].append((at_ns, one))
        return cls(
            started_ns=next(
                (
                    fact.stamp_ns
                    for fact in facts
                    if isinstance(fact, outbox.StateChanged) and fact.state is SessionPhase.RUNNING
                ),
                0,
            ),
            firings=[
                typestore().deserialize_cdr(encode_trigger(fact, 0.0), _TRIGGER)
                for fact in facts
                if isinstance(fact, outbox.TriggerDecision)
            ],
            references=references,
            acks=acks,
            # Readers order a bag by the times of its messages.
            states={
                name: [one for _, one in sorted(stamped_states, key=itemgetter(0))]
                for name, stamped_states in stamped.items()
            },
        )

    def s(self, time_ns: int) -> float:
        """Return seconds since the start of the run, rounded to µs."""
        return round(ns_to_seconds(time_ns - self.started_ns), 6)


def _decoded(bag: BagReader, topic: str) -> Iterable[Any]:
    return (bag.decode(message) for message in bag.messages([absolute(topic)]))


def measured(bag: Path, spec: RunSpec, say: Callable[[str], None]) -> dict[str, Any]:
    """Return the report of a run.

    Args:
        bag: of the run; it may be missing or damaged.
        spec: the run.
        say: tells the user a line of the report.

    Returns:
        For result.json. ``problem`` says what kept it from being measured, null: nothing.
    """
    try:
        with BagReader(bag) as reader:
            report_input = ReportInput.of(reader, spec)
    except (SspError, ValueError) as error:
        return {"schema": SCHEMA, "problem": str(error)}
    report = report_fields(report_input, spec)
    for line in lines(report):
        say(line)
    return report


def report_fields(report_input: ReportInput, spec: RunSpec) -> dict[str, Any]:
    """Compute ``measured`` from the data that were read."""
    purposes = {name: sent.purpose for name, sent in report_input.references.items()}
    return {
        "schema": SCHEMA,
        "problem": None,
        "triggers": [_trigger(report_input, firing) for firing in report_input.firings],
        "never_fired": sorted(
            {t.id for t in spec.triggers} - {str(f.trigger_id) for f in report_input.firings}
        ),
        "tracking": {t.id: tracking(report_input.states[t.id], purposes) for t in spec.targets},
        "states": {name: receipt(states) for name, states in report_input.states.items()},
    }


def _trigger(report_input: ReportInput, firing: Any) -> dict[str, Any]:
    dispatched_ns = stamp_ns(firing.dispatch_time)
    pairs = zip(firing.object_ids, firing.reference_ids, strict=True)
    return {
        "trigger_id": str(firing.trigger_id),
        "condition": str(firing.condition),
        "crossing_s": report_input.s(stamp_ns(firing.crossing_time)),
        "judged_s": report_input.s(stamp_ns(firing.header.stamp)),
        "dispatched_s": report_input.s(dispatched_ns),
        "processing_ms": round(1e3 * float(firing.processing), 3),
        "references": [
            _reference(report_input, str(who), str(name), dispatched_ns) for who, name in pairs
        ],
    }


def _reference(
    report_input: ReportInput, object_id: str, reference_id: str, dispatched_ns: int
) -> dict[str, Any]:
    sent, ack = report_input.references.get(reference_id), report_input.acks.get(reference_id)
    began = _onset(report_input, object_id, sent, dispatched_ns)
    return {
        "object_id": object_id,
        "reference_id": reference_id,
        "acknowledged_s": report_input.s(ack.stamp_ns) if ack is not None else None,
        "accepted": ack.accepted if ack is not None else None,
        "refused": ack.error_msg if ack is not None and not ack.accepted else None,
        "execute_at_s": report_input.s(sent.execute_at_ns) if sent is not None else None,
        "onset": None if isinstance(began, str) else began,
        "no_onset": began if isinstance(began, str) else None,
    }


def _onset(
    report_input: ReportInput, object_id: str, sent: Reference | None, dispatched_ns: int
) -> dict[str, Any] | str:
    """Return the motion onset, or why there is none."""
    if sent is None:
        return "the bag doesn't hold the reference"
    states = sorted(report_input.states.get(object_id, ()), key=lambda state: state.stamp_ns)
    before = [state for state in states if state.stamp_ns <= dispatched_ns]
    tracked = before[-1].reference_id if before else ""
    previous = report_input.references.get(tracked)
    if tracked and previous is None:
        return f"the bag doesn't hold the previous reference {tracked}"
    noise = bands(states, previous, dispatched_ns)
    if noise is None:
        return "too few states before the dispatch to know their noise"
    began = onset(states, previous, noise, dispatched_ns, sent.execute_at_ns)
    if began is None:
        return "no state departs from the previous reference"
    state, k = began
    return {
        "at_s": report_input.s(state.stamp_ns),
        "quantity": QUANTITIES[k],
        "unit": UNITS[k],
        "difference": round(float(differences([state], previous)[0, k]), 4),
        "noise_middle": round(float(noise[0][k]), 4),
        "noise_half_width": round(float(noise[1][k]), 4),
    }


def lines(report: dict[str, Any]) -> list[str]:
    """Return the report for people: one line per trigger, and per object that had a reference."""
    texts = [
        f"trigger {fired['trigger_id']}: crossed at {fired['crossing_s']:.3f} s, judged on the "
        f"state of {fired['judged_s']:.3f} s, "
        f"{'sent' if fired['references'] else 'nothing sent'} at {fired['dispatched_s']:.3f} s "
        f"({fired['processing_ms']:.1f} ms of processing)"
        + "".join(_line_of_reference(r) for r in fired["references"])
        for fired in report["triggers"]
    ]
    texts += [f"trigger {name} never fired" for name in report["never_fired"]]
    for name, errors in report["tracking"].items():
        counted = report["states"][name]
        missing = f", {counted['lost']} lost" if counted["lost"] else ", none lost"
        if errors is not None:
            texts.append(
                f"tracking of {name}: lateral {errors['lateral_rms_m']:.3f} m rms, at most "
                f"{errors['lateral_max_m']:.3f} m; longitudinal "
                f"{errors['longitudinal_rms_m']:.3f} m rms, at most "
                f"{errors['longitudinal_max_m']:.3f} m; {counted['received']} states{missing}"
            )
    return texts


def _line_of_reference(reference: dict[str, Any]) -> str:
    who = reference["object_id"]
    if reference["acknowledged_s"] is None:
        answer = "no answer"
    elif reference["accepted"]:
        answer = f"acknowledged at {reference['acknowledged_s']:.3f} s"
    else:
        answer = f"refused: {reference['refused']}"
    due = reference["execute_at_s"]
    text = f"; {who}: {answer}" + (f", due at {due:.3f} s" if due is not None else "")
    began = reference["onset"]
    if began is None:
        return f"{text}, no motion seen: {reference['no_onset']}"
    return f"{text}, moved at {began['at_s']:.3f} s ({began['quantity']})"
