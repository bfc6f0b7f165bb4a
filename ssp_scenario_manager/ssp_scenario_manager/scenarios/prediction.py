"""The course of a session, predicted without running it: trigger, meetings, and distances."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, takewhile

from ssp_core.clock import seconds_to_ns
from ssp_core.geometry import Polyline, box_distance
from ssp_core.motion.corridor import Corridor
from ssp_core.motion.encounter import (
    Encounter,
    Observable,
    corridor_half_m,
    encounter,
    is_conflict,
    is_crossing,
    is_observable,
)
from ssp_core.motion.event import NO_CONFLICT_S
from ssp_core.motion.intrusion import Intrusion, intrusion_of
from ssp_core.motion.passing import crossed_zone
from ssp_core.motion.reference import Reference, sample
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import ConflictThresholds
from ssp_core.run_file.participants import Hold, ParticipantSpec
from ssp_core.vocabulary import Role
from ssp_core.world.car_following import following_acceleration, free_acceleration
from ssp_core.world.gap_acceptance import PriorityWatch, Word
from ssp_core.world.obstacles import find_obstacles
from ssp_scenario_manager.dispatch.references import (
    APPROACH_LEAD_S,
    Address,
    approach_reference,
    manoeuvre_reference,
)
from ssp_scenario_manager.scenarios.base import CannotPlace
from ssp_scenario_manager.scenarios.motions import STEP_S, Motions
from ssp_scenario_manager.triggers.conditions import Snapshot, condition_text
from ssp_scenario_manager.triggers.evaluator import TriggerWatch


def foreseen_address(object_id: str, execute_s: float) -> Address:
    """Make the address of a reference that is never sent, from a session time on."""
    return Address(object_id, object_id, "", "foreseen", 0, seconds_to_ns(execute_s))


class Players:
    """VUT and targets, moved on in steps; the VUT reacts to what it meets."""

    def __init__(self, plan: Motions) -> None:
        if plan.vut.approach is None:
            raise CannotPlace("the VUT has no path")
        self.plan = plan
        self.path = Polyline(plan.vut.approach.path)
        self.station_m = 0.0
        self.speed_mps = 0.0
        self.references: dict[str, Reference] = {}
        self.act: Reference | None = None
        self._priority = PriorityWatch(plan.driver)
        for target in plan.targets:
            if target.approach is not None:
                address = foreseen_address(target.id, APPROACH_LEAD_S)
                try:
                    self.references[target.id] = approach_reference(address, target.approach)
                except ValueError as error:
                    raise CannotPlace(f"{target.id}: {error}") from error

    @property
    def priority_words(self) -> tuple[Word, ...]:
        """The newest decision at each place at which the VUT's driver gives way."""
        return tuple(self._priority.words)

    def vut(self, t_s: float) -> ObjectState:
        """Return the VUT's state now, which is at a session time."""
        pose = self.path.pose(self.station_m)
        return _state(
            self.plan.vut, Role.VUT, t_s, (pose.x_m, pose.y_m, pose.yaw_rad), self.speed_mps, 0.0
        )

    def target(self, spec: ParticipantSpec, t_s: float) -> ObjectState:
        """Return a target's state at a session time."""
        reference = self.references.get(spec.id)
        act = self.act
        if act is not None and act.object_id == spec.id and seconds_to_ns(t_s) >= act.execute_at_ns:
            reference = act
        if reference is None or seconds_to_ns(t_s) <= reference.execute_at_ns:
            s = spec.start
            return _state(spec, Role.OT, t_s, (s.x_m, s.y_m, s.yaw_rad), 0.0, 0.0)
        p = sample(reference, seconds_to_ns(t_s))
        pose = (p.x_m, p.y_m, p.yaw_rad)
        return _state(spec, Role.OT, t_s, pose, p.speed_mps, p.acceleration_mps2)

    def fire(self, t_s: float) -> None:
        """Dispatch the manoeuvre, as the session does."""
        trigger = self.plan.trigger
        if isinstance(trigger.manoeuvre, Hold):
            return
        spec = self.plan.target(trigger.object_id)
        current = self.references.get(spec.id)
        address = foreseen_address(spec.id, t_s + trigger.lead_time_s)
        try:
            self.act = manoeuvre_reference(
                address, trigger.manoeuvre, self.target(spec, t_s), current, spec.approach
            )
        except ValueError as error:
            raise CannotPlace(f"{spec.id}: {error}") from error

    def advance(self, vut: ObjectState, others: Sequence[ObjectState], dt_s: float) -> None:
        """Move the VUT on as its driver would, who reacts to the others or doesn't."""
        driver, v = self.plan.driver, self.speed_mps
        acceleration_mps2 = free_acceleration(v, driver)
        if self._priority:
            front = self.station_m + self.plan.vut.size.front_m
            decision = self._priority.decide(front, v, others, driver)
            others = [other for other in others if other.object_id not in decision.heeded]
            acceleration_mps2 = min(acceleration_mps2, decision.most_mps2)
        for obstacle in find_obstacles(vut, others, self.path, driver) if driver.reacts else ():
            gap, speed, gain = obstacle.gap_m, obstacle.speed_mps, obstacle.acceleration_mps2
            acceleration_mps2 = min(
                acceleration_mps2, following_acceleration(v, gap, speed, gain, driver)
            )
        faster = max(v + acceleration_mps2 * dt_s, 0.0)
        self.station_m += 0.5 * (v + faster) * dt_s
        self.speed_mps = faster


