"""C5: quantities with their units; speeds, manoeuvre and place within event and platform limits."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator

from ssp_core.motion.event import NO_CONFLICT_S
from ssp_scenario_manager.checks.base import Fail, Failure, Predicate, View, one_of
from ssp_scenario_manager.checks.form import allowed
from ssp_scenario_manager.event_spec.fields import UNITS, Span, get, leaves, show, units_of
from ssp_scenario_manager.event_spec.model import UNRESOLVED

_fail = Fail("C5")
_EPS = 1e-9


def units_are_right(view: View) -> Iterator[Failure]:
    """Check that every quantity has a unit of what its field measures."""
    for path, interval in view.quantities.items():
        rule = view.rule(path)
        if rule is not None and view.measured(path) is None:
            yield _fail(
                view,
                f"{interval.unit!r} is no unit of {rule.dimension}",
                " or ".join(units_of(rule.dimension)),
                f"{path}.unit",
                evidence=view.evidence(path),
                origin=view.origin(path),
            )


def one_unit_each(view: View) -> Iterator[Failure]:
    """Check that a file writes a dimension in one unit, lest 30 km/h be read as 30 m/s."""
    right = {p: q.unit for p, q in view.quantities.items() if view.measured(p) is not None}
    for dimension in dict.fromkeys(UNITS[unit].dimension for unit in right.values()):
        used = Counter(unit for unit in right.values() if UNITS[unit].dimension == dimension)
        usual = used.most_common(1)[0][0]
        for path, unit in right.items():
            if unit in used and unit != usual:
                yield _fail(
                    view,
                    "one file writes one dimension in one unit",
                    f"the value in {usual}",
                    f"{path}.unit",
                    evidence=f"{view.evidence(path)}; elsewhere {dimension} is in {usual}",
                )


def intervals_are_shaped(view: View) -> Iterator[Failure]:
    """Check that intervals are in order, closed where they must be, and exact where needed."""
    for path, interval in view.quantities.items():
        rule, low, high = view.rule(path), interval.min, interval.max
        wrong: list[tuple[str, str, str]] = []
        if low is None and high is None:
            remedy = "at least one end, or `unresolved` where that is allowed"
            wrong.append(("", "is open on both sides, which says nothing", remedy))
        elif low is not None and high is not None and low > high:
            wrong.append((".min", "min is above max", f"min at most {high:g}"))
        if rule is not None and not (low is None and high is None):
            for name, end in (("min", low), ("max", high)):
                needed = name in rule.needs
                if (end is None) == needed:
                    reason = f"a {rule.shape} has {'a' if needed else 'no'} {name}"
                    wrong.append(
                        (f".{name}", reason, f"a number in {interval.unit}" if needed else "null")
                    )
            if rule.shape == "exact" and None not in (low, high) and low != high:
                wrong.append((".max", "must be one value", "min equal to max"))
        for part, reason, remedy in wrong:
            evidence, origin = view.evidence(path), view.origin(path)
            yield _fail(view, reason, remedy, path + part, evidence=evidence, origin=origin)


def inside_the_platform(view: View) -> Iterator[Failure]:
    """Check that no quantity exceeds what vehicles, dummies, cameras and tracks can do."""
    for path, interval in view.quantities.items():
        span, rule = view.measured(path), view.rule(path)
        if span is None or rule is None:
            continue
        limit, factor = rule.limit, UNITS[interval.unit].factor
        for end, value in (("min", span.low), ("max", span.high)):
            if math.isfinite(value) and not limit.holds(value):
                yield _fail(
                    view,
                    f"{value / factor:g} {interval.unit} is beyond what the platform can do",
                    f"{limit.low / factor:.4g}–{limit.high / factor:.4g} {interval.unit}",
                    f"{path}.{end}",
                    evidence=view.evidence(path),
                    origin="platform limit",
                )


UNIT_PREDICATES: tuple[Predicate, ...] = (
    units_are_right,
    one_unit_each,
    intervals_are_shaped,
    inside_the_platform,
)


def manoeuvre_is_complete(view: View) -> Iterator[Failure]:
    """Check that part C gives exactly the manoeuvre's quantities, by the names of its kind."""
    kind, quantities = view.kind, view.event.constraints.manoeuvre
    if kind is None:
        return
    for name in sorted(set(kind.manoeuvre) ^ set(quantities)):
        missing = name in kind.manoeuvre
        yield _fail(
            view,
            f"{kind.name} {'needs' if missing else 'knows no'} {name}",
            f"an interval in {kind.manoeuvre[name]}" if missing else one_of(kind.manoeuvre),
            f"constraints.manoeuvre.{name}",
            evidence=f"given: {one_of(quantities) or 'none'}; interaction.type = {kind.name}",
        )


