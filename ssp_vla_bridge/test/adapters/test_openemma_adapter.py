"""The adapter ``openemma``: hand-computed points, and which of a text's lists is the answer."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid

from ssp_vla_bridge.adapters.pairs import published_points

# A VUT that slows down on a straight road, as its request's history is printed.
HISTORY = tuple((v, 0.0) for v in (4.6, 4.5, 4.5, 4.3, 4.2, 4.0, 3.9, 3.9, 3.6, 3.5))
STEADY = ((5.0, 0.0),) * 10
PLAN = tuple((3.4 - 0.1 * i, 0.5) for i in range(10))
OTHER = tuple((3.0, -0.1 * i) for i in range(10))


@pytest.fixture(scope="module")
def history_request(cases):
    return cases.request_with(cases.straight_history([v for v, _ in HISTORY]))


# --- coordinates


def test_straight_ahead_covers_v_metres_per_half_second(cases):
    adapted = cases.read("openemma", cases.pairs(STEADY))
    assert adapted.trajectory.t_s == tuple(0.5 * i for i in range(11))
    assert cases.points(adapted) == [(5.0 * i, 0.0) for i in range(11)]
    assert adapted.invalid == ()
    assert adapted.info.name == "openemma"
    assert adapted.info.mode == "corrected"
    assert not adapted.info.origin_added
    assert adapted.info.notes == ()


@pytest.mark.parametrize(("k", "side"), [(2.0, 1.0), (-2.0, -1.0)])
def test_a_circle_is_met_exactly_to_the_left_and_to_the_right(cases, k, side):
    # k = 2 hundredths of 1/m is a radius of 50 m; 5 m per step turn by 0.1 rad.
    adapted = cases.read("openemma", cases.pairs([(5.0, k)] * 10))
    by_hand = [(50 * math.sin(0.1 * i), side * 50 * (1 - math.cos(0.1 * i))) for i in range(11)]
    assert np.array(cases.points(adapted)) == pytest.approx(np.array(by_hand), abs=1e-12)
    assert cases.points(adapted)[1] == pytest.approx((4.9916708, side * 0.2497917), abs=1e-6)
    assert cases.points(adapted)[2] == pytest.approx((9.9334665, side * 0.9966711), abs=1e-6)


def test_each_pair_holds_for_its_own_step(cases):
    adapted = cases.read("openemma", cases.pairs([(2.0, 0.0), (1.0, 0.0), (0.0, 0.0)]))
    assert cases.points(adapted) == [(0.0, 0.0), (2.0, 0.0), (3.0, 0.0), (3.0, 0.0)]


def test_native_has_the_published_error_of_two_and_a_half_metres_at_ten_metres_per_second(cases):
    adapted = cases.read("openemma:native", cases.pairs(STEADY))
    assert adapted.info.mode == "native"
    assert adapted.trajectory.t_s == tuple(0.5 * i for i in range(10))
    xs = adapted.trajectory.x_m
    assert xs == pytest.approx([5.0 * i * 10 / 9 for i in range(10)])
    # As the evaluation of OpenEMMA pairs them: point i with the true place half a second later.
    assert np.mean([abs(x - 5.0 * (i + 1)) for i, x in enumerate(xs)]) == pytest.approx(2.5)
    # As the points are stamped here.
    times = adapted.trajectory.t_s
    errors = [abs(x - 10.0 * t) for x, t in zip(xs, times, strict=True)]
    assert np.mean(errors) == pytest.approx(2.5)
    corrected = cases.read("openemma", cases.pairs(STEADY)).trajectory
    assert corrected.x_m == tuple(10.0 * t for t in corrected.t_s)


@pytest.mark.parametrize(("k", "side"), [(2.0, 1.0), (-2.0, -1.0)])
def test_native_turns_left_and_right(cases, k, side):
    adapted = cases.read("openemma:native", cases.pairs([(5.0, k)] * 10))
    # One step of 10/9 turns by 1/9 rad; the trapezoid takes the mean of both ends.
    x_m = 10 / 9 * 5.0 * (1 + math.cos(1 / 9)) / 2
    y_m = side * 10 / 9 * 5.0 * math.sin(1 / 9) / 2
    assert (x_m, y_m) == pytest.approx((5.5384, side * 0.3080), abs=1e-4)
    assert cases.points(adapted)[0] == (0.0, 0.0)
    assert cases.points(adapted)[1] == pytest.approx((x_m, y_m))


@pytest.mark.parametrize("count", [2, 3, 7, 10])
def test_native_is_the_trapezoidal_sum_over_a_time_from_0_to_n_in_n_points(count):
    random = np.random.default_rng(count)
    steps_m, curvatures_pm = random.uniform(0, 8, count), random.uniform(-0.1, 0.1, count)
    times = np.linspace(0, count, count)
    headings = cumulative_trapezoid(curvatures_pm * steps_m, times, initial=0)
    xs = cumulative_trapezoid(steps_m * np.cos(headings), times, initial=0)
    ys = cumulative_trapezoid(steps_m * np.sin(headings), times, initial=0)
    trajectory = published_points(list(zip(steps_m, 100.0 * curvatures_pm, strict=True)))
    assert trajectory.x_m == pytest.approx(list(xs), abs=1e-12)
    assert trajectory.y_m == pytest.approx(list(ys), abs=1e-12)


# --- which list is the answer


def answer_of(cases, text, *request, **kwargs):
    """The pairs that were read, by the points that they give."""
    adapted = cases.read("openemma", text, *request, **kwargs)
    for rows, name in ((PLAN, "plan"), (OTHER, "other"), (HISTORY, "history"), (STEADY, "steady")):
        if adapted.trajectory == cases.read("openemma", cases.pairs(rows)).trajectory:
            return name, adapted
    return adapted.trajectory, adapted


def test_the_echo_of_the_history_before_the_answer_is_passed_over(cases, history_request):
    text = f"The speeds are {cases.pairs(HISTORY)}. So I slow down:\n{cases.pairs(PLAN)}"
    assert answer_of(cases, text, history_request)[0] == "plan"


def test_the_echo_of_the_history_behind_the_answer_is_passed_over(cases, history_request):
    text = f"{cases.pairs(PLAN)}, which continues {cases.pairs(HISTORY)} well."
    name, adapted = answer_of(cases, text, history_request)
    assert name == "plan"
    assert "the echo of the history was left out" in adapted.info.notes


@pytest.mark.parametrize("form", ["[{}, {}]", "[{:.3f},{:.2f}]", "({}, {})"])
def test_the_echo_alone_is_no_answer(cases, history_request, form):
    adapted = cases.read("openemma", cases.pairs(HISTORY, form), history_request)
    assert adapted.trajectory is None
    assert adapted.invalid == ("missing",)


def test_the_echo_of_a_part_is_no_answer(cases, history_request):
    text = f"The last ones are {cases.pairs(HISTORY[4:])}, as I see it."
    adapted = cases.read("openemma", text, history_request)
    assert adapted.invalid == ("missing",)
    assert "the echo of a part of the history was left out" in adapted.info.notes


@pytest.mark.parametrize("joint", [", ", "\n", "\n\n"])
def test_history_and_answer_in_one_list_are_parted(cases, history_request, joint):
    text = cases.pairs(HISTORY) + joint + cases.pairs(PLAN)
    assert answer_of(cases, text, history_request)[0] == "plan"


def test_the_end_of_the_history_before_the_answer_is_parted(cases, history_request):
    assert answer_of(cases, cases.pairs(HISTORY[-3:] + PLAN), history_request)[0] == "plan"


def test_twenty_pairs_are_not_parted_where_the_history_is_not_at_hand(cases):
    adapted = cases.read("openemma", cases.pairs(HISTORY + PLAN), None)
    assert adapted.trajectory is None
    assert adapted.invalid == ("shape",)
    assert "the request isn't at hand" in adapted.info.notes[-1]


def test_an_echo_that_could_not_be_recognised_is_noted(cases):
    name, adapted = answer_of(cases, cases.pairs(HISTORY), None)
    assert name == "history"
    assert adapted.info.notes == (
        "the request isn't at hand, so that an echo of its history isn't recognised",
    )


def test_what_the_text_calls_history_is_none_where_the_request_is_not_at_hand(cases):
    for label in (
        "Observed speeds and curvatures: ",
        "**Historical data:**\n\n",
        "The last 10 values: ",
    ):
        text = f"{label}{cases.pairs(HISTORY)}\n"
        assert cases.read("openemma", text, None).invalid == ("missing",)
        assert cases.read("openemma", text).invalid == ("missing",)
    text += f"Given the history, my future ones are: {cases.pairs(PLAN)}"
    assert answer_of(cases, text)[0] == "plan"


def test_a_steady_history_is_not_told_from_a_plan_that_keeps_on(cases):
    request = cases.request_with(cases.straight_history([5.0] * 10))
    name, adapted = answer_of(cases, cases.pairs(STEADY), request)
    assert name == "steady"
    assert adapted.info.notes == ("the list equals the history, whose rows are all the same",)
    text = f"Historical values: {cases.pairs(STEADY)}"
    assert cases.read("openemma", text, request).invalid == ("missing",)


def test_a_model_without_a_history_can_not_echo_it(cases):
    request = cases.request_with(cases.straight_history([v for v, _ in HISTORY]), "unknown")
    assert answer_of(cases, cases.pairs(HISTORY), request)[0] == "history"


def test_a_list_given_twice_is_one(cases):
    text = f"They are:\n\n{cases.pairs(PLAN)}\n\nSo, finally:\n\n{cases.pairs(PLAN)}"
    name, adapted = answer_of(cases, text)
    assert name == "plan"
    assert adapted.info.notes == ("the list is given 2 times",)


@pytest.mark.parametrize("joint", [", ", "\n", "\n\n"])
def test_a_list_given_twice_in_a_row_is_one(cases, joint):
    text = cases.pairs(PLAN) + joint + cases.pairs(PLAN)
    name, adapted = answer_of(cases, text)
    assert name == "plan"
    assert len(adapted.info.notes) == 1


def test_of_different_lists_the_last_whole_one_is_taken(cases):
    text = f"First {cases.pairs(OTHER)}, but wait: {cases.pairs(PLAN)}. [3.4, 0.5] is slow."
    name, adapted = answer_of(cases, text)
    assert name == "plan"
    assert adapted.info.notes == ("1 other lists of 10 were passed over for the last",)


def test_what_follows_the_reasoning_is_the_answer(cases):
    text = f"Maybe {cases.pairs(OTHER)}.\n</think>\n\n{cases.pairs(PLAN[:4])}"
    adapted = cases.read("openemma", text)
    assert len(adapted.trajectory.t_s) == 5
    assert "reasoning was left out" in adapted.info.notes
    assert "4 rows instead of 10" in adapted.info.notes
    kept = cases.read("openemma", f"Maybe {cases.pairs(PLAN)}.\n</think>\nDone.")
    assert kept.invalid == ("missing",)


def test_reasoning_that_does_not_end_holds_no_answer(cases):
    adapted = cases.read("openemma", f"<think>Maybe {cases.pairs(PLAN)}, but the car")
    assert adapted.invalid == ("missing",)
    assert adapted.info.notes == (
        "the text holds no list of numbers",
        "reasoning was left out",
    )
    assert answer_of(cases, f"<think>No.</think>{cases.pairs(PLAN)}")[0] == "plan"


def test_a_list_that_is_cut_off_has_no_shape(cases):
    adapted = cases.read("openemma", cases.pairs(PLAN)[:-9])
    assert adapted.trajectory is None
    assert adapted.invalid == ("shape",)
    assert adapted.info.notes == ("the list can't be read: it is cut off by the end of the text",)


def test_a_whole_list_before_one_that_is_cut_off_is_taken(cases):
    name, adapted = answer_of(cases, f"{cases.pairs(PLAN)}\nSo it is: {cases.pairs(PLAN)[:30]}")
    assert name == "plan"
    assert adapted.info.notes == ("a later list is cut off",)


def test_a_draft_is_not_taken_for_an_answer_that_is_cut_off(cases):
    text = f"At first {cases.pairs(OTHER[:4])}. In all: {cases.pairs(PLAN)[:12]}"
    assert cases.read("openemma", text).invalid == ("shape",)


@pytest.mark.parametrize(("count", "reason"), [(1, "coverage"), (2, ""), (9, ""), (12, "")])
def test_another_number_of_pairs_is_read_as_it_is(cases, count, reason):
    adapted = cases.read("openemma", cases.pairs([(5.0, 0.0)] * count))
    assert adapted.invalid == ((reason,) if reason else ())
    assert f"{count} rows instead of 10" in adapted.info.notes
    if not reason:
        assert adapted.trajectory.t_s[-1] == 0.5 * count


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "missing"),
        ("I am sorry, but I can't help with that.", "missing"),
        ("[speed_1, curvature_1], [speed_2, curvature_2]", "missing"),
        ("[5.0, 0.0], [5.0, 0.0], ..., [5.0, 0.0]", "shape"),
        ("[5.0, 0.0], [5.0, n/a], [5.0, 0.0]", "shape"),
        ("[5.0, 0.0, 0.5], [5.0, 0.0, 1.0]", "shape"),
        ("[5.0, 5.0, 5.0, 5.0]", "shape"),
        ("[18 px, 0.0], [18 px, 0.0]", "shape"),
        ("(x=5.0, y=0.0), (x=10.0, y=0.0)", "shape"),
        ("(z=0.0, v=5.0), (z=0.0, v=5.0)", "shape"),
        ("[5.0, 0.0], [nan, 0.0], [5.0, 0.0]", "non_finite"),
        ("[5.0, inf], [5.0, 0.0], [5.0, 0.0]", "non_finite"),
        ("[1e308, 1e308], [1e308, 1e308]", "non_finite"),
    ],
)
@pytest.mark.parametrize("mode", ["corrected", "native"])
def test_names_why_there_is_no_trajectory(cases, text, reason, mode):
    adapted = cases.read(f"openemma:{mode}", text)
    assert adapted.trajectory is None
    assert adapted.invalid[0] == reason
    assert adapted.text == text


@pytest.mark.parametrize(
    ("form", "note"),
    [
        ("({}, {})", "round brackets"),
        ("[{} m, {}]", "units in rows"),
        ("{{'v': {}, 'k': {}}}", "names in rows"),
        ("step 1: [{}, {}]", "labels between rows"),
        ("[{} {}]", "a space for a comma"),
    ],
)
def test_what_was_tolerated_is_noted(cases, form, note):
    name, adapted = answer_of(cases, cases.pairs(PLAN, form))
    assert name == "plan"
    assert note in adapted.info.notes


@pytest.mark.parametrize(
    ("heading", "form", "row", "note"),
    [
        ("", "[{} m/s, {}]", (10.0, 0.2), "m/s"),
        ("Speed in m/s and curvature:\n", "[{}, {}]", (10.0, 0.2), "m/s"),
        ("", "[{} m/s, {} 1/m]", (10.0, 0.002), "1/m, m/s"),
        ("(km/h, 1/m):\n", "[{}, {}]", (36.0, 0.002), "1/m, km/h"),
        ("Curvatures in 1/m, times 100:\n", "[{}, {}]", (5.0, 0.2), ""),
        ("(m/step, 1/100 m):\n", "[{}, {}]", (5.0, 0.2), ""),
        ("", "[{} m/step, {}]", (5.0, 0.2), ""),
    ],
)
def test_stated_units_are_converted_to_those_of_the_history(cases, heading, form, row, note):
    adapted = cases.read("openemma", heading + cases.pairs([row] * 10, form))
    asked = cases.read("openemma", cases.pairs([(5.0, 0.2)] * 10))
    assert adapted.trajectory.x_m == pytest.approx(asked.trajectory.x_m)
    assert adapted.trajectory.y_m == pytest.approx(asked.trajectory.y_m)
    converted = [one for one in adapted.info.notes if one.startswith("converted from ")]
    assert converted == ([f"converted from {note}"] if note else [])


def test_a_unit_that_the_interface_does_not_have_is_not_read(cases):
    adapted = cases.read("lightemma", "(m/step, 1/m):\n" + cases.pairs([(5.0, 0.2)] * 6))
    assert adapted.invalid == ("shape",)


def test_a_unicode_minus_is_read_and_noted(cases):
    text = cases.pairs(OTHER).replace("-", "\u2212")
    name, adapted = answer_of(cases, text)
    assert name == "other"
    assert adapted.info.notes == ("a Unicode minus",)


def test_a_curvature_that_no_car_drives_is_read_and_noted(cases):
    # 1/m instead of hundredths the other way round: 15 m/s on a radius of 5 m.
    adapted = cases.read("openemma", cases.pairs([(7.5, 20.0)] * 10))
    assert adapted.invalid == ()
    assert adapted.info.notes == ("it turns with more than 12 m/s² to the side",)


def test_an_intent_to_the_left_does_not_change_a_negative_curvature(cases):
    adapted = cases.read("openemma", "I turn left: " + cases.pairs([(5.0, -2.0)] * 10))
    assert adapted.trajectory.y_m[-1] < 0


def test_the_motion_stage_is_read_where_it_is_named(cases):
    scene, motion = f"Once I saw {cases.pairs(OTHER)}.", cases.pairs(PLAN[:5])
    text = f"{scene}\n\n{motion}"
    spans = [
        {"name": "scene", "start": 0, "end": len(scene)},
        {"name": "motion", "start": len(scene) + 2, "end": len(text)},
    ]
    staged = cases.read("openemma", text, decoding={"stages": spans})
    assert len(staged.trajectory.t_s) == 6
    assert staged.text == text
    assert len(cases.read("openemma", text).trajectory.t_s) == 11


@pytest.mark.parametrize(
    "stages", [[], None, 3, [3], [{"name": "motion"}], [{"name": "motion", "start": 9, "end": 1}]]
)
def test_stages_that_say_nothing_leave_the_whole_text(cases, stages):
    text = cases.pairs(PLAN)
    assert cases.read("openemma", text, decoding={"stages": stages}).invalid == ()


def limited(text, *names):
    """Decoding that says of these stages that they ended at the limit of tokens."""
    spans = [("intent", 0, 0), ("motion", 0, len(text))]
    return {
        "stages": [
            {
                "name": name,
                "start": start,
                "end": end,
                "finish_reason": "length" if name in names else "stop",
            }
            for name, start, end in spans
        ]
    }


@pytest.mark.parametrize("tail", ["", " ", "\n", ","])
def test_a_list_at_the_limit_of_tokens_is_cut_wherever_the_limit_fell(cases, tail):
    text = "Future: [4.0, 0.0], [4.1, 0.0], [4.2, 0.0], [4.3, 0.0]" + tail
    adapted = cases.read("openemma", text, decoding=limited(text, "motion"))
    assert adapted.invalid == ("shape",)
    assert "motion: cut off at the limit of tokens" in adapted.info.notes
    whole = cases.read("openemma", text, decoding={"finish_reason": "length"})
    assert whole.invalid == ("shape",)
    assert "answer: cut off at the limit of tokens" in whole.info.notes


@pytest.mark.parametrize(
    ("text", "points"),
    [
        ("[[4.0, 0.0], [4.0, 0.0], [4.0, 0.0], [4.0, 0.0]]", 5),
        (", ".join(["[4.0, 0.0]"] * 10), 11),
    ],
)
def test_a_list_that_ended_before_the_limit_of_tokens_is_read(cases, text, points):
    adapted = cases.read("openemma", text, decoding=limited(text, "motion"))
    assert (adapted.invalid, len(adapted.trajectory.t_s)) == ((), points)
    assert "motion: cut off at the limit of tokens" in adapted.info.notes


def test_a_stage_before_the_motion_that_was_cut_off_is_noted(cases):
    text = ", ".join(["[4.0, 0.0]"] * 10)
    adapted = cases.read("openemma", text, decoding=limited(text, "intent"))
    assert adapted.invalid == ()
    assert adapted.info.notes == ("intent: cut off at the limit of tokens",)
