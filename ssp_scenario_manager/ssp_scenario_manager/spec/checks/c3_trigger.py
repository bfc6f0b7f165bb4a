"""C3: no conflict before an observable trigger, which can fire; speeds follow their trends."""

from __future__ import annotations

from collections.abc import Iterator

from ssp_core.motion.encounter import OBSERVABLE_BRAKING_MPS2, OBSERVABLE_LATERAL_MPS
from ssp_core.vocabulary import PHASES
from ssp_scenario_manager.spec.checks.base import Fail, Predicate, View, known
from ssp_scenario_manager.spec.failure import Failure
from ssp_scenario_manager.spec.units import Span

_fail = Fail("C3")


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


PREDICATES: tuple[Predicate, ...] = (
    trigger_is_observable,
    conflict_follows_the_trigger,
    trigger_can_fire,
    vut_comes_steadily,
    speeds_follow_trends,
)
