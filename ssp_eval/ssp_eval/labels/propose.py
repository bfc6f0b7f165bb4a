"""Proposes labels from privileged states (METHOD 5.1); a person reviews them before they count."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ssp_core.clock import seconds_to_ns
from ssp_core.errors import InputError
from ssp_core.motion.corridor import Corridor
from ssp_core.motion.encounter import Observable
from ssp_core.motion.event import (
    TOLERANCE_S,
    RecordedEvent,
    find_event,
    instants_of,
)
from ssp_core.motion.state import ObjectState
from ssp_core.motion.state_series import Series, States, states_of, times_of
from ssp_core.vocabulary import LAT_ACTIONS, LON_ACTIONS
from ssp_eval.data.labels import BY_CLOCK, BY_PHASE, Label, Labels, PhasePosition
from ssp_eval.labels.plan import USUAL_LABELS, NoPlan, Plan, Timeline, plan_labels
from ssp_eval.labels.truth import Truth
from ssp_eval.recordings.event import Crop, crop_of
from ssp_eval.recordings.geometry import (
    STATIONARY_MPS,
    in_view,
    is_hidden,
    motion_word,
    position_word,
)
from ssp_eval.score.motion import Motion, lat_action, lon_action

# The camera's horizontal field of view where the clip doesn't know it.
_HFOV_RAD = math.radians(75.0)
# Beyond it an object doesn't count as visible.
_RANGE_M = 80.0
# Between labels on a clock grid, and what their times are multiples of.
_SPACING_S = 0.5
_TIME_GRID_S = 0.1


@dataclass(frozen=True)
class ClipScene:
    """The parts of a clip that don't change."""

    truth: Truth
    event: RecordedEvent
    corridor: Corridor
    standing: frozenset[str]

    def corridor_of(self, vut: ObjectState) -> Corridor:
        """Return the corridor along which the critical OT's place and motion are measured.

        The one that the VUT drives, so that a lead in a bend of the road is ahead. Of a VUT that
        turns at a junction, straight on from its pose: along its turn, a vehicle that comes the
        other way would cross from the side that the turn leads away from.

        Args:
            vut: state at the label's time.
        """
        return self.corridor if self.truth.rules.vut_turn is None else Corridor.of([vut])

    def hides(self, now: States, by: str | None = None) -> bool:
        """Return True when other objects, or that one alone, hide the critical OT."""
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

    def sees(self, now: States, object_id: str) -> bool:
        """Return True when an object is in the camera's field and range and not hidden."""
        vut_id = self.truth.vut_id
        if object_id not in now or vut_id not in now:
            return False
        hfov_rad = _HFOV_RAD if self.truth.hfov_rad is None else self.truth.hfov_rad
        if not in_view(now[vut_id], now[object_id], hfov_rad, _RANGE_M):
            return False
        others = [s for key, s in now.items() if key not in (vut_id, object_id)]
        return not is_hidden(now[vut_id], now[object_id], others)

    def risk_s(self, series: Series) -> float:
        """Return the trigger, or the first instant from then on without the critical OT hidden."""
        for t_s, now in series:
            after = t_s >= self.event.trigger_s - TOLERANCE_S
            if after and self.truth.vut_id in now and not self.hides(now):
                return t_s
        return self.event.trigger_s


def own_motion(
    series: Series,
    ticks_s: Sequence[float],
    vut_id: str,
    t_s: float,
) -> tuple[str, str]:
    """Return the VUT's actions in the second from a label time on, read as METHOD 6.6 does.

    Args:
        series: (clip time in s, states by object id), times rising.
        ticks_s: the times of ``series``.
        vut_id: id of the VUT.
        t_s: label time, s.

    Returns:
        Longitudinal and lateral action; it goes on straight where the clip ends before that is
        known.
    """
    states = []
    for ahead_s in (0.0, 0.5, 1.0):
        i = bisect_right(ticks_s, t_s + ahead_s + TOLERANCE_S) - 1
        state = series[i][1].get(vut_id) if i >= 0 else None
        if state is None or ticks_s[-1] < t_s + ahead_s - TOLERANCE_S:
            return "maintain", "straight"
        # Clips have frames 40 ms apart: without this, their jitter would look like acceleration.
        rest_ns = seconds_to_ns(t_s + ahead_s - ticks_s[i])
        states.append(state.extrapolated(state.stamp_ns + rest_ns))
    points = np.array([states[0].pose.to_local(state.x_m, state.y_m) for state in states])
    (s0, l0), (s1, l1), (s2, l2) = points[:, :, None]
    motion = Motion((s0, s1, s2), (l0, l1, l2), 0.5)
    lon, lat = int(lon_action(motion)[0]), int(lat_action(motion)[0])
    return LON_ACTIONS[lon], LAT_ACTIONS[lat]


