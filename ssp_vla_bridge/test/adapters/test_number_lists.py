"""The scanner of number lists in prose: what is a list, where it begins, what is wrong with it."""

from __future__ import annotations

import math
import sys
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_vla_bridge.adapters.number_lists import CUT, ELIDED, scan_lists

AB = ((3.2, -0.2), (3.1, 0.1))


@pytest.mark.parametrize(
    "text",
    [
        "[3.2, -0.2], [3.1, 0.1]",
        "[3.2,-0.2],[3.1,0.1]",
        "[ 3.2 , -0.2 ] , [ 3.1 , 0.1 ]",
        "(3.2, -0.2), (3.1, 0.1)",
        "[[3.2, -0.2], [3.1, 0.1]]",
        "[(3.2, -0.2), (3.1, 0.1)]",
        "[3.20, \u22120.2], [3.1, 0.1]",
        "[3.2, \u20130.2], [3.1, +.1]",
        "[32e-1, -2E-1], [3.1, 1e-1]",
        "[3.2, -0.2]\n[3.1, 0.1]",
        "1. [3.2, -0.2]\n2. [3.1, 0.1]\n",
        "- **t=0.5s**: [3.2, -0.2]\n- **t=1.0s**: [3.1, 0.1]",
        "t=0.5: (3.2, -0.2), t=1.0: (3.1, 0.1)",
        "Step 1: [3.2 m/s, -0.2 1/m] -> Step 2: [3.1 m/s, 0.1 1/m]",
        "(v1 = 3.2, c1 = -0.2), (v2 = 3.1, c2 = 0.1)",
        '[{"speed": 3.2, "curvature": -0.2}, {"speed": 3.1, "curvature": 0.1}]',
        "[speed_1, curvature_1] = [3.2, -0.2], [speed_2, curvature_2] = [3.1, 0.1]",
        "[3.2 -0.2], [3.1 0.1]",
        "```json\n[[3.2, -0.2],\n [3.1, 0.1]]\n```",
        "$[3.2, -0.2], [3.1, 0.1]$",
        "The answer (as asked for) is: [3.2, -0.2], [3.1, 0.1].",
        "I see 2 cars (see below): [3.2, -0.2], [3.1, 0.1], which is slow.",
    ],
)
def test_one_list_in_its_many_ways_of_writing(text):
    (found,) = scan_lists(text)
    assert found.rows == AB
    assert found.fault == ""


@pytest.mark.parametrize(
    ("text", "rows"),
    [
        ("[4., .5], [4, 5.]", ((4.0, 0.5), (4.0, 5.0))),
        ("[1e3, 2E+2]", ((1000.0, 200.0),)),
        ("[3.2, -0.2, 7]", ((3.2, -0.2, 7.0),)),
    ],
)
def test_numbers_are_read_as_written(text, rows):
    assert scan_lists(text)[0].rows == rows


def test_numbers_that_are_none_are_kept():
    (found,) = scan_lists("[nan, 1], [-inf, NaN], [Infinity, 1e999]")
    assert math.isnan(found.rows[0][0])
    assert found.rows[1][0] == -math.inf
    assert found.rows[2] == (math.inf, math.inf)
    assert found.fault == ""


@pytest.mark.parametrize(
    "text",
    [
        "",
        "No list.",
        "[speed_1, curvature_1], [speed_2, curvature_2]",
        "[['STRAIGHT','DECELERATE'],['STRAIGHT','MAINTAIN']]",
        "(1) slow down, (2) keep left",
        "It is 3.2, -0.2 and 3.1, 0.1.",
        "[] () {} ][ )( .",
        "[3.2]",
        "(about 3 m away)",
    ],
)
def test_what_is_no_list(text):
    assert scan_lists(text) == ()


@pytest.mark.parametrize(
    ("text", "sizes"),
    [
        ("[1, 2], [3, 4] and later on [5, 6]", [2, 1]),
        ("[[1, 2], [3, 4]], [[5, 6], [7, 8]]", [2, 2]),
        ("[1, 2], [3, 4]\n\nSo, the final output is:\n\n[5, 6], [7, 8]", [2, 2]),
        ("at (4.4, 9.6) (x, y): [1, 2], [3, 4]", [1, 2]),
        ("(12 m, 3 s) [1, 2], [3, 4]", [1, 2]),
        ("[1, 2] because the car ahead brakes, [3, 4]", [1, 1]),
    ],
)
def test_prose_and_outer_brackets_part_lists(text, sizes):
    assert [len(one.rows) for one in scan_lists(text)] == sizes


