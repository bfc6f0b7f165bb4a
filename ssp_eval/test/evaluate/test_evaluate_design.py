"""Conditions take turns in a balanced order, so that time alone looks like no cause."""

from __future__ import annotations

import random
from collections import Counter
from itertools import pairwise

import pytest

from ssp_eval.causes.findings import Finding, Word, moved_by
from ssp_eval.evaluate.clients.models import ModelSpec
from ssp_eval.evaluate.conditions.design import balanced_rows, series_of, stages_of
from ssp_eval.evaluate.conditions.expansion import with_repeats, with_twin_conditions
from tests.support.models.answerers import (
    ANSWERERS,
    LABELS,
    Answerer,
    cells_of,
    flipping,
    switching,
)

FEW = ("twin.without.ot1", "twin.control.car", "repeat")
MANY = (
    "twin.without.ot1",
    "twin.mirror.ot1",
    "twin.class.ot1.truck",
    "twin.shift.ot1.m0500",
    "twin.shift.ot1.p0500",
    "twin.control.car",
    "repeat",
)


def finding(answerer: Answerer, recordings: int, conditions: tuple[str, ...] = FEW) -> Finding:
    found = moved_by(cells_of("m", answerer, recordings, conditions))
    assert found is not None
    return found.findings[0]


@pytest.mark.parametrize("count", [1, 2, 3, 4, 7, 12])
def test_everything_stands_at_every_place_and_behind_everything_equally_often(count: int) -> None:
    rows = balanced_rows(count, 2 * count, random.Random(3))
    assert all(sorted(row) == list(range(count)) for row in rows)
    for place in range(count):
        assert set(Counter(row[place] for row in rows).values()) == {2}
    follows = Counter(pair for row in rows for pair in pairwise(row))
    assert len(follows) == count * (count - 1)
    assert len(set(follows.values())) <= 1
    # Of a square that isn't whole no place is taken twice by the same.
    for place in range(count):
        assert len({row[place] for row in rows[:count]}) == count


def test_the_order_is_drawn_for_each_recording_and_the_repeat_is_the_last() -> None:
    models = with_repeats(with_twin_conditions([ModelSpec("m")], FEW[:2]))
    assert [one.condition for one in models] == ["", *FEW]
    assert series_of(models) == [models]
    first, last = stages_of(models, "sha256:1", LABELS)
    assert [one.condition for one in last.models] == ["repeat"]
    assert first == next(iter(stages_of(models, "sha256:1", LABELS)))
    orders = {next(iter(stages_of(models, f"sha256:{n}", LABELS))).rows for n in range(20)}
    assert len(orders) == 20
    # Somebody who was asked about no cause is asked as ever, one condition after the other.
    plain = [ModelSpec("m"), ModelSpec("m", condition="black"), ModelSpec("n")]
    assert with_repeats(plain) == plain
    assert series_of(plain) == [[one] for one in plain]


def test_a_bridge_with_other_options_has_a_stage_of_its_own() -> None:
    models = [
        ModelSpec("m"),
        ModelSpec("m", condition="twin.control.car"),
        *(ModelSpec("m", {"give_back": fact}, condition=f"reasoning.{fact}") for fact in "abc"),
        ModelSpec("m", condition="repeat"),
    ]
    orders = set()
    for number in range(20):
        first, *others, last = stages_of(models, f"sha256:{number}", LABELS)
        assert [one.condition for one in first.models] == ["", "twin.control.car"]
        assert last.models == (models[-1],)
        orders.add(tuple(one.models[0].condition for one in others))
    assert len(orders) == 6


@pytest.mark.parametrize("conditions", [FEW, MANY])
@pytest.mark.parametrize("recordings", [1, 2])
def test_who_changes_after_any_number_of_requests_never_uses_the_object(
    recordings: int, conditions: tuple[str, ...]
) -> None:
    requests = recordings * LABELS * (1 + len(conditions))
    # All of them in one recording with few conditions; else every so many, and the last.
    counts = [*range(0, requests, 1 if requests < 40 else 7), requests]
    words = {k: finding(switching(k), recordings, conditions).word for k in counts}
    assert set(words.values()) <= {Word.OPEN, Word.IGNORES}
    # Who never changes, within these requests, ignores it.
    assert words[0] is words[requests] is Word.IGNORES


def test_who_changes_once_in_a_campaign_that_can_be_tested_does_not_use_the_object() -> None:
    requests = 12 * LABELS * (1 + len(FEW))
    words = {finding(switching(k), 12).word for k in range(0, requests, 37)}
    assert words <= {Word.OPEN, Word.IGNORES}


@pytest.mark.parametrize("recordings", [1, 2, 5])
@pytest.mark.parametrize("conditions", [FEW, MANY])
def test_who_looks_uses_the_object_in_a_few_recordings(
    recordings: int, conditions: tuple[str, ...]
) -> None:
    found = finding(ANSWERERS["uses_the_object"], recordings, conditions)
    assert (found.word, found.tested) == (Word.OBJECT, False)


@pytest.mark.parametrize(("share", "recordings"), [(0.5, 1), (0.1, 1), (0.05, 1), (0.02, 3)])
def test_of_coin_flips_hardly_any_is_said_to_use_the_object(share: float, recordings: int) -> None:
    """False findings are rare over many seeds, shares and numbers of recordings: docs/twins.md."""
    words = Counter(finding(flipping(share, seed), recordings, MANY).word for seed in range(50))
    assert words[Word.OBJECT] + words[Word.EXPLAINS_LATER] <= 2
    assert share < 0.5 or words == {Word.OPEN: 50}
