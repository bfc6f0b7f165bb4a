"""The adaptation of an object target's manoeuvre to a VUT of another speed.

This file owns what is played: ``PlayedPace`` the pace, ``PassingOrder`` who arrives first. An
adaptation that is over never begins anew. Reads no clock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ssp_core.clock import NS_PER_S, seconds_to_ns
from ssp_core.geometry import FloatArray, Polyline
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState, Size
from ssp_core.run_file.model import RunSpec
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
    required_rate,
    toward,
)

_SAME_SPEED_MPS = 0.01
_BISECTIONS = 5
# So long after the decisive instant, the pace is as good as back to 1.
_AFTER_S = 2.0
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
# So many refusals in a row, and the link is too slow for adapting.
MOST_REFUSED = 3
# The longest time between dispatch and execute_at of an adapted reference.
MOST_LEAD_S = 0.4


@dataclass(frozen=True, slots=True)
class Decision:
    """The consequence of one state of the VUT.

    Args:
        pace: to be sent; None: all stays as it is.
        note: for people; empty: there is nothing to tell.
        wrong_order: the passing order can't be kept, in words; empty: it can.
    """

    pace: Pace | None = None
    note: str = ""
    wrong_order: str = ""


class PlayedPace:
    """The pace that an object plays a manoeuvre at, as far as its answers say.

    Args:
        execute_at_ns: of the manoeuvre as planned.
        lead_time_s: between dispatch and execute_at, at first.

    Attributes:
        pace: of the last reference that was sent and not refused.
        taken: of the last one that the object accepted.
        lead_ns: between dispatch and execute_at.
        refused: references in a row that were refused.
    """

    def __init__(self, execute_at_ns: int, lead_time_s: float) -> None:
        self.pace = self.taken = as_planned(execute_at_ns)
        self.lead_ns = seconds_to_ns(lead_time_s)
        self.refused = 0

    def on_answer(self, pace: Pace, *, accepted: bool) -> None:
        """Take an object's answer into account.

        After a refusal the object drives on what it took last; the next reference is given twice
        the time to arrive.

        Args:
            pace: of the reference that was answered.
            accepted: the object took it.
        """
        if accepted:
            self.refused = 0
            if pace.start_ns >= self.taken.start_ns:
                self.taken = pace
            return
        self.refused += 1
        self.lead_ns = min(2 * max(self.lead_ns, 1), seconds_to_ns(MOST_LEAD_S))
        if self.pace == pace:
            self.pace = self.taken


class PassingOrder:
    """The order in which both arrive at the conflict: wrong once it has looked so for long enough.

    Args:
        arrival_s: of the object, own time of its manoeuvre.
        conflict_m: the conflict point, arc length along the VUT's path.
        object_first: the object is to arrive first.
    """

    def __init__(self, arrival_s: float, conflict_m: float, *, object_first: bool) -> None:
        self._arrival_s = arrival_s
        self._conflict_m = conflict_m
        self._object_first = object_first
        self._wrong_ns: int | None = None  # since when it has looked wrong
        self._is_decided = False  # somebody has arrived, and in the right order

    def mistake(self, track: VutTrack, pace: Pace) -> str:
        """Name the participant that is sure to arrive first wrongly, beyond noise; empty: none."""
        if self._is_decided:
            return ""
        object_ns = pace.arrival_ns(self._arrival_s)
        vut_ns = arrival_ns(track, self._conflict_m)
        object_first = self._object_first
        if object_ns < vut_ns if object_first else vut_ns < object_ns:
            self._wrong_ns = None
            self._is_decided = object_ns <= track.stamp_ns or track.front_m >= self._conflict_m
            return ""
        if self._wrong_ns is None:
            self._wrong_ns = track.stamp_ns
        if track.stamp_ns - self._wrong_ns < seconds_to_ns(ORDER_S):
            return ""
        who = "the VUT" if object_first else "the object target"
        ahead_s = abs(object_ns - vut_ns) / NS_PER_S
        return f"{who} would be {ahead_s:.2f} s too early for the passing order"


class PaceLimits:
    """The limits within which a manoeuvre may be played (METHOD 2.3, the limits of safety).

    Args:
        decisive_s: own time of what decides the gap.
    """

    def __init__(
        self,
        planned_motion: PlannedMotion,
        spec: RunSpec,
        target: ParticipantSpec,
        wish: Adaptation,
        decisive_s: float,
    ) -> None:
        self._planned_motion = planned_motion
        self._spec = spec
        self._target = target
        self._wish = wish
        self._decisive_s = decisive_s

    def nearest_rate(self, pace: Pace, start_ns: int, rate: float) -> float:
        """Return the pace that comes nearest to a wanted one inside the limits.

        Args:
            pace: that is played until then.
            start_ns: when the new pace begins.
            rate: the wanted pace.
        """

        def fits(candidate_rate: float) -> bool:
            return self._fits(toward(pace, start_ns, candidate_rate, self._decisive_s))

        if fits(rate):
            return rate
        # As it goes on now it fits, and so does whatever is near enough to that.
        good, bad = pace.target, rate
        for _ in range(_BISECTIONS):
            middle = 0.5 * (good + bad)
            if fits(middle):
                good = middle
            else:
                bad = middle
        return good

    def _fits(self, pace: Pace) -> bool:
        """Tell whether a pace stays inside the limits.

        Speed and acceleration must stay inside theirs, or inside what was planned if that is more,
        and a blind stop from any of its points inside the fence.
        """
        columns = self._planned_motion.columns
        near = columns[:, columns[0] <= self._decisive_s + _AFTER_S]
        played = play(near, pace).columns
        speed, acceleration = played[4], played[5]
        limits, wish = self._spec.limits, self._wish
        site = limits.acceleration_mps2
        most_up = min(site, wish.acceleration_mps2 or site)
        most_down = min(site, wish.deceleration_mps2 or site)
        return bool(
            speed.max() <= max(limits.speed_mps, near[4].max())
            and acceleration.max() <= max(most_up, near[5].max())
            and -acceleration.min() <= max(most_down, -near[5].min())
            and self._stops_inside(played, near)
        )

    def _stops_inside(self, played: FloatArray, planned: FloatArray) -> bool:
        """Tell whether it stops inside the fence where it is faster than planned.

        The object checks the rest.
        """
        at = planned[4, -(played.shape[1] - 1) :] if played.shape[1] > 1 else planned[4, :0]
        faster = played[:, 1:][:, played[4, 1:] > at + _SAME_SPEED_MPS]
        if faster.shape[1] == 0:
            return True
        spec, target = self._spec, self._target
        excess = blind_excess_m(
            faster, target.cls, target.size, spec.limits, spec.geofence, spec.step_s
        )
        return not excess.max() > 0.0


class AdaptedManoeuvre:
    """A manoeuvre that was dispatched as planned, and is played faster or slower since.

    Args:
        spec: of the run; gives limits, fence, and how often an object judges its state.
        target: that moves.
        wish: of the trigger.
        path: the VUT's planned path, frame map.

    Attributes:
        played: the pace that the object plays, as far as it is known.
        over: why it ended; empty while it goes on.
    """

    def __init__(
        self,
        planned_motion: PlannedMotion,
        spec: RunSpec,
        target: ParticipantSpec,
        wish: Adaptation,
        path: Polyline,
        dispatched_ns: int,
    ) -> None:
        self.planned_motion = planned_motion
        self.target = target
        self._wish = wish
        self._path = path
        self.played = PlayedPace(planned_motion.execute_at_ns, wish.lead_time_s)
        self.over = ""
        self._aimed_ns = dispatched_ns  # when a pace was last looked for
        self._track: VutTrack | None = None
        self._braking_ns: int | None = None  # since when the VUT has braked as if it responded
        self._unmet = False  # the gap can't be met at present
        first = wish.first == "initiator"
        # Own time of what decides the gap.
        self._decisive_s = planned_motion.departure_s if first else planned_motion.arrival_s
        # The conflict point, arc length along the VUT's path.
        zone = planned_motion.zone
        self._conflict_m = zone.start_m if wish.anchor is None else path.project(*wish.anchor)[0]
        self._order = PassingOrder(planned_motion.arrival_s, self._conflict_m, object_first=first)
        self._limits = PaceLimits(planned_motion, spec, target, wish, self._decisive_s)

    def judge(self, vut: ObjectState, now_ns: int) -> Decision:
        """Judge a state of the VUT that hasn't been judged yet.

        Args:
            vut: the state.
            now_ns: session time, that of a dispatch.
        """
        self._track = track = follow_vut(self._track, vut, self._path)
        if wrong := self._order.mistake(track, self.played.pace):
            return Decision(wrong_order=wrong)
        if self.over:
            return Decision()
        if over := self._why_over(track, now_ns):
            self.over = over
            return Decision(note=f"adaptation ends: {over}")
        if self._may_respond(track, now_ns):
            return Decision()
        return self._aim(track, vut.size, now_ns)

    def on_answer(self, pace: Pace, *, accepted: bool) -> None:
        """Take an object's answer to the reference of a pace; see ``PlayedPace.on_answer``."""
        self.played.on_answer(pace, accepted=accepted)

    def _why_over(self, track: VutTrack, now_ns: int) -> str:
        """Give the reason why the adaptation is over, empty while it isn't."""
        wish, braking = self._wish, -track.acceleration_mps2
        decisive_ns = self.played.pace.arrival_ns(self._decisive_s)
        if decisive_ns <= now_ns + seconds_to_ns(wish.freeze_s):
            return "the conflict is at hand"
        begun = self.played.pace.at(now_ns)[0] > 0.0
        if wish.response_mps2 is not None and begun and braking > wish.response_mps2:
            return f"the VUT responds, braking at {braking:.1f} m/s^2"
        return ""

    def _may_respond(self, track: VutTrack, now_ns: int) -> bool:
        """Tell whether the VUT has begun to brake in a way that may become a response."""
        response_mps2 = self._wish.response_mps2
        mild = response_mps2 is None or self.played.pace.at(now_ns)[0] <= 0.0
        if mild or -track.acceleration_mps2 <= SUSPICIOUS_SHARE * (response_mps2 or 0.0):
            self._braking_ns = None
            return False
        if self._braking_ns is None:
            self._braking_ns = now_ns
        return now_ns - self._braking_ns < seconds_to_ns(SUSPICION_S)

    def _due_ns(self, track: VutTrack, size: Size) -> float:
        """Compute the time of the decisive instant that gives the specified gap; inf: never."""
        zone, gap_ns = self.planned_motion.zone, self._wish.gap_s * NS_PER_S
        if self._wish.first == "initiator":
            return arrival_ns(track, self._conflict_m) - gap_ns
        end_m = self._conflict_m + zone.end_m - zone.start_m
        return arrival_ns(track, end_m + size.length_m) + gap_ns

    def _aim(self, track: VutTrack, size: Size, now_ns: int) -> Decision:
        """Find the pace with which the decisive instant comes when it must, if there is one."""
        wish, own_s, due_ns = self._wish, self._decisive_s, self._due_ns(track, size)
        off_s = (self.played.pace.arrival_ns(own_s) - due_ns) / NS_PER_S
        if abs(off_s) <= wish.dead_band_s:
            self._unmet = False
            return Decision()
        if now_ns - self._aimed_ns < NS_PER_S / wish.rate_hz:
            return Decision()
        self._aimed_ns = now_ns
        start_ns = now_ns + self.played.lead_ns
        slowest, fastest = wish.speed_share
        rate = slowest
        if math.isfinite(due_ns):
            rate = required_rate(self.played.pace, start_ns, own_s, (due_ns - start_ns) / NS_PER_S)
        rate = self._limits.nearest_rate(
            self.played.pace, start_ns, min(max(rate, slowest), fastest)
        )
        if abs(rate - self.played.pace.target) < _SAME_RATE:
            return Decision(note=self._gap_note(off_s))
        pace = self.played.pace = toward(self.played.pace, start_ns, rate, own_s)
        return Decision(pace, self._gap_note((pace.arrival_ns(own_s) - due_ns) / NS_PER_S))

    def _gap_note(self, off_s: float) -> str:
        """Tell once of a gap that can't be met, and once of one that can again."""
        unmet = abs(off_s) > UNMET_S
        if unmet == self._unmet:
            return ""
        self._unmet = unmet
        if not unmet:
            return "the time gap can be met again"
        by = f"{abs(off_s):.2f} s" if math.isfinite(off_s) else "any time"
        return f"the time gap will be off by {by}: as much as the limits allow is done"


