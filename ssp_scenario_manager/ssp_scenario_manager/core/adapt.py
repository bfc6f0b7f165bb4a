"""When and how an object target's manoeuvre is adapted to a VUT of another speed.

The gap that METHOD 1 defines is second arrival minus first departure. What the OT contributes to it
is one instant, its decisive one: its departure from the conflict zone if it comes first, else its
arrival there. From the VUT's predicted arrival follows when that must be, and from that the pace at
which the manoeuvre goes on (see ``pace``). Nothing here reads a clock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from ssp_core.clock import NS_PER_S, seconds_to_ns
from ssp_core.geometry import Polyline
from ssp_core.motion.state import ObjectState, Size
from ssp_core.run_file.participants import Adaptation
from ssp_scenario_manager.core.adapt_bounds import Bounds, nearest_rate
from ssp_scenario_manager.core.pace import Pace, as_planned, toward, wanted_rate
from ssp_scenario_manager.core.routine import Routine
from ssp_scenario_manager.core.vut_track import VutTrack, arrival_ns, follow_vut

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
        routine: as planned.
        pace: of the last reference that was sent and not refused.
        taken: of the last one that the object accepted.
        aimed_ns: session time at which a pace was last looked for.
        lead_ns: between dispatch and execute_at.
        track: of the VUT.
        refused: references in a row that were refused.
        wrong_ns: since when the passing order has looked wrong; None: it looks right.
        settled: somebody has arrived, and in the right order.
        braking_ns: since when the VUT has braked as if it began to respond; None: it doesn't.
        unmet: the gap can't be met at present.
        over: why it ended; empty while it goes on.
    """

    routine: Routine
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


def begin(routine: Routine, dispatched_ns: int, lead_s: float) -> Adapting:
    """A manoeuvre that was dispatched as planned."""
    pace = as_planned(routine.execute_at_ns)
    return Adapting(routine, pace, pace, dispatched_ns, seconds_to_ns(lead_s))


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
    wish: Adaptation,
    bounds: Bounds,
    vut: ObjectState,
    path: Polyline,
    now_ns: int,
) -> Decision:
    """Judges a state of the VUT that hasn't been judged yet.

    Args:
        adapting: what is remembered.
        wish: of the trigger.
        bounds: of the motion.
        vut: newest state.
        path: of the VUT.
        now_ns: session time, that of a dispatch.
    """
    known = replace(adapting, track=follow_vut(adapting.track, vut, path))
    track = known.track
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
    return _aim(known, wish, bounds, track, vut.size, path, now_ns)


def _conflict_m(routine: Routine, wish: Adaptation, path: Polyline) -> float:
    """The conflict point, arc length along the VUT's path."""
    if wish.anchor is None:
        return routine.zone.start_m
    return path.project(*wish.anchor)[0]


def _decisive_s(routine: Routine, wish: Adaptation) -> float:
    """Own time of what decides the gap."""
    return routine.departure_s if wish.first == "initiator" else routine.arrival_s


def _due_ns(
    routine: Routine, wish: Adaptation, track: VutTrack, size: Size, path: Polyline
) -> float:
    """When the decisive instant must be, for the gap to be as specified; inf: never."""
    conflict_m = _conflict_m(routine, wish, path)
    gap_ns = wish.gap_s * NS_PER_S
    if wish.first == "initiator":
        return arrival_ns(track, conflict_m) - gap_ns
    end_m = conflict_m + routine.zone.end_m - routine.zone.start_m
    return arrival_ns(track, end_m + size.length_m) + gap_ns


def _watch_order(
    known: Adapting, wish: Adaptation, track: VutTrack, path: Polyline
) -> tuple[Adapting, str]:
    """Says so when the wrong one will arrive first whatever is done, and this isn't just noise."""
    if known.settled:
        return known, ""
    routine = known.routine
    conflict_m = _conflict_m(routine, wish, path)
    object_ns = known.pace.reached_ns(routine.arrival_s)
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
    decisive_ns = known.pace.reached_ns(_decisive_s(known.routine, wish))
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
    wish: Adaptation,
    bounds: Bounds,
    track: VutTrack,
    size: Size,
    path: Polyline,
    now_ns: int,
) -> Decision:
    """The pace with which the decisive instant comes when it must, if it can."""
    own_s = _decisive_s(known.routine, wish)
    due_ns = _due_ns(known.routine, wish, track, size, path)
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
        known.routine.columns,
        known.pace,
        wish,
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
        adapting: what is remembered.
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
