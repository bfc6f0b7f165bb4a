"""Proposes a labels file from privileged states; a person looks it over before it counts.

The rules, per label time (METHOD 1 and 5.1, geometry in the VUT's frame):

================  ===============================================================================
slot              proposed value
================  ===============================================================================
phase             by the event times measured after METHOD 1
risk_time_s       start of the trigger phase; where something hides the critical OT then, the first
                  instant from which it can be seen
risk_visible      from risk_time_s on
objects           classes of the OTs that can be seen and matter; null when there is none. An OT
                  that stands all the time and has no event of its own matters only while it hides
                  the critical one
position, motion  of the critical OT (geometry.py); null when it is hidden or out of view
conflict          approach no_conflict, trigger potential, conflict active, resolution resolved;
                  null where the critical OT is hidden in the trigger or conflict phase
lon_actions       no_conflict: maintain; and accelerate where the VUT itself speeds up over the
                  next second, stop where it stands. potential: maintain, decelerate. active:
                  decelerate, stop. resolved: maintain, accelerate, decelerate, and stop where the
                  VUT stands
lat_actions       straight; and left or right where the VUT's own lane bends that way by more than
                  the threshold of METHOD 6.6 within a second
================  ===============================================================================

The event is that of the OT whose conflict starts first. What makes its manoeuvre observable, and
the thresholds of the conflict, are those of the run or of the K*; where nobody says, entering from
the side, else braking ahead. "Can be seen" means in the camera's field and range, with a quarter of
its outline free of other objects (sight.py). What the VUT "itself does" is
measured as METHOD 6.6 reads a trajectory, from its states at 0, 0.5 and 1.0 s. It widens the
admissible set only where there is no conflict: what a driver did in a conflict says nothing about
what was right.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

from ssp_core.clock import seconds_to_ns
from ssp_core.errors import InputError
from ssp_core.interaction import Observable
from ssp_core.run_spec import ConflictThresholds
from ssp_core.state import ObjectState
from ssp_core.vocab import LON_ACTIONS
from ssp_eval.labels.event import Event, find_event, samples_of
from ssp_eval.labels.geometry import (
    DEFAULT_MOTION,
    Corridor,
    MotionThresholds,
    in_view,
    is_hidden,
    motion_word,
    position_word,
)
from ssp_eval.labels.model import Label, Labels
from ssp_eval.score import DEFAULT

_TOLERANCE_S = 1e-9
_TIME_GRID_S = 0.1

_CONFLICT_OF_PHASE = {
    "approach": "no_conflict",
    "trigger": "potential",
    "conflict": "active",
    "resolution": "resolved",
}
_ACTIONS_OF_CONFLICT = {
    "no_conflict": {"maintain"},
    "potential": {"maintain", "decelerate"},
    "active": {"decelerate", "stop"},
    "resolved": {"maintain", "accelerate", "decelerate"},
}


@dataclass(frozen=True)
class ProposalRules:
    """Everything that a proposal depends on besides the states.

    Args:
        count: labels, at least one.
        spacing_s: between labels.
        hfov_rad: the camera's horizontal field of view where the clip doesn't know it.
        range_m: beyond it an object doesn't count as visible.
        motion: thresholds of the motion classes.
    """

    count: int = 9
    spacing_s: float = 0.5
    hfov_rad: float = math.radians(75.0)
    range_m: float = 80.0
    motion: MotionThresholds = DEFAULT_MOTION


@dataclass(frozen=True)
class Truth:
    """Ground truth of one clip.

    Args:
        scenario: name.
        domain: of METHOD 5.2.
        event_version: K* version.
        start_s: clip time from which labels are possible (the first frame).
        end_s: clip time of the last frame.
        vut_id: object id of the VUT.
        target_ids: the OTs.
        series: (clip time in s, states of all objects), times rising.
        source: the file, for messages.
        hfov_rad: of the forward camera, None: not known.
        thresholds: the event's own, where its K* or its run gives them.
        observable: what makes the manoeuvre observable, None: not known.
        rules_of: whose thresholds and observable these are, for people.
    """

    scenario: str
    domain: str
    event_version: str
    start_s: float
    end_s: float
    vut_id: str
    target_ids: tuple[str, ...]
    series: Sequence[tuple[float, Sequence[ObjectState]]]
    source: str
    hfov_rad: float | None = None
    thresholds: ConflictThresholds = field(default_factory=ConflictThresholds)
    observable: Observable | None = None
    rules_of: str = "no K*, the defaults"


@dataclass(frozen=True)
class Proposal:
    """Proposed labels with the event that they were made from."""

    labels: Labels
    event: Event


DEFAULT_RULES = ProposalRules()


def propose(truth: Truth, rules: ProposalRules = DEFAULT_RULES) -> Proposal:
    """Labels from ground truth, by the rules in the module's docstring.

    Args:
        truth: states of the whole clip.
        rules: what else the proposal depends on.

    Raises:
        InputError: there is no VUT, no event, no conflict, or the clip is too short.
    """
    series = [(t_s, {state.object_id: state for state in states}) for t_s, states in truth.series]
    vut = [states[truth.vut_id] for _, states in series if truth.vut_id in states]
    if not vut:
        raise InputError("has no states of the VUT", file=truth.source, value=truth.vut_id)
    corridor = Corridor.of(vut)
    event = _critical_event(truth, series, corridor)
    times_s = label_times(truth.start_s, truth.end_s, event, rules, truth.source)
    ticks_s = [t_s for t_s, _ in series]
    scene = _Scene(truth, rules, event, corridor, _standing(truth, series, event, rules))
    risk_s = scene.risk_s(series)
    labels = []
    for t_s in times_s:
        now = series[max(0, bisect_right(ticks_s, t_s + _TOLERANCE_S) - 1)][1]
        own = _own_motion(series, ticks_s, truth.vut_id, t_s)
        labels.append(_label(t_s, now, scene, risk_s, own))
    result = Labels(
        scenario=truth.scenario,
        domain=truth.domain,
        event_version=truth.event_version,
        risk_time_s=risk_s,
        first_frame_dynamics=False,
        labels=tuple(labels),
    )
    return Proposal(result, event)


def _critical_event(
    truth: Truth,
    series: Sequence[tuple[float, dict[str, ObjectState]]],
    corridor: Corridor,
) -> Event:
    """Of all OTs' events the one whose conflict starts first."""
    kinds: tuple[Observable, ...] = ("lateral", "braking")
    if truth.observable is not None:
        kinds = (truth.observable,)
    events: list[Event] = []
    for kind in kinds:
        for object_id in truth.target_ids:
            samples = samples_of(series, truth.vut_id, object_id)
            event = find_event(samples, corridor.path, truth.thresholds, kind) if samples else None
            if event is not None:
                events.append(event)
        if any(event.conflict_s is not None for event in events):
            break
    if not events:
        side, lead = "enters the VUT's corridor from the side", "brakes ahead of it in its corridor"
        what = {"lateral": side, "braking": lead}.get(truth.observable or "", f"{side}, or {lead}")
        raise InputError(
            f"no object target ({', '.join(truth.target_ids) or 'none given'}) {what}",
            file=truth.source,
            remedy="write its labels by hand",
        )
    critical = [event for event in events if event.conflict_s is not None]
    if not critical:
        raise InputError(
            f"neither TTC falls under {truth.thresholds.ttc_s} s nor the arrival gap under "
            f"{truth.thresholds.arrival_gap_s} s: there is no conflict to label",
            file=truth.source,
            remedy="give other thresholds, or write its labels by hand",
        )
    return min(critical, key=lambda event: event.conflict_s or 0.0)