def critical_fields_are_known(view: View) -> Iterator[Failure]:
    """Check that no safety-critical field is unresolved, which could not be executed."""
    for path in view.critical:
        if path.startswith("topology."):
            continue  # C2 speaks of identity fields
        for below, value in leaves(get(view.value, path)):
            if value == UNRESOLVED:
                at = f"{path}.{below}" if below else path
                reason = "is safety-critical and may not stay unresolved"
                yield _fail(view, reason, allowed(at), at, origin="open decision")


def conflict_comes_in_time(view: View) -> Iterator[Failure]:
    """Check that the conflict comes soon enough after the trigger to be its conflict."""
    paths = ("events.conflict.start", "events.trigger.start")
    spans = view.spans(*paths)
    if spans is not None and spans[0].low - spans[1].high > NO_CONFLICT_S:
        yield _fail(
            view,
            f"comes {spans[0].low - spans[1].high:.1f} s after the trigger; a trigger that no "
            f"conflict follows within {NO_CONFLICT_S:g} s leads to none",
            f"a conflict at most {NO_CONFLICT_S:g} s after the trigger, or a later trigger",
            *paths,
        )


def inside_the_safety_limits(view: View) -> Iterator[Failure]:
    """Check that speeds and accelerations stay inside the event's own safety limits."""
    for path in view.quantities:
        span, rule = view.span(path), view.rule(path)
        if span is None or rule is None or path.startswith("constraints.safety."):
            continue
        by = f"constraints.safety.{rule.dimension}"
        limit = view.span(by) if rule.dimension in ("speed", "acceleration") else None
        if limit is not None and span.high > limit.high + _EPS:
            yield _fail(
                view,
                "is beyond the event's own safety limit",
                f"at most {show(get(view.value, by))}",
                f"{path}.max",
                evidence=view.evidence(path, by),
            )


def speeds_hold_the_manoeuvre(view: View) -> Iterator[Failure]:
    """Check that the initiator's speeds lead from its approach to the manoeuvre's target."""
    kind, speeds = view.kind, f"constraints.speeds.{view.initiator}"
    for name in [n for n, unit in kind.manoeuvre.items() if unit == "m/s"] if kind else ():
        at, approach = f"constraints.manoeuvre.{name}", f"{speeds}.approach"
        spans = view.spans(approach, at)
        if spans is None or kind is None:
            continue
        before, target = spans
        rises = kind.relation == "crossing" or kind.at_junction
        wrong = {
            "merge": target.high > before.high,
            "following": target.high >= before.low,
        }.get(kind.relation)
        if rises:
            wrong = target.low <= before.high
        if wrong:
            remedy = f"a range {'above' if rises else 'below'} the approach's"
            yield _fail(view, "the manoeuvre changes the speed the other way", remedy, at, approach)
        hull = Span(min(before.low, target.low), max(before.high, target.high))
        for phase in ("trigger", "conflict", "resolution"):
            path = f"{speeds}.{phase}"
            span = view.span(path)
            if span is None:
                continue
            if not hull.holds(span):
                reason = "goes beyond the speeds before and after the manoeuvre"
                remedy = f"inside {hull.low:g}–{hull.high:g} m/s"
                yield _fail(view, reason, remedy, path, at, approach)
            if phase != "trigger" and not span.holds(target):
                reason = "leaves out speeds that the manoeuvre may end at"
                remedy = f"at least {target.low:g}–{target.high:g} m/s"
                yield _fail(view, reason, remedy, path, at)


