"""C3: phases in order and evident, an observable trigger before any conflict, speeds that follow
their trends.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

from ssp_core.motion.encounter import OBSERVABLE_BRAKING_MPS2, OBSERVABLE_LATERAL_MPS
from ssp_core.vocabulary import PHASES
from ssp_scenario_manager.event_spec.checks.base import Fail, Failure, Predicate, View, known
from ssp_scenario_manager.event_spec.fields import Span
from ssp_scenario_manager.event_spec.model import Evidence

_fail = Fail("C3")

# Of approach and resolution, for a phase to count as located (METHOD 4.1).
LEAST_S = 0.5
_EPS_S = 1e-6
# Times are written to milliseconds.
_ROUNDING_S = 0.001


def phases_in_order(view: View) -> Iterator[Failure]:
    """Each phase starts after the one before it."""
    for before, after in pairwise(PHASES):
        paths = [f"events.{phase}.start" for phase in (after, before)]
        late, early = view.span(paths[0]), view.span(paths[1])
        if late is None or early is None:
            continue
        if not (early.high <= late.low + _EPS_S and early.low < late.high - _EPS_S):
            yield _fail(
                paths[0],
                view.said(*paths),
                f"{after} doesn't start after {before}",
                f"{after} later than {before}; intervals may touch, not overlap",
            )


def phases_inside_the_clip(view: View) -> Iterator[Failure]:
    """The approach starts with the clip, and the resolution before its end."""
    start, end = view.span("events.clip.start"), view.span("events.clip.end")
    first, last = view.span("events.approach.start"), view.span("events.resolution.start")
    if start and end and not start.high < end.low:
        yield _fail(
            "events.clip.end",
            view.said("events.clip.end", "events.clip.start"),
            "the clip ends before it starts",
            "an end after the start",
        )
    if start and first and (abs(first.low - start.low) > _EPS_S or first.high != first.low):
        yield _fail(
            "events.approach.start",
            view.said("events.approach.start", "events.clip.start"),
            "the approach is all that comes before the trigger: it starts with the clip",
            "the clip's start",
        )
    if end and last and not last.high < end.low - _EPS_S:
        yield _fail(
            "events.resolution.start",
            view.said("events.resolution.start", "events.clip.end"),
            "nothing of the resolution is in the clip",
            "a start before the clip's end",
        )


def enough_before_and_after(view: View) -> Iterator[Failure]:
    """The crop holds at least 0.5 s of approach and of resolution (METHOD 4.1)."""
    for phase, first, last in (
        ("approach", "events.clip.start", "events.trigger.start"),
        ("resolution", "events.resolution.start", "events.clip.end"),
    ):
        early, late = view.span(first), view.span(last)
        if early is None or late is None or late.mid - early.mid >= LEAST_S - _EPS_S:
            continue
        yield _fail(
            last,
            view.said(last, first),
            f"the crop shows {late.mid - early.mid:.3f} s of the {phase}, and no recording cropped "
            "like it can be compared",
            f"at least {LEAST_S:g} s of it in the crop",
        )


def evidence_is_readable(view: View) -> Iterator[Failure]:
    """Evidence names frames or a span, in order, and both say the same at the source's rate."""
    rate = _rate(view)
    for phase in PHASES:
        listed = getattr(view.event.events, phase).evidence
        if any(evidence in listed[:i] for i, evidence in enumerate(listed)):
            path = f"events.{phase}.evidence"
            yield _fail(path, view.said(path), "an entry stands twice", "each entry once")
    for path, evidence in _evidence(view):
        if evidence.frames is None and evidence.span_s is None:
            yield _fail(
                path,
                view.said(path),
                "says nothing",
                "frames or span_s",
                "open decision",
            )
        for name in ("frames", "span_s"):
            ends = getattr(evidence, name)
            if ends is not None and ends[0] > ends[1]:
                yield _fail(
                    f"{path}.{name}",
                    view.said(f"{path}.{name}"),
                    "ends before it starts",
                    "the earlier end first",
                    view.origin(path),
                )
        if rate is None or evidence.frames is None or evidence.span_s is None:
            continue
        for i in (0, 1):
            at_s, frame = evidence.frames[i] / rate.low, evidence.span_s[i] * rate.low
            if abs(at_s - evidence.span_s[i]) > 0.5 / rate.low:
                yield _fail(
                    f"{path}.frames[{i}]",
                    view.said(f"{path}.frames[{i}]", f"{path}.span_s[{i}]", "source.rate"),
                    f"this frame is at {at_s:.3f} s",
                    f"frame {frame:.0f} or {at_s:.3f} s",
                    view.origin(path),
                )


