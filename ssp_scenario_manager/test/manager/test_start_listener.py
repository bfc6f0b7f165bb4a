"""The facts heard before the word that starts, also what processes of bodies and receiver say."""

from __future__ import annotations

import time
from unittest.mock import MagicMock

import pytest
from std_msgs.msg import String

from ssp_core import names
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participation import declaring
from ssp_core.safety.arming import Facts
from ssp_core.safety.body_status import FORGOTTEN_S
from ssp_core.safety.liveness import ADAPTER_SILENT_S
from ssp_core.safety.publishers import LINKS_FRESH_S
from ssp_msgs.msg import BodyStatus, LinkStatus, LocalisationStatus, RecorderStatus
from ssp_scenario_manager.ros import start_listener
from ssp_scenario_manager.ros.start_listener import StartListener
from ssp_scenario_manager.run.over_dds.live import LiveSetup
from ssp_scenario_manager.run.over_dds.summary import summary
from ssp_scenario_manager.sros2 import rights


def test_reasons_of_bodies_and_receiver_are_facts_until_their_processes_are_silent(
    run: RunSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = MagicMock()
    listener = StartListener(node, run)
    calls = {args[1]: args[2] for args, _ in node.create_subscription.call_args_list}
    assert "was never heard" in listener.facts().bodies["ot1"].no_state[0]
    assert not listener.knows_bodies
    calls[names.BODY_STATUS](BodyStatus(object_id="ot9", no_state=["of another run"]))
    assert not listener.knows_bodies
    said = BodyStatus(object_id="ot1", no_state=["refused"], cannot_arm=["no probe report"])
    calls[names.BODY_STATUS](said)
    calls[names.LOCALISATION_STATUS](LocalisationStatus(object_id="vut", reason="no fix"))
    facts = listener.facts()
    assert listener.knows_bodies
    assert (facts.bodies["ot1"].no_state, facts.bodies["ot1"].cannot_arm) == (
        ("refused",),
        ("no probe report",),
    )
    assert facts.vut_refused == "no fix"
    assert (facts.other_managers, facts.foreign) == (0, "")
    calls[names.LINK_STATUS](LinkStatus(strangers=["ot1/state has /x", "clock has /y"]))
    facts = listener.facts()
    assert (facts.other_managers, facts.foreign) == (2, "ot1/state has /x; clock has /y")
    later_s = time.monotonic() + max(FORGOTTEN_S, ADAPTER_SILENT_S) + 0.5
    monkeypatch.setattr(start_listener.time, "monotonic", lambda: later_s)
    facts = listener.facts()
    assert "has said nothing for" in facts.bodies["ot1"].no_state[0]
    assert facts.vut_refused == ""
    # With DDS security a node may hear what the policy names, and nothing else.
    assert set(calls) <= {*rights(run)[names.RUNNER].hears}
    listener.close()
    assert node.destroy_subscription.call_count == node.create_subscription.call_count


def test_what_participants_declare_stands_in_the_summary(run: RunSpec) -> None:
    live, node = run.model_copy(update={"mode": "live"}), MagicMock()
    listener = StartListener(node, live)
    calls = {args[1]: args[2] for args, _ in node.create_subscription.call_args_list}
    assert {names.declared_topic(who) for who in declaring(live)} <= set(calls)
    assert set(calls) <= {*rights(live)[names.RUNNER].hears}
    calls[names.declared_topic("ot1")](String(data="simulated"))
    calls[names.declared_topic("ot1")](String(data="simulated"))
    lines = summary(live, LiveSetup({}), Facts(), {}, listener.participation)
    (told,) = (line for line in lines if "takes part" in line)
    assert told.startswith("  what takes part: simulated: ot1; undeclared: vut, vut/positioning")


def test_strangers_are_those_of_the_operators_page(
    run: RunSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The recorder's count, and what a manager that fell silent said of them doesn't."""
    node = MagicMock()
    listener = StartListener(node, run)
    calls = {args[1]: args[2] for args, _ in node.create_subscription.call_args_list}
    at_s = 100.0
    monkeypatch.setattr(start_listener.time, "monotonic", lambda: at_s)
    calls[names.LINK_STATUS](LinkStatus(strangers=["ot1/state has /x"]))
    calls[names.RECORDER_STATUS](RecorderStatus(strangers=["clock has two"]))
    at_s += LINKS_FRESH_S
    assert listener.facts().foreign == "ot1/state has /x; clock has two"
    at_s += 0.1
    facts = listener.facts()
    assert (facts.other_managers, facts.foreign) == (1, "clock has two")
    calls[names.RECORDER_STATUS](RecorderStatus())
    assert listener.facts().foreign == ""
