"""Starts and their twins: all that is fixed before a driver runs (METHOD 8.1)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.errors import InputError
from ssp_core.files.reading import parse_model
from ssp_core.geometry import Polyline
from ssp_core.hashing import sha256_json
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.driven import BUILT_IN, NO_RESPONSE, Driven, LeftOut
from ssp_core.run_file.latency import ZERO_LATENCY, Latency
from ssp_core.run_file.model import Camera, RunSpec
from ssp_core.run_file.participants import ElapsedTime, Hold, ParticipantSpec, TriggerSpec
from ssp_core.vocabulary import Phase
from ssp_core.world.driver import sees_frames
from ssp_core.world.reference_line import ReferenceLine
from ssp_scenario_manager.closed_loop.contact import Contact, first_contact, first_touch
from ssp_scenario_manager.closed_loop.starts.box import draw_run_values, gap_draw
from ssp_scenario_manager.closed_loop.values import EPSILON_S, LIMITS
from ssp_scenario_manager.compile.task import NO_TUNINGS, Tuning
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.run.in_process import InProcessResult, Record, run_in_process
from ssp_scenario_manager.scenarios.events.crossing import is_hidden

# How long the search for the first trigger, and then the twin, may take in session time.
_SCOUT_S = 40.0
_TWIN_S = 20.0
# A trigger's time lies so far before the step at which it fired, which is then the first after it.
_BEFORE_STEP_S = 0.001


class NoStart(Exception):
    """The reason why a seed gives no start."""


class OffSpec(NoStart):
    """The event of the seed isn't K*'s (METHOD 8.1)."""


class ShortRunUp(NoStart):
    """The place has no room for the hand-over before the event, which may well be K*'s."""


@dataclass(frozen=True, slots=True)
class Start:
    """One start: what all drivers meet, and what its twin did.

    Args:
        run: without a driver, with the times of the triggers instead of their conditions.
        values: drawn from K*'s box, by field of the run file or of K*.
        hand_over_s: t_h.
        first_request_s: of a driver, whatever its latency up to the campaign's largest.
        observable_s: T_obs.
        end_s: T_end.
        frame_period_s: between the frames that are asked about.
        contact: of the twin; None: it has none.
        twin: true states of its VUT by stamp, ns.
        camera: of drivers that see; None: there is none.
        left_out: parts of the compiled run.
    """

    run: RunSpec
    values: Mapping[str, float]
    hand_over_s: float
    first_request_s: float
    observable_s: float
    end_s: float
    frame_period_s: float
    contact: Contact | None
    twin: Mapping[int, ObjectState]
    camera: Camera | None = None
    left_out: Sequence[LeftOut] = ()

    @property
    def v_r_mps(self) -> float | None:
        """Norm of the relative velocity at the twin's first contact."""
        return None if self.contact is None else self.contact.relative_mps

    def facts(self) -> dict[str, Any]:
        """Return all that the twin fixed, as it is hashed."""
        return {
            "seed": self.run.seed,
            "values": dict(self.values),
            "hand_over_s": self.hand_over_s,
            "first_request_s": self.first_request_s,
            "triggers_s": [_after_s(trigger) for trigger in self.run.triggers],
            "observable_s": self.observable_s,
            "end_s": self.end_s,
            "frame_period_s": self.frame_period_s,
            "v_r_mps": self.v_r_mps,
            "contact_s": None if self.contact is None else self.contact.at_s,
            "camera": None if self.camera is None else self.camera.model_dump(mode="json"),
        }

    @property
    def hash(self) -> str:
        """Hash of the run and of what the twin fixed."""
        run = self.run.model_dump(mode="json", by_alias=True, exclude={"run_id", "driven"})
        return sha256_json({"run": run, **self.facts()})

    def sealed(self) -> dict[str, Any]:
        """Return what a campaign keeps of the start; ``from_facts`` makes it anew."""
        return {
            **self.facts(),
            "left_out": list(self.left_out),
            "hash": self.hash,
            "run": self.run.model_dump(mode="json", by_alias=True),
        }

    def driven_by(
        self,
        driver: str,
        options: Mapping[str, Any],
        latency: Latency,
        *,
        event: bool = True,
        repeat: int = 0,
    ) -> RunSpec:
        """Return the run of one driver.

        Args:
            driver: its name.
            options: of it.
            latency: L.
            event: False: the event-free twin, in which no trigger fires (METHOD 8.6).
            repeat: of the start under this driver, from 0.
        """
        driven = Driven(
            driver=driver,
            options=dict(options),
            latency=latency,
            first_request_s=self.first_request_s,
            hand_over_s=self.hand_over_s,
            end_s=self.end_s,
            frame_period_s=self.frame_period_s,
            observable_s=self.observable_s if event else None,
            start=self.hash,
            repeat=repeat,
            left_out=list(self.left_out),
        )
        run = self.run if event else without_event(self.run, self.end_s)
        camera = self.camera if sees_frames(driver) else None
        return run.model_copy(update={"driven": driven, "camera": camera})


