"""The graph as a recording sees it: who publishes what, and which publishers can't be heard.

This file owns what was found on the graph. A look at a large graph is spread over several calls, so
that status goes out meanwhile.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from functools import cache

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.topic_endpoint_info import TopicEndpointInfo

from ssp_monitor.recorder.topics import Selection, TopicDiscovery, TopicSpec
from ssp_monitor.ros.conversions import (
    adapted_profile,
    is_compatible,
    recording_profile,
    why_not_recordable,
)

# Looking at a graph of thousands of nodes takes a while; no more of the time than one in this.
GRAPH_SHARE = 20
GRAPH_MOST_S = 5.0
# To read the types of a thousand new topics and to subscribe to them takes seconds; status must go
# out meanwhile.
ADDING_S = 0.2


class GraphWatch:
    """Topics and publishers on the graph.

    Args:
        node: that looks.
        selection: the topics that are asked for beside the run's own.
        add: is given a topic that was found, its publishers, and the profile to hear it by; False
            where it can't be recorded.
        say: is given what a person should know.

    Attributes:
        topics: those that were found, and what is known of each.
        publishers: how many each topic had at the last look.
        unheard: the topics with a publisher that can't be heard.
    """

    def __init__(
        self,
        node: Node,
        selection: Selection,
        add: Callable[[TopicSpec, Sequence[TopicEndpointInfo], QoSProfile], bool],
        say: Callable[[str], object],
    ) -> None:
        self.topics = TopicDiscovery(selection)
        self.publishers: dict[str, int] = {}
        self.unheard: set[str] = set()
        self._node = node
        self._add = add
        self._say = say
        self._why_not = cache(why_not_recordable)
        self._profiles: dict[str, QoSProfile] = {}
        self._due_s = 0.0
        self._to_judge: deque[tuple[str, Sequence[str]]] = deque()

    def lacks(self, topic: TopicSpec, received: int) -> bool:
        """Tell whether nothing is heard where something must be, or a publisher can't be heard.

        A publisher that this process sees may not have seen this process yet: what it sends until
        then is lost. One that speaks before a run is known to be heard by its first message.

        Args:
            topic: of the run.
            received: how many of its messages were received.
        """
        profile = recording_profile(topic.profile)
        publishers = self._node.get_publishers_info_by_topic(topic.name)
        self.publishers[topic.name] = len(publishers)
        compatibility = [
            is_compatible(publisher, topic.msgtype, profile) for publisher in publishers
        ]
        # Before anything was heard, a publisher that can't be is a mistake that can be mended.
        needs_no_notice = topic.name in self.unheard or not received
        if not all(compatibility) and not needs_no_notice:
            self.unheard.add(topic.name)
            stranger = publishers[compatibility.index(False)]
            self._say(
                f"{topic.name} is not heard from {stranger.node_name}: its type or profile is not "
                "that of the run; what it says is lost"
            )
        silent = topic.speaks_early and not received
        return not all(compatibility) or (topic.required and (not compatibility or silent))

    def look(self) -> None:
        """Look at the graph when it is due, and record new topics for a while."""
        now_s = time.monotonic()
        # A graph that isn't gone through yet is finished first.
        if self.topics.selection.looks and not self._to_judge and now_s >= self._due_s:
            graph = self._graph()
            look_s = time.monotonic() - now_s
            self._due_s = now_s + min(GRAPH_SHARE * look_s, GRAPH_MOST_S)
            self._to_judge.extend(self.topics.in_order(graph))
        until_s = time.monotonic() + ADDING_S
        while self._to_judge and time.monotonic() < until_s:
            for topic in self.topics.look([self._to_judge.popleft()], self._why_not):
                publishers = self._node.get_publishers_info_by_topic(topic.name)
                profile = adapted_profile(topic, publishers)
                if self._add(topic, publishers, profile):
                    self._profiles[topic.name] = profile

    def _graph(self) -> list[tuple[str, list[str]]]:
        """Return topics that are recorded or asked for, each with the types of its publishers."""
        graph = []
        for name, types in self._node.get_topic_names_and_types():
            recorded = self.topics.recorded.get(name)
            if recorded is not None:
                self._count_publishers(name, recorded)
            elif not self.topics.wants(name):
                continue
            # A reader's type counts for nothing; most often all have the same.
            if recorded is None or types != [recorded]:
                publishers = self._node.get_publishers_info_by_topic(name)
                types = sorted({publisher.topic_type for publisher in publishers})
            graph.append((name, types))
        return graph

    def _count_publishers(self, name: str, msgtype: str) -> None:
        """Find publishers that a reader can't hear: its profile is that of the first ones."""
        count = self._node.count_publishers(name)
        if count == self.publishers.get(name) or name not in self._profiles:
            return
        self.publishers[name] = count
        profile = self._profiles[name]
        for publisher in self._node.get_publishers_info_by_topic(name):
            # Of another type the survey tells.
            if publisher.topic_type == msgtype and not is_compatible(publisher, msgtype, profile):
                self.unheard.add(name)
                self._say(
                    f"{name} is not heard from {publisher.node_name}: it came later and offers "
                    "less than those before; what it says is lost"
                )