def _state(
    spec: ParticipantSpec,
    role: Role,
    t_s: float,
    pose: tuple[float, float, float],
    speed_mps: float,
    acceleration_mps2: float,
) -> ObjectState:
    return ObjectState(
        spec.id,
        spec.cls,
        role,
        seconds_to_ns(t_s),
        *pose,
        speed_mps,
        acceleration_mps2,
        0.0,
        spec.size,
    )


# Far from the trigger's threshold, nothing happens that needs the fine step.
_COARSE_S = 0.2
_NEAR = 1.3
LONGEST_S = 60.0
# From the resolution to the end of a run, as EndCondition has it, and some room for reality.
AFTER_S = 2.5
# Who crosses doesn't move along the VUT's path by more than this.
_MOVED_ON_M = 0.1


@dataclass(frozen=True, slots=True)
class Nearest:
    """The least distance between two objects, m, and its session time, s."""

    first: str
    second: str
    t_s: float
    distance_m: float


@dataclass(frozen=True)
class Prediction:
    """The predicted course; times are session times in s, stations are along the VUT's path in m.

    Args:
        fired_s: the trigger's condition became true.
        fired_station_m: VUT's reference point then.
        fired_speed_mps: VUT's speed then.
        initiator_fired_mps: the initiator's speed then.
        trigger_s: start of the phase trigger; None where it never comes. So for the next two.
        conflict_s: start of the conflict.
        resolution_s: start of the resolution.
        overlap_s: first time after the trigger at which the initiator is in the VUT's corridor.
        left_s: it left the corridor, or its rear left the conflict point.
        conflict_station_m: the conflict point: where the conflict zone begins at overlap_s.
        vut_arrival_s: the VUT's front reaches the conflict point; inf: not foreseen.
        vut_in_zone_s: it reaches what the initiator covers of its corridor on the whole, which of
            one that turns as it crosses may begin before that point.
        vut_station_end_m: of the VUT when the run ends.
        vut_end_mps: its speed then.
        separation_m: smallest distance between VUT and a target from the trigger on.
        early_conflict: a conflict stood before the trigger could be seen.
        least_ttc_s: of VUT and initiator from the trigger on.
        vut_fired: the VUT's state when the trigger fires.
        targets_fired: the targets' states then.
        intrusions: conflicts of other objects than the initiator, the first of each.
        nearest: the two objects that come nearest to each other, of those that aren't the VUT.
    """

    fired_s: float
    fired_station_m: float
    fired_speed_mps: float
    initiator_fired_mps: float
    trigger_s: float | None
    conflict_s: float | None
    resolution_s: float | None
    overlap_s: float
    left_s: float
    conflict_station_m: float
    vut_arrival_s: float
    vut_in_zone_s: float
    vut_station_end_m: float
    vut_end_mps: float
    separation_m: float
    early_conflict: bool
    least_ttc_s: float
    vut_fired: ObjectState
    targets_fired: tuple[ObjectState, ...]
    intrusions: tuple[Intrusion, ...] = ()
    nearest: Nearest | None = None

    @property
    def time_gap_s(self) -> float:
        """Second arrival minus first departure at the conflict point (METHOD 1)."""
        return self.vut_arrival_s - self.left_s

    @property
    def initiator_first(self) -> bool:
        """Tell whether the initiator reaches the conflict zone before the VUT."""
        return self.overlap_s < min(self.vut_arrival_s, self.vut_in_zone_s)


