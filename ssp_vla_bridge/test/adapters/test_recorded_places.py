"""Stored answers of cells, campaigns and shadow runs; what is ambiguous is not guessed."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from ssp_core.bag.types import serialize, typestore
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.errors import InputError, PeerError
from ssp_vla_bridge.backend import make_backend
from ssp_vla_bridge.messages import response_to_json

NS = 1_000_000_000


def write(folder, *responses):
    """A raw.jsonl in a folder; gives the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = [json.dumps(response_to_json(response)) + "\n" for response in responses]
    (folder / "raw.jsonl").write_text("".join(lines))
    return folder


@pytest.fixture
def campaign(tmp_path, make_response):
    """Two cells of two models: stamps 10 s (both answer), 11 s (m1 only), 12 s (both the same)."""

    def one(model, request_id, second, text):
        base = make_response([(0, 0), (4, 0), (8, 0)], text=text)
        return replace(
            base,
            request_id=request_id,
            stamp_ns=second * NS,
            model=model,
            model_id=f"{model}/1",
        )

    cells = tmp_path / "cells"
    write(
        cells / "cut_in__sim__m1",
        one("m1", "a-1", 10, "one"),
        one("m1", "b-1", 11, "two"),
        one("m1", "c-1", 12, "same"),
    )
    write(cells / "cut_in__sim__m2", one("m2", "a-2", 10, "other"), one("m2", "c-2", 12, "same"))
    (cells / "cut_in__sim__refused").mkdir()
    return tmp_path


def ask(make_request, file, request_id="new", second=10, **options):
    backend = make_backend("recorded", {"file": str(file), **options})
    return backend.answer(make_request(request_id, second * NS)).text


def test_a_cells_folder_is_its_raw_file(campaign, make_request):
    cell = campaign / "cells" / "cut_in__sim__m2"
    assert ask(make_request, cell) == ask(make_request, cell / "raw.jsonl") == "other"


def test_a_campaign_answers_by_id_then_by_stamp(campaign, make_request):
    assert ask(make_request, campaign, "a-2") == "other"
    assert ask(make_request, campaign, "a-1") == "one"
    assert ask(make_request, campaign, second=11) == "two"
    assert ask(make_request, campaign, second=12) == "same"


def test_different_answers_for_one_stamp_are_refused(campaign, make_request):
    with pytest.raises(PeerError) as caught:
        ask(make_request, campaign)
    for words in ("different answers are stored", "of m1 in", "of m2 in", "option model"):
        assert words in str(caught.value)
    assert ask(make_request, campaign, model="m1") == "one"
    assert ask(make_request, campaign, model="m2") == "other"
    with pytest.raises(PeerError, match="no answer is stored"):
        ask(make_request, campaign, second=11, model="m2")
    with pytest.raises(InputError, match="there are those of m1, m2"):
        ask(make_request, campaign, model="m3")


def test_an_error_beside_an_answer_is_a_difference(campaign, make_request, make_response):
    failed = replace(make_response(), request_id="d", stamp_ns=11 * NS, model="m2", error_code=1)
    write(campaign / "cells" / "cut_in__sim__m2", failed)
    with pytest.raises(PeerError, match="different answers"):
        ask(make_request, campaign, second=11)


def test_of_two_answers_in_one_place_the_later_counts(tmp_path, make_request, make_response):
    first, second = (replace(make_response(), text=text) for text in ("first", "second"))
    assert ask(make_request, write(tmp_path / "x", first, second)) == "second"


def test_answers_that_are_equal_but_for_nan_are_equal(tmp_path, make_request, make_response):
    response = replace(make_response([(math.nan, 0)]), request_id="")
    for name in ("a", "b"):
        write(tmp_path / "cells" / name, response)
    assert ask(make_request, tmp_path) == "I keep my speed."


