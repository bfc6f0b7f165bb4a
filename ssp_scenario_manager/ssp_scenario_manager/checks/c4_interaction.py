"""C4: conflict zone, passing order and responses agree; some response is always admissible."""

from __future__ import annotations

from collections.abc import Iterator

from ssp_scenario_manager.checks.base import (
    Fail,
    Failure,
    Predicate,
    View,
    has_meaning,
    one_of,
)
from ssp_scenario_manager.scenarios.events.kinds import KINDS

_fail = Fail("C4")

# Until a VUT that reacts has its brakes on: what a feasible response allows for.
REACTION_S = 0.5
# What the VUT does in the conflict, by its speed trend in part M.
_DOES = {
    "standing": frozenset({"stop"}),
    "decreasing": frozenset({"decelerate", "stop"}),
    "constant": frozenset({"maintain"}),
    "increasing": frozenset({"accelerate"}),
}
_GIVES_WAY = frozenset({"decelerate", "stop"})
_EXTREME = {"left": "leftmost", "right": "rightmost"}


def kind_is_known(view: View) -> Iterator[Failure]:
    """Check that the type is a kind of interaction that the project knows."""
    path = "interaction.type"
    if view.kind is None:
        reason = "the needs of this kind of interaction aren't defined"
        yield _fail(view, reason, one_of(KINDS), path, origin=view.origin(path))


def words_fit_the_kind(view: View) -> Iterator[Failure]:
    """Check that relation, conflict zone, dominant motion and trigger are those of the kind."""
    kind, interaction = view.kind, view.event.interaction
    if kind is None:
        return
    quantity = view.event.constraints.trigger.quantity
    for path, word, choices in (
        ("interaction.relation", interaction.relation, {kind.relation}),
        ("interaction.zone", interaction.zone, {kind.zone}),
        ("interaction.dominant_motion", interaction.dominant_motion, kind.dominant_motions),
        ("constraints.trigger.quantity", quantity, kind.trigger_quantities),
    ):
        reason = f"{kind.name} has another"
        yield from _fail.unless(view, word, choices, reason, path, "interaction.type")


def intent_fits_the_kind_and_the_motion(view: View) -> Iterator[Failure]:
    """Require the VUT's intent to be that of the kind, and no cell or response to deny it."""
    vut, interaction = view.event.vut_id, view.event.interaction
    path, intent = f"participants.{vut}.intent", view.event.participants[vut].intent
    if not has_meaning(intent):
        return
    if view.kind:
        reason = f"in {view.kind.name} the VUT goes on as it came"
        intents = view.kind.vut_intents
        yield from _fail.unless(view, intent, intents, reason, path, "interaction.type")
    side = str(intent).rpartition("_")[2]
    for phase in ("approach", "trigger"):
        cell, at = view.cell(vut, phase), f"motion.{vut}.{phase}.lateral"
        if cell and cell.lateral == {"left": "right", "right": "left"}.get(side):
            yield _fail(view, "the VUT goes the other way", f"none or {side}", at, path)
    allowed = {side, "straight"} if side in ("left", "right") else {"straight"}
    if not allowed & set(interaction.lateral_responses):
        yield _fail(
            view,
            "no response lets the VUT go on as it means to, not even once the way is free",
            f"add {one_of(allowed)}",
            "interaction.lateral_responses",
            path,
        )
    cell, at = view.cell(vut, "resolution"), f"motion.{vut}.resolution.speed_trend"
    if intent == "stop" and cell and cell.speed_trend == "increasing":
        yield _fail(view, "who means to stop doesn't drive on", "standing", at, path)


def dominant_motion_is_seen(view: View) -> Iterator[Failure]:
    """Check that the dominant motion is the initiator's in the trigger and conflict phases."""
    dominant = view.event.interaction.dominant_motion
    for phase in ("trigger", "conflict"):
        cell = view.cell(view.initiator, phase)
        if cell and cell.motion is not None:
            yield from _fail.unless(
                view,
                cell.motion,
                [dominant],
                "the dominant motion holds longest between trigger and resolution (METHOD 1)",
                f"motion.{view.initiator}.{phase}.motion",
                "interaction.dominant_motion",
            )