_CONFLICT_OF_PHASE = {
    "approach": "no_conflict",
    "trigger": "potential",
    "conflict": "active",
    "resolution": "resolved",
}
_ACTIONS_OF_PHASE = {
    "approach": {"maintain"},
    "trigger": {"maintain", "decelerate"},
    "conflict": {"decelerate", "stop"},
    "resolution": {"maintain", "accelerate", "decelerate"},
}
# What the VUT itself does is right, too, while there is no conflict.
_OWN_ACTIONS_OF_PHASE = {"approach": {"accelerate", "stop"}, "resolution": {"stop"}}


@dataclass(frozen=True)
class Proposal:
    """Proposed labels with the event and the clip that they were made from."""

    labels: Labels
    event: RecordedEvent
    crop: Crop


@dataclass(frozen=True)
class LocatedRecording:
    """A recording whose event was found: what every label of it is read from."""

    truth: Truth
    series: Series
    corridor: Corridor
    event: RecordedEvent
    crop: Crop

    def timeline(self) -> Timeline:
        """Return its phases, to plan labels by.

        Raises:
            NoPlan: the event isn't resolved within the recording.
        """
        event, truth = self.event, self.truth
        if event.conflict_s is None or event.resolution_s is None:
            raise NoPlan(
                f"no label plan (METHOD 5.2b): from the trigger at {event.trigger_s:.2f} s on the "
                f"event isn't resolved before the recording ends, at {truth.end_s:.2f} s",
                file=truth.source,
            )
        return Timeline(
            truth.domain,
            event.trigger_s,
            event.conflict_s,
            event.resolution_s,
            self.crop,
            truth.frames_s,
        )

    def by_plan(self, plan: Plan) -> Proposal:
        """Return labels of a scenario's plan (METHOD 5.2b)."""
        timeline = self.timeline()
        times_s = [timeline.time_of(at) for at in plan.at]
        return self.proposal(times_s, plan.at, timeline.risk_s(plan))

    def proposal(
        self,
        times_s: Sequence[float],
        places: Sequence[PhasePosition] = (),
        onset_s: float | None = None,
    ) -> Proposal:
        """Propose labels at these times.

        Args:
            times_s: clip times, rising.
            places: of a plan, one for each time; empty: they lie on a clock grid.
            onset_s: risk_time_s of the plan; None: from when on the risk can be seen.
        """
        truth, series, event = self.truth, self.series, self.event
        ticks_s = times_of(series)
        scene = ClipScene(truth, event, self.corridor, _standing(truth, series, event))
        visible_s = scene.risk_s(series)
        labels = []
        everywhere: Sequence[PhasePosition | None] = places or (None,) * len(times_s)
        for t_s, at in zip(times_s, everywhere, strict=True):
            now = series[max(0, bisect_right(ticks_s, t_s + TOLERANCE_S) - 1)][1]
            own = own_motion(series, ticks_s, truth.vut_id, t_s)
            labels.append(_label(t_s, at, now, scene, visible_s, own))
        result = Labels(
            scenario=truth.scenario,
            domain=truth.domain,
            event_version=truth.event_version,
            risk_time_s=visible_s if onset_s is None else onset_s,
            first_frame_dynamics=False,
            labels=tuple(labels),
            plan=BY_PHASE if places else BY_CLOCK,
        )
        return Proposal(result, event, self.crop)


def locate(truth: Truth) -> LocatedRecording:
    """Find a recording's event.

    Raises:
        InputError: it has no VUT, event or conflict.
    """
    series = truth.states
    vut = states_of(series, truth.vut_id)
    if not vut:
        raise InputError(
            "has no states of the VUT",
            file=truth.source,
            value=truth.vut_id,
            remedy="give a recording, or a truth file, with states of the VUT",
        )
    corridor = Corridor.of(vut)
    event = _critical_event(truth, series, corridor)
    crop = crop_of(
        truth.start_s, truth.end_s, event.trigger_s, event.resolution_s, truth.rules.window
    )
    return LocatedRecording(truth, series, corridor, event, crop)


def propose(truth: Truth) -> Proposal:
    """Return labels of one recording on a clock grid, for what no plan fits.

    Raises:
        InputError: there is no VUT, no event, no conflict, or the clip is too short.
    """
    recording = locate(truth)
    trigger_s = recording.event.trigger_s
    span_s = (
        trigger_s,
        trigger_s if recording.event.conflict_s is None else recording.event.conflict_s,
    )
    times_s = grid_times(recording.crop.start_s, recording.crop.end_s, span_s, truth.source)
    return recording.proposal(times_s)


def propose_by_plan(truths: Sequence[Truth]) -> tuple[list[Proposal], str]:
    """Propose labels of recordings by one plan, or each on a clock grid without a plan.

    Returns:
        The proposals, and why there is no plan, empty where there is one.

    Raises:
        InputError: see locate and propose.
    """
    recordings = [locate(truth) for truth in truths]
    try:
        plan = plan_labels([one.timeline() for one in recordings])
    except NoPlan as error:
        return [propose(truth) for truth in truths], str(error)
    return [one.by_plan(plan) for one in recordings], ""


