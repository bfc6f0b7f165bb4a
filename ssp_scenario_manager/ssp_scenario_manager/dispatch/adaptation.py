"""When and how an object target's manoeuvre is adapted to a VUT of another speed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ssp_core.clock import NS_PER_S, seconds_to_ns
from ssp_core.geometry import FloatArray, Polyline
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState, Size
from ssp_core.run_file.model import Limits, RunSpec
from ssp_core.run_file.participants import Adaptation, ParticipantSpec, TriggerSpec
from ssp_core.safety.stopping import blind_excess_m
from ssp_scenario_manager.dispatch.planned_motion import (
    Pace,
    PlannedMotion,
    VutTrack,
    arrival_ns,
    as_planned,
    follow_vut,
    planned_motion_of,
    play,
    toward,
    wanted_rate,
)

_SAME_SPEED_MPS = 0.01
_BISECTIONS = 5
# So long after the decisive instant, the pace is as good as back to 1.
_AFTER_S = 2.0


@dataclass(frozen=True, slots=True)
class Bounds:
    """What an adapted motion must stay inside of (METHOD 2.3, the limits of safety).

    Args:
        target: that moves.
        step_s: how often it judges its state.
        wish: of the trigger.
    """

    limits: Limits
    geofence: Sequence[tuple[float, float]]
    target: ParticipantSpec
    step_s: float
    wish: Adaptation


def nearest_rate(
    planned: FloatArray,
    known: Pace,
    bounds: Bounds,
    start_ns: int,
    rate: float,
    until_s: float,
) -> float:
    """The pace that comes nearest to a wanted one inside the limits.

    Args:
        planned: columns of the planned motion as planned.
        known: the pace as it goes on now.
        start_ns: when the new pace begins.
        until_s: own time of what decides the gap.
    """
    if _fits(planned, bounds, toward(known, start_ns, rate, until_s), until_s):
        return rate
    # As it goes on now it fits, and so does whatever is near enough to that.
    good, bad = known.wanted, rate
    for _ in range(_BISECTIONS):
        middle = 0.5 * (good + bad)
        if _fits(planned, bounds, toward(known, start_ns, middle, until_s), until_s):
            good = middle
        else:
            bad = middle
    return good


def _fits(planned: FloatArray, bounds: Bounds, pace: Pace, until_s: float) -> bool:
    """Speed and acceleration stay inside the limits, or inside what was planned if that is more,
    and a blind stop from any of its points stays inside the fence."""
    near = planned[:, planned[0] <= until_s + _AFTER_S]
    played = play(near, pace).columns
    speed, acceleration = played[4], played[5]
    limits, site, wish = bounds.limits, bounds.limits.acceleration_mps2, bounds.wish
    most_up = min(site, wish.acceleration_mps2 or site)
    most_down = min(site, wish.deceleration_mps2 or site)
    return bool(
        speed.max() <= max(limits.speed_mps, near[4].max())
        and acceleration.max() <= max(most_up, near[5].max())
        and -acceleration.min() <= max(most_down, -near[5].min())
        and _stops_inside(played, near, bounds)
    )


def _stops_inside(played: FloatArray, planned: FloatArray, bounds: Bounds) -> bool:
    """Where it is faster than planned; where it isn't, the object has found that it does."""
    at = planned[4, -(played.shape[1] - 1) :] if played.shape[1] > 1 else planned[4, :0]
    faster = played[:, 1:][:, played[4, 1:] > at + _SAME_SPEED_MPS]
    if faster.shape[1] == 0:
        return True
    target = bounds.target
    excess = blind_excess_m(
        faster, target.cls, target.size, bounds.limits, bounds.geofence, bounds.step_s
    )
    return not excess.max() > 0.0


# A passing order that looks wrong for so long is wrong.
ORDER_S = 0.2
# A gap that will be further off than this is told of.
UNMET_S = 0.15
# A VUT that brakes harder than this share of what counts as a response may be beginning one; for so
# long its braking is let be.
SUSPICIOUS_SHARE = 0.4
SUSPICION_S = 0.25
# Two wishes that differ by less are the same.
_SAME_RATE = 0.005