def evidence_shows_its_phase(view: View) -> Iterator[Failure]:
    """A phase has started when it is first seen, and lasts while it is seen."""
    rate = _rate(view)
    frame_s = 1.0 / rate.low if rate else 0.0
    end = view.span("events.clip.end")
    for i, phase in enumerate(PHASES):
        path = f"events.{phase}"
        start = view.span(f"{path}.start")
        after = f"events.{PHASES[i + 1]}.start" if i + 1 < len(PHASES) else "events.clip.end"
        until = view.span(after) or end
        found = [
            (f"{path}.evidence[{k}]", span)
            for k, evidence in enumerate(getattr(view.event.events, phase).evidence)
            if (span := _span_s(evidence, rate)) is not None
        ]
        if start is None or not found:
            continue
        slack = frame_s / 2 + _ROUNDING_S
        first_path, first = min(found, key=lambda item: item[1].low)
        if abs(first.low - start.high) > slack:
            yield _fail(
                first_path,
                view.said(first_path, f"{path}.start"),
                f"{phase} has started when it is first seen, and not later",
                f"evidence from {start.high:g} s on, or a start up to {first.low:g} s",
                view.origin(first_path),
            )
        for at, span in found:
            if until is not None and span.high > until.low + slack:
                yield _fail(
                    at,
                    view.said(at, after),
                    f"the evidence for {phase} goes on when it may be over",
                    f"evidence up to {until.low:g} s, or a later end of {phase}",
                    view.origin(at),
                )


def _rate(view: View) -> Span | None:
    """Frames a second of the source, if they are known."""
    rate = view.span("source.rate")
    return rate if rate and rate.low == rate.high else None


def _evidence(view: View) -> Iterator[tuple[str, Evidence]]:
    for phase in PHASES:
        for i, evidence in enumerate(getattr(view.event.events, phase).evidence):
            yield f"events.{phase}.evidence[{i}]", evidence


def _span_s(evidence: Evidence, rate: Span | None) -> Span | None:
    """When something can be seen, from its span or, with the source's rate, from its frames."""
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
    """The initiator's manoeuvre is absent in the approach and visible from the trigger on."""
    kind, who = view.kind, view.initiator
    if kind is None:
        return
    before, after = view.cell(who, "approach"), view.cell(who, "trigger")
    at = f"motion.{who}"
    dominant = view.event.interaction.dominant_motion
    if kind.observable == "braking":
        if before and before.speed_trend not in ("constant", "unresolved"):
            yield _early(view, f"{at}.approach.speed_trend", "constant")
        if after and after.speed_trend != "decreasing":
            yield _unseen(view, f"{at}.trigger.speed_trend", "decreasing")
        slow = view.span("constraints.manoeuvre.deceleration")
        if slow and slow.low <= OBSERVABLE_BRAKING_MPS2:
            yield _unseen(
                view,
                "constraints.manoeuvre.deceleration",
                f"above {OBSERVABLE_BRAKING_MPS2:g} m/s^2",
            )
        return
    if before and before.lateral not in ("none", "unresolved"):
        yield _early(view, f"{at}.approach.lateral", "none")
    if before and before.motion == dominant:
        yield _early(view, f"{at}.approach.motion", "stationary or same_direction")
    if after and after.lateral == "none":
        yield _unseen(view, f"{at}.trigger.lateral", "left or right")
    yield from _lateral_speed(view)


def _lateral_speed(view: View) -> Iterator[Failure]:
    """Slowest lateral speed of the manoeuvre: walking, or a lane's width in its duration."""
    width, time = view.span(view.road("lane_width")), view.span("constraints.manoeuvre.duration")
    walk = view.span("constraints.manoeuvre.walking_speed")
    path, slowest = "constraints.manoeuvre.walking_speed", walk.low if walk else None
    if width and time and time.high > 0.0:
        path, slowest = "constraints.manoeuvre.duration", width.low / time.high
    if slowest is not None and slowest <= OBSERVABLE_LATERAL_MPS:
        yield _unseen(view, path, f"so that it is faster than {OBSERVABLE_LATERAL_MPS:g} m/s")


