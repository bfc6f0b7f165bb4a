"""The summary above the prompt, before real objects start."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.arming import Facts
from ssp_core.safety.body_status import BodyStatus, known_bodies
from ssp_core.vocabulary import ControlState
from ssp_scenario_manager.run.over_dds.live import LiveSetup
from ssp_scenario_manager.run.over_dds.summary import (
    LOST_S,
    PROMPT,
    PromptFacts,
    changes,
    connected,
    summary,
)


def test_nobody_is_connected(run: RunSpec) -> None:
    lines = summary(run, LiveSetup({}), Facts(), {})
    for object_id in run.object_ids:
        (line,) = [line for line in lines if line.strip().startswith(f"{object_id},")]
        assert "NOT CONNECTED" in line
    assert any("recorder not heard" in line for line in lines)


def test_who_is_real_and_how_far_from_the_start(
    run: RunSpec, state: Callable[..., ObjectState]
) -> None:
    run = run.model_copy(update={"session_token": "live-1", "mode": "live"})
    start = run.targets[0].start
    here = state("ot1", x_m=start.x_m + 0.25, y_m=start.y_m, control_state=ControlState.DISARMED)
    vut = state("vut", x_m=run.vut.start.x_m + 40.0, y_m=run.vut.start.y_m)
    facts = Facts({"ot1": 0.0, "vut": 0.0, "monitor": 0.1}, recorder_ready=True)
    setup = LiveSetup({"ot1": "udp://10.0.0.21:9001"}, {"odometry": "/ins"})
    text = "\n".join(summary(run, setup, facts, {"ot1": here, "vut": vut}))
    for part in (
        "mode live",
        "session live-1",
        "ot1, taken as real, body udp://10.0.0.21:9001: connected, DISARMED, 0.25 m from its start",
        "vut, taken as real, by /ins: connected, TOO FAR, 40.00 m from its start",
        "recorder ready",
        f"limits: {run.limits.speed_mps:g} m/s",
        "blind distance on link loss",
    ):
        assert part in text
    mirrored = summary(run, LiveSetup({"ot1": "mirror"}), facts, {"ot1": here, "vut": vut})
    assert any("ot1, mirror, nothing real moves" in line for line in mirrored)
    elsewhere = summary(run, LiveSetup({}), facts, {"ot1": here, "vut": vut})
    assert any("ot1, assumed real (another host controls it)" in line for line in elsewhere)
    late = replace(facts, ages_s={"ot1": 7.0})
    assert any(
        "NOT CONNECTED, last heard 7.0 s" in t for t in summary(run, setup, late, {"ot1": here})
    )


def test_a_heading_that_is_not_known_at_rest_is_said(
    run: RunSpec, state: Callable[..., ObjectState]
) -> None:
    limits = run.limits.model_copy(update={"heading_by_course": ["vut"]})
    facts, states = Facts({"ot1": 0.0, "vut": 0.0}), {i: state(i) for i in ("vut", "ot1")}
    by_course = run.model_copy(update={"limits": limits})
    lines = summary(by_course, LiveSetup({}), facts, states)
    words = "its heading is not known at rest (limits.heading_by_course): judged on its first metre"
    assert [line.split(",")[0].strip() for line in lines if words in line] == ["vut"]


_NO_PROBE = "it has no probe report"


@pytest.mark.parametrize(
    ("status", "words"),
    [
        (
            BodyStatus("ot1", ("its test object isn't connected: 10.0.0.9:53241: refused",)),
            "; its test object isn't connected: 10.0.0.9:53241: refused",
        ),
        (
            known_bodies(["ot1"], {}, 0)["ot1"],
            "; its object_target was never heard: it doesn't run, or can't be reached",
        ),
        (
            BodyStatus("ot1", ("its clock is 18.0 s ahead",), ("its clock is 18.0 s ahead",)),
            "; its clock is 18.0 s ahead",
        ),
        (
            BodyStatus("ot1", ("nothing comes",), (_NO_PROBE,), lasting=True),
            f"; nothing comes; can't be armed: {_NO_PROBE}",
        ),
    ],
)
def test_why_an_object_is_not_connected_stands_beside_it(
    run: RunSpec, state: Callable[..., ObjectState], status: BodyStatus, words: str
) -> None:
    facts = Facts(bodies={"ot1": status})
    (line,) = (one for one in summary(run, LiveSetup({}), facts, {}) if "ot1, assumed" in one)
    assert line.endswith(f"NOT CONNECTED, nothing comes on /ssp/ot1/state{words}")
    late = Facts({"ot1": 7.0}, bodies={"ot1": status})
    (line,) = (
        one
        for one in summary(run, LiveSetup({}), late, {"ot1": state("ot1")})
        if "ot1, assumed" in one
    )
    assert line.endswith(f"NOT CONNECTED, last heard 7.0 s ago{words}")


def test_what_keeps_a_connected_object_from_being_armed_stands_beside_it(
    run: RunSpec, state: Callable[..., ObjectState]
) -> None:
    status = BodyStatus("ot1", ("heard before it was connected",), (_NO_PROBE, "its clock is late"))
    facts = Facts({"ot1": 0.0, "vut": 0.0}, bodies={"ot1": status})
    states = {one: state(one) for one in ("vut", "ot1")}
    lines = summary(run, LiveSetup({}), facts, states)
    (line,) = (one for one in lines if "ot1, assumed" in one)
    assert ": connected, " in line
    assert line.endswith(f"; can't be armed: {_NO_PROBE}; can't be armed: its clock is late")
    assert not any("can't be armed" in one for one in lines if one is not line)


def test_why_the_vut_has_no_state_stands_beside_it(run: RunSpec) -> None:
    facts = Facts(vut_refused="the fix is of type sbas, limit gbas")
    (line,) = (one for one in summary(run, LiveSetup({}), facts, {}) if "vut, assumed" in one)
    assert line.endswith("; its GNSS/INS gives no state: the fix is of type sbas, limit gbas")


def test_a_reason_that_is_new_after_the_summary_is_said_once(run: RunSpec) -> None:
    def facts(*cannot_arm: str, **ages_s: float) -> Facts:
        return Facts(ages_s, bodies={"ot1": BodyStatus("ot1", (), cannot_arm)})

    shown = PromptFacts(run, facts(_NO_PROBE, vut=0.0, ot1=0.0))
    assert shown.news(facts(_NO_PROBE, vut=0.0, ot1=0.0)) == []
    late = "its body's readings are {} s old on arrival, limit 0.2 s"
    assert shown.news(facts(late.format(0.31), _NO_PROBE, vut=0.0, ot1=0.0)) == [
        f"ot1: can't be armed: {late.format(0.31)}"
    ]
    # Another figure is no news.
    assert shown.news(facts(late.format(0.4), vut=0.0, ot1=0.0)) == []
    gone = Facts({"vut": 0.0}, bodies={"ot1": BodyStatus("ot1", ("it closed the connection",))})
    assert shown.news(gone) == ["ot1: NOT CONNECTED any more", "ot1: it closed the connection"]
    assert shown.news(gone) == []


def test_a_stranger_is_named_above_the_prompt_and_once_where_it_comes_later(run: RunSpec) -> None:
    """The person at the prompt learnt of it from the refusal to arm alone."""
    alone, line = Facts(), "strangers: can't be armed: ot1/state has /ssp/ours and /ssp/x"
    both = Facts(other_managers=1, foreign="ot1/state has /ssp/ours and /ssp/x")
    assert f"  {line}" in summary(run, LiveSetup({}), both, {})
    assert not any("strangers" in one for one in summary(run, LiveSetup({}), alone, {}))
    shown = PromptFacts(run, alone)
    assert shown.news(both) == [line]
    assert shown.news(both) == []


def test_the_prompt_names_the_words() -> None:
    assert '"start"' in PROMPT
    assert '"abort"' in PROMPT


def test_who_comes_and_goes_after_the_summary_is_said_once(run: RunSpec) -> None:
    alone = connected(run, Facts({"vut": 0.0}))
    assert alone["vut"]
    assert not any(alone[who] for who in alone if who != "vut")
    both = connected(run, Facts({"vut": 0.0, "ot1": 0.1}), alone)
    assert changes(alone, both) == ["ot1: connected now"]
    # A moment's silence is no news, a longer one is.
    assert connected(run, Facts({"vut": LOST_S, "ot1": 0.1}), both) == both
    late = connected(run, Facts({"vut": LOST_S + 0.1, "ot1": 0.1}), both)
    assert changes(both, late) == ["vut: NOT CONNECTED any more"]
    assert changes(late, late) == []
