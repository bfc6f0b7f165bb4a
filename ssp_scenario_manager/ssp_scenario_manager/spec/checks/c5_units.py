"""C5: every quantity has its unit, is well formed and lies inside the platform's limits."""

from __future__ import annotations

import math
from collections.abc import Iterator

from ssp_scenario_manager.spec.checks.base import Fail, Predicate, View
from ssp_scenario_manager.spec.failure import Failure
from ssp_scenario_manager.spec.platform import limit_of, rule_of
from ssp_scenario_manager.spec.units import UNITS, Dimension, units_of

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


PREDICATES: tuple[Predicate, ...] = (
    units_are_right,
    one_unit_each,
    intervals_are_shaped,
    inside_the_platform,
)
