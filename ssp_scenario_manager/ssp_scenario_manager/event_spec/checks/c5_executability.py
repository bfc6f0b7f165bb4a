"""C5: every quantity has its unit, and speeds, manoeuvre and place lie inside the limits of event
and platform.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from ssp_scenario_manager.event_spec.checks.base import Fail, Failure, Predicate, View, one_of
from ssp_scenario_manager.event_spec.checks.form import allowed
from ssp_scenario_manager.event_spec.fields import (
    UNITS,
    Dimension,
    Span,
    get,
    leaves,
    limit_of,
    rule_of,
    show,
    units_of,
)
from ssp_scenario_manager.event_spec.model import UNRESOLVED

_fail = Fail("C5")
_EPS = 1e-9


def units_are_right(view: View) -> Iterator[Failure]:
    """Every quantity has a unit of what its field measures."""
    for path, found in view.quantities.items():
        wanted, unit = view.dimension(path), found["unit"]
        if wanted is not None and (unit not in UNITS or UNITS[unit].dimension != wanted):
            yield _fail(
                f"{path}.unit",
                view.said(path),
                f"{unit!r} is no unit of {wanted}",
                " or ".join(units_of(wanted)),
                view.origin(path),
            )


def one_unit_each(view: View) -> Iterator[Failure]:
    """One file writes one dimension in one unit: nobody reads 30 km/h as 30 m/s."""
    used: dict[Dimension, dict[str, list[str]]] = {}
    for path, found in view.quantities.items():
        unit = UNITS.get(found["unit"])
        if unit is not None and unit.dimension == view.dimension(path):
            used.setdefault(unit.dimension, {}).setdefault(found["unit"], []).append(path)
    for dimension, by_unit in used.items():
        if len(by_unit) < 2:
            continue
        usual = max(by_unit, key=lambda name: len(by_unit[name]))
        for unit_name, paths in by_unit.items():
            if unit_name != usual:
                for path in paths:
                    yield _fail(
                        f"{path}.unit",
                        view.said(path) + f"; elsewhere {dimension} is in {usual}",
                        "one file writes one dimension in one unit",
                        f"the value in {usual}",
                    )


def intervals_are_shaped(view: View) -> Iterator[Failure]:
    """Intervals are in order and closed where they must be; what has to be exact is."""
    for path, found in view.quantities.items():
        rule = rule_of(path, view.dimension(path) or "")
        low, high = found["min"], found["max"]
        if low is not None and high is not None and low > high:
            yield _fail(
                f"{path}.min",
                view.said(path),
                "min is above max",
                f"min at most {high:g}",
                view.origin(path),
            )
        if low is None and high is None:
            yield _fail(
                path,
                view.said(path),
                "is open on both sides, which says nothing",
                "at least one end, or `unresolved` where that is allowed",
                view.origin(path),
            )
            continue
        if rule is None:
            continue
        needs = {"floor": ("min",), "ceiling": ("max",)}.get(rule.shape, ("min", "max"))
        for end in ("min", "max"):
            if (found[end] is None) == (end in needs):
                yield _fail(
                    f"{path}.{end}",
                    view.said(path),
                    f"a {rule.shape} has {'a' if end in needs else 'no'} {end}",
                    f"a number in {found['unit']}" if end in needs else "null",
                    view.origin(path),
                )
        if rule.shape == "exact" and None not in (low, high) and low != high:
            yield _fail(
                f"{path}.max",
                view.said(path),
                "must be one value",
                "min equal to max",
                view.origin(path),
            )


def inside_the_platform(view: View) -> Iterator[Failure]:
    """No quantity goes beyond what vehicles, dummies, cameras and tracks can do."""
    for path, found in view.quantities.items():
        span, rule = view.measured(path), rule_of(path, view.dimension(path) or "")
        if span is None or rule is None:
            continue
        limit, factor = limit_of(rule), UNITS[found["unit"]].factor
        for end, value in (("min", span.low), ("max", span.high)):
            if math.isinf(value) or limit.low - _EPS <= value <= limit.high + _EPS:
                continue
            yield _fail(
                f"{path}.{end}",
                view.said(path),
                f"{value / factor:g} {found['unit']} is beyond what the platform can do",
                f"{limit.low / factor:.4g}–{limit.high / factor:.4g} {found['unit']}",
                "platform limit",
            )


UNIT_PREDICATES: tuple[Predicate, ...] = (
    units_are_right,
    one_unit_each,
    intervals_are_shaped,
    inside_the_platform,
)


def manoeuvre_is_complete(view: View) -> Iterator[Failure]:
    """Part C gives the manoeuvre's quantities by the names of its kind, and no others."""
    kind, given = view.kind, view.event.constraints.manoeuvre
    if kind is None:
        return
    for name in sorted(set(kind.manoeuvre) ^ set(given)):
        missing = name in kind.manoeuvre
        yield _fail(
            f"constraints.manoeuvre.{name}",
            f"given: {one_of(given) or 'none'}; interaction.type = {kind.name}",
            f"{kind.name} {'needs' if missing else 'knows no'} {name}",
            f"an interval in {kind.manoeuvre[name]}" if missing else one_of(kind.manoeuvre),
        )


