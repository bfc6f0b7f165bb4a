"""The search for plans: drafts from the preferred values on, each looked ahead and judged."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

from ssp_core.motion.encounter import Observable, corridor_half_m
from ssp_scenario_manager.interactions.adapting import gap_before_response_s
from ssp_scenario_manager.interactions.base import (
    BlockPoint,
    CannotPlace,
    Cross,
    Drive,
    PlaceLimits,
    Plan,
    Trigger,
    Wait,
)
from ssp_scenario_manager.interactions.choosing import Choice, chosen, combinations
from ssp_scenario_manager.interactions.foresight import AFTER_S, Foresight, foresee
from ssp_scenario_manager.interactions.judging import judge, wrong_order
from ssp_scenario_manager.interactions.motions import Motions, motions
from ssp_scenario_manager.interactions.on_block import ahead_of, rectangle
from ssp_scenario_manager.interactions.wanted import (
    classes_of,
    initiator_first,
    size_of,
    thresholds_of,
)
from ssp_scenario_manager.spec.model import Event
from ssp_scenario_manager.topology.block import Block

# Plans that are followed to their end before a block is given up.
MOST_FORESEEN = 20
MOST_DRAFTED = 400
# An initiator that drives goes on for so long after a run ends as foreseen: a VUT may take longer.
RUN_OUT_S = 10.0


@dataclass(frozen=True)
class Draft:
    """A plan before it was looked ahead.

    Args:
        vut: how the VUT drives.
        targets: what the OTs do.
        trigger: of the initiator.
        extra: further reasons against it, from what was foreseen; None where there are none.
        chosen: further fields that follow from the others, as Plan.chosen has them.
    """

    vut: Drive
    targets: Mapping[str, Drive | Wait]
    trigger: Trigger
    extra: Callable[[Motions, Foresight], list[str]] | None = None
    chosen: Mapping[str, tuple[float, str, str]] | None = None


def plans_on(
    event: Event,
    block: Block,
    limits: PlaceLimits,
    observable: Observable,
    choices: Mapping[str, Choice],
    draft: Callable[[Mapping[str, float]], Draft],
    zone: Callable[[Draft, Foresight, BlockPoint], tuple[BlockPoint, ...]],
) -> Iterator[Plan]:
    """Plans that go as K* says, as far as can be foreseen, from the preferred values on.

    Args:
        event: K*.
        block: to place it on.
        limits: of the place.
        observable: of the kind.
        choices: quantities by name.
        draft: makes a plan of values; raises CannotPlace where they don't fit the block.
        zone: corners of the conflict zone, from plan, foresight and conflict point.

    Raises:
        CannotPlace: none does; the reason is that of the preferred values.
    """
    thresholds = thresholds_of(event)
    vut_id = event.vut_id
    first_reason, looked, found = "", 0, False
    for values in itertools.islice(combinations(choices), MOST_DRAFTED):
        try:
            made = draft(values)
            told = motions(
                block.line, classes_of(event), vut_id, made.vut, made.targets, made.trigger
            )
            looked += 1
            still = foresee(_without_response(told), observable, thresholds)
            reasons = wrong_order(event, still)
            if not reasons:
                seen = foresee(told, observable, thresholds)
                reasons = judge(event, limits, told, seen)
            if not reasons and made.extra is not None:
                reasons = made.extra(told, seen)
        except CannotPlace as error:
            reasons = [str(error)]
            made = None
        if made is not None and not reasons:
            conflict = _on_block(block, made.vut, seen.conflict_station_m)
            found = True
            yield Plan(
                vut=made.vut,
                targets=made.targets,
                trigger=_ending(made.trigger, seen),
                conflict=conflict,
                zone=zone(made, seen, conflict),
                expected=_on_block(block, made.vut, seen.fired_station_m),
                chosen={**chosen(choices, values), **(made.chosen or {})},
                gap_s=gap_before_response_s(told, seen, initiator_first=initiator_first(event)),
            )
        first_reason = first_reason or "; ".join(reasons)
        if looked >= MOST_FORESEEN:
            break
    if not found:
        raise CannotPlace(first_reason)


def _ending(trigger: Trigger, seen: Foresight) -> Trigger:
    """The trigger, after whose act the initiator drives on until the event is over, and stops."""
    act = trigger.act
    if isinstance(act, Cross) or seen.resolution_s is None:
        return trigger
    run_out_s = round(seen.resolution_s + AFTER_S + RUN_OUT_S - seen.fired_s, 1)
    return replace(trigger, act=replace(act, run_out_s=run_out_s))


def _without_response(told: Motions) -> Motions:
    return replace(told, driver=told.driver.model_copy(update={"reacts": False}))


def plans_in_lane(
    event: Event,
    block: Block,
    limits: PlaceLimits,
    observable: Observable,
    choices: Mapping[str, Choice],
    draft: Callable[[Mapping[str, float]], Draft],
    reach: Callable[[Draft, Foresight], float],
) -> Iterator[Plan]:
    """As ``plans_on``, for an initiator that takes a part of the VUT's lane.

    The zone begins at the conflict point, where the initiator's rear is when it comes into the
    VUT's way, and ends where its front is when it has done what it does.

    Args:
        reach: how far it drives meanwhile, m; the others as for ``plans_on``.
    """
    half = corridor_half_m(size_of(event, event.vut_id).width_m)
    length = size_of(event, event.interaction.initiator).length_m

    def zone(made: Draft, seen: Foresight, conflict: BlockPoint) -> tuple[BlockPoint, ...]:
        s, y = conflict.s_m, conflict.l_m
        end = min(s + length + reach(made, seen), block.length_m)
        return rectangle(block, s, end, y - half, y + half)

    return plans_on(event, block, limits, observable, choices, draft, zone)


def _on_block(block: Block, vut: Drive, station_m: float) -> BlockPoint:
    s = ahead_of(block, vut.start.s_m, station_m, vut.start.l_m)
    return BlockPoint(round(s, 3), vut.start.l_m)
