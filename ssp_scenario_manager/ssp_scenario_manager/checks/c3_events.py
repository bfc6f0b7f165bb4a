"""C3: phases in order and evident, a trigger observable before any conflict, speeds by trends."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

from ssp_core.motion.encounter import (
    OBSERVABLE_BRAKING_MPS2,
    OBSERVABLE_CLOSING_S,
    OBSERVABLE_LATERAL_MPS,
)
from ssp_core.vocabulary import PHASES
from ssp_scenario_manager.checks.base import Fail, Failure, Predicate, View, has_meaning
from ssp_scenario_manager.event_spec.fields import Span
from ssp_scenario_manager.event_spec.model import Evidence

_fail = Fail("C3")

# Of approach and resolution, for a phase to count as located (METHOD 4.1).
LEAST_S = 0.5
_EPS_S = 1e-6
# Times are written to milliseconds.
_ROUNDING_S = 0.001


def phases_in_order(view: View) -> Iterator[Failure]:
    """Check that each phase starts after the one before it."""
    for before, after in pairwise(PHASES):
        paths = [f"events.{phase}.start" for phase in (before, after)]
        spans = view.spans(*paths)
        if spans is None:
            continue
        early, late = spans
        if not (early.high <= late.low + _EPS_S and early.low < late.high - _EPS_S):
            remedy = f"{after} later than {before}; intervals may touch, not overlap"
            yield _fail(view, f"{after} doesn't start after {before}", remedy, *paths[::-1])


def phases_inside_the_clip(view: View) -> Iterator[Failure]:
    """Check that the approach starts with the clip, and the resolution before its end."""
    start, end = view.span("events.clip.start"), view.span("events.clip.end")
    first, last = view.span("events.approach.start"), view.span("events.resolution.start")
    if start and end and not start.high < end.low:
        reason, paths = "the clip ends before it starts", ("events.clip.end", "events.clip.start")
        yield _fail(view, reason, "an end after the start", *paths)
    if start and first and (abs(first.low - start.low) > _EPS_S or first.high != first.low):
        yield _fail(
            view,
            "the approach is all that comes before the trigger: it starts with the clip",
            "the clip's start",
            "events.approach.start",
            "events.clip.start",
        )
    if end and last and not last.high < end.low - _EPS_S:
        reason, remedy = "nothing of the resolution is in the clip", "a start before the clip's end"
        yield _fail(view, reason, remedy, "events.resolution.start", "events.clip.end")


def enough_before_and_after(view: View) -> Iterator[Failure]:
    """Check that the crop holds at least 0.5 s of approach and of resolution (METHOD 4.1)."""
    for phase, first, last in (
        ("approach", "events.clip.start", "events.trigger.start"),
        ("resolution", "events.resolution.start", "events.clip.end"),
    ):
        spans = view.spans(first, last)
        shown_s = spans[1].mid - spans[0].mid if spans else LEAST_S
        if shown_s < LEAST_S - _EPS_S:
            yield _fail(
                view,
                f"the crop shows {shown_s:.3f} s of the {phase}, and no recording cropped "
                "like it can be compared",
                f"at least {LEAST_S:g} s of it in the crop",
                last,
                first,
            )


def evidence_is_readable(view: View) -> Iterator[Failure]:
    """Check that evidence names frames or a span, in order, which agree at the source's rate."""
    rate = _rate(view)
    for phase, path, evidence in _evidence(view):
        listed = getattr(view.event.events, phase).evidence
        if path.endswith("[0]") and any(item in listed[:i] for i, item in enumerate(listed)):
            at = f"events.{phase}.evidence"
            yield _fail(view, "an entry stands twice", "each entry once", at)
        if evidence.frames is None and evidence.span_s is None:
            yield _fail(view, "says nothing", "frames or span_s", path, origin="open decision")
        origin = view.origin(path)
        for name in ("frames", "span_s"):
            ends = getattr(evidence, name)
            if ends is not None and ends[0] > ends[1]:
                at, reason = f"{path}.{name}", "ends before it starts"
                yield _fail(view, reason, "the earlier end first", at, origin=origin)
        if rate is None or evidence.frames is None or evidence.span_s is None:
            continue
        for i in (0, 1):
            at_s, frame = evidence.frames[i] / rate.low, evidence.span_s[i] * rate.low
            if abs(at_s - evidence.span_s[i]) > 0.5 / rate.low:
                yield _fail(
                    view,
                    f"this frame is at {at_s:.3f} s",
                    f"frame {frame:.0f} or {at_s:.3f} s",
                    f"{path}.frames[{i}]",
                    f"{path}.span_s[{i}]",
                    "source.rate",
                    origin=origin,
                )