@dataclass(frozen=True, slots=True)
class Adapting:
    """What is remembered of one manoeuvre that is being adapted.

    Args:
        pace: of the last reference that was sent and not refused.
        taken: of the last one that the object accepted.
        aimed_ns: session time at which a pace was last looked for.
        lead_ns: between dispatch and execute_at.
        refused: references in a row that were refused.
        wrong_ns: since when the passing order has looked wrong; None: it looks right.
        settled: somebody has arrived, and in the right order.
        braking_ns: since when the VUT has braked as if it began to respond; None: it doesn't.
        unmet: the gap can't be met at present.
        over: why it ended; empty while it goes on.
    """

    planned_motion: PlannedMotion
    pace: Pace
    taken: Pace
    aimed_ns: int
    lead_ns: int
    track: VutTrack | None = None
    refused: int = 0
    wrong_ns: int | None = None
    settled: bool = False
    braking_ns: int | None = None
    unmet: bool = False
    over: str = ""

    def ended(self, why: str) -> Adapting:
        """It is over: what the object has taken stays as it is."""
        return replace(self, over=why)


def begin(planned_motion: PlannedMotion, dispatched_ns: int, lead_s: float) -> Adapting:
    """A manoeuvre that was dispatched as planned."""
    pace = as_planned(planned_motion.execute_at_ns)
    return Adapting(planned_motion, pace, pace, dispatched_ns, seconds_to_ns(lead_s))


@dataclass(frozen=True, slots=True)
class Decision:
    """What follows from one state of the VUT.

    Args:
        adapting: what is remembered from now on.
        pace: to be sent; None: all stays as it is.
        note: for people; empty: there is nothing to tell.
        wrong_order: the passing order can't be kept, in words; empty: it can.
    """

    adapting: Adapting
    pace: Pace | None = None
    note: str = ""
    wrong_order: str = ""


def decide(
    adapting: Adapting,
    bounds: Bounds,
    vut: ObjectState,
    path: Polyline,
    now_ns: int,
) -> Decision:
    """Judges a state of the VUT that hasn't been judged yet.

    Args:
        now_ns: session time, that of a dispatch.
    """
    known = replace(adapting, track=follow_vut(adapting.track, vut, path))
    track, wish = known.track, bounds.wish
    if track is None:
        return Decision(known)
    known, wrong = _watch_order(known, wish, track, path)
    if wrong or known.over:
        return Decision(known, wrong_order=wrong)
    over = _over(known, wish, track, now_ns)
    if over:
        return Decision(known.ended(over), note=f"adaptation ends: {over}")
    known = _suspect(known, wish, track, now_ns)
    if known.braking_ns is not None and now_ns - known.braking_ns < seconds_to_ns(SUSPICION_S):
        return Decision(known)
    return _aim(known, bounds, track, vut.size, path, now_ns)


def _conflict_m(planned_motion: PlannedMotion, wish: Adaptation, path: Polyline) -> float:
    """The conflict point, arc length along the VUT's path."""
    if wish.anchor is None:
        return planned_motion.zone.start_m
    return path.project(*wish.anchor)[0]


def _decisive_s(planned_motion: PlannedMotion, wish: Adaptation) -> float:
    """Own time of what decides the gap."""
    return planned_motion.departure_s if wish.first == "initiator" else planned_motion.arrival_s


def _due_ns(
    planned_motion: PlannedMotion, wish: Adaptation, track: VutTrack, size: Size, path: Polyline
) -> float:
    """When the decisive instant must be, for the gap to be as specified; inf: never."""
    conflict_m = _conflict_m(planned_motion, wish, path)
    gap_ns = wish.gap_s * NS_PER_S
    if wish.first == "initiator":
        return arrival_ns(track, conflict_m) - gap_ns
    end_m = conflict_m + planned_motion.zone.end_m - planned_motion.zone.start_m
    return arrival_ns(track, end_m + size.length_m) + gap_ns


