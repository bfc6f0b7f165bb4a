"""C4 of further participants: each has a script of its own, and none causes the conflict."""

from __future__ import annotations

from collections.abc import Iterator

from ssp_core.vocabulary import PHASES, PhaseWord
from ssp_scenario_manager.checks.base import Fail, Failure, Predicate, View, has_meaning
from ssp_scenario_manager.scenarios.further import further_ids

_fail = Fail("C4")

# Motions and speed trends of the scripts: standing, or driving along a lane at one speed.
_MOTIONS = frozenset({"stationary", "same_direction", "oncoming", "receding"})
_TRENDS = frozenset({"standing", "constant"})
_ALONG_THE_ROAD = frozenset(
    {"vut_lane", "left_lane", "right_lane", "oncoming_lane", "left_kerb", "right_kerb"}
)
_KERBS = frozenset({"left_kerb", "right_kerb"})
_BEFORE_RESOLUTION: tuple[PhaseWord, ...] = PHASES[:-1]


def further_keep_to_the_road(view: View) -> Iterator[Failure]:
    """Check that further participants stand, or drive along their lane at one speed."""
    for who in further_ids(view.event):
        place = f"participants.{who}.region.place"
        yield from _fail.unless(
            view,
            view.event.participants[who].region.place,
            _ALONG_THE_ROAD,
            "a further participant keeps to the VUT's road: only the initiator leaves another",
            place,
            "interaction.initiator",
        )
        for phase in PHASES:
            cell, at = view.cell(who, phase), f"motion.{who}.{phase}"
            if cell is None:
                continue
            if has_meaning(cell.motion):
                reason = "it would come into the VUT's way, which makes it an initiator"
                yield from _fail.unless(
                    view, cell.motion, _MOTIONS, reason, f"{at}.motion", "interaction.initiator"
                )
            if cell.speed_trend != "unresolved":
                reason = "a further participant stands, or drives along its lane at one speed"
                yield from _fail.unless(
                    view, cell.speed_trend, _TRENDS, reason, f"{at}.speed_trend"
                )


def further_drive_in_a_lane(view: View) -> Iterator[Failure]:
    """Check that a further participant drives in a lane: beside the road it stands."""
    for who in further_ids(view.event):
        region = view.event.participants[who].region
        for phase in PHASES:
            cell = view.cell(who, phase)
            if region.place in _KERBS and cell is not None and cell.speed_trend == "constant":
                yield _fail(
                    view,
                    "a further participant that drives, drives in a lane",
                    "speed_trend standing, or a lane as its place",
                    f"motion.{who}.{phase}.speed_trend",
                    f"participants.{who}.region.place",
                )


def further_cause_no_conflict(view: View) -> Iterator[Failure]:
    """Require that TTC to a further participant in the VUT's lane stays above its threshold.

    The gap at the start closes at the highest speeds of part C until the resolution of part E.
    """
    times = [f"events.{name}.start" for name in ("clip", "conflict", "resolution")]
    for who in further_ids(view.event):
        region, gap_path = view.event.participants[who].region, f"participants.{who}.region.gap"
        spans = view.spans(*times, "constraints.thresholds.ttc", gap_path)
        if region.place != "vut_lane" or spans is None:
            continue
        start, conflict, resolution, threshold, gap = spans
        closing, paths = _closing_mps(view, who, region.along)
        if closing <= 0.0:
            continue
        # One ahead may come nearer from the start on, one behind once the VUT gives way.
        span_s = resolution.high - (start.low if region.along == "ahead" else conflict.low)
        ttc_s = max(gap.low - closing * span_s, 0.0) / closing
        if ttc_s <= threshold.high:
            yield _fail(
                view,
                f"TTC between the VUT and {who} may be {ttc_s:.2f} s before the resolution, the "
                f"threshold is {threshold.high:g} s, and the conflict is {view.initiator}'s",
                f"a gap above {closing * (span_s + threshold.high):.0f} m, or speeds that differ "
                "less",
                gap_path,
                *paths,
                "constraints.thresholds.ttc",
            )


def leaving_occluder_causes_no_conflict(view: View) -> Iterator[Failure]:
    """Require that part C has values at which the VUT nears the occluder that leaves no conflict.

    The compiler takes them so that TTC stays above its threshold until it leaves, in the trigger.
    """
    who = view.event.interaction.occluder
    if view.kind is None or not view.kind.occluder_leaves or who not in view.event.participants:
        return
    speeds = [f"constraints.speeds.{i}.approach" for i in (view.event.vut_id, who)]
    gap_path, threshold_path = f"participants.{who}.region.gap", "constraints.thresholds.ttc"
    times = ["events.clip.start", "events.trigger.start"]
    spans = view.spans(*times, threshold_path, gap_path, *speeds)
    if spans is None:
        return
    start, trigger, threshold, gap, ours, theirs = spans
    closing = ours.low - theirs.high
    span_s = max(trigger.low - start.high, 0.0)
    if closing > 0.0 and gap.high - closing * span_s <= threshold.low * closing:
        ttc_s = max(gap.high - closing * span_s, 0.0) / closing
        yield _fail(
            view,
            f"TTC between the VUT and {who} is at most {ttc_s:.2f} s when it leaves, the threshold "
            f"is {threshold.low:g} s, and the conflict is {view.initiator}'s",
            f"a gap above {closing * (span_s + threshold.low):.0f} m, or speeds that differ less",
            gap_path,
            *speeds,
            threshold_path,
        )


def _closing_mps(view: View, who: str, along: str) -> tuple[float, list[str]]:
    """Return the highest speed at which the gap may close before the resolution, and its fields."""
    fastest, fields = 0.0, list[str]()
    for phase in _BEFORE_RESOLUTION:
        names = [f"constraints.speeds.{i}.{phase}" for i in (view.event.vut_id, who)]
        spans, cell = view.spans(*names), view.cell(who, phase)
        if spans is None or cell is None:
            continue
        ours, theirs = spans
        if along == "behind":
            closing = theirs.high - ours.low
        elif cell.heading == "opposite":
            closing = ours.high + theirs.high
        else:
            closing = ours.high - theirs.low
        if closing > fastest:
            fastest, fields = closing, names
    return fastest, fields


FURTHER_PREDICATES: tuple[Predicate, ...] = (
    further_keep_to_the_road,
    further_drive_in_a_lane,
    further_cause_no_conflict,
    leaving_occluder_causes_no_conflict,
)
