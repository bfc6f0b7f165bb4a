"""Every topic of a session has its publishers in the one table by which strangers are found."""

from __future__ import annotations

import pytest

from ssp_core import names
from ssp_core.run_file.driven import Driven
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.publishers import ANYBODY, declarations, expected_publishers
from ssp_monitor.recorder.topics import bag_topics
from ssp_scenario_manager.sros2 import rights
from tests.support.runs import small_run

OBJECTS = [{**small_run()["targets"][0], "id": f"ot{number}"} for number in range(1, 7)]
# Nodes beside a session; what they publish isn't the session's.
BESIDE = ("view", "gnss_ins", "body")


def run_of(mode: str, objects: int) -> RunSpec:
    changes = {"mode": mode, "targets": OBJECTS[:objects], "camera": {}}
    driver = {**small_run()["driver"], "external": mode != "live"}
    return RunSpec.model_validate(small_run(**changes, driver=driver))


@pytest.mark.parametrize("mode", ["lockstep", "live"])
@pytest.mark.parametrize("objects", [1, 6])
def test_every_topic_of_a_session_is_in_the_table(mode: str, objects: int) -> None:
    run = run_of(mode, objects)
    known = {*expected_publishers(run), *ANYBODY, *declarations(run)}
    recorded = {topic.name for topic in bag_topics(run)}
    assert recorded <= {names.absolute(topic) for topic in known}
    if mode == "lockstep":
        driven = Driven(driver="oracle", first_request_s=1.0, hand_over_s=2.0, end_s=9.0)
        led = run.model_copy(update={"driven": driven})
        known = {*expected_publishers(led), *ANYBODY}
        assert {t.name for t in bag_topics(led)} <= {names.absolute(topic) for topic in known}
    allowed = {
        topic
        for node, right in rights(run_of("live", objects)).items()
        if node not in BESIDE
        for topic in right.publishes
        if not topic.endswith("/transition_event")  # of every lifecycle node
    }
    live = run_of("live", objects)
    assert allowed <= {*expected_publishers(live), *ANYBODY, *declarations(live)}


def test_every_name_of_a_topic_is_in_the_table() -> None:
    """A topic that is new in ``names`` has its publishers too, or is no topic."""
    known = expected_publishers(run_of("lockstep", 1)).keys() | ANYBODY.keys()
    nodes = {
        *(names.SIL_WORLD, names.FRONT_CAMERA, names.OBJECT_TARGET, names.SCENARIO_MANAGER),
        *(names.MONITOR, names.RUNNER, names.MONITOR_PAGE, names.VUT_ADAPTER, names.VUT_DRIVER),
    }
    others = {
        *(
            names.NAMESPACE,
            names.VUT_ID,
            names.MAP_FRAME,
            names.BODY_ADDRESSES,
            names.LOAD_SCENARIO,
            names.RUN_SCENARIO,
        )
    }
    told = {v for k, v in vars(names).items() if k.isupper() and isinstance(v, str)}
    assert told - nodes - others == {topic for topic in known if not topic.startswith("ot1/")} - {
        names.state_topic(names.VUT_ID)
    }
    of_objects = {
        made("ot1")
        for word, made in vars(names).items()
        if word.endswith("_topic") and not word.startswith(("vla_", "declared_"))
    }
    assert of_objects == {topic for topic in known if topic.startswith("ot1/")}
