"""The label plan of METHOD 5.2b: golden cases by hand, and what holds for all recordings."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.vocabulary import PHASES
from ssp_eval.data.labels import PhasePosition
from ssp_eval.labels.plan import MOST_INSIDE, NoPlan, Plan, Timeline, plan_labels
from ssp_eval.recordings.event import Crop, Window, crop_of

TRIGGER, CONFLICT = "trigger", "conflict"


def frames(rate_hz: float, end_s: float, first_s: float = 0.0) -> list[float]:
    """Stamps on the nanosecond, as a recording has them."""
    count = math.floor((end_s - first_s) * rate_hz)
    return [round(first_s + k / rate_hz, 9) for k in range(count + 1)]


def line(
    trigger_s: float,
    conflict_s: float,
    resolution_s: float,
    name: str = "one",
    end_s: float = 60.0,
    rate_hz: float = 20.0,
    window: Window | None = None,
) -> Timeline:
    crop = crop_of(0.0, end_s, trigger_s, resolution_s, window)
    stamps = frames(rate_hz, end_s)
    return Timeline(name, trigger_s, conflict_s, resolution_s, crop, stamps)


def counts(plan: Plan) -> tuple[int, ...]:
    return tuple(plan.counts[phase] for phase in PHASES)


def times(plan: Plan, of: Timeline) -> list[float]:
    return [of.time_of(at) for at in plan.at]


# METHOD's own example: cut_in in its three domains.
SYN = line(3.208, 3.333, 5.5, "synthetic", 8.958, 24.0)
SIM = line(10.64, 10.96, 12.14, "simulation", 20.0, 20.0)
PHY = line(10.68, 11.0, 12.24, "physical", 20.0, 20.0)


def test_the_worked_example_of_the_method() -> None:
    plan = plan_labels([SYN, SIM, PHY])
    assert counts(plan) == (3, 1, 4, 1)
    assert plan.at == (
        PhasePosition("approach", 1.5),
        PhasePosition("approach", 1.0),
        PhasePosition("approach", 0.5),
        PhasePosition(TRIGGER, 0.5),
        PhasePosition(CONFLICT, 0.125),
        PhasePosition(CONFLICT, 0.375),
        PhasePosition(CONFLICT, 0.625),
        PhasePosition(CONFLICT, 0.875),
        PhasePosition("resolution", 0.25),
    )
    assert plan.remark == ""
    assert times(plan, SYN) == pytest.approx(
        [1.708, 2.208, 2.708, 3.2705, 3.603875, 4.145625, 4.687375, 5.229125, 5.75]
    )
    gaps = [[b - a for a, b in pairwise(times(plan, one))] for one in (SYN, SIM, PHY)]
    # From trigger to conflict, within the conflict, to the resolution, as METHOD states them.
    assert [g[3] for g in gaps] == pytest.approx([0.333, 0.308, 0.315], abs=0.00051)
    assert [g[4] for g in gaps] == pytest.approx([0.542, 0.295, 0.310], abs=0.00051)
    assert [g[7] for g in gaps] == pytest.approx([0.521, 0.397, 0.405], abs=0.00051)
    assert plan_labels([PHY, SYN, SIM]) == plan


@pytest.mark.parametrize(
    ("of", "expected"),
    [
        # T 0.5, C 0.5: one each, three before, four after.
        ((5.0, 5.5, 6.0), (3, 1, 1, 4)),
        # T 0.6 is one label still (⌈0.6 / 0.6⌉), C 0.6 too.
        ((5.0, 5.6, 6.2), (3, 1, 1, 4)),
        # T 0.7 needs two, C 1.3 three: m + n = 5.
        ((5.0, 5.7, 7.0), (3, 2, 3, 1)),
        # m + n = 6: two before. m + n = 7: one before, one after, nine in all.
        ((5.0, 5.5, 8.4), (2, 1, 5, 1)),
        ((5.0, 5.5, 9.0), (1, 1, 6, 1)),
        # m + n = 8 is more than seven: ten labels. T 1.1 and C 3.5 need two and six.
        ((5.0, 6.1, 9.6), (1, 2, 6, 1)),
        ((5.0, 6.3, 9.9), (1, 3, 6, 1)),
    ],
)
def test_numbers_of_labels_by_the_durations(
    of: tuple[float, float, float], expected: tuple[int, ...]
) -> None:
    plan = plan_labels([line(*of)])
    assert counts(plan) == expected
    most = sum(expected[1:3]) > 7
    assert len(plan.at) == (sum(expected[1:3]) + 2 if most else 9)
    assert bool(plan.remark) == most
    if most:
        assert plan.remark.startswith(f"{len(plan.at)} labels rather than 9")


def test_the_longest_phases_of_all_recordings_count() -> None:
    short, long = line(5.0, 5.45, 6.65), line(5.0, 5.9, 7.6)
    assert counts(plan_labels([short])) == (3, 1, 2, 3)
    assert counts(plan_labels([short, long])) == (3, 2, 3, 1)


def test_resolution_labels_begin_a_quarter_after_its_start() -> None:
    one = line(5.0, 5.5, 6.0)
    assert times(plan_labels([one]), one)[5:] == pytest.approx([6.25, 6.75, 7.25, 7.75])


def test_n_is_raised_until_the_frames_shown_are_near_enough() -> None:
    # T 0.4, C 1.2: m = 1, n = 2. From 5.2 to 5.7 and 5.7 to 6.3 s: the frames shown at 10 Hz, a
    # little late, are those of 5.15, 5.65 and 6.25 s, at most 0.6 apart. With a frame lost
    # at 5.65 and one more at 5.55 s, 5.45 and 6.25 s are 0.8 s apart; n = 3 has 5.2, 5.6, 6.0, 6.4.
    stamps = [round(0.05 + 0.1 * k, 9) for k in range(200)]
    crop = Crop(0.0, 19.0, "by hand")
    whole = Timeline("whole", 5.0, 5.4, 6.6, crop, stamps)
    assert counts(plan_labels([whole])) == (3, 1, 2, 3)
    lost = Timeline("lost", 5.0, 5.4, 6.6, crop, [s for s in stamps if not 5.5 < s < 5.7])
    plan = plan_labels([lost])
    assert counts(plan) == (3, 1, 3, 2)
    shown = [lost.newest_frame_s(lost.time_of(at)) for at in plan.at[3:7]]
    assert shown == [5.15, 5.45, 5.95, 6.35]
    # Whoever is planned with it has as many.
    assert plan_labels([whole, lost]) == plan


def test_m_is_raised_where_no_n_helps() -> None:
    # The trigger lasts 1.2 s: two labels, at 5.3 and 5.9 s. A gap in the frames from 5.6 to
    # 5.95 s makes those shown 5.25 and 5.55 s, which is well; one from 5.1 to 5.35 s makes them
    # 5.05 and 5.85 s, 0.8 s apart: three labels, at 5.2, 5.6 and 6.0 s, show 5.05, 5.55, 5.95 s.
    stamps = [round(0.05 * k, 9) for k in range(400)]
    crop = Crop(0.0, 19.0, "by hand")
    usual = Timeline("usual", 5.0, 6.2, 6.7, crop, stamps)
    assert counts(plan_labels([usual])) == (3, 2, 1, 3)
    lost = Timeline("lost", 5.0, 6.2, 6.7, crop, [s for s in stamps if not 5.07 < s < 5.37])
    plan = plan_labels([lost])
    assert counts(plan) == (3, 3, 1, 2)


def test_labels_a_fifth_of_a_second_apart_are_far_enough_to_the_nanosecond() -> None:
    # C 2.9 needs five labels; where it lasts 1 s less 1 ns they are 0.2 s less 0.2 ns apart.
    long, short = line(5.0, 5.5, 8.4), line(5.0, 5.5, 6.499999999)
    assert counts(plan_labels([long, short])) == (2, 1, 5, 1)


def test_labels_of_which_the_same_frame_is_shown_are_no_plan() -> None:
    slow = Timeline("slow", 5.0, 5.1, 5.7, Crop(0.0, 9.0, "by hand"), frames(1.0, 9.0))
    with pytest.raises(NoPlan, match=r"0\.000 s apart, not more than 0") as caught:
        plan_labels([slow])
    assert "slow: approach 5.000 s, trigger 0.100 s, conflict 0.600 s" in str(caught.value)


@pytest.mark.parametrize(
    ("of", "why"),
    [
        # Label times 0.05 + 0.1 s apart.
        ([line(5.0, 5.1, 5.3)], r"labels of one would be 0\.150 s apart, less than 0\.2 s"),
        # C 3.1 needs six, and where it lasts 1.0 s they'd be 0.167 s apart.
        (
            [line(5.0, 5.5, 8.6, "long"), line(5.0, 5.5, 6.5, "short")],
            "the conflict needs 6 labels where it is longest",
        ),
        ([line(5.0, 5.0, 6.0)], "the trigger of one has no duration"),
        ([line(5.0, 5.5, 5.5)], "the conflict of one has no duration"),
        ([line(1.2, 1.7, 3.0)], r"the approach lies at -0\.300 s, outside the clip of one"),
        ([line(5.0, 5.5, 6.5, end_s=6.7)], r"the resolution lies at 6\.750 s, outside the clip"),
        (
            [line(5.0, 5.5, 6.5, window=Window(1.4, 3.0, "K*"))],
            r"the approach lies at 3\.500 s, outside the clip of one \(3\.600 to 9\.500 s\)",
        ),
        ([line(5.0, 5.5, 5.5 + 0.6 * MOST_INSIDE + 1, end_s=300.0)], "would need 302 labels"),
        (
            [Timeline("late", 5.0, 5.5, 6.5, Crop(0.0, 9.0, "by hand"), [7.0, 7.1])],
            r"late has no frame at or before 5\.250 s",
        ),
    ],
)
def test_where_there_is_no_plan_phase_and_durations_are_named(of: list[Timeline], why: str) -> None:
    with pytest.raises(NoPlan, match=why) as caught:
        plan_labels(of)
    for one in of:
        assert one.durations in str(caught.value)


def test_the_risk_begins_with_the_trigger_or_with_the_frame_shown_at_its_first_label() -> None:
    # At 20 Hz the frame shown at 5.3 s is of 5.3 s, after the trigger's start; at 1.5 Hz it is
    # of 4.667 s, before it, and a record of that time must be a candidate all the same.
    quick = line(5.0, 5.6, 7.0)
    plan = plan_labels([quick])
    assert quick.risk_s(plan) == 5.0
    slow = line(5.0, 5.6, 7.0, rate_hz=1.5)
    assert slow.risk_s(plan) == pytest.approx(7 / 1.5)


durations = st.floats(0.05, 3.0)
rates = st.sampled_from([5.0, 10.0, 12.5, 24.0, 30.0])


@st.composite
def timelines(draw: st.DrawFn) -> Timeline:
    trigger_s = draw(st.floats(2.0, 15.0))
    conflict_s = trigger_s + draw(durations)
    resolution_s = conflict_s + draw(durations)
    end_s = resolution_s + draw(st.floats(2.0, 5.0))
    window = draw(st.none() | st.builds(Window, st.floats(1.6, 4.0), st.floats(2.0, 4.0)))
    crop = crop_of(0.0, end_s, trigger_s, resolution_s, window)
    stamps = frames(draw(rates), end_s, draw(st.floats(-0.2, 0.0)))
    lost = draw(st.sets(st.integers(0, len(stamps) - 1), max_size=3))
    kept = [s for k, s in enumerate(stamps) if k not in lost]
    return Timeline("one", trigger_s, conflict_s, resolution_s, crop, kept)


@settings(max_examples=300, deadline=None)
@given(st.lists(timelines(), min_size=1, max_size=3))
def test_every_plan_keeps_the_rules_in_every_recording(recordings: list[Timeline]) -> None:
    try:
        plan = plan_labels(recordings)
    except NoPlan:
        return
    order = [PHASES.index(at.phase) for at in plan.at]
    assert order == sorted(order)
    assert all(count >= 1 for count in counts(plan))
    m, n = plan.counts[TRIGGER], plan.counts[CONFLICT]
    assert len(plan.at) == (9 if m + n <= 7 else m + n + 2)
    assert plan.counts["approach"] == max(1, min(3, 8 - m - n))
    assert m >= max(one.conflict_s - one.trigger_s for one in recordings) / 0.6 - 1e-9
    assert n >= max(one.resolution_s - one.conflict_s for one in recordings) / 0.6 - 1e-9
    for one in recordings:
        label_times = times(plan, one)
        assert all(b - a >= 0.2 - 1e-8 for a, b in pairwise(label_times))
        starts = (-math.inf, one.trigger_s, one.conflict_s, one.resolution_s, math.inf)
        for at, t_s in zip(plan.at, label_times, strict=True):
            k = PHASES.index(at.phase)
            assert starts[k] <= t_s < starts[k + 1]
            assert one.crop.holds(t_s)
        critical = [
            t for t, at in zip(label_times, plan.at, strict=True) if at.phase in (TRIGGER, CONFLICT)
        ]
        shown = [max(s for s in one.frames_s if s <= t + 0.5e-9) for t in critical]
        assert all(0.0 < b - a <= 0.6 + 1e-9 for a, b in pairwise(shown))
        risk_s = one.risk_s(plan)
        assert risk_s == min(one.trigger_s, shown[0])
        # Nothing of the approach is a candidate of METHOD 6.9, and the first trigger label is.
        assert all(
            t < risk_s for t, at in zip(label_times, plan.at, strict=True) if at.phase == "approach"
        )
