"""The choice of a block: the best that also passes the checks; a person breaks ties."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest

from ssp_scenario_manager.compile.choose import HIGHEST, NoBlockChosen, Winner, choose_block
from ssp_scenario_manager.compile.task import BlockScore
from ssp_scenario_manager.maps.block import Library
from ssp_scenario_manager.scenarios.base import CannotPlace


def library(*names: str) -> Library:
    blocks = tuple(SimpleNamespace(block_id=name) for name in names)
    return Library("town.xodr", "sha256:0", "opendrive", cast(Any, blocks))


def score(name: str, total: float, *reasons: str) -> BlockScore:
    return BlockScore(
        block=name,
        topology=total,
        interaction=total,
        constraints=total,
        total=total,
        reasons=list(reasons),
        eligible=not reasons,
    )


def placing(**refused: str) -> Callable[[Any], Any]:
    def place(block: Any) -> Any:
        if block.block_id in refused:
            raise CannotPlace(refused[block.block_id])
        return SimpleNamespace(block=block)

    return place


SCORES = [score("a", 0.9), score("b", 0.8), score("c", 0.8), score("d", 0.95, "too short")]
LIBRARY = library("a", "b", "c", "d")


def choose(place: Callable[[Any], Any], **given: Any) -> Winner:
    return choose_block(LIBRARY, SCORES, place, **given)


def test_the_highest_score_wins() -> None:
    tried: list[str] = []
    chosen = choose(placing(), on_block=tried.append)
    assert chosen.realisation.block.block_id == "a"
    assert (chosen.chosen_by, chosen.tied) == (HIGHEST, ())
    assert tried == ["a"]


def test_a_winner_that_fails_a_check_leaves_it_to_the_next() -> None:
    chosen = choose(placing(a="the conflict begins before the trigger", b="leaves the geofence"))
    assert chosen.realisation.block.block_id == "c"
    told = {s.block: s for s in chosen.scores}
    assert told["a"].reasons == ["the conflict begins before the trigger"]
    assert not told["a"].eligible
    assert told["b"].reasons == ["leaves the geofence"]
    assert told["c"].eligible
    assert chosen.tied == ()  # b doesn't fit, so that nothing ties


def test_ties_are_reported_and_not_broken() -> None:
    with pytest.raises(
        NoBlockChosen, match=r"2 blocks fit equally well: b, c; .*--choose"
    ) as caught:
        choose(placing(a="no"))
    assert caught.value.tied == ["b", "c"]
    assert [s.block for s in caught.value.scores] == ["a", "b", "c", "d"]


def test_a_persons_choice_breaks_a_tie() -> None:
    chosen = choose(placing(a="no"), choice="c", who="Kim")
    assert chosen.realisation.block.block_id == "c"
    assert (chosen.chosen_by, chosen.tied) == ("Kim", ("b", "c"))


def test_a_choice_without_a_tie_changes_nothing() -> None:
    chosen = choose(placing(), choice="a", who="Kim")
    assert (chosen.chosen_by, chosen.tied) == (HIGHEST, ())


@pytest.mark.parametrize("choice", ["b", "d"])
def test_only_the_best_may_be_chosen(choice: str) -> None:
    with pytest.raises(NoBlockChosen, match=r"is not among the best blocks.*the best that fit: a"):
        choose(placing(), choice=choice, who="Kim")


MANY = [f"road {number:04}" for number in range(2000)]
ALIKE = [score(name, 0.9) for name in MANY]


def test_a_large_tie_is_not_realised_in_full() -> None:
    tried: list[str] = []
    with pytest.raises(NoBlockChosen, match="at least 8 blocks fit equally well") as caught:
        choose_block(
            library(*MANY), ALIKE, placing(**{MANY[1]: "leaves the fence"}), on_block=tried.append
        )
    assert tried == MANY[:9]
    assert caught.value.tied == [MANY[0], *MANY[2:9]]
    assert len(caught.value.scores) == len(MANY)


def test_a_chosen_block_is_realised_first_and_then_one_other() -> None:
    tried: list[str] = []
    chosen = choose_block(
        library(*MANY),
        ALIKE,
        placing(**{MANY[0]: "leaves the fence"}),
        choice=MANY[1500],
        who="Kim",
        on_block=tried.append,
    )
    assert tried == [MANY[1500], MANY[0], MANY[1]]
    assert (chosen.chosen_by, chosen.tied) == ("Kim", (MANY[1], MANY[1500]))


def test_a_chosen_block_that_does_not_fit_is_refused_with_the_reason() -> None:
    with pytest.raises(
        NoBlockChosen, match=r"best blocks: leaves the fence.*that fit: b"
    ) as caught:
        choose(placing(a="no", c="leaves the fence"), choice="c", who="Kim")
    assert caught.value.tied == ["b"]


def test_the_only_one_that_fits_is_no_choice() -> None:
    chosen = choose(placing(a="no", b="no"), choice="c", who="Kim")
    assert (chosen.chosen_by, chosen.tied) == (HIGHEST, ())


def test_many_scores_are_grouped_in_no_time() -> None:
    scores = [score(name, 0.9) for name in MANY] + [score("last", 0.8)]
    nothing = dict.fromkeys(MANY, "leaves the fence")
    before = time.process_time()
    chosen = choose_block(library(*MANY, "last"), scores, placing(**nothing))
    assert chosen.realisation.block.block_id == "last"
    assert time.process_time() - before < 2.0


def test_an_unknown_choice_is_named() -> None:
    with pytest.raises(NoBlockChosen, match=r"there is no such block \(got 'x'\)"):
        choose(placing(), choice="x", who="Kim")


def test_where_nothing_fits_the_reasons_are_counted() -> None:
    with pytest.raises(NoBlockChosen) as caught:
        choose(placing(a="one", b="two", c="two"))
    assert "no block of it fits: two (2 block(s)); " in str(caught.value)
    assert "too short (1 block(s))" in str(caught.value)
    with pytest.raises(NoBlockChosen, match="it has no blocks"):
        choose_block(library(), [], placing())
