"""Contradictions of windows on end: which hold, which leave a doubt, and which a delay explains."""

from __future__ import annotations

import pytest

from ssp_core.safety.contradiction import Contradiction, MotionFindings
from ssp_core.safety.delays import DELAYS_S, Delays
from ssp_core.safety.window import OTHER_SPEED


def contradict(
    findings: MotionFindings, *times_s: float, kind: str = "a", moves: bool = True
) -> Contradiction:
    for now_s in times_s:
        found = findings.contradict(now_s, kind, 1.0, f"at {now_s:g} s", moves=moves)
    return found


def contradiction_and_doubt(
    findings: MotionFindings,
) -> tuple[Contradiction | None, Contradiction | None]:
    """The present contradiction and the doubt."""
    return findings.contradiction, findings.doubt


def test_a_contradiction_holds_from_half_a_second_on() -> None:
    findings = MotionFindings()
    first = contradict(findings, 2.0)
    assert first == Contradiction("a", "a: at 2 s", 0.0, 1, True)
    assert contradiction_and_doubt(findings) == (first, None)
    assert not contradict(findings, 2.25, 2.499).holds
    assert contradict(findings, 2.5) == Contradiction("a", "a: at 2.5 s", 0.5, 4, True)
    assert contradict(findings, 2.5).holds
    findings.agree(2.6, moves=True)
    assert contradiction_and_doubt(findings)[0] is None
    assert contradict(findings, 2.7) == Contradiction("a", "a: at 2.7 s", 0.0, 1, True)


@pytest.mark.parametrize(
    ("times_s", "doubts"),
    [
        ((0.0, 0.125), False),
        ((0.0, 0.03125, 0.0625), False),
        ((0.0, 0.05, 0.1), True),
        ((0.0, 0.125, 0.25), True),
    ],
)
def test_three_windows_over_a_tenth_of_a_second_leave_a_doubt(
    times_s: tuple[float, ...], doubts: bool
) -> None:
    findings = MotionFindings()
    found = contradict(findings, *times_s)
    assert findings.doubt == (found if doubts else None)
    findings.interrupt()
    assert findings.contradiction is None
    assert findings.doubt == (found if doubts else None)


def doubting(*, moves: bool = True) -> MotionFindings:
    findings = MotionFindings()
    contradict(findings, 0.0, 0.25, 0.5, moves=moves)
    return findings


def test_a_doubt_ends_when_the_object_has_moved_for_half_a_second_without_another() -> None:
    findings = doubting()
    findings.agree(1.0, moves=True)
    findings.agree(1.499, moves=True)
    assert findings.doubt is not None
    findings.agree(1.5, moves=True)
    assert findings.doubt is None


def test_standstill_an_interruption_or_a_contradiction_begins_that_half_second_anew() -> None:
    def ends_at(findings: MotionFindings, now_s: float) -> bool:
        findings.agree(now_s - 0.01, moves=True)
        assert findings.doubt is not None
        findings.agree(now_s, moves=True)
        return findings.doubt is None

    still, interrupted, again = doubting(), doubting(), doubting()
    for findings in (still, interrupted, again):
        findings.agree(1.0, moves=True)
    still.agree(1.25, moves=False)
    interrupted.interrupt()
    contradict(again, 1.25)
    for findings in (still, interrupted, again):
        findings.agree(1.5, moves=True)
        assert ends_at(findings, 2.0)


def test_a_doubt_of_an_object_that_stood_ends_while_it_stands() -> None:
    findings = doubting(moves=False)
    _, doubt = contradiction_and_doubt(findings)
    assert doubt is not None
    assert not doubt.moving
    findings.agree(1.0, moves=False)
    findings.agree(1.5, moves=False)
    assert contradiction_and_doubt(findings) == (None, None)
    assert not contradict(findings, 2.0, moves=False).moving


def test_who_moved_in_one_window_or_in_the_doubt_before_has_moved() -> None:
    findings = MotionFindings()
    contradict(findings, 0.0, moves=True)
    assert contradict(findings, 0.1, moves=False).moving
    doubts = doubting()
    doubts.interrupt()
    assert contradict(doubts, 3.0, moves=False).moving
    still = MotionFindings()
    contradict(still, 0.0, moves=False)
    assert contradict(still, 0.1, moves=True).moving


