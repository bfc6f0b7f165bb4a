"""Why a recording is refused: one table of causes and what they bring with them.

The order of the table is the order of precedence. A finding stands under the first one above it
that may have brought it about; what has nobody above it is a cause of its own, and the first of
these is the primary reason (METHOD 4).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Meaning:
    """What a code says.

    Args:
        text: the finding in a few words.
        check: what is looked at.
        brings: codes that follow from it where it is found.
    """

    text: str
    check: str
    brings: frozenset[str] = frozenset()


_PHASES = frozenset(
    {"approach_phase", "trigger_phase", "conflict_phase", "resolution_phase", "epd_missing"}
)
_CAMERA = frozenset({"participant_off_camera", "zone_off_camera", "coverage_unknown"})
_PROPERTIES = frozenset(
    {"conflict_type_differs", "motion_differs", "order_differs", "lane_differs", "place_differs"}
)
_EVENT = frozenset({"no_manoeuvre", "conflict_missing", "conflict_unresolved", "event_awaited"})
_EVERYTHING = _PHASES | _CAMERA | _PROPERTIES | _EVENT | {"roles_swapped", "wrong_side"}
# What an end before its time can change: neither sides nor lanes nor who takes part.
_CUT_SHORT = (
    _PHASES | _CAMERA | _EVENT | {"conflict_type_differs", "motion_differs", "order_differs"}
)

TABLE: dict[str, Meaning] = {
    "not_compiled": Meaning(
        "not compiled from a K*",
        "the bag holds a sealed task (task.json) and the K* that it was made from",
        frozenset({"other_event", "epd_missing"}),
    ),
    "seal_broken": Meaning(
        "a sealed file was changed",
        "task.json, event.yaml and site.yaml in the bag have the hashes that the task names",
        frozenset({"other_event"}),
    ),
    "other_event": Meaning(
        "made from another K* version",
        "all three recordings name the same K* version",
        frozenset({"epd_missing"}),
    ),
    "other_source": Meaning(
        "not the source clip of the K*",
        "an imported video is the one that the K* was taken from, in its crop",
        frozenset(),
    ),
    "same_recording": Meaning(
        "the recording of another domain",
        "no two of the recordings are the same bag or were made from the same file",
        frozenset(),
    ),
    "unlogged_change": Meaning(
        "changed on site without a record",
        "every difference between what was compiled and what ran has a record in the log",
        _EVERYTHING | {"roles_differ", "topology_differs"},
    ),
    "identity_switch": Meaning(
        "identity switch",
        "every participant keeps its id and class, and nobody else appears under them",
        _EVERYTHING | {"roles_differ", "safety_abort", "run_invalid"},
    ),
    "safety_abort": Meaning(
        "safety abort",
        "no safety event was recorded, and the session wasn't aborted",
        _CUT_SHORT | {"run_invalid"},
    ),
    "run_invalid": Meaning(
        "the run is not valid",
        "the run's verdict is valid",
        _CUT_SHORT,
    ),
    "verdict_missing": Meaning(
        "the runner's word is missing",
        "the bag holds verdict.json, in which `ssp run` says how the run ended",
        frozenset(),
    ),
    "unverified": Meaning(
        "unverified",
        "every property, the phases and the log are measured, observed by a named person, or "
        "reviewed in the K* of which this is the source clip",
        frozenset({"epd_missing", "coverage_unknown"}),
    ),
    "observation_differs": Meaning(
        "an observation differs",
        "what a person saw is what the states show",
        frozenset(),
    ),
    "source_rejected": Meaning(
        "rejected by who looked at it",
        "no participant is deformed or changes, motion and road hold together, and there is a "
        "conflict",
        frozenset(),
    ),
    "no_video": Meaning(
        "no forward video",
        "the recording has camera frames",
        _CAMERA | _PHASES,
    ),
    "roles_swapped": Meaning(
        "roles swapped",
        "the participants have the roles of the K*",
        (_EVERYTHING | {"roles_differ"}) - {"roles_swapped"},
    ),
    "roles_differ": Meaning(
        "other participants",
        "the participants have the classes and roles of the K*",
        _EVERYTHING - {"roles_swapped"},
    ),
    "topology_differs": Meaning(
        "another road",
        "the road driven on has the lanes and the shape of the K*",
        _EVERYTHING - {"roles_swapped"},
    ),
    "wrong_side": Meaning(
        "from the wrong side",
        "the manoeuvre comes from the side that the K* says",
        frozenset({"motion_differs", "lane_differs", "place_differs"}),
    ),
    "no_manoeuvre": Meaning(
        "no observable manoeuvre",
        "the OT's manoeuvre becomes observable",
        _PHASES | _CAMERA | _PROPERTIES | {"event_awaited", "conflict_missing", "off_spec"},
    ),
    "conflict_missing": Meaning(
        "conflict missing",
        "TTC or the gap between the arrivals falls under the K*'s threshold after the trigger",
        _PHASES | _CAMERA | _PROPERTIES | {"event_awaited", "conflict_unresolved", "off_spec"},
    ),
    "conflict_unresolved": Meaning(
        "conflict not resolved",
        "the conflict ends within the clip",
        _PHASES | _CAMERA | {"event_awaited"},
    ),
    "conflict_type_differs": Meaning(
        "another type of conflict",
        "the paths meet as the K* says: merge, crossing or following",
        frozenset({"motion_differs", "order_differs", "lane_differs", "place_differs"}),
    ),
    "motion_differs": Meaning(
        "another dominant motion",
        "the motion that holds longest from trigger to resolution is that of the K*",
        frozenset(),
    ),
    "order_differs": Meaning(
        "another passing order",
        "the participants reach the conflict zone in the K*'s order",
        _CAMERA | {"off_spec"},
    ),
    "off_spec": Meaning(
        "outside the K*",
        "time gap and passing order lie in the K*'s range, and the run's verdict isn't off_spec",
        frozenset({"event_awaited"}),
    ),
    "event_awaited": Meaning(
        "the session ended for want of the event",
        "no safety event says that the event did not take place in time",
        frozenset(),
    ),
    "lane_differs": Meaning(
        "another lane", "the VUT drives, and the OT comes, in the lanes of the K*", frozenset()
    ),
    "place_differs": Meaning(
        "another initial region", "every participant starts in the region of the K*", frozenset()
    ),
    "approach_phase": Meaning(
        "approach phase not located", "at least 0.5 s of it lie in the clip", frozenset()
    ),
    "trigger_phase": Meaning(
        "trigger phase not located", "the trigger's start is found", frozenset()
    ),
    "conflict_phase": Meaning(
        "conflict phase not located", "the conflict's start is found", frozenset()
    ),
    "resolution_phase": Meaning(
        "resolution phase not located", "the resolution's start is found", frozenset()
    ),
    "epd_missing": Meaning(
        "EPD can't be computed",
        "all event times are known here and in Synthetic, and the K* says how long its source's "
        "approach and resolution are",
        frozenset(),
    ),
    "participant_off_camera": Meaning(
        "a participant is off camera",
        "each participant is visible for the K*'s share of the time from trigger to resolution",
        frozenset({"zone_off_camera"}),
    ),
    "zone_off_camera": Meaning(
        "the conflict zone is off camera",
        "the conflict zone is visible for that share of the time until the VUT reaches it",
        frozenset(),
    ),
    "coverage_unknown": Meaning(
        "camera coverage unknown",
        "the camera's geometry is recorded, or persons said what is visible",
        frozenset(),
    ),
}
_RANK = {code: index for index, code in enumerate(TABLE)}


@dataclass(frozen=True)
class Finding:
    """One thing that keeps a recording out.

    Args:
        code: of the table.
        detail: what was found and what was wanted, with units.
        t_s: clip time at which it happens, for what never happens +inf; None: at no time. A finding
            can't follow from a later one.
    """

    code: str
    detail: str
    t_s: float | None = None

    @property
    def text(self) -> str:
        return TABLE[self.code].text


@dataclass(frozen=True)
class Reason:
    """A cause, with the findings that follow from it."""

    finding: Finding
    consequences: tuple[Finding, ...]


def explain(findings: Iterable[Finding]) -> tuple[Reason, ...]:
    """Causes in order of precedence, each with its consequences (METHOD 4).

    Args:
        findings: in any order; the same one twice counts once.

    Raises:
        KeyError: a code that isn't in the table.
    """
    ranked = sorted(
        dict.fromkeys(findings),
        key=lambda f: (_RANK[f.code], -math.inf if f.t_s is None else f.t_s, f.detail),
    )
    reasons: dict[Finding, list[Finding]] = {}
    root_of: dict[Finding, Finding] = {}
    for finding in ranked:
        cause = next((c for c in root_of if _brings(c, finding)), None)
        if cause is None:
            root_of[finding] = finding
            reasons[finding] = []
        else:
            root_of[finding] = root_of[cause]
            reasons[root_of[cause]].append(finding)
    return tuple(Reason(cause, tuple(rest)) for cause, rest in reasons.items())


def _brings(cause: Finding, finding: Finding) -> bool:
    if cause.code == finding.code:
        # What happens once more doesn't stand beside the first time.
        return cause.t_s is not None and finding.t_s is not None
    if finding.code not in TABLE[cause.code].brings:
        return False
    return cause.t_s is None or finding.t_s is None or cause.t_s <= finding.t_s
