"""What a run's bag says of its triggers, tracking and states, for result.json and people."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ssp_core import names
from ssp_core.bag.reader import BagReader, object_states
from ssp_core.cdr.messages import stamp_ns
from ssp_core.cdr.references import Acknowledgement, decode_ack, decode_reference
from ssp_core.clock import NS_PER_S, ns_to_seconds
from ssp_core.errors import SspError
from ssp_core.motion.reference import Reference, sample
from ssp_core.motion.state import ObjectState
from ssp_core.names import absolute
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_scenario_manager.session.link_quality import LossCounter

BEFORE_S = 2.0
LEAST_STATES = 5
SIGMAS = 4.0
# Of a normal distribution: its standard deviation over its median absolute deviation.
MAD_TO_SIGMA = 1.4826
# After execute_at; who hasn't moved by then doesn't.
WITHIN_S = 5.0
# Half the width of a band at least, in the quantity's unit.
FLOORS = {"speed": 0.02, "acceleration": 0.05, "lateral acceleration": 0.05}
UNITS = {"speed": "m/s", "acceleration": "m/s^2", "lateral acceleration": "m/s^2"}


@dataclass(frozen=True, slots=True)
class Band:
    """Differences between states and reference that are noise: middle and half width."""

    middle: float
    half: float

    def holds(self, difference: float) -> bool:
        return abs(difference - self.middle) <= self.half


@dataclass(frozen=True, slots=True)
class Onset:
    """First state outside a noise band.

    Args:
        stamp_ns: of that state.
        quantity: ``speed``, ``acceleration`` or ``lateral acceleration``, the one that is furthest
            outside in terms of its band.
        difference: state minus previous reference, in the quantity's unit.
        band: noise of that difference.
    """

    stamp_ns: int
    quantity: str
    difference: float
    band: Band


def differences(state: ObjectState, previous: Reference | None) -> dict[str, float]:
    """State minus reference, by quantity.

    Args:
        state: of the object.
        previous: reference that it tracked; None: it stood, and was to stand.
    """
    speed, along, across = 0.0, 0.0, 0.0
    if previous is not None:
        point = sample(previous, state.stamp_ns)
        speed, along = point.speed_mps, point.acceleration_mps2
        across = point.speed_mps**2 * point.curvature_1pm
    return {
        "speed": state.speed_mps - speed,
        "acceleration": state.acceleration_mps2 - along,
        "lateral acceleration": state.speed_mps * state.yaw_rate_radps - across,
    }


def bands(
    states: Sequence[ObjectState], previous: Reference | None, until_ns: int
) -> dict[str, Band] | None:
    """Noise bands from the states before an instant, by quantity; None: too few states.

    Args:
        states: of the object, in order.
        previous: as in ``differences``.
        until_ns: the instant.
    """
    name = previous.reference_id if previous is not None else ""
    begin_ns = until_ns - BEFORE_S * NS_PER_S
    before = [
        differences(s, previous)
        for s in states
        if begin_ns <= s.stamp_ns <= until_ns and s.reference_id == name and s.is_finite
    ]
    if len(before) < LEAST_STATES:
        return None
    found = {}
    for quantity, floor in FLOORS.items():
        values = [d[quantity] for d in before]
        middle = statistics.median(values)
        sigma = MAD_TO_SIGMA * statistics.median(abs(v - middle) for v in values)
        found[quantity] = Band(middle, max(SIGMAS * sigma, floor))
    return found


def onset(
    states: Sequence[ObjectState],
    previous: Reference | None,
    noise: dict[str, Band],
    dispatched_ns: int,
    execute_at_ns: int,
) -> Onset | None:
    """The first of two states in a row that depart from the previous reference.

    Args:
        states: of the object, in order of their stamps.
        previous: as in ``differences``.
        noise: as ``bands`` gives it.
        dispatched_ns: looked at are later states.
        execute_at_ns: of the new reference; looked at are states up to ``WITHIN_S`` later.
    """
    candidate: Onset | None = None
    for state in states:
        if not state.is_finite or state.stamp_ns <= dispatched_ns:
            continue
        if ns_to_seconds(state.stamp_ns - execute_at_ns) > WITHIN_S:
            break
        outside = {
            quantity: value
            for quantity, value in differences(state, previous).items()
            if not noise[quantity].holds(value)
        }
        if not outside:
            candidate = None
        elif candidate is not None:
            return candidate
        else:
            widest = max(outside, key=lambda q: abs(outside[q] - noise[q].middle) / noise[q].half)
            candidate = Onset(state.stamp_ns, widest, outside[widest], noise[widest])
    return None


@dataclass(frozen=True, slots=True)
class Errors:
    """Tracking errors over some states, m: root mean square, and the largest in size.

    Args:
        states: that the errors are of.
        not_finite: left out, because an error is no number.
    """

    states: int
    not_finite: int
    lateral_rms_m: float
    lateral_max_m: float
    longitudinal_rms_m: float
    longitudinal_max_m: float


@dataclass(frozen=True, slots=True)
class Tracking:
    """Tracking errors of one object over the run, and over each of its references in order."""

    whole: Errors
    by_reference: dict[str, Errors] = field(default_factory=dict)


def tracking(states: Iterable[ObjectState]) -> Tracking | None:
    """Tracking errors that an object reports of itself.

    Args:
        states: of one object in order; counted are those in state RUNNING with a reference. An
            object that aborts brakes as it must, and its distance to a reference says nothing.

    Returns:
        None where it never tracked anything.
    """
    counted = [s for s in states if s.reference_id and s.control_state is ControlState.RUNNING]
    if not counted:
        return None
    by_reference: dict[str, list[ObjectState]] = {}
    for state in counted:
        by_reference.setdefault(state.reference_id, []).append(state)
    return Tracking(_errors(counted), {name: _errors(own) for name, own in by_reference.items()})


def _errors(states: Sequence[ObjectState]) -> Errors:
    pairs = [
        (s.error_lateral_m, s.error_longitudinal_m)
        for s in states
        if math.isfinite(s.error_lateral_m) and math.isfinite(s.error_longitudinal_m)
    ]
    lateral, longitudinal = [a for a, _ in pairs], [b for _, b in pairs]
    return Errors(
        states=len(pairs),
        not_finite=len(states) - len(pairs),
        lateral_rms_m=_rms(lateral),
        lateral_max_m=max(map(abs, lateral), default=0.0),
        longitudinal_rms_m=_rms(longitudinal),
        longitudinal_max_m=max(map(abs, longitudinal), default=0.0),
    )


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(math.fsum(v * v for v in values) / len(values)) if values else 0.0


@dataclass(frozen=True, slots=True)
class Receipt:
    """States of one object in the bag.

    Args:
        received: all of them.
        lost: sequence numbers that are missing between the first and the last.
        out_of_order: that came after one with a later stamp.
    """

    received: int
    lost: int
    out_of_order: int


def receipt(states: Sequence[ObjectState]) -> Receipt:
    """Counts the states of one object, in the order in which they were recorded."""
    tally, latest_ns, late = LossCounter(), -1, 0
    for state in states:
        tally.see(state.sequence)
        late += state.stamp_ns < latest_ns
        latest_ns = max(latest_ns, state.stamp_ns)
    return Receipt(tally.received, tally.lost, late)


SCHEMA = "ssp.measured/1"


@dataclass(frozen=True)
class ReportInput:
    """What is read from the bag.

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
    states: dict[str, list[ObjectState]]

    @classmethod
    def of(cls, bag: BagReader, spec: RunSpec) -> ReportInput:
        """Reads all of it. Raises InputError for a damaged bag."""
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


