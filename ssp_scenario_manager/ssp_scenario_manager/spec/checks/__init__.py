"""The checks of a K* (METHOD 1): form, C1–C5 and the review state, all failures together."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ssp_scenario_manager.spec.checks import (
    c1_motion,
    c1_places,
    c1_type,
    c2_topology,
    c3_time,
    c3_trigger,
    c4_interaction,
    c5_executability,
    c5_units,
    form,
    review,
)
from ssp_scenario_manager.spec.checks.base import Predicate, View
from ssp_scenario_manager.spec.failure import Check, Failure
from ssp_scenario_manager.spec.model import Event

# In the order of a report.
PREDICATES: dict[Check, tuple[Predicate, ...]] = {
    "C1": c1_type.PREDICATES + c1_places.PREDICATES + c1_motion.PREDICATES,
    "C2": c2_topology.PREDICATES,
    "C3": c3_time.PREDICATES + c3_trigger.PREDICATES,
    "C4": c4_interaction.PREDICATES,
    "C5": c5_units.PREDICATES + c5_executability.PREDICATES,
    "review": review.PREDICATES,
}


def check_event(event: Event | Mapping[str, Any], *, reviewed: bool = True) -> list[Failure]:
    """Every check that doesn't hold, in a fixed order; [] for a K* that may be compiled.

    Args:
        event: typed, or a mapping as it was read from a file.
        reviewed: whether to check part U too; False for a candidate before its review.
    """
    failures: list[Failure] = []
    view: View | None = View(event) if isinstance(event, Event) else None
    if not isinstance(event, Event):
        view, failures = form.read(event)
    if view is None:
        return failures
    for check, predicates in PREDICATES.items():
        if check == "review" and not reviewed:
            continue
        found = (failure for predicate in predicates for failure in predicate(view))
        failures.extend(failure for failure in found if not _about_stopgap(failure, view))
    return list(dict.fromkeys(failures))


def _about_stopgap(failure: Failure, view: View) -> bool:
    """Whether a failure speaks of a field that couldn't be read, which is reported already."""
    if view.is_broken(failure.field):
        return True
    named = (item.partition(" = ")[0] for item in failure.evidence.split("; "))
    return any(view.is_broken(path) for path in named)