@dataclass(frozen=True, slots=True)
class _Instant:
    t_s: float
    front_m: float
    meeting: Encounter
    observable: bool
    conflict: bool
    zone_m: float
    separation_m: float
    initiator: ObjectState


def predict(plan: Motions, observable: Observable, thresholds: ConflictThresholds) -> Prediction:
    """Follow a plan from standstill to the end of its run.

    Raises:
        CannotPlace: the trigger never fires, or a manoeuvre can't be driven from where it does.
    """
    players = Players(plan)
    initiator = plan.target(plan.initiator_id)
    watch = TriggerWatch(plan.trigger, players.path, 0)
    t, fired = 0.0, None
    instants: list[_Instant] = []
    intrusions: dict[str, Intrusion] = {}
    nearest: Nearest | None = None
    early = visible = False
    while t < LONGEST_S:
        vut = players.vut(t)
        others = [players.target(spec, t) for spec in plan.targets]
        meetings = [(other, encounter(vut, other, players.path)) for other in others]
        subject, meeting = next((o, m) for o, m in meetings if o.object_id == initiator.id)
        conflict = is_conflict(meeting, thresholds.ttc_s, thresholds.arrival_gap_s)
        for other, its in meetings:
            intrusion = intrusion_of(other.object_id, t, its, thresholds)
            if intrusion is not None and other.object_id != initiator.id:
                intrusions.setdefault(intrusion.object_id, intrusion)
        nearest = _nearer(nearest, others, t)
        if fired is None:
            early = early or conflict
            snapshot = Snapshot(vut, {o.object_id: o for o in others}, players.path, 0, {})
            firing = watch.observe(snapshot)
            far = _is_far(watch) or t + _COARSE_S < plan.trigger.not_before_s
            if firing is not None:
                fired = (t, players.station_m, players.speed_mps, vut, tuple(others))
                players.fire(t)
        else:
            front = players.station_m + vut.size.front_m
            observed = is_observable(observable, meeting, subject)
            visible = visible or observed
            instants.append(
                _Instant(
                    t,
                    front,
                    meeting,
                    observed,
                    # One that is over before the manoeuvre shows is none (METHOD 1).
                    conflict and visible,
                    front + meeting.zone_gap_m,
                    min(box_distance(vut.box, other.box) for other in others),
                    subject,
                )
            )
            if _is_over(instants, t):
                break
        dt_s = _COARSE_S if fired is None and far else STEP_S
        players.advance(vut, others, dt_s)
        t += dt_s
    if fired is None:
        never = condition_text(plan.trigger.condition)
        raise CannotPlace(f"its trigger never fires, as far as can be foreseen: {never}")
    summary = _summary(players, fired, instants, early, initiator.id)
    return replace(summary, intrusions=tuple(intrusions.values()), nearest=nearest)


def _nearer(nearest: Nearest | None, others: Sequence[ObjectState], t_s: float) -> Nearest | None:
    """Return the nearest two objects so far."""
    for one, other in combinations(others, 2):
        distance_m = box_distance(one.box, other.box)
        if nearest is None or distance_m < nearest.distance_m:
            nearest = Nearest(one.object_id, other.object_id, t_s, distance_m)
    return nearest


def _is_far(watch: TriggerWatch) -> bool:
    """Tell whether all distances and times of the trigger are well above their thresholds."""
    return bool(watch.values) and all(
        what.relation == "<" and value > _NEAR * what.threshold + 2.0
        for what, value in watch.values
    )


