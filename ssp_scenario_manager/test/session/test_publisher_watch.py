"""The manager's look at the graph: how soon a stranger is named, and by what."""

from __future__ import annotations

import os
from collections import defaultdict
from types import SimpleNamespace
from typing import Any

import pytest

from ssp_core import names
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.publishers import LONGEST_TOLD, MOST_TOLD, NAMELESS
from ssp_scenario_manager.session.supervision import LivenessMonitor

endpoints = pytest.importorskip("ssp_scenario_manager.ros.endpoints")
manager_node = pytest.importorskip("ssp_scenario_manager.ros.manager_node")
NodeNameNonExistentError = pytest.importorskip("rclpy.node").NodeNameNonExistentError
UNKNOWN = "_NODE_NAME_UNKNOWN_"
LATEST_S = 0.2


class Graph:
    """A graph in memory, in the place of a node's."""

    def __init__(self) -> None:
        self.topics: dict[str, list[Any]] = defaultdict(list)
        self.adapter_topics: list[str] | None = None
        self.handle = self

    def add(self, topic: str, node: str, process: int, host: int = 7) -> Any:
        count = sum(map(len, self.topics.values()))
        gid = [1, 15, host, host, *process.to_bytes(2, "little"), *[0] * 6, 0, 0, 0, count]
        made = SimpleNamespace(node_name=node, node_namespace="/ssp", endpoint_gid=gid)
        self.topics[topic].append(made)
        return made

    def get_count_publishers(self, topic: str) -> int:
        return len(self.topics[topic])

    def resolve_topic_name(self, topic: str) -> str:
        return topic

    def get_subscriber_names_and_types_by_node(
        self, node: str, namespace: str
    ) -> list[tuple[str, list[str]]]:
        if self.adapter_topics is None:
            raise NodeNameNonExistentError
        assert (node, namespace) == (names.VUT_ADAPTER, names.NAMESPACE)
        return [(topic, ["t"]) for topic in self.adapter_topics]

    def get_publishers_info_by_topic(self, topic: str) -> list[Any]:
        return self.topics[topic]


class Watched:
    """A session with one object, and looks at it at the manager's period."""

    def __init__(self, run: RunSpec) -> None:
        self.graph = Graph()
        for topic in (names.SESSION_STATE, names.STEP_DONE, names.HEARTBEAT):
            self.graph.add(topic, names.SCENARIO_MANAGER, os.getpid() & 0xFFFF)
        for topic in ("ot1/state", "ot1/reference_ack", names.STEP_DONE, names.HEARTBEAT_REPLY):
            self.graph.add(topic, names.OBJECT_TARGET, 2)
        self.liveness = LivenessMonitor()
        self.watch = endpoints.PublisherWatch(self.graph, self.liveness)
        self.now_s = 100.0
        self.watch.follow(run, round(self.now_s * 1e9))

    def look(self, seconds: float) -> str:
        """Looks for so long; what is known then."""
        for _ in range(int(seconds / manager_node.WATCHDOG_PERIOD_S)):
            self.now_s += manager_node.WATCHDOG_PERIOD_S
            self.watch.look(round(self.now_s * 1e9))
        return str(self.liveness.foreign_text)


@pytest.fixture
def watched(run: RunSpec) -> Watched:
    return Watched(run)


TOPICS = ["ot1/state", "ot1/reference_ack", names.STEP_DONE, names.HEARTBEAT_REPLY, names.HEARTBEAT]


def test_a_sound_session_has_no_strangers(watched: Watched) -> None:
    watched.graph.add(names.RECORDER_STATUS, names.MONITOR, 3)
    watched.graph.add(names.STEP_DONE, names.MONITOR, 3)
    for topic in (names.SAFETY_EVENT, names.TF, "vla/a/response"):
        watched.graph.add(topic, "anybody", 9)
        watched.graph.add(topic, "anybody_else", 8)
    assert watched.look(1.0) == ""
    assert watched.liveness.other_managers == 0


@pytest.mark.parametrize("topic", TOPICS)
def test_a_stranger_is_named_at_the_next_look(watched: Watched, topic: str) -> None:
    watched.graph.add(topic, "intruder", 9)
    found = watched.look(manager_node.WATCHDOG_PERIOD_S)
    assert found.startswith(f"{topic} has ")
    assert "/ssp/intruder" in found
    assert watched.liveness.other_managers == 1