@pytest.mark.parametrize(
    "text",
    [
        "[1, 2], [3, 4], [5",
        "[1, 2], [3, 4], [5, -",
        "[1, 2], [3, 4], [",
        "[1, 2], [3, 4],",
        "[1, 2], [3, 4], t=1.5:  [",
        "[[1, 2], [3, 4]",
        "Trajectory: [(1, 2), (3, 4)\n",
        "[1, 2] [3, 4] [5.",
    ],
)
def test_a_list_that_the_end_of_the_text_cuts_off_says_so(text):
    (found,) = scan_lists(text)
    assert found.rows == ((1.0, 2.0), (3.0, 4.0))
    assert found.fault == CUT


@pytest.mark.parametrize("text", ["So: [", "So: [3.", "So: [(", "So: [3.2, -0.2", "So: [-"])
def test_a_list_cut_off_in_its_first_row_is_there(text):
    assert [(one.rows, one.fault) for one in scan_lists(text)] == [((), CUT)]


@pytest.mark.parametrize(
    "text", ["[1, 2], [3, 4]", "[1, 2], [3, 4].", "[1, 2], [3, 4]**\n", "[1, 2], [3, 4] (m/s"]
)
def test_a_list_that_ends_is_not_cut_off(text):
    assert scan_lists(text)[0].fault == ""


@pytest.mark.parametrize(
    "text", ["[1, 2], ..., [3, 4]", "[1, 2], …, [3, 4]", "[1, 2], [3, 4], ..."]
)
def test_an_ellipsis_is_a_fault(text):
    (found,) = scan_lists(text)
    assert found.fault == ELIDED


@pytest.mark.parametrize(
    "row",
    ["[n/a, 1]", "[1, 2, 3]", "[1-2, 3]", "[1.2.3, 4]", "[1, 2 cars]", "[0x10, 1]", "[1,, 2]"],
)
def test_a_row_that_is_none_spoils_its_list(row):
    (found,) = scan_lists(f"[1, 2], {row}, [3, 4]")
    assert found.fault == "row 2 isn't like the others"


def test_rows_without_a_comma_between_them_are_marked():
    (found,) = scan_lists("[1, 2], [3, 4]\n[5, 6], [7, 8]")
    assert found.loose == (2,)


def test_names_and_units_are_told():
    (found,) = scan_lists("(v=3.2 m/s, c=0.1 1/m), (v=3.1 m/s, c=0.0 1/m)")
    assert found.names == (frozenset({"v"}), frozenset({"c"}))
    assert found.units == {"m/s", "1/m"}


def test_offsets_are_those_of_the_text():
    text = "So: [(1, 2), (3, 4)]."
    (found,) = scan_lists(text)
    assert text[found.start : found.end] == "[(1, 2), (3, 4)"


PIECES = [
    "[",
    "]",
    "(",
    ")",
    "{",
    "}",
    ",",
    ", ",
    " ",
    "\n",
    "1",
    "-0.2",
    "[1, 2]",
    "(3, 4)",
    "nan",
    "\u2212",
    "...",
    "t=",
    "v=",
    "m/s",
    "'",
    '"',
    "\\",
    "x",
    "*",
    "</think>",
    "trajectory:",
]


@settings(max_examples=300, deadline=None)
@given(st.lists(st.sampled_from(PIECES) | st.text(max_size=3), max_size=40).map("".join))
def test_any_text_is_scanned(text):
    end = 0
    for one in scan_lists(text):
        assert end <= one.start <= one.end <= len(text)
        end = one.end
        assert one.rows or one.fault
        if not one.fault:
            assert len({len(row) for row in one.rows}) == 1


HOSTILE = {
    "opening": "[",
    "closing": "]",
    "empty": "[]",
    "all three": "[({",
    "rows": "[1,2],",
    "labels": "[1,2] t=",
    "odd rows": "[1 2 , \u22123]x",
    "quotes": "['",
    "spaces": "[ ",
    "digits": "1",
    "dots": ".",
    "opened rows": "[1,2",
    "one number": "(1)",
    "minus": "[-",
    "words": "[a",
    "lines": "[1,2]\n",
}


@pytest.mark.parametrize("unit", HOSTILE.values(), ids=HOSTILE)
def test_twice_the_text_takes_no_more_than_twice_the_steps(unit):
    small, large = (_steps(unit * (size // len(unit))) for size in (4_000, 8_000))
    assert large <= 2.05 * small


@pytest.mark.parametrize("unit", HOSTILE.values(), ids=HOSTILE)
def test_a_long_text_is_scanned(unit):
    # What a pattern does inside is no step of Python; the bound is some ten times what it takes.
    text = unit * (250_000 // len(unit))
    start_s = time.process_time()
    scan_lists(text)
    assert time.process_time() - start_s < 8.0


def _steps(text: str) -> int:
    """Lines of Python that scanning a text runs."""
    count = 0

    def trace(frame, event, argument):
        nonlocal count
        count += 1
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        scan_lists(text)
    finally:
        sys.settrace(before)
    return count