def make_start(
    run: RunSpec,
    event: Event,
    seed: int,
    latency_max_s: float,
    history_s: float = LIMITS.history_s,
    tunings: Mapping[str, Tuning] = NO_TUNINGS,
) -> Start:
    """Return the start of a seed.

    Args:
        run: as it was compiled; traffic and adaptation are left out, the camera is that of
            drivers that see.
        event: K*.
        seed: of the start.
        latency_max_s: largest latency of the campaign, for which the hand-over leaves time.
        history_s: longest history of a driver, for which it does so too.
        tunings: of the task that the run is of, by field of K*, see ``draw_run_values``.

    Raises:
        OffSpec: the event of this seed isn't K*'s.
        ShortRunUp: it begins before the hand-over.
        InputError: the values make no run.
    """
    frame_s = _frame_period_s(run)
    history_s = max(history_s, LIMITS.history_s)
    start_run, values = draw_run_values(prepared(run), event, seed, tunings)
    gaps = gap_draw(start_run, event, seed)
    if (bounds := gaps.bounds_m) is not None:
        widest, _ = gaps.with_gap(bounds.high)
        run_up = _run_up(without_operator(widest), latency_max_s, frame_s, history_s)
        start_run, drawn_gaps = gaps.with_gap(gaps.draw_m(run_up.room_m))
        values |= drawn_gaps
    bare = without_operator(start_run)
    run_up = _run_up(bare, latency_max_s, frame_s, history_s)
    hand_over_s, fires_s = run_up.hand_over_s, run_up.fires_s
    first_s = _first_request_s(hand_over_s, latency_max_s, frame_s)
    driven = Driven(
        driver=NO_RESPONSE,
        first_request_s=first_s,
        hand_over_s=hand_over_s,
        end_s=fires_s + _TWIN_S,
        frame_period_s=frame_s,
    )
    twin = bare.model_copy(update={"driven": driven})
    result, record = run_in_process(twin)
    contact = first_contact(record.reports, run.vut.id)
    resolved_s = result.phase_s(Phase.RESOLUTION)
    if not result.ok and contact is None and resolved_s is not None:
        # Where a VUT without a response gets to after T_end, as off the site, is not of the event.
        end_s = min(_end_s(resolved_s), fires_s + _TWIN_S)
        earlier = driven.model_copy(update={"end_s": end_s})
        twin = bare.model_copy(update={"driven": earlier})
        result, record = run_in_process(twin)
        resolved_s = result.phase_s(Phase.RESOLUTION)
    if problem := _touched_scenery(twin, record, resolved_s):
        raise OffSpec(problem)
    fixed = start_run.model_copy(update={"triggers": _at_their_times(twin, result)})
    observable_s = result.phase_s(Phase.TRIGGER)
    if problem := _off_spec(twin, result, contact) or _early_visibility(run, event, result, record):
        raise OffSpec(problem)
    if observable_s is None or observable_s < hand_over_s:
        raise ShortRunUp("the event is observable before the hand-over")
    over_s = resolved_s if contact is None else contact.at_s
    if over_s is None:
        raise OffSpec("without a response there is neither contact nor resolution")
    return Start(
        run=fixed,
        values=values,
        hand_over_s=hand_over_s,
        first_request_s=first_s,
        observable_s=observable_s,
        end_s=_end_s(over_s),
        frame_period_s=frame_s,
        contact=contact,
        twin=vut_states(record, run.vut.id),
        camera=run.camera,
        left_out=left_out_of(run),
    )


def _end_s(over_s: float) -> float:
    """Return T_end of an event that is over at a session time."""
    return round(over_s + LIMITS.after_s, 6)


def commanded(driver: str) -> dict[str, Any]:
    """Return the changes of a driven run that a driver without plans leads."""
    return {"driver": driver, "options": {}, "latency": ZERO_LATENCY}