def evidence_shows_its_phase(view: View) -> Iterator[Failure]:
    """Check that a phase has started when it is first seen, and lasts while it is seen."""
    rate = _rate(view)
    slack = (0.5 / rate.low if rate else 0.0) + _ROUNDING_S
    ends = [*(f"events.{phase}.start" for phase in PHASES), "events.clip.end"]
    for phase, (at_start, at_end) in zip(PHASES, pairwise(ends), strict=True):
        start, until = view.span(at_start), view.span(at_end) or view.span("events.clip.end")
        sightings = [
            (path, span)
            for of, path, evidence in _evidence(view)
            if of == phase and (span := _span_s(evidence, rate)) is not None
        ]
        if start is None or not sightings:
            continue
        first_path, first = min(sightings, key=lambda item: item[1].low)
        if abs(first.low - start.high) > slack:
            yield _fail(
                view,
                f"{phase} has started when it is first seen, and not later",
                f"evidence from {start.high:g} s on, or a start up to {first.low:g} s",
                first_path,
                at_start,
                origin=view.origin(first_path),
            )
        for path, span in sightings:
            if until is not None and span.high > until.low + slack:
                yield _fail(
                    view,
                    f"the evidence for {phase} goes on when it may be over",
                    f"evidence up to {until.low:g} s, or a later end of {phase}",
                    path,
                    at_end,
                    origin=view.origin(path),
                )


def _rate(view: View) -> Span | None:
    """Return the source's frames a second, if they are known."""
    rate = view.span("source.rate")
    return rate if rate and rate.low == rate.high else None


def _evidence(view: View) -> Iterator[tuple[str, str, Evidence]]:
    """Yield phase and path of each piece of evidence."""
    for phase in PHASES:
        for i, evidence in enumerate(getattr(view.event.events, phase).evidence):
            yield phase, f"events.{phase}.evidence[{i}]", evidence


def _span_s(evidence: Evidence, rate: Span | None) -> Span | None:
    """Return the span of an evidence, from its times or from its frames and their rate."""
    if evidence.span_s is not None:
        return Span(*evidence.span_s)
    if evidence.frames is not None and rate is not None:
        return Span(evidence.frames[0] / rate.low, evidence.frames[1] / rate.low)
    return None


TIME_PREDICATES: tuple[Predicate, ...] = (
    phases_in_order,
    phases_inside_the_clip,
    enough_before_and_after,
    evidence_is_readable,
    evidence_shows_its_phase,
)


