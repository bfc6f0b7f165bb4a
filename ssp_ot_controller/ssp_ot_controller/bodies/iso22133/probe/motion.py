"""Clauses of a probe about motion.

An object is judged by the places that it reports; its state is held against them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ssp_core.clock import NS_PER_S, ns_to_seconds
from ssp_core.geometry import FloatArray, Polyline
from ssp_core.vocabulary import ControlState
from ssp_ot_controller.bodies.iso22133.messages import Heab, Strt, Traj
from ssp_ot_controller.bodies.iso22133.probe.steps import DRIVES, Finding, ProbeClause, Step, within
from ssp_ot_controller.bodies.iso22133.probe_report import Outcome
from ssp_ot_controller.bodies.iso22133.states import state_of, state_text
from ssp_ot_controller.bodies.iso22133.units import nearest_utc_ns

C = ControlState

IntArray = NDArray[np.int64]
# Speeds are ways over so long, which is more than receivers' noise.
_SPAN_NS = NS_PER_S // 5
# An object is slower when it has lost this much of its speed, and its share.
_LOST_MPS = 0.3
_LOST_SHARE = 0.1
# It stands when it moves less than this in the last second of a step.
STANDS_M = 0.1
# It has started when it has come this far.
_BEGUN_M = 0.2


@dataclass(frozen=True, slots=True)
class _Track:
    """The reported places of an object: arrivals and its own stamps in ns, places in m."""

    arrived_ns: IntArray
    stamp_ns: IntArray
    x_m: FloatArray
    y_m: FloatArray

    def way_m(self, since: int) -> FloatArray:
        """Return the straight ways of all places from one of them."""
        ways: FloatArray = np.hypot(self.x_m - self.x_m[since], self.y_m - self.y_m[since])
        return ways

    def speeds_mps(self) -> FloatArray:
        """Compute the speed over the last fifth of a second before each place.

        NaN without such a place.
        """
        before = np.searchsorted(self.stamp_ns, self.stamp_ns - _SPAN_NS, side="right") - 1
        dx, dy = self.x_m - self.x_m[before], self.y_m - self.y_m[before]
        dt_s = (self.stamp_ns - self.stamp_ns[before]) / NS_PER_S
        has_predecessor = (before >= 0) & (dt_s > 0.0)
        speeds: FloatArray = np.hypot(dx, dy) / np.where(has_predecessor, dt_s, 1.0)
        return np.where(has_predecessor, speeds, np.nan)

    def until(self, ns: int) -> int:
        """Index of the last place that came until then; -1 for none."""
        return int(np.searchsorted(self.arrived_ns, ns, side="right")) - 1


def _track(step: Step) -> _Track:
    """Return the places from the newest before the start on, or all where nothing was started."""
    strt = step.last_sent(Strt)
    rows: list[tuple[int, int, float, float]] = []
    for received, m in step.monrs():
        arrived_ns = received.stamp_ns
        stamp_ns = arrived_ns
        if m.time_of_week_ns is not None:
            stamp_ns = nearest_utc_ns(m.time_of_week_ns, arrived_ns)
        # A report that isn't newer than the one before says nothing of the motion.
        if m.x_m is None or m.y_m is None or (rows and stamp_ns <= rows[-1][1]):
            continue
        rows.append((arrived_ns, stamp_ns, m.x_m, m.y_m))
    if strt is not None:
        before = sum(row[0] <= strt.stamp_ns for row in rows)
        rows = rows[max(before - 1, 0) :]
    times = np.array([row[:2] for row in rows], dtype=np.int64).reshape(-1, 2)
    places = np.array([row[2:] for row in rows], dtype=np.float64).reshape(-1, 2)
    return _Track(times[:, 0], times[:, 1], *places.T)


def _plan(step: Step) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return times, ways and speeds of the trajectory that was sent last."""
    sent = step.last_sent(Traj)
    points = sent.message.points if sent is not None and isinstance(sent.message, Traj) else ()
    rows = [(p.t_s, p.x_m or 0.0, p.y_m or 0.0, p.speed_mps or 0.0) for p in points]
    t_s, x, y, speed = np.array(rows, dtype=np.float64).reshape(-1, 4).T
    way = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))))
    return t_s, way, speed


