"""The block that an event goes onto (METHOD 2.2), and a trigger's value with which it would happen
there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from ssp_core.errors import InputError
from ssp_scenario_manager.compile.place import Realisation
from ssp_scenario_manager.compile.retrieval import ties
from ssp_scenario_manager.compile.task import BlockScore
from ssp_scenario_manager.event_spec.model import Event, Interval
from ssp_scenario_manager.maps.block import Block, Library
from ssp_scenario_manager.scenarios.base import CannotPlace
from ssp_scenario_manager.scenarios.values import quantity_at

HIGHEST = "highest score"
# Fitting blocks of equal score after which no further one is looked for: enough to choose among.
ENOUGH = 8


class NotChosen(InputError):
    """No block was chosen: none fits, or several fit equally well.

    Args:
        problem: what is wrong.
        scores: of all blocks, with what was found out on the way.
        tied: ids of the blocks among which a person has to choose, the first ENOUGH of them.
        remedy: what would be right.
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
class Chosen:
    """The winner.

    Args:
        realisation: of the event on it.
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
    said: Callable[[str], None] = lambda block: None,
    would_do: Callable[[Block], str | None] = lambda block: None,
) -> Chosen:
    """The winner of the retrieval that passes connectivity and conflict-geometry checks.

    Not every block of equal score is realised: without a choice, until ENOUGH of them fit; with
    one, the chosen block and then as many others as show whether there was anything to choose.

    Args:
        library: blocks of the ground.
        scores: of all of them, eligible ones first, then best first (retrieve.score_blocks).
        place: realises the event on a block; raises CannotPlace with the reason.
        choice: id of the block that a person chose among ties.
        who: that person.
        said: is told each block that is tried.
        would_do: of the best block, where none fits: what of K* alone keeps the event from it.

    Raises:
        NotChosen: none fits; or several that score alike fit, and no choice among them was given.
    """
    search = _Search(library, scores, place, said)
    if choice is not None and choice not in search.blocks:
        raise NotChosen(
            "there is no such block",
            scores,
            file=library.source,
            value=choice,
            remedy="name one of those that tie, with --choose",
        )
    for group in _groups([score for score in scores if score.eligible]):
        ids = [score.block for score in group]
        if choice is None:
            found = search.fitting(ids, ENOUGH)
            if found:
                return _highest(search, found, complete=len(found) < ENOUGH)
        elif choice in ids:
            chosen = search.fitting([choice], 1)
            others = [block for block in ids if block != choice]
            if chosen:
                return _chosen(search, ids, chosen[0], search.fitting(others, 1), who)
            found = search.fitting(others, ENOUGH)
            if found:
                raise _not_the_best(search, choice, found)
        else:
            found = search.fitting(ids, 1)
            if found:
                raise _not_the_best(search, choice, found)
    told = search.told()
    remedy = "name another site or map; the table above says what each block lacks"
    best = next((score.block for score in scores if score.eligible), None)
    hint = would_do(search.blocks[best]) if best is not None else None
    raise NotChosen(
        f"no block of it fits: {_why(told)}",
        told,
        file=library.source,
        remedy=f"{remedy}. On {best}, {hint}" if hint else remedy,
    )


class _Search:
    """Realises the event on blocks, and notes why one doesn't fit."""

    def __init__(
        self,
        library: Library,
        scores: Sequence[BlockScore],
        place: Callable[[Block], Realisation],
        said: Callable[[str], None],
    ) -> None:
        self.library = library
        self.blocks = {block.block_id: block for block in library.blocks}
        self._scores = {score.block: score for score in scores}
        self._place = place
        self._said = said

    def fitting(self, ids: Sequence[str], enough: int) -> list[Realisation]:
        """The first blocks that the event fits onto, at most as many as are enough."""
        fits: list[Realisation] = []
        for block in ids:
            if len(fits) == enough:
                break
            self._said(block)
            try:
                fits.append(self._place(self.blocks[block]))
            except CannotPlace as error:
                score = self._scores[block]
                self._scores[block] = score.model_copy(
                    update={"eligible": False, "reasons": [*score.reasons, str(error)]}
                )
        return fits

    def told(self) -> list[BlockScore]:
        """All scores, with what was found out."""
        return list(self._scores.values())

    def reasons(self, block: str) -> Sequence[str]:
        """Why a block doesn't fit."""
        return self._scores[block].reasons