def critical_fields_are_known(view: View) -> Iterator[Failure]:
    """No safety-critical field is unresolved: nobody can execute what nobody knows."""
    for path in view.critical:
        if path.startswith("topology."):
            continue  # C2 speaks of identity fields
        for below, value in leaves(get(view.value, path)):
            if value == UNRESOLVED:
                at = f"{path}.{below}" if below else path
                yield _fail(
                    at,
                    view.said(at),
                    "is safety-critical and may not stay unresolved",
                    allowed(at),
                    "open decision",
                )


def inside_the_safety_limits(view: View) -> Iterator[Failure]:
    """Speeds and accelerations stay inside the event's own safety limits."""
    fastest = view.span("constraints.safety.speed")
    hardest = view.span("constraints.safety.acceleration")
    for path in view.quantities:
        span, dimension = view.span(path), view.dimension(path)
        own = path.startswith("constraints.safety.")
        limit = {"speed": fastest, "acceleration": hardest}.get(dimension or "")
        if span is None or limit is None or own or span.high <= limit.high + _EPS:
            continue
        by = f"constraints.safety.{dimension}"
        yield _fail(
            f"{path}.max",
            view.said(path, by),
            "is beyond the event's own safety limit",
            f"at most {show(get(view.value, by))}",
        )


def speeds_hold_the_manoeuvre(view: View) -> Iterator[Failure]:
    """The initiator's speeds run between its approach and the manoeuvre's target speed."""
    kind, who = view.kind, view.initiator
    if kind is None:
        return
    before = view.span(f"constraints.speeds.{who}.approach")
    for name, unit in kind.manoeuvre.items():
        target = view.span(f"constraints.manoeuvre.{name}")
        if unit != "m/s" or before is None or target is None:
            continue
        at = f"constraints.manoeuvre.{name}"
        wrong = {
            "merge": target.high > before.high,
            "following": target.high >= before.low,
            "crossing": target.low <= before.high,
        }[kind.relation]
        if wrong:
            yield _fail(
                at,
                view.said(at, f"constraints.speeds.{who}.approach"),
                "the manoeuvre changes the speed the other way",
                f"a range {'above' if kind.relation == 'crossing' else 'below'} the approach's",
            )
        hull = Span(min(before.low, target.low), max(before.high, target.high))
        for phase in ("trigger", "conflict", "resolution"):
            path = f"constraints.speeds.{who}.{phase}"
            span = view.span(path)
            if span is None:
                continue
            if not hull.holds(span):
                yield _fail(
                    path,
                    view.said(path, at, f"constraints.speeds.{who}.approach"),
                    "goes beyond the speeds before and after the manoeuvre",
                    f"inside {hull.low:g}–{hull.high:g} m/s",
                )
            if phase != "trigger" and not span.holds(target):
                yield _fail(
                    path,
                    view.said(path, at),
                    "leaves out speeds that the manoeuvre may end at",
                    f"at least {target.low:g}–{target.high:g} m/s",
                )