def twin_of(run: RunSpec) -> tuple[Mapping[int, ObjectState], Contact | None]:
    """Drive the twin of a driven run again; return its VUT's true states, and its first contact."""
    if run.driven is None:
        raise InputError(
            "is no driven run", field="driven", remedy="give a run of `ssp run --drive`"
        )
    driven = run.driven.model_copy(update=commanded(NO_RESPONSE))
    twin = without_operator(run).model_copy(update={"driven": driven, "camera": None})
    _, record = run_in_process(twin)
    return vut_states(record, run.vut.id), first_contact(record.reports, run.vut.id)


def from_facts(facts: Mapping[str, Any]) -> Start:
    """Return a start from what was sealed of it; its twin is driven again.

    Args:
        facts: as ``Start.sealed`` returns it.

    Raises:
        InputError: the start isn't the one that was sealed.
    """
    run = parse_model(RunSpec, facts["run"], f"the start of seed {facts['seed']}")
    start = Start(
        run=run,
        values=facts["values"],
        hand_over_s=facts["hand_over_s"],
        first_request_s=facts["first_request_s"],
        observable_s=facts["observable_s"],
        end_s=facts["end_s"],
        frame_period_s=facts["frame_period_s"],
        contact=None,
        twin={},
        camera=None if facts["camera"] is None else parse_model(Camera, facts["camera"], "camera"),
        left_out=facts["left_out"],
    )
    twin, contact = twin_of(start.driven_by(NO_RESPONSE, {}, ZERO_LATENCY))
    start = replace(start, twin=twin, contact=contact)
    if start.hash != facts["hash"]:
        raise InputError(
            "isn't the start that was sealed: its twin drives otherwise here",
            field=f"start of seed {facts['seed']}",
            value=start.hash,
            remedy="go on with the build that drew the starts, or name a new folder with --out",
        )
    return start


def vut_states(record: Record, vut_id: str) -> dict[int, ObjectState]:
    """Return the true states of the VUT by stamp, ns."""
    return {state.stamp_ns: state for state in record.truths(vut_id)}


def left_out_of(run: RunSpec) -> list[LeftOut]:
    """Return the parts of a compiled run that ``prepared`` leaves out."""
    adapts = any(trigger.adaptation is not None for trigger in run.triggers)
    there: tuple[tuple[LeftOut, bool], ...] = (
        ("traffic", bool(run.traffic)),
        ("adaptation", adapts),
    )
    return [part for part, is_there in there if is_there]


def prepared(run: RunSpec) -> RunSpec:
    """Return a run as a driven session has it: no traffic, no adaptation, nothing rendered."""
    triggers = [t.model_copy(update={"adaptation": None}) for t in run.triggers]
    return run.model_copy(update={"traffic": [], "triggers": triggers, "camera": None})


# Between an object that stands beside the carriageway and the carriageway's edge.
_BESIDE_M = 0.15


def without_operator(run: RunSpec) -> RunSpec:
    """Return the run without what an operator does in it: a twin has none of it."""
    faults = [fault for fault in run.faults if fault.kind != "operator_abort"]
    return run.model_copy(update={"faults": faults})


def without_event(run: RunSpec, end_s: float) -> RunSpec:
    """Return the run with triggers that don't fire before its end (METHOD 8.6).

    An object that is the event by being there stands at its start, beside the carriageway.
    """
    never = [
        t.model_copy(update={"condition": ElapsedTime(type="elapsed_time", after_s=end_s + 1.0)})
        for t in run.triggers
    ]
    end = run.end.model_copy(update={"at_latest_s": max(run.end.at_latest_s, end_s + 10.0)})
    limits = run.limits.model_copy(update={"duration_s": max(run.limits.duration_s, end_s + 10.0)})
    holding = {t.object_id for t in run.triggers if isinstance(t.manoeuvre, Hold)}
    targets = [_beside(run, t) if t.id in holding else t for t in run.targets]
    return without_operator(run).model_copy(
        update={"triggers": never, "end": end, "limits": limits, "targets": targets}
    )


def _beside(run: RunSpec, target: ParticipantSpec) -> ParticipantSpec:
    """Return an object that stands to the right of the carriageway, at its start."""
    line = ReferenceLine.of_road(run.road)
    s_m, _ = line.to_local(target.start.x_m, target.start.y_m)
    edge_m = min(lane.y_m - lane.width_m / 2.0 for lane in run.road.lanes)
    x_m, y_m = line.to_map(s_m, edge_m - _BESIDE_M - target.size.width_m / 2.0)
    start = target.start.model_copy(update={"x_m": x_m, "y_m": y_m})
    return target.model_copy(update={"start": start, "approach": None})