def conflict_is_closing(view: View) -> Iterator[Failure]:
    """Require that the gap between VUT and initiator closes from the trigger into the conflict."""
    for phase in ("trigger", "conflict"):
        cell, path = (
            view.cell(view.initiator, phase),
            f"motion.{view.initiator}.{phase}.longitudinal",
        )
        if cell:
            reason = "nothing conflicts without coming nearer"
            yield from _fail.unless(view, cell.longitudinal, ["closing"], reason, path)


def passing_order_fits(view: View) -> Iterator[Failure]:
    """Require that the participant which arrives first at the conflict point may do so."""
    kind, interaction = view.kind, view.event.interaction
    if kind is None or kind.first == "either":
        return
    first = interaction.initiator if kind.first == "initiator" else interaction.affected
    if interaction.passing_order[0] != first:
        reason = f"in {kind.name} the {kind.first} reaches the conflict point first"
        yield _fail(view, reason, f"{first} first", "interaction.passing_order", "interaction.type")


def responses_agree(view: View) -> Iterator[Failure]:
    """Check that the admissible responses let the first one pass, and stand once each."""
    interaction = view.event.interaction
    for name in ("longitudinal_responses", "lateral_responses"):
        words = getattr(interaction, name)
        if len(set(words)) < len(words):
            yield _fail(view, "a word stands twice", "each word once", f"interaction.{name}")
    wrong = set(interaction.longitudinal_responses) - _GIVES_WAY
    if interaction.passing_order[0] == interaction.initiator and wrong:
        yield _fail(
            view,
            f"who arrives second gives way, and {one_of(wrong)} doesn't",
            one_of(_GIVES_WAY),
            "interaction.longitudinal_responses",
            "interaction.passing_order",
        )


def responses_have_room(view: View) -> Iterator[Failure]:
    """Check that a lateral response has a lane to go to, with a lane change that is permitted."""
    topology = view.event.topology
    lanes = topology.lanes_same_direction.range
    for side in ("left", "right"):
        if side not in view.event.interaction.lateral_responses:
            continue
        no_lane = topology.vut_lane.value == _EXTREME[side] or (lanes and lanes.max < 2)
        if no_lane or f"lane_change_{side}" not in topology.permitted_manoeuvres.permitted:
            yield _fail(
                view,
                f"there is nowhere to go on the {side}",
                "straight",
                "interaction.lateral_responses",
                "topology.vut_lane",
                "topology.permitted_manoeuvres",
            )


def vut_does_what_is_admissible(view: View) -> Iterator[Failure]:
    """Require that the VUT's motion in the conflict (part M) is one of the admissible responses."""
    vut, interaction = view.event.vut_id, view.event.interaction
    cell, at = view.cell(vut, "conflict"), f"motion.{vut}.conflict"
    if cell is None:
        return
    does = _DOES.get(cell.speed_trend)
    reason = "the VUT of the source does what no response admits"
    if does is not None and not does & set(interaction.longitudinal_responses):
        remedy = "a trend that a response brings about, or any"
        along = "interaction.longitudinal_responses"
        yield _fail(view, reason, remedy, f"{at}.speed_trend", along)
    lateral = {"none": "straight"}.get(cell.lateral, cell.lateral)
    if has_meaning(cell.lateral):
        across = "interaction.lateral_responses"
        allowed = interaction.lateral_responses
        yield from _fail.unless(view, lateral, allowed, reason, f"{at}.lateral", across)


def vut_keeps_its_lane_untouched(view: View) -> Iterator[Failure]:
    """Require that the VUT keeps its lane before the conflict, and where no response leaves it."""
    vut, responses = view.event.vut_id, "interaction.lateral_responses"
    allowed = set(view.event.interaction.lateral_responses)
    for phase in ("trigger", "resolution"):
        cell, path = view.cell(vut, phase), f"motion.{vut}.{phase}.lateral"
        if cell and cell.lateral in ("left", "right") and cell.lateral not in allowed:
            reason = "the VUT leaves its lane, which no response admits"
            yield _fail(view, reason, "none", path, responses)