def _is_over(instants: list[_Instant], t_s: float) -> bool:
    """Tell whether AFTER_S passed without a conflict, and the VUT its conflict point."""
    last = next((i for i in reversed(instants) if i.conflict), None)
    if last is None:
        # A vehicle may come a long way before what it does shows (METHOD 1).
        observable_s = next((i.t_s for i in instants if i.observable), instants[0].t_s)
        return t_s - observable_s > NO_CONFLICT_S
    if t_s - last.t_s < AFTER_S:
        return False
    first = next((i for i in instants if i.meeting.in_corridor), None)
    return first is not None and instants[-1].front_m >= first.zone_m


def _summary(
    players: Players,
    fired: tuple[float, float, float, ObjectState, tuple[ObjectState, ...]],
    instants: list[_Instant],
    early: bool,
    initiator_id: str,
) -> Prediction:
    fired_s, station, speed, vut, others = fired
    trigger_s = next((i.t_s for i in instants if i.observable), None)
    inside = [i for i in instants if i.meeting.in_corridor]
    point = inside[0].zone_m if inside else math.inf
    overlap_s = inside[0].t_s if inside else math.inf
    left_s = overlap_s
    if inside:
        # A crossing one leaves the corridor; one that merges or leads leaves the point behind it.
        left_s = next(
            (i.t_s for i in instants if i.t_s > overlap_s and _has_left(i, point)), math.inf
        )
    conflicts = [i.t_s for i in instants if i.conflict]
    conflict_s = conflicts[0] if conflicts else None
    resolution_s = None
    if conflicts and instants[-1].t_s - conflicts[-1] >= AFTER_S - STEP_S:
        resolution_s = conflicts[-1] + STEP_S
    end_s = min((resolution_s or LONGEST_S) + AFTER_S, instants[-1].t_s) if instants else fired_s
    at_end = next((i for i in instants if i.t_s >= end_s - STEP_S / 2), None)
    later = next((i for i in instants if at_end is not None and i.t_s > at_end.t_s), None)
    end_speed = players.speed_mps
    if at_end is not None and later is not None:
        end_speed = (later.front_m - at_end.front_m) / (later.t_s - at_end.t_s)
    front = players.plan.vut.size.front_m
    return Prediction(
        fired_s=fired_s,
        fired_station_m=station,
        fired_speed_mps=speed,
        initiator_fired_mps=next(o.speed_mps for o in others if o.object_id == initiator_id),
        trigger_s=trigger_s,
        conflict_s=conflict_s,
        resolution_s=resolution_s,
        overlap_s=overlap_s,
        left_s=left_s,
        conflict_station_m=point,
        vut_arrival_s=_arrival_s(instants, point),
        vut_in_zone_s=_arrival_s(instants, _covered_from_m(players, instants, point)),
        vut_station_end_m=at_end.front_m - front if at_end is not None else players.station_m,
        vut_end_mps=end_speed,
        separation_m=min((i.separation_m for i in instants), default=math.inf),
        early_conflict=early,
        least_ttc_s=min((i.meeting.ttc_s for i in instants), default=math.inf),
        vut_fired=replace(vut, speed_mps=speed),
        targets_fired=others,
    )


def _arrival_s(instants: Sequence[_Instant], station_m: float) -> float:
    """Return when the VUT's front is at a station; inf: it isn't."""
    return next((i.t_s for i in instants if i.front_m >= station_m), math.inf)


def _covered_from_m(players: Players, instants: Sequence[_Instant], point_m: float) -> float:
    """Return the first station that an initiator that crosses covers, as a session measures it.

    A session ends with a collision.
    """
    entry = next((k for k, i in enumerate(instants) if i.meeting.in_corridor), None)
    half_m = corridor_half_m(players.plan.vut.size.width_m)
    corridor = Corridor(players.path, half_m)
    if entry is None or not is_crossing(corridor.heading_rad(instants[entry].initiator)):
        return point_m
    before = (instant.initiator for instant in reversed(instants[:entry]))
    after = (
        instant.initiator
        for instant in takewhile(lambda instant: instant.separation_m > 0.0, instants[entry:])
    )
    own = corridor.extent(instants[entry].initiator)
    return crossed_zone(after, before, own, corridor, turns=False).start_m


def _has_left(instant: _Instant, point_m: float) -> bool:
    """Tell whether it is out of the corridor, or has moved on along it, and its zone with it."""
    return instant.zone_m > point_m + _MOVED_ON_M or not instant.meeting.in_corridor