def _watch_order(
    known: Adapting, wish: Adaptation, track: VutTrack, path: Polyline
) -> tuple[Adapting, str]:
    """Says so when the wrong one will arrive first whatever is done, and this isn't just noise."""
    if known.settled:
        return known, ""
    planned_motion = known.planned_motion
    conflict_m = _conflict_m(planned_motion, wish, path)
    object_ns = known.pace.reached_ns(planned_motion.arrival_s)
    vut_ns = arrival_ns(track, conflict_m)
    right = object_ns < vut_ns if wish.first == "initiator" else vut_ns < object_ns
    if right and (object_ns <= track.stamp_ns or track.front_m >= conflict_m):
        return replace(known, settled=True, wrong_ns=None), ""
    if right:
        return replace(known, wrong_ns=None), ""
    if known.wrong_ns is None:
        return replace(known, wrong_ns=track.stamp_ns), ""
    if track.stamp_ns - known.wrong_ns < seconds_to_ns(ORDER_S):
        return known, ""
    who = "the VUT" if wish.first == "initiator" else "the object target"
    ahead_s = abs(object_ns - vut_ns) / NS_PER_S
    return known, f"{who} would be {ahead_s:.2f} s too early for the passing order"


def _over(known: Adapting, wish: Adaptation, track: VutTrack, now_ns: int) -> str:
    """Why it is over, empty while it isn't."""
    decisive_ns = known.pace.reached_ns(_decisive_s(known.planned_motion, wish))
    if decisive_ns <= now_ns + seconds_to_ns(wish.freeze_s):
        return "the conflict is at hand"
    own_s, _, _ = known.pace.at(now_ns)
    braking = -track.acceleration_mps2
    if wish.response_mps2 is not None and own_s > 0.0 and braking > wish.response_mps2:
        return f"the VUT responds, braking at {braking:.1f} m/s^2"
    return ""


def _suspect(known: Adapting, wish: Adaptation, track: VutTrack, now_ns: int) -> Adapting:
    """Notes since when the VUT has braked in a way that may become a response."""
    own_s, _, _ = known.pace.at(now_ns)
    mild = wish.response_mps2 is None or own_s <= 0.0
    if mild or -track.acceleration_mps2 <= SUSPICIOUS_SHARE * (wish.response_mps2 or 0.0):
        return known if known.braking_ns is None else replace(known, braking_ns=None)
    return known if known.braking_ns is not None else replace(known, braking_ns=now_ns)


def _aim(
    known: Adapting,
    bounds: Bounds,
    track: VutTrack,
    size: Size,
    path: Polyline,
    now_ns: int,
) -> Decision:
    """The pace with which the decisive instant comes when it must, if it can."""
    wish = bounds.wish
    own_s = _decisive_s(known.planned_motion, wish)
    due_ns = _due_ns(known.planned_motion, wish, track, size, path)
    off_s = (known.pace.reached_ns(own_s) - due_ns) / NS_PER_S
    if abs(off_s) <= wish.dead_band_s:
        return Decision(replace(known, unmet=False))
    if now_ns - known.aimed_ns < NS_PER_S / wish.rate_hz:
        return Decision(known)
    known = replace(known, aimed_ns=now_ns)
    start_ns = now_ns + known.lead_ns
    slowest, fastest = wish.speed_share
    rate = slowest
    if math.isfinite(due_ns):
        rate = wanted_rate(known.pace, start_ns, own_s, (due_ns - start_ns) / NS_PER_S)
    rate = nearest_rate(
        known.planned_motion.columns,
        known.pace,
        bounds,
        start_ns,
        min(max(rate, slowest), fastest),
        own_s,
    )
    if abs(rate - known.pace.wanted) < _SAME_RATE:
        return Decision(*_told(known, off_s))
    pace = toward(known.pace, start_ns, rate, own_s)
    told, _, note = _told(replace(known, pace=pace), (pace.reached_ns(own_s) - due_ns) / NS_PER_S)
    return Decision(told, pace, note)


def _told(known: Adapting, off_s: float) -> tuple[Adapting, None, str]:
    """Tells once of a gap that can't be met, and once of one that can again."""
    unmet = abs(off_s) > UNMET_S
    if unmet == known.unmet:
        return known, None, ""
    if not unmet:
        return replace(known, unmet=False), None, "the time gap can be met again"
    by = f"{abs(off_s):.2f} s" if math.isfinite(off_s) else "any time"
    why = f"the time gap will be off by {by}: as much as the limits allow is done"
    return replace(known, unmet=True), None, why


