"""``images: none``: the same questions without pictures, in words that don't speak of any."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from ssp_core.errors import InputError
from ssp_vla_bridge.backend import respond
from ssp_vla_bridge.backends.openai_chat import read_options
from ssp_vla_bridge.messages import TASK, EgoSample
from ssp_vla_bridge.prompts import PROMPTS, find_stages, visible_request, words_sha256

EVERY = pytest.mark.parametrize("interface", PROMPTS)
BEFORE = {"scene": "SCENE", "objects": "OBJECTS", "intent": "INTENT"}
DRIVEN = tuple(EgoSample(-k * 0.5, -k * 0.5 * 8.25, 0.0, 0.0, 8.25, 0.0) for k in range(10, -1, -1))
# The words of a question in which nothing was seen.
NO_PICTURE = "You are given no picture."
OF_PICTURES = re.compile(r"pictur|camera|image|frame|you see\b|\d s before now", re.IGNORECASE)


def of_pictures(told):
    """The first word about pictures, but for the sentence that there are none, and the task's."""
    return OF_PICTURES.search(told.replace(NO_PICTURE, "").replace(TASK.instruction, ""))


def words(interface, request):
    """System and user text of each stage."""
    built = [stage.build(request, BEFORE) for stage in find_stages(interface)]
    return [f"{prompt.system}\n{prompt.text}" for prompt in built]


@EVERY
def test_no_picture_is_sent_and_none_is_spoken_of(interface, service, make_openai, make_request):
    request = make_request(history=DRIVEN)
    make_openai(images="none", interface=interface).answer(request)
    assert len(service.asked) == len(find_stages(interface))
    for asked in service.asked:
        told = asked.body["messages"][-1]["content"]
        assert isinstance(told, str)  # no parts at all, which servers of such models may not know
        assert told.count(NO_PICTURE) == 1
        system = "".join(m["content"] for m in asked.body["messages"][:-1])
        assert not of_pictures(system + told)


@EVERY
def test_every_step_of_a_blind_question_tells_the_history(interface, make_request):
    request = visible_request(make_request(history=DRIVEN), blind=True)
    for told in words(interface, request):  # OpenEMMA's own pairs are metres per half a second
        assert "8.25" in told or "[4.1" in told
    seeing = words(interface, make_request(history=DRIVEN))
    assert all(NO_PICTURE not in told for told in seeing)


@EVERY
def test_an_unknown_history_is_said_without_pictures_to_judge_by(interface, make_request):
    request = replace(make_request(), history=(), ego_provenance="unknown")
    for told in words(interface, visible_request(request, blind=True)):
        assert "is not known; assume no numbers" in told
        assert not of_pictures(told)


def test_it_is_recorded_and_other_words_are_another_question(service, make_openai, make_request):
    request = make_request(history=DRIVEN)
    response = respond(make_openai(images="none"), "seer", request).response
    assert response.error_msg == ""
    assert response.decoding["images"] == "none"
    assert response.decoding["frames"] == 0
    seeing = respond(make_openai(), "seer", request).response
    assert "images" not in seeing.decoding
    assert response.decoding["prompt_sha256"] != seeing.decoding["prompt_sha256"]
    told = {words_sha256("openai", {"images": one}, request) for one in ("none", None)}
    assert len(told) == 2


@pytest.mark.parametrize("value", ["all", "None", "", "some"])
def test_another_value_is_refused(value):
    options = {"base_url": "http://127.0.0.1:9/v1", "model": "m", "images": value}
    with pytest.raises(InputError, match=r"images.*none asks without any"):
        read_options(options)