def label_times(
    start_s: float, end_s: float, event: Event, rules: ProposalRules, source: str
) -> list[float]:
    """Equally spaced times, centred on the span from trigger to conflict, inside the clip.

    They lie on a 0.1 s grid; where the clip ends too early or begins too late, they are shifted.

    Raises:
        InputError: the clip is shorter than the labels' span.
    """
    conflict_s = event.trigger_s if event.conflict_s is None else event.conflict_s
    span_s = (rules.count - 1) * rules.spacing_s
    first_grid = math.ceil(start_s / _TIME_GRID_S - 1e-6)
    last_grid = math.floor((end_s - span_s) / _TIME_GRID_S + 1e-6)
    if last_grid < first_grid:
        raise InputError(
            f"is too short: {rules.count} labels {rules.spacing_s} s apart span {span_s:.1f} s, "
            f"the clip has {end_s - start_s:.1f} s",
            file=source,
            remedy="give a smaller --count or --spacing",
        )
    wanted = round(((event.trigger_s + conflict_s - span_s) / 2.0) / _TIME_GRID_S)
    first_s = min(max(wanted, first_grid), last_grid) * _TIME_GRID_S
    return [round(first_s + k * rules.spacing_s, 6) for k in range(rules.count)]


@dataclass(frozen=True)
class _OwnMotion:
    """The VUT's motion over the next second, read as METHOD 6.6 reads a trajectory."""

    stands: bool = False
    speeds_up: bool = False
    sideways: str | None = None