def trigger_is_observable(view: View) -> Iterator[Failure]:
    """Check that the initiator's manoeuvre is visible from the trigger on, and not before."""
    kind, at = view.kind, f"motion.{view.initiator}"
    if kind is None:
        return
    before, after = view.cell(view.initiator, "approach"), view.cell(view.initiator, "trigger")
    early: dict[str, str] = {}
    unseen: dict[str, str] = {}
    if kind.observable == "braking":
        if before and before.speed_trend not in ("constant", "unresolved"):
            early[f"{at}.approach.speed_trend"] = "constant"
        if after and after.speed_trend != "decreasing":
            unseen[f"{at}.trigger.speed_trend"] = "decreasing"
        slow = view.span("constraints.manoeuvre.deceleration")
        if slow and slow.low <= OBSERVABLE_BRAKING_MPS2:
            remedy = f"above {OBSERVABLE_BRAKING_MPS2:g} m/s^2"
            unseen["constraints.manoeuvre.deceleration"] = remedy
    elif kind.observable == "closing":
        ttc = view.span("constraints.thresholds.ttc")
        if ttc and ttc.high >= OBSERVABLE_CLOSING_S:
            unseen["constraints.thresholds.ttc"] = f"below {OBSERVABLE_CLOSING_S:g} s"
        for phase in ("trigger", "conflict"):
            cell = view.cell(view.initiator, phase)
            if before and cell and cell.speed_trend != before.speed_trend:
                unseen[f"{at}.{phase}.speed_trend"] = before.speed_trend
    else:
        if before and before.lateral not in ("none", "unresolved"):
            early[f"{at}.approach.lateral"] = "none"
        if before and before.motion == view.event.interaction.dominant_motion:
            early[f"{at}.approach.motion"] = "stationary or same_direction"
        if after and after.lateral == "none":
            unseen[f"{at}.trigger.lateral"] = "left or right"
        path, slowest_mps = _lateral_speed(view)
        if slowest_mps <= OBSERVABLE_LATERAL_MPS:
            unseen[path] = f"so that it is faster than {OBSERVABLE_LATERAL_MPS:g} m/s"
    for path, remedy in early.items():
        reason = "the manoeuvre would be visible before the trigger"
        yield _fail(view, reason, remedy, path, "interaction.type")
    for path, remedy in unseen.items():
        reason = "the trigger starts when the manoeuvre can be seen (METHOD 1), and this can't"
        yield _fail(view, reason, remedy, path, "interaction.type", view.road("lane_width"))


def _lateral_speed(view: View) -> tuple[str, float]:
    """Return the manoeuvre's slowest lateral speed: walking, or a lane's width in its duration."""
    both = view.spans(view.road("lane_width"), "constraints.manoeuvre.duration")
    if both and both[1].high > 0.0:
        return "constraints.manoeuvre.duration", both[0].low / both[1].high
    walk = view.span("constraints.manoeuvre.walking_speed")
    return "constraints.manoeuvre.walking_speed", walk.low if walk else float("inf")


def conflict_follows_the_trigger(view: View) -> Iterator[Failure]:
    """Require that the conflict's threshold isn't reached yet at the trigger."""
    names = ["constraints.trigger.below", "constraints.thresholds.ttc"]
    speeds = [f"constraints.speeds.{i}.approach" for i in (view.event.vut_id, view.initiator)]
    spans, both = view.spans(*names), view.spans(*speeds)
    if spans is None:
        return
    below, ttc = spans
    if view.event.constraints.trigger.quantity == "time_to_arrival":
        least = below.low
    elif both is None:
        return
    else:
        names += speeds
        ours, theirs = both
        in_lane = view.event.interaction.relation == "following"
        # In the VUT's lane TTC counts from the start; from beside it only once the OT moves over.
        closing = ours.high - theirs.low if in_lane else ours.low - theirs.high
        least = (below.low if in_lane else below.high) / closing if closing > 0.0 else float("inf")
    if view.kind and view.kind.observable == "closing":
        if least < OBSERVABLE_CLOSING_S:
            reason = f"TTC may be {least:.2f} s by then: the VUT is seen to close in before"
            remedy = f"a larger value, for at least {OBSERVABLE_CLOSING_S:g} s"
            yield _fail(view, reason, remedy, *names)
    elif least <= ttc.high:
        yield _fail(
            view,
            f"at the trigger TTC may already be {least:.2f} s: the conflict would come first",
            "a larger value, or a smaller threshold",
            *names,
        )


