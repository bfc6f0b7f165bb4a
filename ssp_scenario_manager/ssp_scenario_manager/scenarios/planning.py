"""The search for plans: drafts from the preferred values on, predicted, judged and adapted."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

from ssp_core.clock import seconds_to_ns
from ssp_core.geometry import Polyline
from ssp_core.motion.encounter import Observable, corridor_half_m
from ssp_core.run_file.model import EndCondition, Limits
from ssp_core.run_file.participants import Adaptation, Hold
from ssp_core.run_file.values import Point
from ssp_core.vocabulary import ObjectWord
from ssp_scenario_manager.dispatch.planned_motion import (
    PlannedMotion,
    follow_vut,
    foreseen_gap_s,
    planned_motion_of,
)
from ssp_scenario_manager.dispatch.references import (
    APPROACH_LEAD_S,
    approach_reference,
    manoeuvre_reference,
)
from ssp_scenario_manager.event_spec.fields import Span
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.maps.block import Block
from ssp_scenario_manager.scenarios.base import (
    BlockPoint,
    CannotPlace,
    Cross,
    Drive,
    Plan,
    Setting,
    Trigger,
    Wait,
)
from ssp_scenario_manager.scenarios.block_places import ahead_of, rectangle
from ssp_scenario_manager.scenarios.further import (
    further_choices,
    further_ids,
    further_motions,
    starts_apart,
)
from ssp_scenario_manager.scenarios.motions import CRUISE_SHARE, Motions, motions, stopping_m
from ssp_scenario_manager.scenarios.prediction import AFTER_S, Prediction, foreseen_address, predict
from ssp_scenario_manager.scenarios.values import (
    Choice,
    choice_entries,
    classes_of,
    combinations,
    initiator_first,
    size_of,
    speed_bounds,
    thresholds_of,
    wanted_passing,
)


def judge(event: Event, limits: Limits, plan_motions: Motions, prediction: Prediction) -> list[str]:
    """List what is wrong with a plan that was looked ahead; empty: it goes as K* says."""
    c = event.constraints
    wrong = []
    if prediction.early_conflict:
        wrong.append("the conflict begins before the trigger")
    if prediction.trigger_s is None:
        wrong.append("the manoeuvre never becomes observable")
    if prediction.conflict_s is None:
        wrong.append(
            "no conflict comes: TTC and arrival gap stay above their thresholds (least TTC "
            f"{prediction.least_ttc_s:.2f} s)"
        )
    if prediction.resolution_s is None and prediction.conflict_s is not None:
        wrong.append("the conflict isn't resolved")
    least_s, most_s = wanted_passing(event).bounds_s
    comes = not math.isinf(prediction.vut_arrival_s)
    if comes and not Span(least_s, most_s).holds(prediction.time_gap_s):
        wrong.append(
            f"the time gap at the conflict point would be {prediction.time_gap_s:.2f} s, K* wants "
            f"{least_s:g} to {most_s:g} s"
        )
    low, high = speed_bounds(event, event.vut_id, ("approach", "trigger"))
    # A driver nears its cruise speed slowly.
    if not low * CRUISE_SHARE <= prediction.fired_speed_mps <= high + 1e-9:
        wrong.append(
            f"the VUT would drive {prediction.fired_speed_mps:.1f} m/s at the trigger, K* wants "
            f"{low:g} to {high:g} m/s"
        )
    least = max(limits.separation_m, c.safety.separation.si.low)
    if prediction.separation_m <= least:
        wrong.append(
            f"VUT and target come within {prediction.separation_m:.2f} m, limit is {least:g} m"
        )
    path = (
        Polyline(plan_motions.vut.approach.path) if plan_motions.vut.approach is not None else None
    )
    needed = prediction.vut_station_end_m + stopping_m(
        prediction.vut_end_mps, plan_motions.driver.comfortable_deceleration_mps2
    )
    if path is not None and needed > path.length_m:
        wrong.append(
            f"the VUT needs {needed:.0f} m from its start to the run's end and to a stop, the "
            f"block leaves it {path.length_m:.0f} m"
        )
    other = event.interaction.initiator
    wrong += [
        f"{one.text(thresholds_of(event))}, and the conflict is {other}'s"
        for one in prediction.intrusions
    ]
    near = prediction.nearest
    if near is not None and further_ids(event) and near.distance_m <= least:
        wrong.append(
            f"{near.first} and {near.second} come within {near.distance_m:.2f} m at "
            f"{near.t_s:.1f} s, limit is {least:g} m"
        )
    end = EndCondition()
    longest = min(c.safety.duration.si.high, end.at_latest_s)
    ends = (prediction.resolution_s or 0.0) + end.after_resolution_s
    if ends > longest:
        wrong.append(f"the run takes {ends:.0f} s, limit is {longest:g} s")
    return wrong


def wrong_order(event: Event, still: Prediction) -> list[str]:
    """List what is wrong with the passing order of a plan.

    ``still``: of a VUT that holds its speed.
    """
    if initiator_first(event) == still.initiator_first:
        return []
    first, other = event.interaction.passing_order[0], event.interaction.initiator
    own_s = still.overlap_s - still.fired_s
    vut_s = min(still.vut_arrival_s, still.vut_in_zone_s) - still.fired_s
    if math.isinf(own_s):
        return [f"{other} wouldn't come into the VUT's corridor"]
    return [
        f"{first} wouldn't reach the conflict point first: after the trigger {other} takes "
        f"{own_s:.1f} s to the VUT's corridor, the VUT at its approach speed {vut_s:.1f} s"
    ]


# What every body of a class can do, m/s^2: hardest acceleration and braking. Beyond it a reference
# would be refused.
BODY_MPS2: dict[ObjectWord, tuple[float, float]] = {
    "pedestrian": (2.4, 2.9),
    "cyclist": (1.7, 3.4),
    "truck": (1.7, 4.8),
    "bus": (1.7, 4.8),
    "car": (3.5, 6.5),
    "motorcycle": (5.0, 6.5),
}
# Of what the place allows; the rest is for the tracking of it.
_SHARE_OF_LIMIT = 0.9


def _routine(plan_motions: Motions, prediction: Prediction) -> PlannedMotion | None:
    """Return the initiator's manoeuvre from where it is when the trigger fires."""
    trigger, path = plan_motions.trigger, plan_motions.vut.approach
    target = plan_motions.target(plan_motions.initiator_id)
    if path is None or isinstance(trigger.manoeuvre, Hold) or trigger.object_id != target.id:
        return None

    before = None
    if target.approach is not None:
        before = approach_reference(foreseen_address(target.id, APPROACH_LEAD_S), target.approach)
    state = next(s for s in prediction.targets_fired if s.object_id == target.id)
    manoeuvre = manoeuvre_reference(
        foreseen_address(target.id, prediction.fired_s + trigger.lead_time_s),
        trigger.manoeuvre,
        state,
        before,
        target.approach,
    )
    fired_ns = seconds_to_ns(prediction.fired_s)
    return planned_motion_of(
        before, manoeuvre, fired_ns, target, plan_motions.vut, Polyline(path.path)
    )


