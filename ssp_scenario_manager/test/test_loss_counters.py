"""States that are missing, by their sequence numbers."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_scenario_manager.session.link_quality import LossCounter, LossCounters


def counted(sequences: list[int]) -> tuple[int, int]:
    count = LossCounter()
    for sequence in sequences:
        count.see(sequence)
    return count.received, count.lost


@pytest.mark.parametrize(
    ("sequences", "lost"),
    [
        ([], 0),
        ([1, 2, 3], 0),
        ([7, 8, 9], 0),  # what came before the first that was heard is no loss
        ([1, 2, 5, 6], 2),
        ([1, 3, 2, 4], 0),  # late, not lost
        ([1, 1, 1, 2], 0),  # a world that holds repeats itself
        ([0, 0, 0], 0),  # a source that doesn't count
        ([5, 9, 6, 7], 1),
        ([500, 1, 2, 3], 0),  # begun anew
        ([2000, 900, 901], 0),
        ([2, 1, 3], 0),
    ],
)
def test_losses(sequences: list[int], lost: int) -> None:
    assert counted(sequences) == (len(sequences), lost)


@given(st.sets(st.integers(2, 60)))
def test_what_is_missing_is_lost_in_whatever_order_the_rest_comes(
    missing: set[int],
) -> None:
    """Neighbours may overtake each other; the first and the last arrive."""
    sequences = [n for n in range(1, 62) if n not in missing]
    for i in range(1, len(sequences) - 2, 2):
        sequences[i], sequences[i + 1] = sequences[i + 1], sequences[i]
    assert counted(sequences) == (len(sequences), len(missing))


def test_losses_are_told_once() -> None:
    losses = LossCounters()
    for sequence in (1, 2, 5):
        losses.see("ot2", sequence)
    losses.see("ot1", 1)
    assert losses.news() == ["ot2: 2 states lost, 2 of 5 so far"]
    assert losses.news() == []
    losses.see("ot2", 7)
    assert losses.news() == ["ot2: 1 states lost, 3 of 7 so far"]
    losses.forget()
    assert losses.of == {}
    assert losses.news() == []
