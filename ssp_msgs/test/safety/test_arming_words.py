"""Words of obstacles and refusals, and of what the recorder lacks."""

from __future__ import annotations

import math

import pytest

from ssp_core import names
from ssp_core.safety.arming import (
    Facts,
    Need,
    Obstacle,
    recorder_lacks,
    recorder_obstacles,
    refusal_of,
    refusal_text,
)
from ssp_core.safety.body_status import BodyStatus


@pytest.mark.parametrize("reason", ["the key is out", "", "ot2 refused: no power"])
def test_a_refusal_is_read_from_its_own_words(reason: str) -> None:
    assert refusal_of(refusal_text("ot1", reason)) == {"ot1": reason}
    assert refusal_of("ot1 has refused") == refusal_of("") == {}


@pytest.mark.parametrize(
    ("missing", "failure", "warnings", "lacks"),
    [
        (["/a", "/b"], "disk full", ["slow"], ("/a", "/b")),
        ([], "disk full", ["slow"], ("disk full",)),
        ([], "", ["slow", "hot"], ("slow",)),
        ([], "", [], ()),
    ],
)
def test_a_recorder_lacks_topics_or_what_failed_or_what_it_warned_of_first(
    missing: list[str], failure: str, warnings: list[str], lacks: tuple[str, ...]
) -> None:
    assert recorder_lacks(missing, failure, warnings) == lacks


@pytest.mark.parametrize(
    ("obstacle", "text"),
    [
        (Obstacle(Need.WORLD, "w", math.inf, 6.0), "no tick of the simulated world arrives"),
        (
            Obstacle(Need.OBJECT_STATE, "ot1", math.inf, 0.25, "it is off"),
            "no state of ot1 arrives: it is off",
        ),
        (
            Obstacle(Need.OBJECT_STATE, "ot1", 1.0, 0.25, "it is off"),
            "no state of ot1 arrives: none for 1.00 s, limit 0.25 s: it is off",
        ),
        (Obstacle(Need.RECORDER, "", 1.5, 1.0), "the recorder is silent for 1.50 s, limit 1 s"),
        (Obstacle(Need.BODY, "ot1", detail="no power"), "ot1: no power"),
    ],
)
def test_a_silence_says_for_how_long_unless_nothing_was_ever_heard(
    obstacle: Obstacle, text: str
) -> None:
    assert obstacle.text == text


def test_a_recorder_that_is_heard_must_be_ready_and_have_lost_nothing() -> None:
    def recorder_findings(
        age_s: float | None, ready: bool, lost: int, *missing: str
    ) -> list[Obstacle]:
        ages = {} if age_s is None else {names.MONITOR: age_s}
        return [*recorder_obstacles(Facts(ages, {}, {}, ready, missing, lost))]

    assert recorder_findings(1.0, True, 0) == []
    assert [one.need for one in recorder_findings(1.01, False, 3)] == [Need.RECORDER]
    assert [one.need for one in recorder_findings(None, True, 0)] == [Need.RECORDER]
    (lost,) = recorder_findings(0.0, True, 3)
    assert (lost.need, lost.who, lost.measured, lost.limit) == (
        Need.RECORDER_LOSSLESS,
        names.MONITOR,
        3.0,
        0.0,
    )
    (unready,) = recorder_findings(0.0, False, 3, "/a")
    assert (unready.need, unready.who, unready.detail) == (Need.RECORDER_READY, names.MONITOR, "/a")


def test_waiting_is_hopeless_once_one_body_or_one_refusal_lasts() -> None:
    gone, back = BodyStatus("ot1", lasting=True), BodyStatus("ot2")
    assert not Facts().is_hopeless
    assert not Facts(bodies={"ot2": back}).is_hopeless
    assert Facts(bodies={"ot1": gone, "ot2": back}).is_hopeless
    assert Facts(lasting=True, bodies={"ot2": back}).is_hopeless