def _begun(step: Step, track: _Track) -> tuple[int, float] | None:
    """Index of the place at which it had begun to move, and its time on the trajectory, s."""
    strt = step.last_sent(Strt)
    first = -1 if strt is None else track.until(strt.stamp_ns)
    if first < 0:
        return None
    moved = np.flatnonzero(track.way_m(first)[first:] >= _BEGUN_M)
    t_s, way, _ = _plan(step)
    return (first + int(moved[0]), float(np.interp(_BEGUN_M, way, t_s))) if len(moved) else None


def starts(step: Step, clause: ProbeClause, steps: Mapping[str, Step]) -> Finding:
    """Measure how late it started, in the drive in which that was most."""
    driven = [steps[name] for name in DRIVES if name in steps and steps[name].last_sent(Strt)]
    findings = [_start(one, clause) for one in driven]
    measured = [one for one in findings if one.measured is not None]
    if not measured or len(measured) < len(findings):
        return Finding(Outcome.FAIL, step.problem or "it never moved")
    return max(measured, key=lambda one: abs(one.measured or 0.0))


def _start(step: Step, clause: ProbeClause) -> Finding:
    track = _track(step)
    begun = _begun(step, track)
    strt = step.last_sent(Strt)
    if begun is None or strt is None:
        return Finding(Outcome.FAIL, step.problem or "it never moved")
    asked_s = ns_to_seconds(step.marks["start"] - strt.stamp_ns)
    late_s = ns_to_seconds(int(track.arrived_ns[begun[0]]) - step.marks["start"]) - begun[1]
    text = f"sent {asked_s:.2f} s ahead; negative: too early"
    return within(clause, late_s, text, sent=(strt.data,), came=_monr_at(step, track, begun[0]))


def _monr_at(step: Step, track: _Track, index: int) -> tuple[bytes, ...]:
    return tuple(r.data for r, _ in step.monrs() if r.stamp_ns == track.arrived_ns[index])[:1]


def stops(step: Step, clause: ProbeClause, _: Mapping[str, Step]) -> Finding:
    """Measure from the step's mark to where it became slower for good, if it stands at the end.

    An uneven pace is no stop: one that speeds up again hasn't begun to brake.
    """
    mark_ns = step.marks.get("stimulus")
    track = _track(step)
    at = -1 if mark_ns is None else track.until(mark_ns)
    if mark_ns is None or at < 0:
        return Finding(Outcome.NOT_RUN, step.problem or "it wasn't brought to speed")
    speeds = track.speeds_mps()
    before_mps = float(speeds[at])
    if not before_mps > 2.0 * _LOST_MPS:
        return Finding(Outcome.NOT_RUN, f"drove at {before_mps:.2f} m/s only")
    limit_mps = before_mps - max(_LOST_MPS, _LOST_SHARE * before_mps)
    fast = np.flatnonzero(~(speeds[at + 1 :] <= limit_mps))
    first = at + 1 + (int(fast[-1]) + 1 if len(fast) else 0)
    speed_text = f"at {before_mps:.2f} m/s"
    sent = tuple(
        s.data for s in step.sent if isinstance(s.message, Heab) and s.stamp_ns <= mark_ns
    )[-1:]
    last = track.until(int(track.arrived_ns[-1]) - NS_PER_S)
    if first >= len(speeds) or last <= at or float(track.way_m(last)[last:].max()) > STANDS_M:
        way_m = float(track.way_m(at)[-1])
        text = f"{speed_text}; after {way_m:.1f} m it still moves"
        return Finding(Outcome.FAIL, text, None, sent, _monr_at(step, track, len(speeds) - 1))
    reaction_s = ns_to_seconds(int(track.arrived_ns[first]) - mark_ns)
    standing = first + int(np.flatnonzero(~(speeds[first:] > STANDS_M))[0])
    stood_s = ns_to_seconds(int(track.arrived_ns[standing]) - mark_ns)
    text = f"{speed_text}; stood after {stood_s:.2f} s and {float(track.way_m(at)[standing]):.1f} m"
    evidence = _monr_at(step, track, first)
    due_s = _slows_by_itself_s(step, track, mark_ns)
    if due_s is not None and reaction_s > due_s - _LOST_MPS:
        text += f"; its trajectory slows {due_s:.2f} s after the stimulus"
        if clause.bound is not None and reaction_s <= clause.bound:
            return Finding(Outcome.FAIL, text, None, sent, evidence)
    return within(clause, reaction_s, text, sent=sent, came=evidence)


