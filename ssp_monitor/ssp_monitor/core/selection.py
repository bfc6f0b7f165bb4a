"""Which topics of the graph are recorded, and how they are heard."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from ssp_monitor.core.pattern import Pattern
from ssp_monitor.core.topics import Profile, TopicSpec

# Each reader takes memory and a thread's time. A session's own topics don't count.
MOST_TOPICS = 2000
# What every node has and no one looks for in a bag. Recorded when named, never by a pattern.
NOISE = frozenset(("/parameter_events", "/rosout"))


@dataclass(frozen=True, slots=True)
class Selection:
    """What a person asked for, beside the run's own topics.

    Args:
        everything: all topics of the graph.
        include: of the graph, those in whose names one of these is found.
        exclude: none of these, unless they are named or the run's own.
        named: exact names.
        own: the run's own topics, which are recorded in any case, by another rule.
        most: no more than this.
    """

    everything: bool = False
    include: tuple[Pattern, ...] = ()
    exclude: tuple[Pattern, ...] = ()
    named: frozenset[str] = frozenset()
    own: frozenset[str] = frozenset()
    most: int = MOST_TOPICS

    @property
    def looks(self) -> bool:
        """Whether there is anything to look for on the graph."""
        return self.everything or bool(self.include or self.named)

    def wants(self, name: str) -> bool:
        """Whether a topic is asked for by its name."""
        if name in self.own:
            return False
        if name in self.named:
            return True
        if name in NOISE or is_hidden(name):
            return False
        if not (self.everything or any(pattern.found_in(name) for pattern in self.include)):
            return False
        return not any(pattern.found_in(name) for pattern in self.exclude)


def is_hidden(name: str) -> bool:
    """Whether a part of the name begins with an underscore, as ROS hides topics."""
    return "/_" in name


@dataclass(slots=True)
class Survey:
    """What was found on the graph so far: each name is judged once, and once warned about.

    Args:
        selection: what is asked for.
    """

    selection: Selection
    # Topics by name with their types; those that are of another type too by now; and those that
    # had several types when they were found and are not recorded for that.
    recorded: dict[str, str] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    changed: set[str] = field(default_factory=set)
    ambiguous: set[str] = field(default_factory=set)
    _judged: dict[str, bool] = field(default_factory=dict)
    _told: set[str] = field(default_factory=set)
    _refused: list[str] = field(default_factory=list)

    def look(
        self, graph: Iterable[tuple[str, Sequence[str]]], installed: Mapping[str, str | None]
    ) -> list[TopicSpec]:
        """The topics to record from now on.

        Args:
            graph: names with the types that their publishers and subscribers have.
            installed: asked by type: why a message type can't be recorded, or None.

        Returns:
            Those that are new, named ones first, then by name.
        """
        found: list[TopicSpec] = []
        for name, types in self.in_order(graph):
            if name in self.recorded:
                self._look_again(name, types)
            elif not types or not self.wants(name):
                continue
            elif (spec := self._new(name, types, installed)) is not None:
                self.recorded[name] = spec.msgtype
                found.append(spec)
        return found

    def in_order(
        self, graph: Iterable[tuple[str, Sequence[str]]]
    ) -> list[tuple[str, Sequence[str]]]:
        """A graph as ``look`` goes through it, for who looks at parts of it."""
        return sorted(graph, key=lambda item: (item[0] not in self.selection.named, item[0]))

    def all_warnings(self) -> list[str]:
        if not self._refused:
            return list(self.warnings)
        some = ", ".join(self._refused[:5]) + (", ..." if len(self._refused) > 5 else "")
        limit = (
            f"{len(self._refused)} topics are not recorded, the limit is {self.selection.most}: "
            f"{some}"
        )
        return [*self.warnings, limit]

    def wants(self, name: str) -> bool:
        """As Selection.wants; each name is judged once."""
        judged = self._judged.get(name)
        if judged is None:
            judged = self._judged[name] = self.selection.wants(name)
        return judged

    def _new(
        self, name: str, types: Sequence[str], installed: Mapping[str, str | None]
    ) -> TopicSpec | None:
        if len(types) > 1:
            self.ambiguous.add(name)
            self._warn(name, f"{_not_recorded(name)}: {', '.join(types)}")
            return None
        if (why := installed[types[0]]) is not None:
            self._warn(name, f"{name} is not recorded: {why}")
            return None
        if len(self.recorded) >= self.selection.most:
            if name not in self._told:
                self._told.add(name)
                self._refused.append(name)
            return None
        if name in self.ambiguous:
            self._settle(name)
        # Stamps of strangers may be of another clock, and nobody knows how many publish.
        return TopicSpec(name, types[0], Profile.ADAPTED, session_time=False)

    def _settle(self, name: str) -> None:
        """One type is left: the topic is recorded, and what came before stays lost."""
        self.ambiguous.discard(name)
        self.warnings = [text for text in self.warnings if not text.startswith(_not_recorded(name))]
        self.warnings.append(f"{name} had several types at first and is recorded since it has one")

    def _look_again(self, name: str, types: Sequence[str]) -> None:
        """A reader of the one type never hears the other; what it says is lost, and nobody can
        count it. rosbag2 does the same, without a word."""
        others = [kind for kind in types if kind != self.recorded[name]]
        if others and name not in self.changed:
            self.changed.add(name)
            self.warnings.append(
                f"{name} is also of type {', '.join(others)} now: only {self.recorded[name]} is "
                "recorded, the rest is lost"
            )

    def _warn(self, name: str, text: str) -> None:
        if name not in self._told:
            self._told.add(name)
            self.warnings.append(text)


def _not_recorded(name: str) -> str:
    return f"{name} has several types and is not recorded"