def _decoded(bag: BagReader, topic: str) -> Iterable[Any]:
    return (bag.decode(message) for message in bag.messages([absolute(topic)]))


def measured(bag: Path, spec: RunSpec, say: Callable[[str], None]) -> dict[str, Any]:
    """The report of a run.

    Args:
        bag: of the run; it may be missing or damaged.
        spec: the run.
        say: takes one line for people per trigger and per object target.

    Returns:
        For result.json. ``problem`` says what kept it from being measured, null: nothing.
    """
    try:
        with BagReader(bag) as reader:
            heard = ReportInput.of(reader, spec)
    except (SspError, ValueError) as error:
        return {"schema": SCHEMA, "problem": str(error)}
    report = told(heard, spec)
    for line in lines(report):
        say(line)
    return report


def told(heard: ReportInput, spec: RunSpec) -> dict[str, Any]:
    """As ``measured``, of what was read. Times are s since the start of the run, rounded to µs."""
    follow = {target.id: tracking(heard.states[target.id]) for target in spec.targets}
    return {
        "schema": SCHEMA,
        "problem": None,
        "triggers": [_trigger(heard, firing) for firing in heard.firings],
        "never_fired": sorted(
            {t.id for t in spec.triggers} - {str(f.trigger_id) for f in heard.firings}
        ),
        "tracking": {
            name: None
            if found is None
            else {
                **_errors_report(found.whole),
                "by_reference": [
                    {
                        "reference_id": reference,
                        "purpose": _purpose(heard, reference),
                        **_errors_report(e),
                    }
                    for reference, e in found.by_reference.items()
                ],
            }
            for name, found in follow.items()
        },
        "states": {
            name: {
                "received": counted.received,
                "lost": counted.lost,
                "out_of_order": counted.out_of_order,
            }
            for name, counted in ((n, receipt(states)) for n, states in heard.states.items())
        },
    }


