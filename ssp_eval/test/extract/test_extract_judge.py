"""The LLM's proposals that are kept: the scope and binding of the rules apply to its quotes."""

from __future__ import annotations

import json

import pytest

from ssp_eval.data.records import SLOT_NAMES, Slot, Slots
from ssp_eval.extract.llm.judge import judge
from ssp_eval.extract.llm.reply import Proposal, read_reply
from tests.support.models.llm_server import GOOD


# What the rules can't read by themselves, in places where it counts and where it doesn't.
@pytest.mark.parametrize(
    ("text", "slot", "label", "quote", "stands"),
    [
        ("We throttle the pace.", "lon_action", "decelerate", "throttle the pace", True),
        ("Plan: throttle the pace.", "lon_action", "decelerate", "throttle the pace", True),
        ("We will throttle the pace.", "lon_action", "decelerate", "throttle the pace", True),
        (
            "If it rains, we throttle the pace.",
            "lon_action",
            "decelerate",
            "throttle the pace",
            False,
        ),
        ("We do not throttle the pace.", "lon_action", "decelerate", "throttle the pace", False),
        (
            "We do not throttle the pace.",
            "lon_action",
            "decelerate",
            "do not throttle the pace",
            False,
        ),
        ("We could throttle the pace.", "lon_action", "decelerate", "throttle the pace", False),
        (
            "Question: should we throttle the pace?",
            "lon_action",
            "decelerate",
            "throttle the pace",
            False,
        ),
        (
            "Rather than throttle the pace, we wait and see.",
            "lon_action",
            "decelerate",
            "throttle the pace",
            False,
        ),
        ("The truck throttles its pace.", "lon_action", "decelerate", "throttles its pace", False),
        (
            "If it rains, throttle the pace. It is dry: we throttle the pace.",
            "lon_action",
            "decelerate",
            "throttle the pace",
            True,
        ),
        (
            "We hug the lane centre stripe.",
            "lat_action",
            "straight",
            "hug the lane centre stripe",
            True,
        ),
        ("A truck is wheezing along.", "motion", "same_direction", "wheezing along", True),
        ("A truck may be wheezing along.", "motion", "same_direction", "wheezing along", False),
        ("A truck might wheeze along.", "motion", "same_direction", "wheeze along", False),
        ("The truck might flatten us.", "conflict", "potential", "might flatten us", True),
        ("The truck flattens its springs.", "conflict", "potential", "flattens its springs", False),
        ("The truck might flatten us.", "conflict", "active", "flatten us", False),
        (
            "A truck is here. It is not bothersome.",
            "conflict",
            "no_conflict",
            "not bothersome",
            True,
        ),
        ("A truck is here. It is not bothersome.", "conflict", "no_conflict", "bothersome", False),
        # Words that are known, and known to say nothing of the slot.
        (
            "A truck is here. It is not our concern.",
            "conflict",
            "no_conflict",
            "not our concern",
            False,
        ),
        ("We see the wet road.", "lon_action", "accelerate", "see the wet road", False),
        ("The sky is grey and a truck is here.", "position", "rear", "sky is grey", False),
        ("A truck is here, with two lanes.", "motion", "receding", "two lanes", False),
        ("Not a soul is about.", "objects", "nobody", "Not a soul", True),
        ("If a velocipede appeared, we would see it.", "objects", "cyclist", "velocipede", False),
        ("We accelerate gently.", "lon_action", "decelerate", "accelerate gently", False),
        ("We throttle the pace.", "lat_action", "left", "throttle the pace", False),
        ("We shimmy leftwards.", "lat_action", "left", "shimmy leftwards", True),
        ("A bus is here.", "objects", "car", "bus", False),
        ("A truck is behind us.", "position", "front", "behind us", False),
        ("A truck is wheezing across.", "motion", "crossing_from_left", "wheezing across", False),
        (
            "A truck is wheezing across from the left.",
            "motion",
            "crossing_from_left",
            "wheezing across",
            True,
        ),
        ("A velocipede is here.", "objects", "cyclist", "velocipede", True),
    ],
)
def test_scope_and_binding_hold_for_quotes(
    text: str, slot: str, label: str, quote: str, stands: bool
) -> None:
    judged = judge(text, Slots(), [Proposal(slot, label, quote)])
    taken = judged.slots.get(slot)
    assert (taken is not None) == stands, judged
    if taken is not None:
        value = () if label == "nobody" else (label,) if slot == "objects" else label
        start = text.rfind(quote)
        assert taken == Slot(value, ((start, start + len(quote)),))


def test_several_objects_and_a_second_answer() -> None:
    text = "A velocipede and a rickshaw puller are here, rolling side by side."
    proposals = [
        Proposal("objects", "cyclist", "velocipede"),
        Proposal("objects", "pedestrian", "rickshaw puller"),
    ]
    judged = judge(text, Slots(), proposals)
    assert judged.slots["objects"].value == ("cyclist", "pedestrian")
    twice = [
        Proposal("lon_action", "decelerate", "throttle the pace"),
        Proposal("lon_action", "stop", "throttle the pace"),
    ]
    judged = judge("We throttle the pace.", Slots(), twice)
    assert judged.slots["lon_action"].value == "decelerate"
    assert judged.dropped == ("lon_action: a second answer",)


@pytest.mark.parametrize("asked", [SLOT_NAMES, ("motion",)])
def test_a_fence_of_code_is_taken_off(asked: tuple[str, ...]) -> None:
    reply = read_reply("```json\n" + json.dumps(GOOD) + "\n```", asked)
    assert {item.slot for item in reply.items} <= set(asked)
    assert any(item.slot == "motion" for item in reply.items)
