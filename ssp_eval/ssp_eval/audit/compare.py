"""From two values of the same property to findings: what exactly is not preserved."""

from __future__ import annotations

import math
from collections.abc import Mapping

from ssp_eval.audit.measure import Phases
from ssp_eval.audit.reasons import Finding
from ssp_eval.recordings.crop import LOCATED_S
from ssp_eval.recordings.properties import (
    CONFLICT,
    FIELDS,
    MOTION,
    ORDER,
    ROLES,
    TOPOLOGY,
    Property,
    differences,
)

_MIRRORED = {
    "cutting_in_from_left": "cutting_in_from_right",
    "cutting_in_from_right": "cutting_in_from_left",
    "crossing_from_left": "crossing_from_right",
    "crossing_from_right": "crossing_from_left",
}
_OF_LANES = {"vut_lane", "adjacency"}
_CODES = {CONFLICT: "conflict_type_differs", ORDER: "order_differs", MOTION: "motion_differs"}


def property_findings(
    found: Mapping[str, Property],
    wanted: Mapping[str, Property],
    phases: Phases | None,
    first_arrival_s: float | None,
) -> list[Finding]:
    """What of the mandatory properties isn't preserved.

    Args:
        found: q(d, k) of the fields that are verified.
        wanted: what it must be equal to; a field that isn't determined there judges nothing.
        phases: of this recording; None: nobody located any.
        first_arrival_s: at the conflict zone, None: nobody arrives.
    """
    # From when on nothing that happens can change the value.
    decided_s = {
        MOTION: math.inf if phases is None or phases.resolution_s is None else phases.resolution_s,
        CONFLICT: math.inf if first_arrival_s is None else first_arrival_s,
        ORDER: math.inf if first_arrival_s is None else first_arrival_s,
    }
    findings: list[Finding] = []
    for field in FIELDS:
        value, reference = found.get(field), wanted[field]
        if value is None or reference.words is None:
            continue
        if value.words is None:
            code = _CODES.get(field, "topology_differs" if field == TOPOLOGY else "roles_differ")
            findings.append(Finding(code, f"can't be determined: {value.how}", math.inf))
            continue
        parts = differences(value, reference) or {}
        if field == TOPOLOGY:
            findings += _topology(parts)
        elif field == ROLES:
            findings += _roles(parts)
        elif parts:
            findings.append(_one(field, parts, decided_s[field], value.how))
    return findings


def _one(field: str, parts: Mapping[str, tuple[str, str]], decided_s: float, how: str) -> Finding:
    ((ours, theirs),) = parts.values()
    text = f"{ours} instead of {theirs} ({how})"
    if field == MOTION and _MIRRORED.get(theirs) == ours:
        return Finding("wrong_side", text)
    return Finding(_CODES[field], text, decided_s)


def _topology(parts: Mapping[str, tuple[str, str]]) -> list[Finding]:
    findings = []
    for code, names in (
        ("topology_differs", [n for n in parts if n not in _OF_LANES]),
        ("lane_differs", [n for n in parts if n in _OF_LANES]),
    ):
        if names:
            text = "; ".join(f"{n} {parts[n][0]} instead of {parts[n][1]}" for n in names)
            findings.append(Finding(code, text))
    return findings


def _roles(parts: Mapping[str, tuple[str, str]]) -> list[Finding]:
    findings = []
    starts = {name: pair for name, pair in parts.items() if name.endswith(" starts in")}
    if starts:
        text = "; ".join(f"{n} {ours} instead of {theirs}" for n, (ours, theirs) in starts.items())
        findings.append(Finding("place_differs", text, 0.0))
    rest = {name: pair for name, pair in parts.items() if name not in starts}
    if not rest:
        return findings
    text = "; ".join(f"{n}: {ours} instead of {theirs}" for n, (ours, theirs) in rest.items())
    turned = {"initiator", "affected"} <= set(rest) and (
        rest["initiator"] == rest["affected"][::-1]
    )
    people = {n: pair for n, pair in rest.items() if n not in ("initiator", "affected")}
    exchanged = len(people) > 1 and sorted(p[0] for p in people.values()) == sorted(
        p[1] for p in people.values()
    )
    findings.append(Finding("roles_swapped" if turned or exchanged else "roles_differ", text))
    return findings


def phase_findings(phases: Phases, closest: str) -> list[Finding]:
    """Which key phases can't be located, and why.

    Args:
        phases: of the recording.
        closest: how near it came to a conflict, for people; empty where nobody measured it.
    """
    findings = []
    never = math.inf
    if not phases.has_approach and phases.trigger_s is not None:
        text = (
            f"{phases.trigger_s - phases.start_s:.2f} s of it lie in the clip, of {LOCATED_S:g} s"
        )
        findings.append(Finding("approach_phase", text, 0.0))
    if not phases.has_resolution and phases.resolution_s is not None:
        text = (
            f"{phases.end_s - phases.resolution_s:.2f} s of it lie in the clip, of {LOCATED_S:g} s"
        )
        findings.append(Finding("resolution_phase", text, phases.resolution_s))
    missing = []
    if phases.trigger_s is None:
        findings.append(
            Finding("no_manoeuvre", "nobody's manoeuvre becomes observable in the clip", never)
        )
        missing = ["trigger", "conflict", "resolution"]
    elif phases.conflict_s is None:
        text = f"after the trigger at {phases.trigger_s:.2f} s {closest or 'nobody saw one'}"
        findings.append(Finding("conflict_missing", text, never))
        missing = ["conflict", "resolution"]
    elif phases.resolution_s is None:
        text = f"it lasts from {phases.conflict_s:.2f} s to the clip's end"
        findings.append(Finding("conflict_unresolved", text, never))
        missing = ["resolution"]
    findings += [
        Finding(f"{phase}_phase", f"the start of the {phase} phase isn't in the clip", never)
        for phase in missing
    ]
    if missing:
        findings.append(
            Finding("epd_missing", f"there is no time of {' and '.join(missing)}", never)
        )
    return findings