def _frame_period_s(run: RunSpec) -> float:
    """Return the period of the camera, in whole steps; 0.1 s without one."""
    wanted_s = 0.1 if run.camera is None else 1.0 / run.camera.rate_hz
    return round(max(1, round(wanted_s / run.step_s)) * run.step_s, 9)


@dataclass(frozen=True, slots=True)
class _RunUp:
    """The way of a VUT that keeps to its approach, up to the first trigger.

    Args:
        hand_over_s: t_h.
        fires_s: session time of the first trigger.
        room_m: by which the gap to the trigger's object may be smaller without a later t_h.
    """

    hand_over_s: float
    fires_s: float
    room_m: float


def _run_up(run: RunSpec, latency_max_s: float, frame_s: float, history_s: float) -> _RunUp:
    """Return what precedes the first trigger while the VUT keeps to its approach.

    No frame that a driver is asked about lies before the VUT holds its speed: its plan would be of
    another speed than the one at the hand-over. The tracker nears the approach speed, passes it and
    comes back, so that within what counts as held two frames may still differ: t_h is chosen so
    that the first frame asked about and t_h itself don't.
    """
    scout = Driven(driver=BUILT_IN, first_request_s=0.0, hand_over_s=0.0, end_s=_SCOUT_S / 2)
    for end_s in (_SCOUT_S / 2, _SCOUT_S):
        driven = scout.model_copy(update={"end_s": end_s, "hand_over_s": end_s - run.step_s})
        result, record = run_in_process(run.model_copy(update={"driven": driven}))
        if result.triggers:
            break
    else:
        why = "; ".join(result.reasons) or f"no trigger fires within {_SCOUT_S:g} s"
        raise OffSpec(why)
    fires_ns = min(t.dispatched_ns for t in result.triggers)
    approach = [s for s in record.truths(run.vut.id) if s.stamp_ns <= fires_ns]
    held_mps = approach[-1].speed_mps
    since_ns = approach[-1].stamp_ns
    for state in reversed(approach):
        if abs(state.speed_mps - held_mps) > LIMITS.steady_mps:
            break
        since_ns = state.stamp_ns
    asked_s = latency_max_s + frame_s
    steady_s = ns_to_seconds(since_ns) + max(LIMITS.steady_s, asked_s)
    asked_s += history_s
    earliest_s = _ceil(max(steady_s, asked_s), frame_s)
    fires_s = ns_to_seconds(fires_ns)
    latest_s = fires_s - LIMITS.before_trigger_s
    if earliest_s > latest_s + EPSILON_S:
        raise ShortRunUp(
            f"the run-up is too short: the hand-over would be at {earliest_s:g} s, the first "
            f"trigger fires at {fires_s:g} s"
        )
    room_s = latest_s - earliest_s - frame_s
    nearing_mps = _nearing_mps(run, record, fires_ns)
    times_s = (earliest_s, latest_s)
    hand_over_s = _hand_over_s(approach, times_s, latency_max_s, frame_s)
    return _RunUp(hand_over_s, fires_s, max(room_s * nearing_mps, 0.0))


def _first_request_s(hand_over_s: float, latency_max_s: float, frame_s: float) -> float:
    """Return the time of the first frame that a driver is asked about, for a hand-over."""
    return _floor(hand_over_s - latency_max_s - frame_s, frame_s)


def _hand_over_s(
    approach: Sequence[ObjectState],
    within_s: tuple[float, float],
    latency_max_s: float,
    frame_s: float,
) -> float:
    """Return t_h: the first frame time with the speed of the first frame that is asked about.

    Where there is none, the frame time at which the two speeds differ least.

    Args:
        approach: states of the VUT up to the first trigger.
        within_s: earliest frame time, and the latest time.
        latency_max_s: largest latency of the campaign.
        frame_s: between two frames.
    """
    speeds = {state.stamp_ns: state.speed_mps for state in approach}
    earliest_s, latest_s = within_s
    best_s, least_mps = earliest_s, math.inf
    for i in range(int((latest_s - earliest_s) / frame_s + 1e-6) + 1):
        at_s = round(earliest_s + i * frame_s, 9)
        first_s = _first_request_s(at_s, latency_max_s, frame_s)
        off_mps = abs(speeds[seconds_to_ns(at_s)] - speeds[seconds_to_ns(first_s)])
        if off_mps < least_mps:
            best_s, least_mps = at_s, off_mps
        if off_mps <= LIMITS.asked_mps:
            break
    return best_s