def answered(adapting: Adapting, pace: Pace, *, accepted: bool, most_lead_ns: int) -> Adapting:
    """Takes an object's answer into account.

    A refused one was not taken, so that what was taken last is driven on; the next one is given
    twice the time to arrive.

    Args:
        pace: of the reference that was answered.
        accepted: False: refused.
        most_lead_ns: the longest time between dispatch and execute_at.
    """
    if accepted:
        taken = pace if pace.start_ns >= adapting.taken.start_ns else adapting.taken
        return replace(adapting, taken=taken, refused=0)
    pace = adapting.taken if adapting.pace == pace else adapting.pace
    lead = min(2 * max(adapting.lead_ns, 1), most_lead_ns)
    return replace(adapting, pace=pace, refused=adapting.refused + 1, lead_ns=lead)


# So many refusals in a row, and the link is too slow for adapting.
MOST_REFUSED = 3
# The longest time between dispatch and execute_at of an adapted reference.
MOST_LEAD_S = 0.4


@dataclass(slots=True)
class _Fired:
    """A trigger whose manoeuvre is adapted.

    Args:
        before: the reference that the object drove then; None: it stood.
        adapting: None until the manoeuvre is on its way.
    """

    trigger: TriggerSpec
    wish: Adaptation
    manoeuvre: Reference
    before: Reference | None
    adapting: Adapting | None = None


class Adaptations:
    """The manoeuvres of a run that are adapted, and the references that adapted them."""

    def __init__(self) -> None:
        self._fired: dict[str, _Fired] = {}
        self._sent: dict[str, tuple[str, Pace]] = {}
        self._notes: list[str] = []

    def fire(self, trigger: TriggerSpec, manoeuvre: Reference, before: Reference | None) -> None:
        """A manoeuvre is dispatched; one without an adaptation is let be."""
        if trigger.adaptation is not None:
            self._fired[trigger.id] = _Fired(trigger, trigger.adaptation, manoeuvre, before)

    def judge(
        self, spec: RunSpec, path: Polyline, vut: ObjectState, now_ns: int
    ) -> list[tuple[TriggerSpec, Decision]]:
        """Judges every manoeuvre on a state of the VUT, in the order in which they fired."""
        decisions = []
        for fired in list(self._fired.values()):
            trigger, manoeuvre = fired.trigger, fired.manoeuvre
            if manoeuvre.dispatched_ns == now_ns:
                continue  # It is on its way out; nothing may hold it up.
            target = next(t for t in spec.targets if t.id == trigger.object_id)
            if fired.adapting is None:
                planned_motion = planned_motion_of(
                    fired.before, manoeuvre, manoeuvre.dispatched_ns, target, spec.vut, path
                )
                if planned_motion is None:
                    del self._fired[trigger.id]
                    why = "doesn't come into the VUT's corridor: no adaptation"
                    self._notes.append(f"{target.id} {why}")
                    continue
                lead_s = fired.wish.lead_time_s
                fired.adapting = begin(planned_motion, manoeuvre.dispatched_ns, lead_s)
            bounds = Bounds(spec.limits, spec.geofence, target, spec.step_s, fired.wish)
            decision = decide(fired.adapting, bounds, vut, path, now_ns)
            fired.adapting = decision.adapting
            decisions.append((trigger, decision))
        return decisions

    def send(self, reference_id: str, trigger_id: str, pace: Pace) -> None:
        """An adapted reference is dispatched, at the pace of a decision."""
        self._sent[reference_id] = (trigger_id, pace)

    def answer(self, reference_id: str, *, accepted: bool, message: str) -> None:
        """An object's answer to an adapted reference that doesn't end the run."""
        trigger_id, pace = self._sent.pop(reference_id)
        fired = self._fired[trigger_id]
        if fired.adapting is None:
            raise ValueError(f"{reference_id} is of a manoeuvre that nobody adapts")
        most_ns = seconds_to_ns(MOST_LEAD_S)
        known = answered(fired.adapting, pace, accepted=accepted, most_lead_ns=most_ns)
        if not accepted and not known.over and known.refused >= MOST_REFUSED:
            known = known.ended(f"{reference_id} was refused: {message}")
            self._notes.append(f"adaptation ends: {known.over}")
        fired.adapting = known

    def take_notes(self) -> list[str]:
        """Takes out what people should know."""
        notes, self._notes = self._notes, []
        return notes