def vut_gives_way_in_the_conflict(view: View) -> Iterator[Failure]:
    """Require that the one who gives way does so in the conflict, not only after it."""
    vut, order = view.event.vut_id, view.event.interaction.passing_order
    conflict, resolution = view.cell(vut, "conflict"), view.cell(vut, "resolution")
    if conflict and resolution and order[0] != vut and resolution.speed_trend == "decreasing":
        yield from _fail.unless(
            view,
            conflict.speed_trend,
            ("decreasing", "standing"),
            "the VUT would brake when nothing is in its way any more, and not before",
            f"motion.{vut}.conflict.speed_trend",
            f"motion.{vut}.resolution.speed_trend",
            "interaction.passing_order",
        )


def separation_fits_the_time_gap(view: View) -> Iterator[Failure]:
    """Check that the smallest time gap at the conflict point, driven fast, keeps the separation."""
    names = (
        "constraints.safety.separation",
        "constraints.time_gap",
        f"constraints.speeds.{view.event.vut_id}.conflict",
    )
    spans = view.spans(*names)
    if spans is None:
        return
    separation, gap, speed = spans
    room = gap.low * speed.high
    if separation.low > room:
        reason = f"they pass {room:.1f} m apart at most with the smallest time gap"
        yield _fail(view, reason, "a smaller separation, or a larger time gap", *names)


def thresholds_fit_the_kind(view: View) -> Iterator[Failure]:
    """Check that the conflict is judged by what the kind compares: TTC, arrivals or both."""
    kind, thresholds = view.kind, view.event.constraints.thresholds
    if kind is None:
        return
    if (thresholds.arrival_gap is not None) != kind.uses_arrival_gap:
        compared = "two arrivals are compared" if kind.uses_arrival_gap else "TTC alone counts"
        remedy = "a time" if kind.uses_arrival_gap else "null"
        path = "constraints.thresholds.arrival_gap"
        yield _fail(view, f"in {kind.name} {compared}", remedy, path, "interaction.type")
    if thresholds.ttc is None:
        yield _fail(
            view,
            "a VUT that closes in is in conflict, whatever the arrival times are",
            "a time",
            "constraints.thresholds.ttc",
            "interaction.type",
        )


def a_response_is_feasible(view: View) -> Iterator[Failure]:
    """Require that the VUT can still brake at the trigger, safely and without a collision."""
    vut, c = view.event.vut_id, "constraints"
    approach = f"{c}.speeds.{view.initiator}.approach"
    names = [f"{c}.trigger.below", f"{c}.safety.acceleration", f"{c}.speeds.{vut}.trigger"]
    spans, end = view.spans(*names, approach), view.span(f"{c}.manoeuvre.end_speed")
    if spans is None or spans[1].high <= 0.0:
        return
    below, limit, ours, theirs = spans
    fast, brake = ours.high, limit.high
    if view.event.constraints.trigger.quantity == "time_to_arrival":
        room, needed = fast * below.low, fast * REACTION_S + fast**2 / (2 * brake)
    elif end is not None:
        # Both brake: the initiator to its end speed, the VUT after its reaction to the same.
        names += [approach, f"{c}.manoeuvre.end_speed"]
        slow = view.span(f"{c}.manoeuvre.deceleration")
        rate = slow.high if slow and slow.high > 0.0 else brake
        duration = (fast - end.low) / brake + REACTION_S
        braking_s = max(0.0, theirs.low - end.low) / rate
        theirs_m = (theirs.low**2 - end.low**2) / (2 * rate) + end.low * (duration - braking_s)
        room = below.low + max(0.0, theirs_m)
        needed = fast * REACTION_S + max(0.0, fast**2 - end.low**2) / (2 * brake)
    elif view.kind and view.kind.observable == "closing":
        closing = fast - theirs.low
        room, needed = below.low, closing * REACTION_S + closing**2 / (2 * brake)
    else:
        return
    if needed > room:
        yield _fail(
            view,
            f"braking in time takes {needed:.1f} m, and there may be only {room:.1f} m",
            "a larger value, lower speeds, or a harder deceleration",
            *names,
        )


INTERACTION_PREDICATES: tuple[Predicate, ...] = (
    kind_is_known,
    words_fit_the_kind,
    intent_fits_the_kind_and_the_motion,
    dominant_motion_is_seen,
    conflict_is_closing,
    passing_order_fits,
    responses_agree,
    responses_have_room,
    vut_does_what_is_admissible,
    vut_keeps_its_lane_untouched,
    vut_gives_way_in_the_conflict,
    separation_fits_the_time_gap,
    thresholds_fit_the_kind,
    a_response_is_feasible,
)