def _slows_by_itself_s(step: Step, track: _Track, mark_ns: int) -> float | None:
    """Find when the trajectory ends its cruise, from the mark on; None where that isn't known."""
    begun = _begun(step, track)
    if begun is None:
        return None
    t_s, _, speed = _plan(step)
    cruise_until_s = float(t_s[np.flatnonzero(speed >= 0.99 * speed.max())[-1]])
    return ns_to_seconds(int(track.arrived_ns[begun[0]]) - mark_ns) + cruise_until_s - begun[1]


def unheard(step: Step, clause: ProbeClause, steps: Mapping[str, Step]) -> Finding:
    """Measure as ``stops`` does.

    An object that also ceases to report is judged by where it is found.
    """
    track, mark_ns = _track(step), step.marks.get("stimulus")
    again = steps.get(f"{clause.step}_again")
    if mark_ns is None or not len(track.x_m):
        return stops(step, clause, steps)
    heard_ns = step.marks["end"] - int(track.arrived_ns[-1])
    if "lost" not in step.marks and heard_ns < NS_PER_S // 2:
        return stops(step, clause, steps)
    silent_s = ns_to_seconds(int(track.arrived_ns[-1]) - mark_ns)
    silence_text = f"reported nothing from {max(silent_s, 0.0):.2f} s on"
    later_track = None if again is None else _track(again)
    at = track.until(mark_ns)
    if later_track is None or not len(later_track.x_m) or at < 0:
        return Finding(Outcome.FAIL, f"{silence_text}, and wasn't found again")
    before_mps = float(track.speeds_mps()[at])
    way_m = math.hypot(later_track.x_m[0] - track.x_m[at], later_track.y_m[0] - track.y_m[at])
    later_s = ns_to_seconds(int(later_track.arrived_ns[0]) - mark_ns)
    moved_m = float(later_track.way_m(0).max())
    if moved_m > STANDS_M or not before_mps > 2.0 * _LOST_MPS:
        text = f"{silence_text}; {later_s:.1f} s later it was {way_m:.1f} m on and still moved"
        return Finding(Outcome.FAIL, text, came=(again.monrs()[0][0].data,) if again else ())
    text = f"{silence_text}; stood {way_m:.1f} m on, so that it drove on for no longer than this"
    return within(clause, way_m / before_mps, text)


def keeps_to_way(step: Step, clause: ProbeClause, steps: Mapping[str, Step]) -> Finding:
    """Measure how far it came off its trajectory, in the drive in which that was most.

    An abort ends a session, and so do lost heartbeats.
    """
    findings = [_off_way(name, steps[name], clause) for name in DRIVES if name in steps]
    measured = [one for one in findings if one.measured is not None]
    if not measured:
        return Finding(Outcome.NOT_RUN, step.problem or "it never moved")
    return max(measured, key=lambda one: one.measured or 0.0)


def _off_way(name: str, step: Step, clause: ProbeClause) -> Finding:
    track, sent = _track(step), step.last_sent(Traj)
    if _begun(step, track) is None or sent is None or not isinstance(sent.message, Traj):
        return Finding(Outcome.NOT_RUN, step.problem or "it never moved")
    places = [(p.x_m or 0.0, p.y_m or 0.0) for p in sent.message.points]
    apart = [p for i, p in enumerate(places) if i == 0 or p != places[i - 1]]
    until = len(track.x_m)
    if name != "normal_stop" and "stimulus" in step.marks:
        until = track.until(step.marks["stimulus"]) + 1
    driven = list(zip(track.x_m.tolist(), track.y_m.tolist(), strict=True))[:until]
    projections = Polyline(apart).project_all(driven)
    return within(clause, max(abs(offset) for _, offset in projections), sent=(sent.data[:256],))


