"""``--shadow``: what is asked of a bridge beside a session, and what is refused."""

from __future__ import annotations

import json
import re

import pytest

from ssp_core.errors import InputError
from ssp_scenario_manager.run.companions import RECORDED, shadow_model


def test_a_name_alone_follows_twice_a_second() -> None:
    model = shadow_model("opencv_baseline")
    assert model.parameters == {"model": "opencv_baseline", "shadow_hz": 2.0}


def test_what_is_not_the_bridges_own_goes_to_its_backend() -> None:
    text = (
        'qwen={"backend": "openai", "interface": "openemma", "hz": 1, "timeout_s": 9, '
        '"model": "m", "seed": 3}'
    )
    parameters = dict(shadow_model(text).parameters)
    options = json.loads(json.loads(str(parameters.pop("backend_options"))))
    assert options == {"model": "m", "seed": 3}
    assert parameters == {
        "model": "qwen",
        "shadow_hz": 1.0,
        "backend": "openai",
        "interface": "openemma",
        "timeout_s": 9.0,
    }


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("a/b", "--shadow"),
        ("", "--shadow"),
        ("m={", "--shadow"),
        ("m=[1]", "--shadow"),
        ('m={"hz": 0}', "--shadow hz"),
        ('m={"hz": true}', "--shadow hz"),
        ('m={"hz": "2"}', "--shadow hz"),
        ('m={"timeout_s": "long"}', "--shadow timeout_s"),
    ],
)
def test_what_cannot_be_meant_is_refused_with_its_field(text: str, field: str) -> None:
    with pytest.raises(InputError) as refusal:
        shadow_model(text)
    assert refusal.value.field == field


def test_the_recorder_takes_answers_and_health_and_no_requests() -> None:
    taken = re.compile(RECORDED)
    assert taken.search("/ssp/vla/m/response")
    assert taken.search("/diagnostics")
    assert not taken.search("/ssp/vla/m/request")
    assert not taken.search("/other/ssp/vla/m/response")
