"""The block of an event (METHOD 2.2), and a trigger's value with which it would happen there."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from ssp_core.errors import InputError
from ssp_scenario_manager.compile.place import Realisation
from ssp_scenario_manager.compile.retrieval import score_block, ties
from ssp_scenario_manager.compile.task import BlockScore
from ssp_scenario_manager.event_spec.fields import UNITS, units_of
from ssp_scenario_manager.event_spec.model import Event, Interval
from ssp_scenario_manager.event_spec.other_lanes import with_lanes
from ssp_scenario_manager.maps.block import Block, Library
from ssp_scenario_manager.scenarios.base import CannotPlace
from ssp_scenario_manager.scenarios.events.kinds import KINDS
from ssp_scenario_manager.scenarios.values import quantity_at

HIGHEST = "highest score"
# Fitting blocks of equal score after which no further one is looked for: enough to choose among.
ENOUGH = 8
# Blocks on which an event of another number of lanes is tried.
_MOST_TRIED = 3
# Lanes that the clip generator draws, in the VUT's direction and oncoming.
_MOST_LANES = 4


class NoBlockChosen(InputError):
    """No block was chosen: none fits, or several fit equally well.

    Args:
        tied: ids of the blocks among which a person has to choose, the first ENOUGH of them.
    """

    def __init__(
        self,
        problem: str,
        scores: Sequence[BlockScore],
        tied: Sequence[str] = (),
        *,
        file: str | None = None,
        value: object = None,
        remedy: str | None = None,
    ) -> None:
        self.scores = list(scores)
        self.tied = list(tied)
        super().__init__(problem, file=file, value=value, remedy=remedy)


@dataclass(frozen=True)
class Winner:
    """The winner.

    Args:
        scores: of all blocks, best first; what a check found is among a block's reasons.
        chosen_by: HIGHEST, or the person who chose between ties.
        tied: ids of blocks that were found to be as good, the winner's too; empty without a tie.
    """

    realisation: Realisation
    scores: list[BlockScore]
    chosen_by: str
    tied: tuple[str, ...]


def choose_block(
    library: Library,
    scores: Sequence[BlockScore],
    place: Callable[[Block], Realisation],
    *,
    choice: str | None = None,
    who: str | None = None,
    on_block: Callable[[str], None] = lambda _block: None,
    would_do: Callable[[Block], str | None] = lambda _block: None,
    other_lanes: Callable[[Sequence[Block]], str | None] = lambda _blocks: None,
) -> Winner:
    """Return the winner of the retrieval that passes connectivity and conflict-geometry checks.

    Not every block of equal score is realised: without a choice, until ENOUGH of them fit; with
    one, the chosen block and then as many others as show whether there was anything to choose.

    Args:
        library: the blocks of the place.
        scores: of all its blocks, best first.
        place: realises the event on a block; raises CannotPlace with the reason.
        choice: id of the block that a person chose among ties.
        who: the person who chose.
        on_block: called with each block that is tried.
        would_do: of the best block, where none fits: what of K* alone keeps the event from it.
        other_lanes: of blocks in order, where none may hold the event: how it is made for the
            number of lanes of one of them.

    Raises:
        NoBlockChosen: none fits; or several that score alike fit, and none of them was named.
    """
    scores_by_block = {score.block: score for score in scores}
    blocks = {block.block_id: block for block in library.blocks}

    def fitting(ids: Sequence[str], enough: int) -> list[Realisation]:
        """Return the first blocks that the event fits onto; the scores get the others' reasons."""
        fits: list[Realisation] = []
        for block in ids:
            if len(fits) == enough:
                break
            on_block(block)
            try:
                fits.append(place(blocks[block]))
            except CannotPlace as error:
                reasons = [*scores_by_block[block].reasons, str(error)]
                update = {"eligible": False, "reasons": reasons}
                scores_by_block[block] = scores_by_block[block].model_copy(update=update)
        return fits

    def refused(
        problem: str, remedy: str, tied: Sequence[str] = (), value: object = None
    ) -> NoBlockChosen:
        all_scores = list(scores_by_block.values())
        return NoBlockChosen(
            problem, all_scores, tied, file=library.source, value=value, remedy=remedy
        )

    if choice is not None and choice not in blocks:
        remedy = "name one of those that tie, with --choose"
        left_out = [fault for fault in library.faults if choice.startswith(f"{fault[0]} ")]
        raise refused(f"there is no such block{_left_out(left_out)}", remedy, value=choice)
    for ids in _groups(scores):
        others = [block for block in ids if block != choice]
        mine = fitting([choice], 1) if choice is not None and choice in ids else []
        if mine:
            beside = [fit.block.block_id for fit in fitting(others, 1)]
            tied = tuple(block for block in ids if block == choice or block in beside)
            # Where no other block fits, there was nothing to choose.
            by, tied = (who or "", tied) if beside else (HIGHEST, ())
            return Winner(mine[0], list(scores_by_block.values()), by, tied)
        fits = fitting(others, ENOUGH if choice is None or choice in ids else 1)
        names = [fit.block.block_id for fit in fits]
        if fits and choice is not None:
            why = "".join(f": {reason}" for reason in scores_by_block[choice].reasons[:1])
            remedy = f"the best that fit: {_some(names)}"
            raise refused(f"is not among the best blocks{why}", remedy, names, choice)
        if len(fits) == 1:
            return Winner(fits[0], list(scores_by_block.values()), HIGHEST, ())
        if fits:
            count = f"{'' if len(fits) < ENOUGH else 'at least '}{len(fits)} blocks"
            remedy = "choose one: ssp compile … --choose BLOCK --who NAME; the choice is logged"
            raise refused(f"{count} fit equally well: {_some(names)}", remedy, names)
    remedy = "name another site or map; the table above says what each block lacks"
    best = next((score.block for score in scores if score.eligible), None)
    hint = would_do(blocks[best]) if best is not None else None
    if best is None:
        # The chosen block first.
        hint = other_lanes(
            [blocks[name] for name in sorted(scores_by_block, key=lambda n: n != choice)]
        )
    elif hint:
        hint = f"On {best}, {hint}"
    raise refused(
        f"no block of it fits: {_why(list(scores_by_block.values()))}{_left_out(library.faults)}",
        f"{remedy}. {hint}" if hint else remedy,
    )