def _own_motion(
    series: Sequence[tuple[float, dict[str, ObjectState]]],
    ticks_s: Sequence[float],
    vut_id: str,
    t_s: float,
) -> _OwnMotion:
    states = []
    for ahead_s in (0.0, 0.5, 1.0):
        i = bisect_right(ticks_s, t_s + ahead_s + _TOLERANCE_S) - 1
        state = series[i][1].get(vut_id) if i >= 0 else None
        if state is None or ticks_s[-1] < t_s + ahead_s - _TOLERANCE_S:
            return _OwnMotion()
        # Clips have frames 40 ms apart: without this, their jitter would look like acceleration.
        rest_ns = seconds_to_ns(t_s + ahead_s - ticks_s[i])
        states.append(state.extrapolated(state.stamp_ns + rest_ns))
    points = [states[0].pose.to_local(state.x_m, state.y_m) for state in states]
    v1_mps = (points[1][0] - points[0][0]) / 0.5
    v2_mps = (points[2][0] - points[1][0]) / 0.5
    shift_m = points[2][1]
    sideways = None
    if DEFAULT.at_least(abs(shift_m), DEFAULT.lateral_shift_m):
        sideways = "left" if shift_m > 0 else "right"
    stands = DEFAULT.at_most(v2_mps, DEFAULT.stop_speed_mps)
    speeds_up = DEFAULT.at_least((v2_mps - v1_mps) / 0.5, DEFAULT.accel_mps2)
    return _OwnMotion(stands, not stands and speeds_up, sideways)


@dataclass(frozen=True)
class _Scene:
    """What doesn't change over a clip."""

    truth: Truth
    rules: ProposalRules
    event: Event
    corridor: Corridor
    standing: frozenset[str]

    def hides(self, now: dict[str, ObjectState], by: str | None = None) -> bool:
        """True when other objects, or that one alone, hide the critical OT."""
        critical = now.get(self.event.object_id)
        if critical is None:
            return False
        vut_id = self.truth.vut_id
        others = [
            state
            for object_id, state in now.items()
            if object_id not in (vut_id, self.event.object_id) and by in (None, object_id)
        ]
        return is_hidden(now[vut_id], critical, others)

    def sees(self, now: dict[str, ObjectState], object_id: str) -> bool:
        """True when an object is in the camera's field and range and not hidden."""
        vut_id, rules = self.truth.vut_id, self.rules
        if object_id not in now or vut_id not in now:
            return False
        hfov_rad = rules.hfov_rad if self.truth.hfov_rad is None else self.truth.hfov_rad
        if not in_view(now[vut_id], now[object_id], hfov_rad, rules.range_m):
            return False
        others = [s for key, s in now.items() if key not in (vut_id, object_id)]
        return not is_hidden(now[vut_id], now[object_id], others)

    def risk_s(self, series: Sequence[tuple[float, dict[str, ObjectState]]]) -> float:
        """The trigger, or the first instant after it at which nothing hides the critical OT."""
        for t_s, now in series:
            after = t_s >= self.event.trigger_s - _TOLERANCE_S
            if after and self.truth.vut_id in now and not self.hides(now):
                return t_s
        return self.event.trigger_s