def _groups(scores: Sequence[BlockScore]) -> Iterator[list[BlockScore]]:
    """Blocks that score alike, best first."""
    left = list(scores)
    while left:
        names = {score.block for score in ties(left)}
        yield [score for score in left if score.block in names]
        left = [score for score in left if score.block not in names]


def _highest(search: _Search, found: list[Realisation], *, complete: bool) -> Chosen:
    """The only block that fits, of those with the highest score."""
    if len(found) == 1:
        return Chosen(found[0], search.told(), HIGHEST, ())
    ids = [fit.block.block_id for fit in found]
    count = f"{len(ids)} blocks" if complete else f"at least {len(ids)} blocks"
    raise NotChosen(
        f"{count} fit equally well: {_some(ids)}",
        search.told(),
        ids,
        file=search.library.source,
        remedy="choose one: ssp compile … --choose BLOCK --who NAME; the choice is logged",
    )


def _chosen(
    search: _Search,
    ids: Sequence[str],
    chosen: Realisation,
    others: Sequence[Realisation],
    who: str | None,
) -> Chosen:
    """What a person chose; where no other block fits, there was nothing to choose."""
    if not others:
        return Chosen(chosen, search.told(), HIGHEST, ())
    fits = {fit.block.block_id for fit in (chosen, *others)}
    return Chosen(chosen, search.told(), who or "", tuple(i for i in ids if i in fits))


def _not_the_best(search: _Search, choice: str, found: Sequence[Realisation]) -> NotChosen:
    ids = [fit.block.block_id for fit in found]
    why = "".join(f": {reason}" for reason in search.reasons(choice)[:1])
    return NotChosen(
        f"is not among the best blocks{why}",
        search.told(),
        ids,
        file=search.library.source,
        value=choice,
        remedy=f"the best that fit: {_some(ids)}",
    )


def _some(names: Sequence[str], most: int = 8) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _why(scores: Sequence[BlockScore]) -> str:
    """The reasons of the best blocks, each once."""
    if not scores:
        return "it has no blocks"
    reasons: dict[str, int] = {}
    for score in scores:
        for reason in score.reasons[:1]:
            reasons[reason] = reasons.get(reason, 0) + 1
    worst = sorted(reasons.items(), key=lambda item: -item[1])[:3]
    return "; ".join(f"{reason} ({count} block(s))" for reason, count in worst)


FIELD = "constraints.trigger.below"
# Values outside of K*'s interval are tried in this ratio, so many above and below it.
_RATIO = 1.25
_ABOVE, _BELOW = 8, 4


def fitting_trigger(event: Event, place: Callable[[Event], object]) -> str | None:
    """In words, the value nearest to K*'s interval that would do while all else stays as it is.

    Args:
        event: K*, which doesn't fit the block.
        place: places an event on the block; raises CannotPlace with the reason.

    Returns:
        None where the trigger's value isn't what is wrong.
    """
    asked = quantity_at(event, FIELD)
    if not isinstance(asked, Interval) or asked.min is None or asked.max is None:
        return None
    for value in _values(asked.min, asked.max):
        try:
            place(_with_trigger(event, Interval(min=value, max=value, unit=asked.unit)))
        except CannotPlace:
            continue
        return f"{FIELD} of {value:g} {asked.unit} would do, K* has {asked.min:g} to {asked.max:g}"
    return None


def _values(low: float, high: float) -> list[float]:
    """Rounded to a tenth, the nearest to the interval first."""
    tried = [(k, high * _RATIO**k) for k in range(1, _ABOVE + 1)]
    tried += [(k, low / _RATIO**k) for k in range(1, _BELOW + 1)]
    return [round(value, 1) for _, value in sorted(tried) if round(value, 1) > 0.0]


def _with_trigger(event: Event, below: Interval) -> Event:
    constraints = event.constraints
    trigger = constraints.trigger.model_copy(update={"below": below})
    return event.model_copy(
        update={"constraints": constraints.model_copy(update={"trigger": trigger})}
    )