def message_of(response):
    """VlaResponse.msg with the types of rosbags, as a recorder has its bytes."""
    types = typestore().types
    stamp = types["builtin_interfaces/msg/Time"](
        sec=response.stamp_ns // NS, nanosec=response.stamp_ns % NS
    )

    return types["ssp_msgs/msg/VlaResponse"](
        header=types["std_msgs/msg/Header"](stamp=stamp, frame_id=""),
        request_id=response.request_id,
        model=response.model,
        model_id=response.model_id,
        text=response.text,
        arrays=[
            types["ssp_msgs/msg/NativeArray"](
                name=a.name,
                shape=np.array(a.shape, np.uint32),
                data=np.array(a.data),
                frame=a.frame,
                unit=a.unit,
                step=a.step_s,
                first_time=a.first_time_s,
            )
            for a in response.arrays
        ],
        decoding=json.dumps(dict(response.decoding)) if response.decoding else "",
        latency=response.latency_s,
        error_code=response.error_code,
        error_msg=response.error_msg,
    )


@pytest.fixture
def bag(tmp_path, make_response):
    """The bag of a session that two models followed in shadow mode."""
    path = tmp_path / "session"
    with BagWriter(path) as writer:
        for index, model in enumerate(("m1", "m2")):
            topic = f"/ssp/vla/{model}/response"
            writer.add_topic(topic, "ssp_msgs/msg/VlaResponse")
            response = replace(
                make_response([(0, 0), (4, 0.25)], text=f"I am {model}."),
                request_id=f"shadow-{model}",
                model=model,
                decoding={"seed": index},
            )
            if model == "m2":
                response = replace(response, stamp_ns=response.stamp_ns + NS)
            writer.write(topic, serialize(message_of(response)), 11 * NS + index, 11 * NS)
    return path


def test_a_bag_of_a_shadow_run_answers_by_stamp(bag, make_request):
    mcap = next(bag.glob("*.mcap"))
    for file in (bag, mcap):
        backend = make_backend("recorded", {"file": str(file)})
        answer = backend.answer(make_request("x", 10 * NS))
        assert answer.text == "I am m1."
        assert dict(answer.decoding) == {"seed": 0}
        array = answer.arrays[0]
        assert (array.shape, array.data) == ((2, 2), (0.0, 0.0, 4.0, 0.25))
        assert (array.frame, array.step_s, array.first_time_s) == ("ego_xy", 0.5, 0.0)
    assert ask(make_request, bag, "shadow-m2", second=11) == "I am m2."
    assert ask(make_request, bag, second=11, model="m2") == "I am m2."


def test_other_places_are_refused_with_what_would_be_right(tmp_path, make_request):
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="a cell's folder, a campaign's folder or a bag"):
        ask(make_request, tmp_path / "empty")
    with pytest.raises(InputError, match="is not there"):
        ask(make_request, tmp_path / "nothing")
    with BagWriter(tmp_path / "other") as writer:
        writer.add_topic("/ssp/vla/m/response", "std_msgs/msg/String")
    with pytest.raises(InputError, match="holds no responses"):
        ask(make_request, tmp_path / "other")


def test_a_bag_whose_facts_are_no_object_is_named(tmp_path, make_request, make_response):
    message = message_of(make_response())
    message.decoding = "[1]"
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/ssp/vla/m/response", "ssp_msgs/msg/VlaResponse")
        writer.write("/ssp/vla/m/response", serialize(message), NS, NS)
    with pytest.raises(InputError, match=r"/ssp/vla/m/response: holds an answer at 1000000000 ns"):
        ask(make_request, tmp_path / "bag")


def test_answers_of_another_interface_are_refused_and_never_read_by_the_wrong_one(
    tmp_path, make_response
):
    path = tmp_path / "raw.jsonl"
    answers = [
        replace(make_response([(0, 0), (4, 0)]), model=model, decoding={"interface": spoken})
        for model, spoken in (("chat", "openemma"), ("mine", "waypoints"), ("their", "v1/chat"))
    ]
    path.write_text("".join(json.dumps(response_to_json(one)) + "\n" for one in answers))
    with pytest.raises(InputError) as caught:
        make_backend("recorded", {"file": str(path)})
    assert caught.value.field == "backend_options.interface"
    assert "given by the interface openemma" in str(caught.value)
    assert '"interface": "openemma"' in caught.value.remedy
    for model, spoken in (("chat", "openemma"), ("mine", "waypoints"), ("their", "llavida")):
        options = {"file": str(path), "model": model, "interface": spoken}
        assert make_backend("recorded", options).interface == spoken
