"""The model's own text with one fact turned is given back, and the trajectory asked for."""

from __future__ import annotations

import pytest

from ssp_core.errors import InputError, PeerError
from ssp_vla_bridge.backends.given_back import before_trajectory, check_continued, turned
from ssp_vla_bridge.backends.openai_chat import read_options

TEXT = (
    "A dark SUV and two cyclists are ahead on the left. The car brakes right now. I slow down and "
    "keep to my lane; my vehicle is on the Right."
)
ROWS = "[[4, 0], [8, 0], [12, 0.1], [16, 0.2]]"
PAIRS = ", ".join(["[4.0, 0.0]"] * 10)


@pytest.mark.parametrize(
    ("fact", "text"),
    [
        (
            "object",
            "A dark pedestrian and two cars are ahead on the left. The pedestrian brakes right "
            "now. I slow down and keep to my lane; my vehicle is on the Right.",
        ),
        (
            "side",
            "A dark SUV and two cyclists are ahead on the right. The car brakes right now. I slow "
            "down and keep to my lane; my vehicle is on the Left.",
        ),
        (
            "action",
            "A dark SUV and two cyclists are ahead on the left. The car brakes right now. I "
            "accelerate and keep to my lane; my vehicle is on the Right.",
        ),
        ("control", TEXT),
    ],
)
def test_one_fact_is_turned_and_the_others_stay(fact: str, text: str) -> None:
    assert turned(TEXT, fact) == text


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("Keep my present speed.", "Brake."),
        ("Braking hard, then stopping", "Accelerating, then accelerating"),
        ("accelerates", "brakes"),
        ("Nothing of the kind.", "Nothing of the kind."),
    ],
)
def test_a_plan_is_about_the_model_itself(before: str, after: str) -> None:
    assert turned(before, "action", is_plan=True) == after
    assert turned(before, "action") == before or "my" in before


def test_an_article_goes_with_its_object() -> None:
    assert turned("An SUV waits.", "object") == "A pedestrian waits."
    assert turned("People and a bus", "object") == "Cars and a pedestrian"


def test_stages_are_asked_as_ever_and_the_last_is_given_the_turned_text(
    service, make_openai, make_request
):
    service.answers = ["A car on the left.", "1. The car", "I slow down.", PAIRS]
    answer = make_openai(give_back="action").answer(make_request())
    assert answer.text == "\n\n".join(service.answers)  # what it said itself
    assert len(service.asked) == 4
    assert "Your intent is: I accelerate." in service.asked[3].text
    assert "A car on the left." in service.asked[3].text
    assert answer.decoding["give_back"] == "action"
    motion = answer.decoding["stages"][-1]
    assert motion["given_back"]["intent"] == "I accelerate."
    assert [stage["name"] for stage in answer.decoding["stages"] if "given_back" in stage] == [
        "motion"
    ]


def test_the_control_asks_what_is_asked_anyway(service, make_openai, make_request):
    service.answers = ["A car.", "1. The car", "I slow down.", PAIRS]
    make_openai().answer(make_request())
    make_openai(give_back="control").answer(make_request())
    assert [one.body for one in service.asked[:4]] == [one.body for one in service.asked[4:]]


def test_an_answer_of_one_stage_is_given_back_as_a_beginning(service, make_openai, make_request):
    service.answers = [f"A car ahead. I slow down.\nTrajectory: {ROWS}", " [[5, 0], [9, 0]]"]
    request = make_request()
    answer = make_openai(interface="waypoints", give_back="object").answer(request)
    assert answer.text == "A car ahead. I slow down.\nTrajectory: [[5, 0], [9, 0]]"
    first, then = (one.body for one in service.asked)
    assert then["messages"][:-1] == first["messages"]
    assert then["messages"][-1] == {
        "role": "assistant",
        "content": "A pedestrian ahead. I slow down.\nTrajectory:",
    }
    assert (then["continue_final_message"], then["add_generation_prompt"]) == (True, False)
    assert "continue_final_message" not in first
    service.answers = [service.answers[0], ROWS.replace("4, 0", "5, 0")]
    again = make_openai(interface="waypoints", give_back="control").answer(request)
    (stage,) = again.decoding["stages"]
    assert stage["given_back"]["motion"] == "A car ahead. I slow down.\nTrajectory:"
    assert (stage["start"], stage["end"]) == (0, len(again.text))


@pytest.mark.parametrize(
    ("fact", "answers", "why"),
    [
        ("side", [f"A car ahead.\nTrajectory: {ROWS}"], "says no side that could be turned"),
        ("side", [f"Trajectory: {ROWS}"], "says no side"),
        ("object", [ROWS], "no text before a trajectory"),
        ("object", ["A car, and I don't know."], "no text before a trajectory"),
        ("object", [f"A car is ahead. I slow down. Trajectory: {ROWS}"] * 2, "begins anew"),
        ("object", [f"A car. Trajectory: {ROWS}", "I can't go on."], "begins anew"),
    ],
)
def test_what_can_t_be_given_back_is_not_available(
    service, make_openai, make_request, fact, answers, why
):
    service.answers = answers
    with pytest.raises(PeerError, match=f"n/a: .*{why}"):
        make_openai(interface="waypoints", give_back=fact).answer(make_request())


def test_a_server_that_refuses_a_beginning_is_named(service, make_openai, make_request):
    refusal = service.http({"error": {"message": "unknown continue_final_message"}}, status=400)
    service.queue = [
        lambda s, c: c.sendall(s.http(s.completion(f"A car.\nTrajectory: {ROWS}"))),
        lambda s, c: c.sendall(refusal),
    ]
    with pytest.raises(PeerError, match="continue_final_message"):
        make_openai(interface="waypoints", give_back="object").answer(make_request())


def test_an_unknown_fact_is_refused() -> None:
    options = {"base_url": "http://127.0.0.1:9/v1", "model": "seer-7b", "give_back": "weather"}
    with pytest.raises(InputError, match="known: object, side, action, control"):
        read_options(options)


def test_a_beginning_ends_before_the_numbers() -> None:
    assert before_trajectory("I go.\n2-second trajectory: [(1,2), (3,4)]").endswith("trajectory:")
    check_continued(" [(1,2), (3,4)]")
    check_continued("Trajectory: [(1,2)]")