def conflict_follows_the_trigger(view: View) -> Iterator[Failure]:
    """At the trigger the conflict's threshold isn't reached yet, so that it can follow."""
    c = view.event.constraints
    ttc, below = view.span("constraints.thresholds.ttc"), view.span("constraints.trigger.below")
    vut, who = view.event.vut_id, view.initiator
    if ttc is None or below is None:
        return
    names = ["constraints.trigger.below", "constraints.thresholds.ttc"]
    if c.trigger.quantity == "time_to_arrival":
        least = below.low
    else:
        speeds = [f"constraints.speeds.{i}.approach" for i in (vut, who)]
        ours, theirs = view.span(speeds[0]), view.span(speeds[1])
        if ours is None or theirs is None:
            return
        names += speeds
        in_lane = view.event.interaction.relation == "following"
        # In the VUT's lane TTC counts from the start; from beside it only once the OT moves over.
        closing = ours.high - theirs.low if in_lane else ours.low - theirs.high
        least = (below.low if in_lane else below.high) / closing if closing > 0.0 else float("inf")
    if least <= ttc.high:
        yield _fail(
            names[0],
            view.said(*names),
            f"at the trigger TTC may already be {least:.2f} s: the conflict would come first",
            "a larger value, or a smaller threshold",
        )


def trigger_can_fire(view: View) -> Iterator[Failure]:
    """The initiator starts farther away than the trigger's distance, and the gap closes."""
    who, vut = view.initiator, view.event.vut_id
    cell = view.cell(who, "approach")
    path = f"motion.{who}.approach.longitudinal"
    if cell and cell.longitudinal != "closing" and not view.is_broken(path):
        yield _fail(
            path,
            view.said(path, "constraints.trigger.quantity"),
            "the trigger waits for the VUT to come nearer",
            "closing",
        )
    below, gap = view.span("constraints.trigger.below"), view.span(f"participants.{who}.region.gap")
    speeds = f"constraints.speeds.{vut}.approach"
    ours = view.span(speeds)
    if below is None or gap is None or ours is None:
        return
    in_time = view.event.constraints.trigger.quantity == "time_to_arrival"
    distance = below.high * ours.high if in_time else below.high
    if gap.low <= distance:
        yield _fail(
            "constraints.trigger.below",
            view.said("constraints.trigger.below", f"participants.{who}.region.gap", speeds),
            "the trigger may fire at once: there is no approach",
            f"the initiator starts more than {distance:.1f} m away, or a smaller value",
        )


def vut_comes_steadily(view: View) -> Iterator[Failure]:
    """Until the conflict the VUT doesn't speed up, but in answer to the trigger if it may."""
    vut = view.event.vut_id
    may = "accelerate" in view.event.interaction.longitudinal_responses
    for phase in ("approach", "trigger"):
        cell, path = view.cell(vut, phase), f"motion.{vut}.{phase}.speed_trend"
        if cell is None or cell.speed_trend != "increasing" or (may and phase == "trigger"):
            continue
        yield _fail(
            path,
            view.said(path, f"constraints.speeds.{vut}.{phase}"),
            "the trigger's distance and time count on the speed of the approach",
            "constant, or any",
        )


def speeds_follow_trends(view: View) -> Iterator[Failure]:
    """A participant's ranges of speed follow from phase to phase as its speed trends say."""
    for who in view.event.participants:
        previous: tuple[str, Span, str] | None = None
        for phase in PHASES:
            cell, path = view.cell(who, phase), f"constraints.speeds.{who}.{phase}"
            span = view.span(path)
            if cell is None or span is None:
                previous = None
                continue
            trend, at = cell.speed_trend, f"motion.{who}.{phase}.speed_trend"
            if (trend == "standing") != (span.low == span.high == 0.0) and known(trend):
                yield _fail(
                    path, view.said(path, at), "standing is a speed of 0", "0 m/s, or another trend"
                )
            elif trend == "constant" and span.low <= 0.0:
                yield _fail(
                    path, view.said(path, at), "a constant speed is above 0", "min above 0 m/s"
                )
            elif previous:
                wrong = _course(previous[1], previous[2], span, trend)
                if wrong:
                    yield _fail(path, view.said(path, at, previous[0]), *wrong)
            previous = path, span, trend


def _course(before: Span, held: str, now: Span, trend: str) -> tuple[str, str] | None:
    """What is wrong with a range of speed after another, if anything: (reason, remedy)."""
    steady = held in ("constant", "standing")
    if trend == "constant" and held == "constant" and before != now:
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


def _early(view: View, path: str, wanted: str) -> Failure:
    return _fail(
        path,
        view.said(path, "interaction.type"),
        "the manoeuvre would be visible before the trigger",
        wanted,
    )


def _unseen(view: View, path: str, wanted: str) -> Failure:
    return _fail(
        path,
        view.said(path, "interaction.type", view.road("lane_width")),
        "the trigger starts when the manoeuvre can be seen (METHOD 1), and this can't",
        wanted,
    )


TRIGGER_PREDICATES: tuple[Predicate, ...] = (
    trigger_is_observable,
    conflict_follows_the_trigger,
    trigger_can_fire,
    vut_comes_steadily,
    speeds_follow_trends,
)