def _groups(scores: Sequence[BlockScore]) -> Iterator[list[str]]:
    """Yield ids of the eligible blocks that score alike, best first."""
    left = [score for score in scores if score.eligible]
    while left:
        names = {score.block for score in ties(left)}
        yield [score.block for score in left if score.block in names]
        left = [score for score in left if score.block not in names]


def _some(names: Sequence[str], most: int = 8) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _left_out(faults: Sequence[tuple[str, str]], most: int = 3) -> str:
    """Return roads that the map has and that no block was made of, with the reasons."""
    text = "".join(f"; {name} is left out: {why}" for name, why in faults[:most])
    return text + (f"; and {len(faults) - most} more roads" if len(faults) > most else "")


def _why(scores: Sequence[BlockScore]) -> str:
    """Return the reasons of the best blocks, each once."""
    if not scores:
        return "it has no blocks"
    worst = Counter(reason for score in scores for reason in score.reasons[:1]).most_common(3)
    return "; ".join(f"{reason} ({count} block(s))" for reason, count in worst)


FIELD = "constraints.trigger.below"
# Values outside of K*'s interval are tried in this ratio, so many above and below it, the nearest
# first, rounded to a tenth.
_RATIO = 1.25
_ABOVE, _BELOW = 8, 4


def fitting_trigger(event: Event, place: Callable[[Event], object]) -> str | None:
    """Name the value nearest to K*'s interval that would do while all else stays as it is.

    Args:
        event: whose trigger's value does not fit.
        place: places an event on the block; raises CannotPlace with the reason.

    Returns:
        None where the trigger's value isn't what is wrong.
    """
    quantity = quantity_at(event, FIELD)
    if not isinstance(quantity, Interval) or quantity.min is None or quantity.max is None:
        return None
    allowed, unit = quantity.si, units_of(UNITS[quantity.unit].dimension)[0]
    tried = [(k, allowed.high * _RATIO**k) for k in range(1, _ABOVE + 1)]
    tried += [(k, allowed.low / _RATIO**k) for k in range(1, _BELOW + 1)]
    for value in (round(value, 1) for _, value in sorted(tried)):
        if value <= 0.0:
            continue
        below = Interval(min=value, max=value, unit=unit)
        trigger = event.constraints.trigger.model_copy(update={"below": below})
        constraints = event.constraints.model_copy(update={"trigger": trigger})
        try:
            place(event.model_copy(update={"constraints": constraints}))
        except CannotPlace:
            continue
        return f"{FIELD} of {value:g} {unit} would do, K* has {allowed.low:g} to {allowed.high:g}"
    return None


def fitting_lanes(
    event: Event, name: str, blocks: Sequence[Block], place: Callable[[Event, Block], object]
) -> str | None:
    """Tell how the event is made for the number of lanes of a block.

    Args:
        event: that fits onto none of the blocks.
        name: by which the event was asked for.
        blocks: in the order in which they are tried.
        place: places an event on a block; raises CannotPlace with the reason.

    Returns:
        None where the number of lanes isn't all that is wrong with the blocks that were tried.
    """
    tried = 0
    for block in blocks:
        same, opposite = len(block.forward_lanes), len(block.backward_lanes)
        if not 1 <= same <= _MOST_LANES or opposite > _MOST_LANES:
            continue
        other = with_lanes(event, same, opposite)
        if not score_block(other, block, KINDS[event.interaction.type]).eligible:
            continue
        tried += 1
        try:
            place(other, block)
        except CannotPlace:
            if tried == _MOST_TRIED:
                break
            continue
        command = f"`ssp spec clip {name} --lanes {same}+{opposite}`"
        return f"{command} makes an event that fits on {block.block_id}"
    return None