def vut_only_brakes(view: View) -> Iterator[Failure]:
    """Check that the VUT never exceeds its approach speed, and may stand if it may stop."""
    speeds, responses = f"constraints.speeds.{view.event.vut_id}", "longitudinal_responses"
    admissible = view.event.interaction.longitudinal_responses
    for phase in ("trigger", "conflict", "resolution"):
        spans = view.spans(f"{speeds}.{phase}", f"{speeds}.approach")
        if spans is None:
            continue
        span, before = spans
        path = f"{speeds}.{phase}"
        if "accelerate" not in admissible and span.high > before.high + _EPS:
            reason = "no admissible response makes the VUT faster"
            yield _fail(view, reason, f"at most {before.high:g} m/s", path, f"{speeds}.approach")
        if "stop" in admissible and phase != "trigger" and span.low > 0.0:
            reason = "a VUT that may stop has 0 in its range"
            yield _fail(view, reason, "min 0", path, f"interaction.{responses}")


def lane_change_is_drivable(view: View) -> Iterator[Failure]:
    """Check that the widest lane change in the shortest time keeps to the safety limit."""
    names = (
        "constraints.manoeuvre.duration",
        view.road("lane_width"),
        "constraints.safety.acceleration",
    )
    spans = view.spans(*names)
    if spans is None or spans[0].low <= 0.0:
        return
    time, width, limit = spans
    # Half the way with, half against the least lateral acceleration: w = a t² / 4.
    needed = 4.0 * width.high / time.low**2
    if needed > limit.high:
        reason = f"takes at least {needed:.2f} m/s^2 of lateral acceleration"
        remedy = f"at least {math.sqrt(4.0 * width.high / limit.high):.2f} s"
        yield _fail(view, reason, remedy, *names)


def site_is_large_enough(view: View) -> Iterator[Failure]:
    """Check that the site is long enough for approach and braking, and wide enough at the kerb."""
    vut, who, c = view.event.vut_id, view.initiator, "constraints"
    names = [f"{c}.site.lateral_clearance", f"{c}.manoeuvre.kerb_distance"]
    spans = view.spans(*names)
    if spans and spans[0].low < spans[1].high:
        reason = "the initiator may have to wait beyond the site's edge"
        yield _fail(view, reason, f"at least {spans[1].high:g} m", *names)
    names = [
        f"{c}.site.length",
        f"participants.{who}.region.gap",
        f"{c}.speeds.{vut}.approach",
        f"{c}.speeds.{who}.approach",
        f"{c}.trigger.below",
    ]
    spans = view.spans(*names, f"{c}.safety.acceleration")
    if spans is None or spans[-1].high <= 0.0:
        return
    length, gap, ours, theirs, below, hardest = spans
    closing = ours.low - theirs.high
    if view.event.constraints.trigger.quantity == "time_to_arrival":
        needed = gap.high
    elif closing > 0.0:
        braking_m = ours.high**2 / (2.0 * hardest.high)
        needed = ours.high * max(0.0, gap.high - below.low) / closing + braking_m
    else:
        return
    if length.low < needed:
        reason = "the event may need more road than the site must have"
        remedy = f"at least {math.ceil(needed)} m, or a narrower initial gap"
        yield _fail(view, reason, remedy, *names)


def weights_count_something(view: View) -> Iterator[Failure]:
    """Check that not every weight of KPR is 0."""
    weights = view.event.constraints.weights
    if len(weights) == 5 and not any(weights.values()):
        reason, remedy = "KPR would divide by 0 (METHOD 4)", "at least one weight above 0"
        yield _fail(view, reason, remedy, "constraints.weights")


EXECUTABILITY_PREDICATES: tuple[Predicate, ...] = (
    manoeuvre_is_complete,
    critical_fields_are_known,
    conflict_comes_in_time,
    inside_the_safety_limits,
    speeds_hold_the_manoeuvre,
    vut_only_brakes,
    lane_change_is_drivable,
    site_is_large_enough,
    weights_count_something,
)