def test_the_weightiest_kind_of_this_contradiction_names_it() -> None:
    findings = MotionFindings()
    findings.contradict(0.0, "a", 9.0, "", moves=True)
    findings.agree(0.1, moves=True)
    weights = (("a", 2.0), ("b", 1.5), ("b", 1.5), (OTHER_SPEED, 9.0))
    kinds = [
        findings.contradict(k / 8, kind, weight, "x", moves=True, other_speed="in knots").kind
        for k, (kind, weight) in enumerate(weights)
    ]
    assert kinds == ["a", "a", "b", "in knots"]
    assert findings.contradiction is not None
    assert findings.contradiction.text == "in knots: x"
    alone = MotionFindings().contradict(0.0, OTHER_SPEED, 1.0, "x", moves=True)
    assert alone.kind == OTHER_SPEED


# -- the delay between place and motion -----------------------------------------------------------

NONE, FIRST, LAST = DELAYS_S.index(0.0), 0, len(DELAYS_S) - 1


def fits(*delays: int) -> list[bool]:
    return [k in delays for k in range(len(DELAYS_S))]


def test_a_delay_that_did_not_fit_for_half_a_second_is_out_for_ten() -> None:
    delays = Delays()
    assert (delays.believed_s, delays.is_at_rest) == (0.0, True)
    assert delays.take(0.0, fits(FIRST))
    assert not delays.is_at_rest
    assert delays.believed_s == 0.0
    assert delays.possible(0.499) == list(DELAYS_S)
    assert delays.take(0.5, fits(FIRST))
    # None is out, and the one that fits is believed.
    assert delays.believed_s == DELAYS_S[FIRST]
    assert delays.possible(0.5) == [DELAYS_S[FIRST]]
    assert delays.possible(10.5) == [DELAYS_S[FIRST]]
    assert delays.possible(10.51) == list(DELAYS_S)
    assert not delays.take(0.6, fits(NONE))
    assert delays.take(0.7, fits(FIRST, NONE))
    assert not delays.take(10.5, fits(NONE))
    assert delays.take(10.6, fits(NONE))


def test_a_delay_that_fits_in_between_is_not_out() -> None:
    delays = Delays()
    delays.take(0.0, fits(FIRST))
    delays.take(0.25, fits(FIRST, LAST))
    delays.take(0.5, fits(FIRST))
    assert delays.possible(0.5) == [DELAYS_S[FIRST], DELAYS_S[LAST]]
    delays.take(0.999, fits(FIRST))
    assert delays.possible(0.999) == [DELAYS_S[FIRST], DELAYS_S[LAST]]
    delays.take(1.0, fits(FIRST))
    assert delays.possible(1.0) == [DELAYS_S[FIRST]]


def test_the_middle_of_those_that_fit_is_believed_once_the_one_before_is_out() -> None:
    delays = Delays()
    delays.take(0.0, fits(7, 8, 9))
    delays.take(0.5, fits(7, 8, 9))
    assert delays.believed_s == DELAYS_S[8]
    # It stays believed while it isn't out, whatever else fits.
    delays.take(0.6, fits(7))
    assert delays.believed_s == DELAYS_S[8]
    delays.take(1.1, fits(7))
    assert delays.believed_s == DELAYS_S[7]


def test_of_four_that_fit_the_third_is_believed() -> None:
    delays = Delays()
    for now_s in (0.0, 0.5):
        delays.take(now_s, fits(7, 8, 9, 10))
    assert delays.believed_s == DELAYS_S[9]


def test_a_delay_is_not_believed_up_to_the_end_of_its_time_out() -> None:
    delays = Delays()
    for now_s, k in ((0.0, FIRST), (0.5, FIRST), (0.625, LAST), (1.125, LAST)):
        delays.take(now_s, fits(k))
    # The first is out until 11.125 s, the last until 10.5 s.
    assert delays.believed_s == DELAYS_S[FIRST]
    assert delays.take(11.125, fits(LAST))
    assert delays.believed_s == DELAYS_S[LAST]


def test_beginning_anew_forgets_what_did_not_fit_just_now_but_not_what_is_out() -> None:
    delays = Delays()
    delays.take(0.0, fits(FIRST))
    delays.begin_anew()
    assert (delays.is_at_rest, delays.believed_s) == (True, 0.0)
    delays.take(0.5, fits(FIRST))
    assert delays.possible(0.5) == list(DELAYS_S)
    delays.take(1.0, fits(FIRST))
    delays.begin_anew()
    assert (delays.is_at_rest, delays.believed_s) == (False, DELAYS_S[FIRST])
    assert delays.possible(1.1) == [DELAYS_S[FIRST]]