def trigger_can_fire(view: View) -> Iterator[Failure]:
    """Check that the initiator starts beyond the trigger's distance, and that the gap closes."""
    who = view.initiator
    cell, path = view.cell(who, "approach"), f"motion.{who}.approach.longitudinal"
    if cell:
        reason = "the trigger waits for the VUT to come nearer"
        quantity = "constraints.trigger.quantity"
        yield from _fail.unless(view, cell.longitudinal, ["closing"], reason, path, quantity)
    names = [
        "constraints.trigger.below",
        f"participants.{who}.region.gap",
        f"constraints.speeds.{view.event.vut_id}.approach",
    ]
    spans = view.spans(*names)
    if spans is None:
        return
    below, gap, ours = spans
    in_time = view.event.constraints.trigger.quantity == "time_to_arrival"
    distance = below.high * ours.high if in_time else below.high
    if gap.low <= distance:
        remedy = f"the initiator starts more than {distance:.1f} m away, or a smaller value"
        reason = "the trigger may fire at once: there is no approach"
        yield _fail(view, reason, remedy, *names)


def vut_comes_steadily(view: View) -> Iterator[Failure]:
    """Require a VUT that speeds up before the conflict to be allowed that response."""
    vut = view.event.vut_id
    may = "accelerate" in view.event.interaction.longitudinal_responses
    for phase in ("approach", "trigger"):
        cell = view.cell(vut, phase)
        if cell and cell.speed_trend == "increasing" and not (may and phase == "trigger"):
            yield _fail(
                view,
                "the trigger's distance and time count on the speed of the approach",
                "constant, or any",
                f"motion.{vut}.{phase}.speed_trend",
                f"constraints.speeds.{vut}.{phase}",
            )


def speeds_follow_trends(view: View) -> Iterator[Failure]:
    """Check that a participant's speeds follow from phase to phase as its speed trends say."""
    for who in view.event.participants:
        previous: tuple[str, Span, str] | None = None
        for phase in PHASES:
            cell, path = view.cell(who, phase), f"constraints.speeds.{who}.{phase}"
            span = view.span(path)
            if cell is None or span is None:
                previous = None
                continue
            trend, at = cell.speed_trend, f"motion.{who}.{phase}.speed_trend"
            if (trend == "standing") != (span.low == span.high == 0.0) and has_meaning(trend):
                reason, remedy = "standing is a speed of 0", "0 m/s, or another trend"
                yield _fail(view, reason, remedy, path, at)
            elif trend == "constant" and span.low <= 0.0:
                yield _fail(view, "a constant speed is above 0", "min above 0 m/s", path, at)
            elif previous and (wrong := _course(previous[1], previous[2], span, trend)):
                yield _fail(view, *wrong, path, at, previous[0])
            previous = path, span, trend


def _course(before: Span, trend_before: str, now: Span, trend: str) -> tuple[str, str] | None:
    """Name a contradiction between two successive ranges of speed, if any: (reason, remedy)."""
    steady = trend_before in ("constant", "standing")
    if trend == "constant" and trend_before == "constant" and before != now:
        return "a speed that stays constant has one range", "the range of the phase before"
    if steady and not now.holds(before):
        return "the phase starts at the speeds of the one before", "a range that holds that one"
    if not before.meets(now):
        return "no speed is in both phases' ranges", "ranges that meet"
    if trend == "decreasing" and (now.high > before.high or now.low >= before.high):
        return "a falling speed has no higher range", "at most that of the phase before"
    if trend == "increasing" and (now.low < before.low or now.high <= before.low):
        return "a rising speed has no lower range", "at least that of the phase before"
    return None


TRIGGER_PREDICATES: tuple[Predicate, ...] = (
    trigger_is_observable,
    conflict_follows_the_trigger,
    trigger_can_fire,
    vut_comes_steadily,
    speeds_follow_trends,
)
