"""Causes and consequences: the primary reason first, what follows from it under it (METHOD 4)."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_eval.audit.evidence.reasons import TABLE, Finding, explain

CODES = list(TABLE)
DOCS = Path(__file__).resolve().parents[3] / "docs" / "audit.md"


def primary(*findings: Finding) -> str:
    return explain(findings)[0].finding.code


def under(*findings: Finding) -> list[str]:
    (reason,) = explain(findings)
    return [found.code for found in reason.consequences]


@pytest.mark.parametrize("code", CODES)
def test_causes_stand_above_their_consequences(code: str) -> None:
    for consequence in TABLE[code].brings:
        assert CODES.index(consequence) > CODES.index(code), consequence


def test_a_missing_conflict_takes_phase_and_epd_with_it() -> None:
    never = math.inf
    found = [
        Finding("epd_missing", "", never),
        Finding("conflict_phase", "", never),
        Finding("conflict_missing", "TTC is at least 4 s", never),
    ]
    assert primary(*found) == "conflict_missing"
    assert under(*found) == ["conflict_phase", "epd_missing"]


def test_swapped_roles_take_order_and_motion_with_them() -> None:
    found = [
        Finding("order_differs", ""),
        Finding("motion_differs", ""),
        Finding("roles_swapped", ""),
        Finding("lane_differs", ""),
    ]
    assert primary(*found) == "roles_swapped"
    assert len(explain(found)) == 1


def test_an_abort_explains_only_what_comes_after_it() -> None:
    abort = Finding("safety_abort", "", 6.0)
    late = Finding("conflict_missing", "", math.inf)
    early = Finding("participant_off_camera", "", 5.0)
    assert [r.finding.code for r in explain([abort, late, early])] == [
        "safety_abort",
        "participant_off_camera",
    ]
    assert under(abort, late) == ["conflict_missing"]


def test_what_happens_again_stands_under_the_first_time() -> None:
    first, then = Finding("safety_abort", "separation", 6.0), Finding("safety_abort", "hit", 6.4)
    assert primary(then, first) == "safety_abort"
    assert explain([then, first])[0].finding is first
    assert under(then, first) == ["safety_abort"]
    apart = [Finding("unverified", "topology"), Finding("unverified", "roles")]
    assert len(explain(apart)) == 2


def test_a_session_that_waited_in_vain_is_no_abort() -> None:
    found = [Finding("event_awaited", "", 40.0), Finding("conflict_missing", "", math.inf)]
    assert primary(*found) == "conflict_missing"


def test_a_consequence_of_a_consequence_stands_under_the_cause() -> None:
    switch = Finding("identity_switch", "", 5.0)
    abort = Finding("safety_abort", "", 5.5)
    invalid = Finding("run_invalid", "", math.inf)
    zone = Finding("zone_off_camera", "", 7.0)
    assert under(zone, invalid, abort, switch) == ["safety_abort", "run_invalid", "zone_off_camera"]


def test_what_has_nothing_to_do_with_each_other_stands_side_by_side() -> None:
    found = [Finding("other_source", ""), Finding("verdict_missing", "")]
    assert [r.finding.code for r in explain(found)] == ["other_source", "verdict_missing"]


@given(
    found=st.lists(
        st.builds(
            Finding,
            st.sampled_from(CODES),
            st.sampled_from(["", "x", "y"]),
            st.none() | st.floats(0, 20) | st.just(math.inf),
        ),
        max_size=12,
    ),
    order=st.randoms(),
)
def test_every_finding_is_told_once_whatever_their_order(
    found: list[Finding], order: object
) -> None:
    reasons = explain(found)
    told = [f for r in reasons for f in (r.finding, *r.consequences)]
    assert sorted(map(str, told)) == sorted(map(str, set(found)))
    ranks = [CODES.index(r.finding.code) for r in reasons]
    assert ranks == sorted(ranks)
    shuffled = list(found)
    order.shuffle(shuffled)  # type: ignore[attr-defined]  # a random.Random
    assert explain(shuffled) == reasons


def test_an_unknown_code_is_a_bug() -> None:
    with pytest.raises(KeyError):
        explain([Finding("made_up", "")])


def test_the_documentation_names_every_code_in_order() -> None:
    rows = re.findall(r"^\| [^|]+ \| ((?:`\w+`(?:, )?)+) \|", DOCS.read_text(), re.MULTILINE)
    assert re.findall(r"`(\w+)`", " ".join(rows)) == CODES