def _nearing_mps(run: RunSpec, record: Record, at_ns: int) -> float:
    """Return the speed by which the VUT nears the initiator along its own heading."""
    at = {i: record.truths(i) for i in (run.vut.id, run.initiator_id)}
    vut, other = (next(s for s in at[i] if s.stamp_ns >= at_ns) for i in at)
    return vut.speed_mps - other.speed_mps * math.cos(other.yaw_rad - vut.yaw_rad)


def _early_visibility(run: RunSpec, event: Event, result: InProcessResult, record: Record) -> str:
    """Say that K*'s occluder doesn't hide the initiator when it moves; empty: it does."""
    occluder = event.interaction.occluder
    if occluder is None or not result.triggers:
        return ""
    at_ns = result.triggers[0].stamp_ns
    who = (run.vut.id, run.initiator_id, occluder)
    vut, subject, hiding = (next(s for s in record.truths(i) if s.stamp_ns >= at_ns) for i in who)
    eye_m = (run.camera or Camera()).forward_m
    if is_hidden(vut, subject, hiding, eye_m):
        return ""
    return f"{occluder} doesn't hide {subject.object_id} from the VUT when the trigger fires"


def _at_their_times(run: RunSpec, result: InProcessResult) -> list[TriggerSpec]:
    """Return the triggers with the times at which they fired; those that didn't never fire."""
    fired = {t.trigger_id: ns_to_seconds(t.stamp_ns) - _BEFORE_STEP_S for t in result.triggers}
    never_s = min(run.end.at_latest_s, run.limits.duration_s) - 1.0
    return [
        trigger.model_copy(
            update={
                "condition": ElapsedTime(
                    type="elapsed_time", after_s=round(fired.get(trigger.id, never_s), 6)
                ),
                "edge": "none",
                "held_for_s": 0.0,
                "not_before_s": 0.0,
            }
        )
        for trigger in run.triggers
    ]


def _off_spec(run: RunSpec, result: InProcessResult, contact: Contact | None) -> str:
    """Say why a twin's event isn't K*'s (METHOD 4.4); empty: it is.

    A time gap isn't asked of a twin with a contact, which has none that is above zero.
    """
    if not result.ok:
        return "; ".join(result.reasons) or result.verdict.name.lower()
    missing = [p for p in (Phase.TRIGGER, Phase.CONFLICT) if result.phase_s(p) is None]
    if missing:
        return f"phase {missing[0].name.lower()} never begins"
    if result.happened.intrusions:
        return result.happened.intrusions[0].text(run.thresholds)
    if run.passing is None:
        return ""
    wrong = run.passing.misses(
        run.initiator_id,
        result.passing.other_first,
        result.passing.time_gap_s,
        vut_arrived=result.passing.own_arrival_s is not None,
    )
    problems = wrong if contact is None else [text for text in wrong if text.startswith("passing")]
    return "; ".join(problems)


def _touched_scenery(run: RunSpec, record: Record, resolved_s: float | None) -> str:
    """Say which scenery a twin touches before it is over, which ends it; empty: none."""
    touch = first_touch(run, record.reports) if run.road.scenery else None
    if touch is None or touch.other in run.object_ids:
        return ""
    if resolved_s is not None and touch.at_s > _end_s(resolved_s):
        return ""
    return f"without a response the VUT touches {touch.other} at {touch.at_s:.2f} s"


def _after_s(trigger: TriggerSpec) -> float:
    condition = trigger.condition
    return condition.after_s if isinstance(condition, ElapsedTime) else math.nan


def _ceil(t_s: float, period_s: float) -> float:
    return round(math.ceil(t_s / period_s - 1e-6) * period_s, 9)


def _floor(t_s: float, period_s: float) -> float:
    return round(max(math.floor(t_s / period_s + 1e-6), 0) * period_s, 9)


def path_of(run: RunSpec) -> Polyline:
    """Return the path of a driven run's VUT."""
    if run.vut.approach is None:
        raise ValueError("a driven run without a path for the VUT passed the checks")
    return Polyline(run.vut.approach.path)