def _standing(
    truth: Truth,
    series: Sequence[tuple[float, dict[str, ObjectState]]],
    event: Event,
    rules: ProposalRules,
) -> frozenset[str]:
    """The OTs without an event that stand over the whole clip."""
    moving = {
        state.object_id
        for _, states in series
        for state in states.values()
        if abs(state.speed_mps) >= rules.motion.standstill_mps
    }
    return frozenset(truth.target_ids) - moving - {event.object_id}


def _label(
    t_s: float, now: dict[str, ObjectState], scene: _Scene, risk_s: float, own: _OwnMotion
) -> Label:
    vut, event = now[scene.truth.vut_id], scene.event
    seen = [
        now[object_id]
        for object_id in scene.truth.target_ids
        if scene.sees(now, object_id)
        and (object_id not in scene.standing or scene.hides(now, by=object_id))
    ]
    critical = next((state for state in seen if state.object_id == event.object_id), None)
    phase = event.phase_at(t_s)
    conflict: str | None = _CONFLICT_OF_PHASE[phase]
    actions = _lon_actions(_CONFLICT_OF_PHASE[phase], own)
    if phase in ("trigger", "conflict") and scene.hides(now):
        conflict = None
    motion = scene.rules.motion
    return Label(
        t_s=t_s,
        phase=phase,
        risk_visible=t_s >= risk_s - _TOLERANCE_S,
        objects=tuple(sorted({state.object_class.word for state in seen})) if seen else None,
        position=None if critical is None else position_word(scene.corridor, vut, critical),
        motion=None if critical is None else motion_word(scene.corridor, vut, critical, motion),
        conflict=conflict,
        lon_actions=actions,
        lat_actions=("straight",) if own.sideways is None else ("straight", own.sideways),
    )


def _lon_actions(conflict: str, own: _OwnMotion) -> tuple[str, ...]:
    actions = set(_ACTIONS_OF_CONFLICT[conflict])
    if conflict == "no_conflict" and own.speeds_up:
        actions.add("accelerate")
    if conflict in ("no_conflict", "resolved") and own.stands:
        actions.add("stop")
    return tuple(action for action in LON_ACTIONS if action in actions)


def response_problems(labels: Labels) -> list[str]:
    """Why no model could get a risk response (METHOD 6.9) under these labels; empty if one can.

    It takes two labels, at or after risk onset, adjacent among those whose conflict is potential
    or active, that admit a defensive action and lie at most 0.6 s apart.
    """
    onset_s = labels.risk_onset_s
    defensive = {"decelerate", "stop"}
    candidates = [
        label
        for label in labels.labels
        if label.t_s >= onset_s - _TOLERANCE_S and label.conflict in ("potential", "active")
    ]
    if len(candidates) < 2:
        return [
            f"only {len(candidates)} label(s) at or after the risk onset ({onset_s:g} s) have "
            "conflict potential or active; a risk response needs two"
        ]
    gaps_s = []
    for before, after in pairwise(candidates):
        if defensive.intersection(before.lon_actions) and defensive.intersection(after.lon_actions):
            gaps_s.append(after.t_s - before.t_s)
    if not gaps_s:
        return ["no two adjacent labels in the conflict admit decelerate or stop"]
    if not DEFAULT.at_most(min(gaps_s), DEFAULT.response_gap_s):
        return [
            f"labels in the conflict are {min(gaps_s):g} s apart; a risk response needs two at "
            f"most {DEFAULT.response_gap_s} s apart"
        ]
    return []
