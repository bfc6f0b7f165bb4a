"""Clauses of a probe about the reports of an object in motion, by the rules of a session.

They are read as the gateway reads them, and judged as manager and object do, in each drive.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from ssp_core.clock import ns_to_seconds
from ssp_core.geodesy import Datum, Place
from ssp_core.safety.consistency import Bounds, ConsistencyWatch
from ssp_ot_controller.bodies.body import BodyReading
from ssp_ot_controller.bodies.iso22133.framing import RejectedBytes
from ssp_ot_controller.bodies.iso22133.link import ReceivedMessage
from ssp_ot_controller.bodies.iso22133.messages import Monr, ObjectError, Strt
from ssp_ot_controller.bodies.iso22133.probe.steps import (
    DRIVES,
    Finding,
    ProbeClause,
    Step,
    within,
)
from ssp_ot_controller.bodies.iso22133.probe_report import Outcome
from ssp_ot_controller.bodies.iso22133.reports import MonrReadings
from ssp_ot_controller.bodies.odometry import AHEAD_S

# Places stay in the frame of the OSEM: they are compared with each other alone.
_FRAME = Datum(Place(0.0, 0.0))
# By the sign of its speed, and as it is driven.
_FORWARDS = "drives backwards: "
_WAYS = ("", _FORWARDS)


@dataclass(frozen=True, slots=True)
class _Report:
    """One MONR, and what the gateway makes of it.

    Args:
        reading: None: it gives none.
        problem: why a session doesn't use it; empty: it does.
    """

    received: ReceivedMessage
    monr: Monr
    reading: BodyReading | None
    problem: str

    @property
    def stamp_ns(self) -> int:
        """Return its own stamp; 0: it is no reading."""
        return 0 if self.reading is None else self.reading.stamp_ns

    @property
    def ahead_s(self) -> float:
        """Return how far its stamp lies ahead of when it was read."""
        return ns_to_seconds(self.stamp_ns - self.received.stamp_ns)


def _reports(step: Step) -> Iterator[_Report]:
    """Yield the reports of a step; no place counts as less certain than it is stated."""
    readings = MonrReadings(_FRAME, None, 0.0)
    for received, monr in step.monrs():
        reading = readings.take(monr, received.stamp_ns)
        if isinstance(reading, RejectedBytes):
            yield _Report(received, monr, None, reading.text)
            continue
        one = _Report(received, monr, reading, "")
        is_ahead = one.ahead_s > AHEAD_S
        yield replace(one, problem="is stamped ahead of time") if is_ahead else one


@dataclass(frozen=True, slots=True)
class _Drive:
    """One drive, until a session would be over: where an object is to notice lost heartbeats.

    Args:
        reports: of the whole step.
        from_ns: when the STRT was sent.
        problem: why the probe broke it off; empty: it didn't.
    """

    reports: tuple[_Report, ...]
    from_ns: int
    until_ns: int
    problem: str

    def started(self) -> tuple[_Report, ...]:
        """Return the reports since the STRT."""
        return tuple(one for one in self.reports if one.received.stamp_ns > self.from_ns)


def _drives(steps: Mapping[str, Step]) -> list[_Drive]:
    drives = []
    for name in DRIVES:
        step = steps.get(name)
        strt = None if step is None else step.last_sent(Strt)
        if step is None or strt is None or not step.came:
            continue
        until_ns = step.marks.get("end", step.came[-1].stamp_ns)
        if name == "loss":
            until_ns = step.marks.get("stimulus", until_ns)
        reports = tuple(one for one in _reports(step) if one.received.stamp_ns <= until_ns)
        drives.append(_Drive(reports, strt.stamp_ns, until_ns, step.problem))
    return drives


def _not_driven(step: Step) -> Finding:
    return Finding(Outcome.NOT_RUN, step.problem or "it was never started")


def stays_fresh(step: Step, clause: ProbeClause, steps: Mapping[str, Step]) -> Finding:
    """Measure how old the newest report that can be used becomes in a drive."""
    drives = _drives(steps)
    if not any(drive.started() for drive in drives):
        return _not_driven(step)
    oldest: tuple[float, _Report | None] = (0.0, None)
    for drive in drives:
        newest_ns, last = drive.from_ns, None
        for one in (*drive.reports, None):
            at_ns = drive.until_ns if one is None else one.received.stamp_ns
            if at_ns > drive.from_ns:
                age_s = ns_to_seconds(at_ns - newest_ns)
                oldest = max(oldest, (age_s, last), key=lambda found: found[0])
            if one is not None:
                last = one
                newest_ns = newest_ns if one.problem else one.stamp_ns
    age_s, last = oldest
    if clause.bound is not None and age_s <= clause.bound:
        return within(clause, age_s)
    if last is None:
        return within(clause, age_s, "no report came")
    text = last.problem
    if not text and last.ahead_s < -0.5 * age_s:
        text = "its clock is behind, or its reports come late"
    return within(clause, age_s, text or "no other report came", came=(last.received.data,))


def is_not_ahead(step: Step, clause: ProbeClause, steps: Mapping[str, Step]) -> Finding:
    """Measure how far its stamps lie ahead of when they were read, in a drive."""
    stamped = [one for drive in _drives(steps) for one in drive.started() if one.stamp_ns]
    if not stamped:
        return _not_driven(step)
    first = max(stamped, key=lambda one: one.ahead_s)
    if first.ahead_s <= 0.0:
        return within(clause, 0.0)
    text = f"its clock is ahead: {first.ahead_s:.3f} s"
    return within(clause, first.ahead_s, text, came=(first.received.data,))


def knows_its_place(step: Step, clause: ProbeClause, steps: Mapping[str, Step]) -> Finding:
    """Count the reports of a drive that state bad positioning."""
    reports = [one for drive in _drives(steps) for one in drive.started()]
    if not reports:
        return _not_driven(step)
    bad = [
        one.received.data
        for one in reports
        if one.monr.error_status & ObjectError.BAD_POSITIONING_ACCURACY
    ]
    text = "its error status has bad positioning" if bad else ""
    return within(clause, len(bad), text, came=tuple(bad))


def states_its_motion(step: Step, _: ProbeClause, steps: Mapping[str, Step]) -> Finding:
    """Judge that no contradiction of stated motion and places holds in a drive (METHOD 4.3b).

    Nor one of motion forwards, where the sign of the speed counts: that is how it is driven. A
    drive that the probe broke off shows nothing but one that keeps an object from being armed.
    """
    drives = [drive for drive in _drives(steps) if any(one.reading for one in drive.started())]
    if not drives:
        return _not_driven(step)
    findings = [_contradiction(drive, step.bounds, way) for drive in drives for way in _WAYS]
    for verdict in (Outcome.FAIL, Outcome.NOT_RUN, Outcome.PASS):
        if these := [one for one in findings if one.verdict is verdict]:
            return max(these, key=lambda one: one.measured or 0.0)
    return _not_driven(step)


def _contradiction(drive: _Drive, bounds: Bounds, way: str) -> Finding:
    """Find the contradiction that holds longest in a drive."""
    watch = ConsistencyWatch(bounds)
    longest = Finding(Outcome.PASS, measured=0.0)
    for one in drive.started():
        if (r := one.reading) is None or one.problem:
            continue
        speed_mps = abs(r.speed_mps) if way == _FORWARDS else r.speed_mps
        watch.take(r.stamp_ns, r.x_m, r.y_m, r.yaw_rad, speed_mps, r.position_std_m)
        contradiction = watch.contradiction
        if contradiction is not None and contradiction.held_s > (longest.measured or 0.0):
            verdict = Outcome.FAIL if contradiction.holds else Outcome.PASS
            text = f"{way}{contradiction.text}"
            longest = Finding(verdict, text, contradiction.held_s, came=(one.received.data,))
    if not drive.problem or longest.verdict is Outcome.FAIL:
        return longest
    if watch.doubt is not None:
        return replace(longest, verdict=Outcome.FAIL)
    return Finding(Outcome.NOT_RUN, drive.problem)