def gap_before_response_s(
    plan_motions: Motions, prediction: Prediction, *, initiator_first: bool
) -> float | None:
    """Return second arrival minus first departure (METHOD 1), with a VUT that keeps its speed.

    Returns:
        s, rounded to 1 ms; None where the initiator's manoeuvre doesn't lead it into the VUT's
        corridor.
    """
    planned_motion = _routine(plan_motions, prediction)
    if planned_motion is None or plan_motions.vut.approach is None:
        return None
    path = Polyline(plan_motions.vut.approach.path)
    track = follow_vut(None, prediction.vut_fired, path)
    gap = foreseen_gap_s(
        planned_motion, track, plan_motions.vut.size, initiator_first=initiator_first
    )
    return round(gap, 3)


def adaptation_of(
    plan_motions: Motions,
    gap_s: float | None,
    *,
    initiator_first: bool,
    anchor: Point | None,
    most_mps2: float,
) -> Adaptation | None:
    """Make the adaptation that lets a run's trigger keep the gap; None where there is none to keep.

    Args:
        plan_motions: the motions, with the trigger.
        gap_s: as ``gap_before_response_s`` gives it.
        initiator_first: the initiator is to pass first.
        anchor: the conflict point, where it doesn't move with the place of the trigger.
        most_mps2: acceleration that the place allows.
    """
    if gap_s is None:
        return None
    up, down = BODY_MPS2[plan_motions.target(plan_motions.trigger.object_id).object_class]
    most = round(_SHARE_OF_LIMIT * most_mps2, 3)
    return Adaptation(
        anchor=anchor,
        first="initiator" if initiator_first else "vut",
        gap_s=gap_s,
        acceleration_mps2=min(up, most),
        deceleration_mps2=min(down, most),
    )


# Plans that are followed to their end before a block is given up.
MOST_FORESEEN = 20
MOST_DRAFTED = 400
# An initiator that drives goes on for so long after a run ends as foreseen: a VUT may take longer.
RUN_OUT_S = 10.0


@dataclass(frozen=True)
class Draft:
    """A plan before it was looked ahead.

    Args:
        extra: further reasons against it, from what was foreseen; None where there are none.
        choices: further fields that follow from the others, as Plan.choices has them.
    """

    vut: Drive
    targets: Mapping[str, Drive | Wait]
    trigger: Trigger
    extra: Callable[[Motions, Prediction], list[str]] | None = None
    choices: Mapping[str, tuple[float, str, str]] | None = None