def vut_only_brakes(view: View) -> Iterator[Failure]:
    """The VUT never goes faster than in the approach, and may stand if it may stop."""
    vut = view.event.vut_id
    before = view.span(f"constraints.speeds.{vut}.approach")
    stops = "stop" in view.event.interaction.longitudinal_responses
    speeds_up = "accelerate" in view.event.interaction.longitudinal_responses
    for phase in ("trigger", "conflict", "resolution"):
        path = f"constraints.speeds.{vut}.{phase}"
        span = view.span(path)
        if span is None or before is None:
            continue
        if not speeds_up and span.high > before.high + _EPS:
            yield _fail(
                path,
                view.said(path, f"constraints.speeds.{vut}.approach"),
                "no admissible response makes the VUT faster",
                f"at most {before.high:g} m/s",
            )
        if stops and phase in ("conflict", "resolution") and span.low > 0.0:
            yield _fail(
                path,
                view.said(path, "interaction.longitudinal_responses"),
                "a VUT that may stop has 0 in its range",
                "min 0",
            )


def lane_change_is_drivable(view: View) -> Iterator[Failure]:
    """A lane change over the widest lane in the shortest time keeps to the safety limit."""
    width, time = view.span(view.road("lane_width")), view.span("constraints.manoeuvre.duration")
    limit = view.span("constraints.safety.acceleration")
    if width is None or time is None or limit is None or time.low <= 0.0:
        return
    # Half the way with, half against the least lateral acceleration: w = a t² / 4.
    needed = 4.0 * width.high / time.low**2
    if needed > limit.high:
        path = "constraints.manoeuvre.duration"
        yield _fail(
            path,
            view.said(path, view.road("lane_width"), "constraints.safety.acceleration"),
            f"takes at least {needed:.2f} m/s^2 of lateral acceleration",
            f"at least {math.sqrt(4.0 * width.high / limit.high):.2f} s",
        )


def site_is_large_enough(view: View) -> Iterator[Failure]:
    """The site is long enough for approach and braking, and wide enough beyond the kerb."""
    vut, who = view.event.vut_id, view.initiator
    c = "constraints"
    clearance, kerb = (
        view.span(f"{c}.site.lateral_clearance"),
        view.span(f"{c}.manoeuvre.kerb_distance"),
    )
    if clearance and kerb and clearance.low < kerb.high:
        yield _fail(
            f"{c}.site.lateral_clearance",
            view.said(f"{c}.site.lateral_clearance", f"{c}.manoeuvre.kerb_distance"),
            "the initiator may have to wait beyond the site's edge",
            f"at least {kerb.high:g} m",
        )
    length, gap = view.span(f"{c}.site.length"), view.span(f"participants.{who}.region.gap")
    ours, theirs = view.span(f"{c}.speeds.{vut}.approach"), view.span(f"{c}.speeds.{who}.approach")
    below, hardest = view.span(f"{c}.trigger.below"), view.span(f"{c}.safety.acceleration")
    if not (length and gap and ours and theirs and below and hardest) or hardest.high <= 0.0:
        return
    if view.event.constraints.trigger.quantity == "time_to_arrival":
        needed = gap.high
    else:
        closing = ours.low - theirs.high
        if closing <= 0.0:
            return
        braking_m = ours.high**2 / (2.0 * hardest.high)
        needed = ours.high * max(0.0, gap.high - below.low) / closing + braking_m
    if length.low < needed:
        yield _fail(
            f"{c}.site.length",
            view.said(
                f"{c}.site.length",
                f"participants.{who}.region.gap",
                f"{c}.speeds.{vut}.approach",
                f"{c}.speeds.{who}.approach",
                f"{c}.trigger.below",
            ),
            "the event may need more road than the site must have",
            f"at least {math.ceil(needed)} m, or a narrower initial gap",
        )


def weights_count_something(view: View) -> Iterator[Failure]:
    """Not every weight of KPR is 0."""
    weights = view.event.constraints.weights
    if len(weights) == 5 and not any(weights.values()):
        yield _fail(
            "constraints.weights",
            view.said("constraints.weights"),
            "KPR would divide by 0 (METHOD 4)",
            "at least one weight above 0",
        )


EXECUTABILITY_PREDICATES: tuple[Predicate, ...] = (
    manoeuvre_is_complete,
    critical_fields_are_known,
    inside_the_safety_limits,
    speeds_hold_the_manoeuvre,
    vut_only_brakes,
    lane_change_is_drivable,
    site_is_large_enough,
    weights_count_something,
)
