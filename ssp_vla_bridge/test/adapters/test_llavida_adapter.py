"""The adapter ``llavida``: (x lateral, y forward) becomes (y, −x), and nothing is padded."""

from __future__ import annotations

import pytest

LEFT = [(-0.1, 3.0), (-0.4, 6.0), (-0.9, 9.0), (-1.6, 11.9), (-2.5, 14.8), (-3.6, 17.6)]
RIGHT = [(-x, y) for x, y in LEFT]


def listed(cases, rows, form="({},{})"):
    return f"3-second trajectory: [{cases.pairs(rows, form, ',')}]"


@pytest.mark.parametrize(("rows", "side"), [(LEFT, 1.0), (RIGHT, -1.0)])
def test_lateral_and_forward_become_forward_and_left(cases, rows, side):
    adapted = cases.read("llavida", listed(cases, rows))
    assert adapted.trajectory.t_s == (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
    assert adapted.trajectory.x_m == (0.0, 3.0, 6.0, 9.0, 11.9, 14.8, 17.6)
    assert adapted.trajectory.y_m == tuple(side * y for y in (0.0, 0.1, 0.4, 0.9, 1.6, 2.5, 3.6))
    assert adapted.info.origin_added
    assert adapted.info.notes == ()


def test_the_line_of_meta_actions_stays_in_the_text(cases):
    text = f"Correct action: [['STRAIGHT','DECELERATE'],['STRAIGHT','STOP']]\n{listed(cases, LEFT)}"
    adapted = cases.read("llavida", text)
    assert adapted.text == text
    assert adapted.invalid == ()


@pytest.mark.parametrize(
    "text",
    [
        "**3-second trajectory:** [{}]",
        "3-second trajectory:\n[{}]",
        "3 second Trajectory = [ {} ]",
        "Once past the parked car, my 3-second trajectory: [{}]",
        "<think>A car at (4.36,9.56), moving to (4.36,9.57).</think>\n3-second trajectory: [{}]",
        "Notable: car at (4.36,9.56), (4.4,9.6). Planned Trajectory:\n[{}]\nI keep on.",
    ],
)
def test_the_list_behind_the_label_is_the_answer(cases, text):
    adapted = cases.read("llavida", text.format(cases.pairs(LEFT, "({},{})")))
    assert adapted.trajectory == cases.read("llavida", listed(cases, LEFT)).trajectory


def test_a_bold_label_and_nested_lists_are_noted(cases):
    text = listed(cases, LEFT, "[{}, {}]").replace(
        "3-second trajectory:", "**3-second trajectory:**"
    )
    adapted = cases.read("llavida", text)
    assert adapted.invalid == ()
    assert adapted.info.notes == ("square brackets", "a bold label")


def test_a_list_without_its_label_is_read_and_noted(cases):
    adapted = cases.read("llavida", f"[{cases.pairs(LEFT, '({},{})')}]")
    assert adapted.invalid == ()
    assert adapted.info.notes == ("no list stands behind 'trajectory'",)


def test_a_historical_trajectory_is_no_answer(cases):
    text = "Historical trajectory (last 2 seconds): [(0.0,-6.4), (0.0,-4.3), (0.0,-2.3)]"
    assert cases.read("llavida", text).invalid == ("missing",)
    adapted = cases.read("llavida", f"{text}\n{listed(cases, LEFT)}")
    assert adapted.trajectory == cases.read("llavida", listed(cases, LEFT)).trajectory


def test_the_past_points_of_the_request_are_no_answer(cases):
    request = cases.request_with(cases.straight_history([5.0, 4.0, 3.5, 3.0, 2.5, 2.0]))
    echo = "[(0.00,-20.00), (0.00,-15.00), (0.00,-11.00), (0.00,-7.50), (0.00,-4.50), (0.00,-2.00)]"
    adapted = cases.read("llavida", f"3-second trajectory: {echo}", request)
    assert adapted.invalid == ("missing",)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("I slow down.", "missing"),
        ("3-second trajectory: none", "missing"),
        ("3-second trajectory: [(0.0,3.0),(0.0,5.5),(0.0", "shape"),
        ("3-second trajectory: [(0.0,3.0),(0.0,5.5)", "shape"),
        ("3-second trajectory: [(0.0,3.0),(0.0,x),(0.0,5.5)]", "shape"),
        ("3-second trajectory: [(0.0,3.0,0.0),(0.0,5.5,0.0)]", "shape"),
        ("3-second trajectory: [0.0,3.0,0.0,5.5]", "shape"),
        ("3-second trajectory: [(0.0,3.0)]", "coverage"),
        ("3-second trajectory: [(0.0,3.0),(nan,5.5)]", "non_finite"),
    ],
)
def test_nothing_is_padded_and_nothing_stands_still_instead(cases, text, reason):
    adapted = cases.read("llavida", text)
    assert adapted.trajectory is None
    assert adapted.invalid == (reason,)


def test_a_short_list_stays_short(cases):
    adapted = cases.read("llavida", listed(cases, LEFT[:4]))
    assert adapted.trajectory.t_s == (0.0, 0.5, 1.0, 1.5, 2.0)
    assert adapted.info.notes == ("4 rows instead of 6",)


def test_points_without_an_outer_bracket_at_the_limit_of_tokens_are_cut_off(cases):
    text = "3-second trajectory: (0.0, 2.0), (0.0, 4.0), (0.0, 6.0)"
    assert cases.read("llavida", text).invalid == ()
    assert cases.read("llavida", text, decoding={"finish_reason": "length"}).invalid == ("shape",)