def plans_on(
    setting: Setting,
    observable: Observable,
    choices: Mapping[str, Choice],
    draft: Callable[[Mapping[str, float]], Draft],
    zone: Callable[[Draft, Prediction, BlockPoint], tuple[BlockPoint, ...]],
) -> Iterator[Plan]:
    """Yield plans that go as K* says, as far as can be foreseen, from the preferred values on.

    Args:
        setting: event, block and limits.
        observable: how the initiator's manoeuvre shows.
        choices: the values of each quantity.
        draft: makes a plan of values; raises CannotPlace where they don't fit the block.
        zone: corners of the conflict zone, from plan, foresight and conflict point.

    Raises:
        CannotPlace: none does; the reason is that of the preferred values.
    """
    event, block, thresholds = setting.event, setting.block, thresholds_of(setting.event)
    choices = {**choices, **further_choices(setting)}
    first_reason, looked, has_plan = "", 0, False
    for values in itertools.islice(combinations(choices), MOST_DRAFTED):
        try:
            trial_draft = _with_further(setting, draft(values), values)
            plan_motions = motions(
                block.line,
                classes_of(event),
                event.vut_id,
                trial_draft.vut,
                trial_draft.targets,
                trial_draft.trigger,
            )
            looked += 1
            steady = plan_motions.driver.model_copy(update={"reacts": False})
            still = predict(replace(plan_motions, driver=steady), observable, thresholds)
            reasons = wrong_order(event, still)
            if not reasons:
                prediction = predict(plan_motions, observable, thresholds)
                reasons = judge(event, setting.limits, plan_motions, prediction)
            if not reasons and trial_draft.extra is not None:
                reasons = trial_draft.extra(plan_motions, prediction)
        except CannotPlace as error:
            reasons = [str(error)]
            trial_draft = None
        if trial_draft is not None and not reasons:
            conflict = _on_block(block, trial_draft.vut, prediction.conflict_station_m)
            has_plan = True
            yield Plan(
                vut=trial_draft.vut,
                targets=trial_draft.targets,
                trigger=_ending(trial_draft.trigger, prediction),
                conflict=conflict,
                zone=zone(trial_draft, prediction, conflict),
                expected=_on_block(block, trial_draft.vut, prediction.fired_station_m),
                choices={**choice_entries(choices, values), **(trial_draft.choices or {})},
                at_most={
                    choice.field: choice.at_most
                    for choice in choices.values()
                    if math.isfinite(choice.at_most)
                },
                gap_s=gap_before_response_s(
                    plan_motions, prediction, initiator_first=initiator_first(event)
                ),
            )
        first_reason = first_reason or "; ".join(reasons)
        if looked >= MOST_FORESEEN:
            break
    if not has_plan:
        raise CannotPlace(first_reason)


def _with_further(setting: Setting, draft: Draft, values: Mapping[str, float]) -> Draft:
    """Return a draft with the further participants.

    Raises:
        CannotPlace: one has no place, or two would start too near to each other.
    """
    targets = {**draft.targets, **further_motions(setting, draft.vut, values)}
    for reason in starts_apart(setting.event, draft.vut, targets):
        raise CannotPlace(reason)
    return replace(draft, targets=targets)


def _ending(trigger: Trigger, prediction: Prediction) -> Trigger:
    """Return the trigger, with an act after which the initiator drives on to the event's end."""
    act = trigger.act
    if isinstance(act, Cross | Hold) or prediction.resolution_s is None:
        return trigger
    run_out_s = round(prediction.resolution_s + AFTER_S + RUN_OUT_S - prediction.fired_s, 1)
    return replace(trigger, act=act.model_copy(update={"run_out_s": run_out_s}))


def plans_in_lane(
    setting: Setting,
    observable: Observable,
    choices: Mapping[str, Choice],
    draft: Callable[[Mapping[str, float]], Draft],
    reach: Callable[[Draft, Prediction], float],
) -> Iterator[Plan]:
    """Make plans as ``plans_on`` does, for an initiator that takes a part of the VUT's lane.

    The zone begins at the conflict point, where the initiator's rear is when it comes into the
    VUT's way, and ends where its front is when it has done what it does.

    Args:
        setting: event, block and limits.
        observable: how the initiator's manoeuvre shows.
        choices: the values of each quantity.
        draft: makes a plan of values; raises CannotPlace where they don't fit the block.
        reach: how far it drives meanwhile, m.
    """
    event, block = setting.event, setting.block
    half = corridor_half_m(size_of(event, event.vut_id).width_m)
    length = size_of(event, event.interaction.initiator).length_m

    def zone(
        trial_draft: Draft, prediction: Prediction, conflict: BlockPoint
    ) -> tuple[BlockPoint, ...]:
        s, y = conflict.s_m, conflict.l_m
        end = min(s + length + reach(trial_draft, prediction), block.length_m)
        return rectangle(s, end, y - half, y + half)

    return plans_on(setting, observable, choices, draft, zone)


def _on_block(block: Block, vut: Drive, station_m: float) -> BlockPoint:
    s = ahead_of(block, vut.start.s_m, station_m, vut.start.l_m)
    return BlockPoint(round(s, 3), vut.start.l_m)
