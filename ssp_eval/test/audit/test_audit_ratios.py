"""φ, EPD and KPR (METHOD 4): values worked out by hand, and what must not change them."""

from __future__ import annotations

import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from ssp_eval.data.audit import (
    EVENT_PHASES,
    FIELDS,
    Property,
    differences,
    is_equal,
    phase_difference,
    phase_fraction,
    property_retention,
)

TIMES = st.floats(-1e4, 1e4)
SHARES = st.dictionaries(st.sampled_from(EVENT_PHASES), st.floats(0, 1), min_size=1)
WORDS = st.lists(st.sampled_from("abcdef"), min_size=1, max_size=3, unique=True).map(tuple)
PROPERTIES = st.dictionaries(st.sampled_from(["p", "q", "r"]), WORDS, min_size=1).map(
    lambda words: Property(words, "made up")
)
ALL = st.fixed_dictionaries(dict.fromkeys(FIELDS, PROPERTIES))
WEIGHTS = st.fixed_dictionaries({field: st.floats(0, 10) for field in FIELDS})


def test_phi_is_the_share_of_the_clip_that_has_passed() -> None:
    assert phase_fraction(3.0, 1.0, 9.0) == 0.25
    assert phase_fraction(1.0, 1.0, 9.0) == 0.0
    assert phase_fraction(9.0, 1.0, 9.0) == 1.0


@pytest.mark.parametrize("bad", [(1.0, 2.0, 2.0), (1.0, 3.0, 2.0), (math.nan, 0.0, 1.0)])
def test_a_clip_without_length_has_no_phi(bad: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="has no fraction"):
        phase_fraction(*bad)


@given(t=TIMES, start=TIMES, length=st.floats(0.1, 1e3), scale=st.floats(0.01, 100), shift=TIMES)
def test_phi_knows_no_clock_and_no_speed(
    t: float, start: float, length: float, scale: float, shift: float
) -> None:
    before = phase_fraction(t, start, start + length)
    after = phase_fraction(
        t * scale + shift, start * scale + shift, (start + length) * scale + shift
    )
    assert after == pytest.approx(before, rel=1e-6, abs=1e-5)


def test_epd_is_the_mean_distance() -> None:
    here = {"trigger": 0.5, "conflict": 0.6, "resolution": 0.9}
    there = {"trigger": 0.4, "conflict": 0.65, "resolution": 0.9}
    assert phase_difference(here, there) == pytest.approx((0.1 + 0.05) / 3)


@given(phi=SHARES)
def test_epd_of_a_clip_with_itself_is_0(phi: dict[str, float]) -> None:
    assert phase_difference(phi, phi) == 0.0


@given(
    pairs=st.dictionaries(
        st.sampled_from(EVENT_PHASES), st.tuples(st.floats(0, 1), st.floats(0, 1)), min_size=1
    )
)
def test_epd_is_symmetric_and_at_most_1(pairs: dict[str, tuple[float, float]]) -> None:
    ours, theirs = ({k: v[i] for k, v in pairs.items()} for i in (0, 1))
    assert phase_difference(ours, theirs) == phase_difference(theirs, ours)
    assert 0.0 <= phase_difference(ours, theirs) <= 1.0


def test_epd_needs_the_same_events() -> None:
    with pytest.raises(ValueError, match="can't be compared"):
        phase_difference({"trigger": 0.1}, {"trigger": 0.1, "conflict": 0.2})
    with pytest.raises(ValueError, match="can't be compared"):
        phase_difference({}, {})


@given(reference=ALL, weights=WEIGHTS)
def test_kpr_of_a_recording_with_itself_is_1(
    reference: dict[str, Property], weights: dict[str, float]
) -> None:
    assume(sum(weights.values()) > 0)
    assert property_retention(reference, reference, weights) == pytest.approx(1.0)


@given(reference=ALL, weights=WEIGHTS, changed=st.sets(st.sampled_from(FIELDS)))
def test_kpr_falls_by_exactly_the_weight_of_a_changed_field(
    reference: dict[str, Property], weights: dict[str, float], changed: set[str]
) -> None:
    assume(sum(weights.values()) > 1e-3)
    found = dict(reference)
    for field in changed:
        words = dict(found[field].words or {})
        words[next(iter(words))] = ("something else",)
        found[field] = Property(words, "changed")
    lost = sum(weights[field] for field in changed) / sum(weights.values())
    assert property_retention(found, reference, weights) == pytest.approx(1.0 - lost)


def test_kpr_without_weights_counts_fields() -> None:
    reference = {field: Property({"p": ("a",)}, "") for field in FIELDS}
    found = {**reference, FIELDS[0]: Property({"p": ("b",)}, ""), FIELDS[1]: Property(None, "")}
    assert property_retention(found, reference) == pytest.approx(3 / 5)
    assert property_retention({}, reference) == 0.0
    # Part C may name some fields only; the others weigh 1.
    assert property_retention(found, reference, {FIELDS[0]: 3.0}) == pytest.approx(3 / 7)


@pytest.mark.parametrize(
    "weights", [dict.fromkeys(FIELDS, 0.0), {FIELDS[0]: -1.0}, {FIELDS[0]: math.inf}]
)
def test_weights_that_mean_nothing_are_refused(weights: dict[str, float]) -> None:
    reference = {field: Property({"p": ("a",)}, "") for field in FIELDS}
    with pytest.raises(ValueError, match="can't be used"):
        property_retention(reference, reference, weights)


def test_several_words_mean_any_of_them() -> None:
    wanted = Property({"lanes": ("2", "3", "4"), "segment": ("straight",)}, "")
    assert wanted.text == "lanes 2 to 4; segment straight"
    assert is_equal(Property({"lanes": ("3",), "segment": ("straight",)}, ""), wanted)
    other = Property({"lanes": ("1",), "segment": ("straight",)}, "")
    assert differences(other, wanted) == {"lanes": ("1", "2 to 4")}
    assert differences(Property({"lanes": ("2",)}, ""), wanted) == {
        "segment": ("absent", "straight")
    }


@given(a=PROPERTIES, b=PROPERTIES)
def test_equality_is_symmetric(a: Property, b: Property) -> None:
    assert is_equal(a, b) == is_equal(b, a)


def test_what_is_not_determined_equals_nothing() -> None:
    known, unknown = Property({"p": ("a",)}, ""), Property(None, "no states")
    assert differences(known, unknown) is None
    assert not is_equal(unknown, unknown)
