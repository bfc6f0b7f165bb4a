"""The SROS2 policy: what it holds; that it fits the nodes is tested in a live session."""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree

from ssp_core.run_file.model import RunSpec
from ssp_scenario_manager.sros2 import policy, rights


def live(run: RunSpec, **changes: Any) -> RunSpec:
    return run.model_copy(update={"mode": "live", **changes})


def allowed(run: RunSpec, node: str, kind: str, what: str) -> set[str | None]:
    root = ElementTree.fromstring(policy(run, "/ins"))
    (profile,) = root.findall(f".//profile[@node='{node}']")
    return {item.text for group in profile.findall(f"{kind}[@{what}='ALLOW']") for item in group}


def test_only_the_manager_leads_objects(run: RunSpec) -> None:
    for node, right in rights(live(run)).items():
        leads = node == "scenario_manager"
        assert ("ot1/reference" in right.publishes) == leads, node
        assert ("manager/heartbeat" in right.publishes) == leads, node
        assert ("ot1/command" in right.calls) == leads, node


def test_names_are_absolute_and_of_this_run(run: RunSpec) -> None:
    spec = live(run)
    assert "/ssp/ot1/state" in allowed(spec, "object_target", "topics", "publish")
    assert allowed(spec, "gnss_ins", "topics", "publish") == {
        *("/ins", "/rosout", "/parameter_events"),
        *("/ssp/declared/vut", "/ssp/declared/vut/positioning"),
    }
    assert allowed(spec, "scenario_manager", "actions", "execute") == {"/ssp/run_scenario"}
    assert "/ssp/abort" in allowed(spec, "ssp_run", "services", "request")
    assert "/ssp/abort" in allowed(spec, "monitor_page", "services", "request")
    assert "/ins" in allowed(spec, "vut_adapter", "topics", "subscribe")
    for watcher in ("monitor_page", "view"):
        assert "/ssp/object_states" in allowed(spec, watcher, "topics", "subscribe")


def test_no_camera_no_rights_for_one(run: RunSpec) -> None:
    assert "camera" not in rights(live(run, camera=None))