def _critical_event(
    truth: Truth,
    series: Series,
    corridor: Corridor,
) -> RecordedEvent:
    """Choose, of all OTs' events, the one whose conflict starts first."""
    rules, events = truth.rules, list[RecordedEvent]()
    kinds: tuple[Observable, ...] = ("lateral", "braking")
    for kind in kinds if rules.observable is None else (rules.observable,):
        for object_id in truth.target_ids:
            instants = instants_of(series, truth.vut_id, object_id)
            event = None
            if instants:
                event = find_event(
                    instants, corridor.path, rules.thresholds, kind, for_good_s=rules.for_good_s
                )
            if event is not None:
                events.append(event)
        if any(event.conflict_s is not None for event in events):
            break
    if not events:
        side, lead = "enters the VUT's corridor from the side", "brakes ahead of it in its corridor"
        near = "is ahead in its corridor while the VUT closes in on it"
        what = {"lateral": side, "braking": lead, "closing": near}.get(
            rules.observable or "", f"{side}, or {lead}"
        )
        raise InputError(
            f"no object target ({', '.join(truth.target_ids) or 'none given'}) {what}",
            file=truth.source,
            remedy="write its labels by hand",
        )
    critical = [event for event in events if event.conflict_s is not None]
    if not critical:
        raise InputError(
            f"neither TTC falls under {rules.thresholds.ttc_s} s nor the arrival gap under "
            f"{rules.thresholds.arrival_gap_s} s: there is no conflict to label",
            file=truth.source,
            remedy="give other thresholds, or write its labels by hand",
        )
    return min(critical, key=lambda event: event.conflict_s or 0.0)


def grid_times(
    start_s: float, end_s: float, centre_s: tuple[float, float], source: str
) -> list[float]:
    """Return nine times 0.5 s apart, centred on a span such as that from trigger to conflict.

    They lie inside the clip on a 0.1 s grid; where it ends too early or begins too late, they are
    shifted.

    Raises:
        InputError: the clip is shorter than the labels' span.
    """
    span_s = (USUAL_LABELS - 1) * _SPACING_S
    first_grid = math.ceil(start_s / _TIME_GRID_S - 1e-6)
    last_grid = math.floor((end_s - span_s) / _TIME_GRID_S + 1e-6)
    if last_grid < first_grid:
        raise InputError(
            f"is too short: {USUAL_LABELS} labels {_SPACING_S} s apart span {span_s:.1f} s, "
            f"the clip has {end_s - start_s:.1f} s",
            file=source,
            remedy="write its labels by hand",
        )
    centred_grid = round(((sum(centre_s) - span_s) / 2.0) / _TIME_GRID_S)
    first_s = min(max(centred_grid, first_grid), last_grid) * _TIME_GRID_S
    return [round(first_s + k * _SPACING_S, 6) for k in range(USUAL_LABELS)]


def _standing(
    truth: Truth,
    series: Series,
    event: RecordedEvent,
) -> frozenset[str]:
    """Return the OTs without an event that stand over the whole clip."""
    moving = {
        state.object_id
        for _, states in series
        for state in states.values()
        if abs(state.speed_mps) >= STATIONARY_MPS
    }
    return frozenset(truth.target_ids) - moving - {event.object_id}


def _label(
    t_s: float,
    at: PhasePosition | None,
    now: States,
    scene: ClipScene,
    visible_s: float,
    own: tuple[str, str],
) -> Label:
    vut, event = now[scene.truth.vut_id], scene.event
    objects = [
        now[object_id]
        for object_id in scene.truth.target_ids
        if scene.sees(now, object_id)
        and (object_id not in scene.standing or scene.hides(now, by=object_id))
    ]
    critical = next((state for state in objects if state.object_id == event.object_id), None)
    phase = event.phase_at(t_s) if at is None else at.phase
    corridor = scene.corridor_of(vut)
    conflict: str | None = _CONFLICT_OF_PHASE[phase]
    actions = _ACTIONS_OF_PHASE[phase] | ({own[0]} & _OWN_ACTIONS_OF_PHASE.get(phase, set()))
    # The turn is admitted throughout: who says "wait, then turn left" commits to it (LABELLING).
    lateral = ("straight", scene.truth.rules.vut_turn, own[1])
    if phase in ("trigger", "conflict") and scene.hides(now):
        conflict = None
    return Label(
        t_s=t_s,
        phase=phase,
        risk_visible=t_s >= visible_s - TOLERANCE_S,
        objects=tuple(sorted({state.object_class.word for state in objects})) if objects else None,
        position=None if critical is None else position_word(corridor, vut, critical),
        motion=None if critical is None else motion_word(corridor, vut, critical),
        conflict=conflict,
        lon_actions=tuple(action for action in LON_ACTIONS if action in actions),
        lat_actions=tuple(dict.fromkeys(word for word in lateral if word is not None)),
        at=at,
    )
