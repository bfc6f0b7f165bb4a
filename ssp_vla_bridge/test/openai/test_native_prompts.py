"""Native prompts come from the one task, with the history as it is known and nothing else."""

from __future__ import annotations

from dataclasses import fields, replace

import pytest

from ssp_core.errors import InputError
from ssp_vla_bridge.messages import TASK, EgoSample, Response
from ssp_vla_bridge.native_history import previous_stage, stage_text
from ssp_vla_bridge.prompts import PROMPTS, UNKNOWN_PAST, find_stages

NS = 1_000_000_000
BEFORE = {"scene": "SCENE TEXT", "objects": "OBJECTS TEXT", "intent": "INTENT TEXT"}
VOCABULARIES = ("objects", "positions", "motions", "conflicts", "lon_actions", "lat_actions")
EVERY = pytest.mark.parametrize("interface", PROMPTS)


def prompts(interface, request):
    """System and user text of each stage, by name."""
    built = {stage.name: stage.build(request, BEFORE) for stage in find_stages(interface)}
    return {name: f"{prompt.system}\n{prompt.text}" for name, prompt in built.items()}


def driven(seconds_s=5.0, spacing_s=0.5, speed_mps=8.0, yaw_rate_radps=0.0):
    """Straight driving along x up to t = 0."""
    count = round(seconds_s / spacing_s)
    return tuple(
        EgoSample(-k * spacing_s, -k * spacing_s * speed_mps, 0.0, 0.0, speed_mps, yaw_rate_radps)
        for k in range(count, -1, -1)
    )


def earlier(text="I slow down for the car.", stamp_ns=9 * NS, stages=None, **changes):
    whole = f"The scene.\n\n{text}\n\n[1,0]"
    start = whole.index(text) if text else 0
    span = {"name": "intent", "start": start, "end": start + len(text)}
    found = [span] if stages is None else stages
    response = Response("r0", stamp_ns, "m", "m/1", whole, (), {"stages": found})
    return replace(response, **changes)


# The task.


@EVERY
def test_every_word_of_the_task_is_asked(interface, make_request):
    told = prompts(interface, make_request())
    everything = "\n".join(told.values())
    for name in VOCABULARIES:
        for word in getattr(TASK, name):
            assert word.replace("_", " ") in everything
    for text in told.values():
        assert TASK.instruction in text
    assert "every 0.5 s, up to 2 s" in told["motion"]


# What another task changes, by field of the task: the stages that ask for it.
ASKED_IN = {
    "openemma": {
        "instruction": {"scene", "objects", "intent", "motion"},
        "objects": {"scene", "objects"},
        "positions": {"objects"},
        "motions": {"objects"},
        "conflicts": {"objects"},
        "lon_actions": {"intent"},
        "lat_actions": {"intent"},
        "trajectory_step_s": {"motion"},
        "trajectory_horizon_s": {"motion"},
    },
    "lightemma": {
        "instruction": {"scene", "intent", "motion"},
        "objects": {"scene"},
        "positions": {"scene"},
        "motions": {"scene"},
        "conflicts": {"scene"},
        "lon_actions": {"intent"},
        "lat_actions": {"intent"},
        "trajectory_step_s": {"motion"},
        "trajectory_horizon_s": {"motion"},
    },
    "llavida": {field.name: {"motion"} for field in fields(TASK)},
    "waypoints": {field.name: {"motion"} for field in fields(TASK)},
}
OTHER = {
    "instruction": "Park the lorry.",
    "trajectory_step_s": 0.25,
    "trajectory_horizon_s": 2.5,
}


@EVERY
@pytest.mark.parametrize("field", [field.name for field in fields(TASK)])
def test_another_task_is_another_prompt(interface, field, make_request):
    request = make_request(history=driven())
    value = OTHER.get(field, ("tram", *getattr(TASK, field)[1:]) if field in VOCABULARIES else "")
    changed = replace(request, task=replace(TASK, **{field: value}))
    before, after = prompts(interface, request), prompts(interface, changed)
    assert {name for name in before if before[name] != after[name]} == ASKED_IN[interface][field]


@pytest.mark.parametrize(
    ("interface", "most_s"), [("openemma", 5), ("lightemma", 3), ("llavida", 3)]
)
def test_a_native_form_says_where_it_ends(interface, most_s, make_request):
    request = make_request()
    fits = replace(request, task=replace(TASK, trajectory_horizon_s=float(most_s)))
    assert f"up to {most_s} s" in prompts(interface, fits)["motion"]
    longer = replace(request, task=replace(TASK, trajectory_horizon_s=most_s + 0.5))
    with pytest.raises(InputError, match=f"{interface} plans.* cover {most_s} s"):
        prompts(interface, longer)


def test_the_forms_are_the_systems_own(make_request):
    request = make_request()
    assert "[speed_10, curvature_10]" in prompts("openemma", request)["motion"]
    assert "[speed_11" not in prompts("openemma", request)["motion"]
    assert "(v5, c5), (v6, c6)]" in prompts("lightemma", request)["motion"]
    told = prompts("llavida", request)["motion"]
    assert "\n3-second trajectory: [(x1,y1), " in told
    assert "(x6,y6)]\n" in told
    told = prompts("waypoints", request)["motion"]
    assert told.endswith("Trajectory: [[x1, y1], [x2, y2], [x3, y3], [x4, y4]]")
    assert "4 points, the first one 0.5 s from now" in told