# -- what it states while it moves ----------------------------------------------------------------

# How long the state that it reports may lag behind what it was told.
LAG_S = 1.0


def runs(step: Step, clause: ProbeClause, steps: Mapping[str, Step]) -> Finding:
    """Judge that each drive is in RUNNING from its start to the stimulus that ends it.

    It stays ARMED until it hears of the start, and must never be DISARMED in motion.
    """
    late_s: float | None = None
    for name in DRIVES:
        one = steps.get(name)
        track = None if one is None else _track(one)
        if one is None or track is None or _begun(one, track) is None:
            continue
        start_ns = one.marks["start"]
        until_ns = one.marks.get("stimulus", one.marks.get("end", int(track.arrived_ns[-1])))
        moving_ns = _moving_until_ns(track)
        strt = one.last_sent(Strt)
        strt_ns = start_ns if strt is None else strt.stamp_ns
        running_ns: int | None = None
        armed = False
        for received, monr in one.monrs_in_order():
            at_ns, state = received.stamp_ns, state_of(monr.state)
            armed = armed or state is C.ARMED
            if at_ns <= strt_ns and armed and state is not C.ARMED:
                text = f"reports {state_text(monr.state)} before it hears of its start"
                return Finding(Outcome.FAIL, text, came=(received.data,))
            if at_ns < start_ns:
                continue
            if at_ns > until_ns:
                odd = state is C.DISARMED and at_ns < moving_ns
            elif running_ns is None:
                odd = state not in (C.ARMED, C.PRE_RUNNING, C.RUNNING)
                running_ns = at_ns if state is C.RUNNING else None
            else:
                odd = state is not C.RUNNING
            if odd:
                text = f"reports {state_text(monr.state)} while it drives"
                return Finding(Outcome.FAIL, text, came=(received.data,))
        if running_ns is None:
            return Finding(Outcome.FAIL, "doesn't report RUNNING while it drives")
        late_s = max(late_s or 0.0, ns_to_seconds(running_ns - start_ns))
    if late_s is None:
        return Finding(Outcome.NOT_RUN, step.problem or "it never moved")
    return within(clause, late_s)


def ends_run(step: Step, clause: ProbeClause, _: Mapping[str, Step]) -> Finding:
    """Judge that the object is in POSTRUN from soon after the normal stop until it stands.

    Then it may be DISARMED, and nothing else.
    """
    mark_ns, track = step.marks.get("stimulus"), _track(step)
    if mark_ns is None or _begun(step, track) is None:
        return Finding(Outcome.NOT_RUN, step.problem or "it wasn't brought to speed")
    moving_ns = _moving_until_ns(track)
    postrun_ns: int | None = None
    for received, monr in step.monrs_in_order():
        at_ns, state = received.stamp_ns, state_of(monr.state)
        is_standing = postrun_ns is not None and at_ns >= moving_ns
        if at_ns <= mark_ns or (is_standing and state is C.DISARMED):
            continue
        if state is C.POSTRUN:
            postrun_ns = postrun_ns or at_ns
        elif postrun_ns is not None or state is not C.RUNNING:
            text = f"reports {state_text(monr.state)} while it stops"
            return Finding(Outcome.FAIL, text, came=(received.data,))
    if postrun_ns is None:
        return Finding(Outcome.FAIL, "doesn't report POSTRUN while it stops")
    return within(clause, ns_to_seconds(postrun_ns - mark_ns))


def _moving_until_ns(track: _Track) -> int:
    """Find when it came to where it stands at the end of the step."""
    ways = np.hypot(track.x_m - track.x_m[-1], track.y_m - track.y_m[-1])
    moving = np.flatnonzero(ways > STANDS_M)
    return int(track.arrived_ns[moving[-1]]) if len(moving) else 0
