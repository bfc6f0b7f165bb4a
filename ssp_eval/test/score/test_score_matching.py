"""METHOD 6.1 against brute force over every one-to-one, non-crossing pairing."""

from itertools import combinations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_eval.score.matching import match
from ssp_eval.score.thresholds import Thresholds

WINDOW_S = 0.11
TOLERANCE_S = 1e-9


def all_pairings(labels, records):
    """Every allowed pairing as a tuple of record indices or None per label."""
    for size in range(min(len(labels), len(records)) + 1):
        for chosen_labels in combinations(range(len(labels)), size):
            for chosen_records in combinations(range(len(records)), size):
                pairs = dict(zip(chosen_labels, chosen_records, strict=True))
                if all(
                    abs(records[i] - labels[j]) <= WINDOW_S + TOLERANCE_S for j, i in pairs.items()
                ):
                    yield tuple(pairs.get(j) for j in range(len(labels)))


def brute_force(labels, records):
    """METHOD 6.1 word by word: most pairs, least error, then the earliest record per label."""

    def size(pairing):
        return sum(i is not None for i in pairing)

    def error(pairing):
        return sum(abs(records[i] - labels[j]) for j, i in enumerate(pairing) if i is not None)

    rest = list(all_pairings(labels, records))
    most = max(map(size, rest))
    rest = [pairing for pairing in rest if size(pairing) == most]
    least = min(map(error, rest))
    rest = [pairing for pairing in rest if error(pairing) <= least + TOLERANCE_S]
    for j in range(len(labels)):
        best = min((pairing[j] for pairing in rest), key=lambda i: len(records) if i is None else i)
        rest = [pairing for pairing in rest if pairing[j] == best]
    return rest[0]


def times(step_s, largest):
    """Strictly rising times on a grid: coarse grids are full of ties."""
    return st.lists(st.integers(0, largest), max_size=6, unique=True).map(
        lambda steps: [step * step_s for step in sorted(steps)]
    )


@settings(max_examples=100, deadline=None)
@given(labels=times(0.03, 12), records=times(0.03, 12))
def test_equals_brute_force_where_ties_abound(labels, records):
    assert match(labels, records) == brute_force(labels, records)


@settings(max_examples=100, deadline=None)
@given(labels=times(0.055, 8), records=times(0.055, 8))
def test_equals_brute_force_where_distances_are_exactly_the_window(labels, records):
    assert match(labels, records) == brute_force(labels, records)


@settings(max_examples=100, deadline=None)
@given(labels=times(0.0137, 40), records=times(0.0071, 80))
def test_equals_brute_force_in_general(labels, records):
    assert match(labels, records) == brute_force(labels, records)


@settings(max_examples=60, deadline=None)
@given(
    labels=times(0.05, 8),
    records=times(0.05, 8),
    jitter=st.lists(st.sampled_from([0.0, 3e-10, -3e-10, 2e-9, -2e-9]), min_size=6, max_size=6),
)
def test_equals_brute_force_around_the_tolerance(labels, records, jitter):
    records = [time + jitter[i] for i, time in enumerate(records)]
    assert match(labels, records) == brute_force(labels, records)


@pytest.mark.parametrize(
    ("labels", "records", "expected"),
    [
        ([], [], ()),
        ([], [1.0], ()),
        ([1.0], [], (None,)),
        ([1.0], [1.11], (0,)),
        ([1.0], [0.89], (0,)),
        ([1.0], [1.110000002], (None,)),
        ([1.0], [0.889999998], (None,)),
        ([1.0, 1.1], [1.08, 1.2], (0, 1)),
        ([1.0], [0.9, 1.1], (0,)),
        ([0.9, 1.1], [1.0], (0, None)),
        ([1.0, 1.2], [1.1, 1.1000000001], (0, 1)),
        # The first choice spends all of the tolerance, and the sums round: no pair is lost for it.
        (
            [0.1, 0.15000000000000002, 0.25],
            [0.0, 1e-9, 0.05000000033, 0.29999999950000006],
            (0, 2, 3),
        ),
    ],
)
def test_by_hand(labels, records, expected):
    assert match(labels, records) == expected


def test_the_tolerance_is_for_the_total_and_not_for_each_label():
    """Either first record costs 0.7e-9 s more than the second one; both are more than 1e-9."""
    assert match([1.0, 2.0], [0.95 - 7e-10, 1.05, 1.95 - 7e-10, 2.05]) == (0, 3)


def test_what_one_label_leaves_of_the_tolerance_is_the_next_ones():
    """The first records cost 0.2e-9 and 0.6e-9 s more than the second ones: less than 1e-9."""
    assert match([1.0, 2.0], [0.95 - 2e-10, 1.05, 1.95 - 6e-10, 2.05]) == (0, 2)


def test_where_nothing_of_the_tolerance_is_left_the_best_choice_still_is_one():
    """Powers of two aren't rounded: the first choice costs exactly the tolerance."""
    thresholds = Thresholds(tolerance=2.0**-30)
    records = [-(2.0**-5) - 2.0**-30, 2.0**-5, 1.0, 1.0625]
    assert match([0.0, 1.0], records, thresholds) == (0, 2)


def test_a_long_recording_is_matched_in_linear_time():
    """50,000 records at 100 Hz against 1,000 labels: a full table would hold 50 million entries."""
    labels = [0.5 * j for j in range(1000)]
    records = [0.01 * i for i in range(50_000)]
    assert match(labels, records) == tuple(50 * j for j in range(1000))