@pytest.mark.parametrize(("step_s", "horizon_s", "count"), [(0.1, 2.0, 20), (0.7, 2.0, 2)])
def test_waypoints_are_as_many_as_the_task_asks(make_request, step_s, horizon_s, count):
    task = replace(TASK, trajectory_step_s=step_s, trajectory_horizon_s=horizon_s)
    told = prompts("waypoints", replace(make_request(), task=task))["motion"]
    assert f"That is {count} points" in told
    assert told.count("[x") == count + 1  # the form, and the axes' explanation


def test_an_interface_without_prompts_is_named():
    with pytest.raises(InputError, match=r"alpamayo.*known: lightemma, llavida, openemma"):
        find_stages("alpamayo")


# Frames and history.


@EVERY
def test_the_frames_times_are_told_as_they_are(interface, make_request, grey_jpeg):
    one = prompts(interface, make_request())
    three = prompts(interface, make_request(jpegs=[grey_jpeg] * 3))
    for name in one:
        assert "The picture was taken by your vehicle's front camera 0.00 s before now" in one[name]
        assert "The 3 pictures were taken" in three[name]
        assert "0.20, 0.10, 0.00 s before now, oldest first" in three[name]


@EVERY
@pytest.mark.parametrize("how", ["none", "not believed"])
def test_an_unknown_past_is_said_to_be_unknown(interface, how, make_request):
    request = make_request()
    if how == "not believed":
        request = replace(make_request(history=driven()), ego_provenance="unknown")
    told = prompts(interface, request)["motion"]
    assert UNKNOWN_PAST in told
    assert "oldest first, are" not in told
    assert "8.0" not in told
    assert UNKNOWN_PAST not in prompts(interface, make_request(history=driven()))["motion"]


def test_the_past_is_told_in_each_systems_numbers(make_request):
    request = make_request(history=driven())
    told = prompts("openemma", request)["motion"]
    pairs = ", ".join(["[4.0,0.0]"] * 10)
    assert f"last 10 pairs of your vehicle, 0.5 s apart, oldest first, are {pairs}." in told
    told = prompts("lightemma", request)
    for name in ("intent", "motion"):
        assert "last 6 speeds, 0.5 s apart" in told[name]
        assert f"are {[8.0] * 6} m/s" in told[name]
        assert f"{[0.0] * 6} 1/m" in told[name]
    told = prompts("llavida", request)["motion"]
    assert "[(0.00,-24.00), (0.00,-20.00)" in told
    assert "(0.00,-4.00)]; it is at (0.00,0.00) now, and its speed is 8.00 m/s" in told
    told = prompts("waypoints", request)["motion"]
    assert "[-5.0, -40.00, 0.00, 8.00], " in told
    assert "[0.0, 0.00, 0.00, 8.00]." in told


def test_a_short_past_is_told_as_short_as_it_is(make_request):
    request = make_request(history=driven(seconds_s=1.5))
    told = prompts("openemma", request)["motion"]
    assert "last 3 pairs" in told
    assert told.count("[4.0,0.0]") == 3


def test_later_stages_are_given_the_earlier_ones(make_request):
    told = prompts("openemma", make_request())
    assert all(text in told["motion"] for text in BEFORE.values())
    assert not any(text in told["intent"] for text in BEFORE.values())
    told = prompts("lightemma", make_request())
    assert "SCENE TEXT" in told["intent"]
    assert "SCENE TEXT" in told["motion"]
    assert "INTENT TEXT" in told["motion"]


# The intent before.


def test_openemma_is_told_its_intent_of_before(make_request):
    plain = prompts("openemma", make_request())
    told = prompts("openemma", replace(make_request(), previous=earlier()))
    assert "1.0 s ago your intent was:\nI slow down for the car.\n" in told["intent"]
    assert "keep this intent or change it" in told["intent"]
    assert "ago your intent" not in plain["intent"]
    assert {name for name in told if told[name] != plain[name]} == {"intent"}


@pytest.mark.parametrize("interface", ["lightemma", "llavida", "waypoints"])
def test_other_interfaces_carry_nothing_over(interface, make_request):
    request = make_request()
    assert prompts(interface, request) == prompts(interface, replace(request, previous=earlier()))


@pytest.mark.parametrize(
    "previous",
    [
        None,
        earlier(error_code=2, error_msg="broken"),
        earlier(stamp_ns=10 * NS),
        earlier(stamp_ns=11 * NS),
        earlier(text=""),
        earlier(text="  \n "),
        earlier(decoding={}),
        earlier(stages=[]),
        earlier(stages="intent"),
        earlier(stages=["intent"]),
        earlier(stages=[{"name": "intent"}]),
        earlier(stages=[{"name": "intent", "start": 0, "end": 10_000}]),
        earlier(stages=[{"name": "intent", "start": -9, "end": 40}]),
        earlier(stages=[{"name": "intent", "start": 9, "end": 4}]),
        earlier(stages=[{"name": "intent", "start": 0.0, "end": 4.0}]),
        earlier(stages=[{"name": "intent", "start": "0", "end": "4"}]),
        earlier(stages=[{"name": "scene", "start": 0, "end": 4}]),
    ],
)
def test_what_is_no_earlier_intent_is_not_used(previous, make_request):
    request = make_request()
    assert previous_stage(request, "intent") is None
    carried = replace(request, previous=previous)
    assert previous_stage(carried, "intent") is None
    assert prompts("openemma", carried) == prompts("openemma", request)


def test_a_span_is_characters_and_not_bytes():
    text = "Größe – здесь 😀"
    stages = [{"name": "intent", "start": 6, "end": len(text)}]
    response = Response("r", 1, "m", "m/1", text, (), {"stages": stages})
    assert stage_text(response, "intent") == "– здесь 😀"