def _purpose(heard: ReportInput, reference_id: str) -> str | None:
    sent = heard.references.get(reference_id)
    return sent.purpose if sent is not None else None


def _errors_report(errors: Errors) -> dict[str, Any]:
    return {
        "states": errors.states,
        "not_finite": errors.not_finite,
        "lateral_rms_m": round(errors.lateral_rms_m, 4),
        "lateral_max_m": round(errors.lateral_max_m, 4),
        "longitudinal_rms_m": round(errors.longitudinal_rms_m, 4),
        "longitudinal_max_m": round(errors.longitudinal_max_m, 4),
    }


def _trigger(heard: ReportInput, firing: Any) -> dict[str, Any]:
    def s(time: Any) -> float:
        return round(ns_to_seconds(stamp_ns(time) - heard.started_ns), 6)

    pairs = zip(firing.object_ids, firing.reference_ids, strict=True)
    return {
        "trigger_id": str(firing.trigger_id),
        "condition": str(firing.condition),
        "crossing_s": s(firing.crossing_time),
        "judged_s": s(firing.header.stamp),
        "dispatched_s": s(firing.dispatch_time),
        "processing_ms": round(1e3 * float(firing.processing), 3),
        "references": [
            _reference(heard, str(who), str(name), stamp_ns(firing.dispatch_time))
            for who, name in pairs
        ],
    }


def _reference(
    heard: ReportInput, object_id: str, reference_id: str, dispatched_ns: int
) -> dict[str, Any]:
    def s(ns: int) -> float:
        return round(ns_to_seconds(ns - heard.started_ns), 6)

    sent, ack = heard.references.get(reference_id), heard.acks.get(reference_id)
    found: dict[str, Any] = {
        "object_id": object_id,
        "reference_id": reference_id,
        "acknowledged_s": s(ack.stamp_ns) if ack is not None else None,
        "accepted": ack.accepted if ack is not None else None,
        "refused": ack.error_msg if ack is not None and not ack.accepted else None,
        "execute_at_s": s(sent.execute_at_ns) if sent is not None else None,
        "onset": None,
        "no_onset": None,
    }
    began = _onset(heard, object_id, sent, dispatched_ns)
    if isinstance(began, str):
        return {**found, "no_onset": began}
    found["onset"] = {
        "at_s": s(began.stamp_ns),
        "quantity": began.quantity,
        "unit": UNITS[began.quantity],
        "difference": round(began.difference, 4),
        "noise_middle": round(began.band.middle, 4),
        "noise_half_width": round(began.band.half, 4),
    }
    return found


def _onset(
    heard: ReportInput, object_id: str, sent: Reference | None, dispatched_ns: int
) -> Onset | str:
    """The motion onset, or why there is none."""
    if sent is None:
        return "the bag doesn't hold the reference"
    states = sorted(heard.states.get(object_id, ()), key=lambda state: state.stamp_ns)
    before = [state for state in states if state.stamp_ns <= dispatched_ns]
    tracked = before[-1].reference_id if before else ""
    previous = heard.references.get(tracked)
    if tracked and previous is None:
        return f"the bag doesn't hold the previous reference {tracked}"
    noise = bands(states, previous, dispatched_ns)
    if noise is None:
        return "too few states before the dispatch to know their noise"
    began = onset(states, previous, noise, dispatched_ns, sent.execute_at_ns)
    return began or "no state departs from the previous reference"


def lines(report: dict[str, Any]) -> list[str]:
    """The report for people: one line per trigger, and per object that tracked something."""
    found = [
        f"trigger {fired['trigger_id']}: crossed at {fired['crossing_s']:.3f} s, judged on the "
        f"state of {fired['judged_s']:.3f} s, sent at {fired['dispatched_s']:.3f} s "
        f"({fired['processing_ms']:.1f} ms of processing)"
        + "".join(_line_of_reference(r) for r in fired["references"])
        for fired in report["triggers"]
    ]
    found += [f"trigger {name} never fired" for name in report["never_fired"]]
    for name, errors in report["tracking"].items():
        counted = report["states"][name]
        missing = f", {counted['lost']} lost" if counted["lost"] else ", none lost"
        if errors is not None:
            found.append(
                f"tracking of {name}: lateral {errors['lateral_rms_m']:.3f} m rms, at most "
                f"{errors['lateral_max_m']:.3f} m; longitudinal "
                f"{errors['longitudinal_rms_m']:.3f} m rms, at most "
                f"{errors['longitudinal_max_m']:.3f} m; {counted['received']} states{missing}"
            )
    return found


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