class Adaptations:
    """The manoeuvres of a run that are adapted, and the references that adapted them."""

    def __init__(self) -> None:
        self._dispatched: list[tuple[str, Adaptation, Reference, Reference | None]] = []
        self._adapted: list[AdaptedManoeuvre] = []
        self._sent: dict[str, tuple[AdaptedManoeuvre, Pace]] = {}
        self._notes: list[str] = []

    def fire(self, trigger: TriggerSpec, manoeuvre: Reference, before: Reference | None) -> None:
        """Take a dispatched manoeuvre to adapt; one without an adaptation is left alone.

        Args:
            trigger: that fired.
            manoeuvre: the reference that it sent.
            before: the reference that the object drove then; None: it stood.
        """
        if trigger.adaptation is not None:
            self._dispatched.append((trigger.object_id, trigger.adaptation, manoeuvre, before))

    def judge(
        self, spec: RunSpec, path: Polyline, vut: ObjectState, now_ns: int
    ) -> list[tuple[AdaptedManoeuvre, Decision]]:
        """Judge every manoeuvre on a state of the VUT, in the order in which they fired."""
        # What is on its way out this instant waits: nothing may hold it up.
        dispatches = [one for one in self._dispatched if one[2].dispatched_ns != now_ns]
        self._dispatched = [one for one in self._dispatched if one[2].dispatched_ns == now_ns]
        for object_id, wish, manoeuvre, before in dispatches:
            target = next(t for t in spec.targets if t.id == object_id)
            sent_ns = manoeuvre.dispatched_ns
            planned = planned_motion_of(before, manoeuvre, sent_ns, target, spec.vut, path)
            if planned is None:
                why = "doesn't come into the VUT's corridor: no adaptation"
                self._notes.append(f"{object_id} {why}")
            else:
                adapted = AdaptedManoeuvre(planned, spec, target, wish, path, sent_ns)
                self._adapted.append(adapted)
        return [(adapted, adapted.judge(vut, now_ns)) for adapted in self._adapted]

    def send(self, reference_id: str, adapted: AdaptedManoeuvre, pace: Pace) -> None:
        """Remember an adapted reference that is dispatched at the pace of a decision."""
        self._sent[reference_id] = (adapted, pace)

    def answer(self, reference_id: str, *, accepted: bool, message: str) -> None:
        """Take an object's answer to an adapted reference, if it doesn't end the run."""
        adapted, pace = self._sent.pop(reference_id)
        adapted.on_answer(pace, accepted=accepted)
        if not adapted.over and adapted.played.refused >= MOST_REFUSED:
            adapted.over = f"{reference_id} was refused: {message}"
            self._notes.append(f"adaptation ends: {adapted.over}")

    def take_notes(self) -> list[str]:
        """Take out the notes for people."""
        notes, self._notes = self._notes, []
        return notes