@pytest.mark.parametrize("topic", TOPICS)
def test_a_name_is_waited_for_but_not_for_long(watched: Watched, topic: str) -> None:
    intruder = watched.graph.add(topic, UNKNOWN, 9)
    assert watched.look(manager_node.WATCHDOG_PERIOD_S) == ""
    assert NAMELESS in watched.look(LATEST_S - 2 * manager_node.WATCHDOG_PERIOD_S)
    intruder.node_name = "intruder"
    assert "/ssp/intruder" in watched.look(manager_node.WATCHDOG_PERIOD_S)
    watched.graph.topics[topic].remove(intruder)
    assert watched.look(manager_node.WATCHDOG_PERIOD_S) == ""


@pytest.mark.parametrize("topic", TOPICS)
def test_a_process_of_this_host_is_named_before_the_graph_knows_its_node(
    watched: Watched, topic: str
) -> None:
    watched.graph.add(topic, UNKNOWN, 4711)
    assert f"{NAMELESS} (process 4711 of this host)" in watched.look(LATEST_S)


def test_a_process_of_another_host_is_not_mistaken_for_one_of_this(watched: Watched) -> None:
    watched.graph.add(names.HEARTBEAT, UNKNOWN, 4711, host=8)
    found = watched.look(LATEST_S)
    assert NAMELESS in found
    assert "process" not in found


def test_an_object_whose_process_began_anew_is_waited_out(watched: Watched) -> None:
    for topic in ("ot1/state", "ot1/reference_ack", names.HEARTBEAT_REPLY):
        watched.graph.add(topic, names.OBJECT_TARGET, 4)
    assert "/ssp/object_target" in watched.look(0.2)
    for found in watched.graph.topics.values():
        found[:] = [one for one in found if one.endpoint_gid[4:6] != [2, 0]]
    assert watched.look(0.2) == ""


def test_the_receivers_topics_have_one_publisher_each(watched: Watched) -> None:
    """The track that two publishers of odometry make between them is none that the VUT drove."""
    watched.graph.adapter_topics = ["/ins/odometry", "/clock"]
    watched.graph.add("/ins/odometry", "ins", 9)
    assert watched.look(1.0) == ""
    second = watched.graph.add("/ins/odometry", "old_bag", 8)
    found = watched.look(manager_node.WATCHDOG_PERIOD_S)
    assert found == "/ins/odometry has /ssp/ins and /ssp/old_bag"
    assert watched.liveness.other_managers == 1
    watched.graph.topics["/ins/odometry"].remove(second)
    assert watched.look(0.2) == ""


def test_topics_that_the_adapter_hears_no_more_are_forgotten(watched: Watched) -> None:
    watched.graph.adapter_topics = ["/ins/odometry"]
    for node in ("ins", "old_bag"):
        watched.graph.add("/ins/odometry", node, 9)
    assert "/ins/odometry" in watched.look(0.2)
    watched.graph.adapter_topics = ["/other/odometry"]
    assert watched.look(0.2) == ""


def test_operators_are_told_of_a_stranger_at_the_look_that_finds_it(watched: Watched) -> None:
    """The page and the prompt have it from the manager, which reports links once a second."""
    told: list[tuple[str, ...]] = []
    period_s = manager_node.WATCHDOG_PERIOD_S
    manager = SimpleNamespace(
        _liveness=watched.liveness,
        _others=SimpleNamespace(look=lambda _: watched.look(period_s)),
        _report_links=lambda: told.append(watched.liveness.strangers),
    )
    look = manager_node.ScenarioManager._look_at_publishers
    look(manager)
    assert told == []
    intruder = watched.graph.add("ot1/state", "intruder", 9)
    look(manager)
    assert told == [("ot1/state has /ssp/intruder and /ssp/object_target",)]
    look(manager)
    watched.graph.topics["ot1/state"].remove(intruder)
    look(manager)
    assert told[1:] == [()]


def test_of_many_strangers_some_are_told_and_none_at_length(watched: Watched) -> None:
    for number in range(20):
        watched.liveness.foreign[f"t{number}"] = 1, "x" * 5000
    assert [len(text) for text in watched.liveness.strangers] == [LONGEST_TOLD] * MOST_TOLD
    watched.liveness.foreign.clear()
    watched.liveness.hear_strangers(["clock has two"])
    assert watched.liveness.strangers == ()
