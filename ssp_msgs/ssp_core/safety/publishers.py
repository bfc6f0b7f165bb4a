"""The publishers that each topic of a session may have, one table that finds strangers.

Most topics have one publisher, of any name: a second one is a stranger. Topics that several parts
of a session share may be published once by each process of these parts; a part's processes are
known by the topics that are theirs alone.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, auto

from ssp_core import names
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participation import declaring

# A publisher of a process that was killed stays in the graph for so long, s: the longest lease of
# our profiles. One that ends in order is gone at once.
FORGOTTEN_S = 20
# Of the topics with strangers, as many as are told in a message or taken from one.
MOST_TOLD = 8
LONGEST_TOLD = 1000
# The manager tells of its links and of strangers once a second; three periods without are silence.
LINKS_FRESH_S = 3.0


def known_strangers(
    by_manager: Sequence[str], manager_age_s: float, by_recorder: Sequence[str]
) -> tuple[str, ...]:
    """Return the strangers that the manager finds in the graph and the recorder in messages.

    Args:
        by_manager: its last report; that of a manager that is silent says nothing of now.
        manager_age_s: how long ago that came.
        by_recorder: its last report.
    """
    return *(by_manager if manager_age_s <= LINKS_FRESH_S else ()), *by_recorder


class Part(Enum):
    """A part of a session, which is one process or several."""

    MANAGER = auto()
    WORLD = auto()
    OBJECTS = auto()
    RECORDER = auto()
    CAMERA = auto()
    RUNNER = auto()


# Where a process id stands in the prefix of a GUID: its lower 16 bits.
_ID = slice(4, 6)
# What stands for a node that the graph has not named yet.
NAMELESS = "a node without a name"
ONE: tuple[Part, ...] = ()
# Each topic that isn't an object's: the parts that share it, or ONE publisher.
_OF_SESSION: dict[str, tuple[Part, ...]] = {
    names.CLOCK: ONE,
    names.WORLD_TICK: ONE,
    names.STEP_DONE: (Part.MANAGER, Part.OBJECTS, Part.RECORDER, Part.CAMERA),
    names.ACTUATOR_COMMANDS: (Part.OBJECTS,),
    names.VUT_COMMAND: ONE,
    names.BODY_STATUS: (Part.OBJECTS,),
    names.HEARTBEAT: ONE,
    names.HEARTBEAT_REPLY: (Part.OBJECTS,),
    names.LINK_STATUS: ONE,
    names.OBJECT_STATES: (Part.OBJECTS,),
    names.FAULT_EVENT: (Part.WORLD, Part.OBJECTS, Part.RUNNER),
    names.SESSION_STATE: ONE,
    names.TRIGGER_EVENT: ONE,
    names.PHASE_EVENT: ONE,
    names.RECORDER_STATUS: ONE,
    names.LOCALISATION_STATUS: ONE,
    names.CAMERA_IMAGE: ONE,
    names.CAMERA_INFO: ONE,
    names.CAMERA_MOUNT: ONE,
    names.CAMERA_RENDERER: ONE,
    names.WORLD_PLANT: ONE,
    names.state_topic(names.VUT_ID): ONE,
}
# What anybody may publish beside us, and why that does no harm.
ANYBODY = {
    names.SAFETY_EVENT: "any node may report danger, and end a session",
    names.TF: "every ROS system has its own frames there; nothing of ours is judged by it",
    names.TF_STATIC: "as /tf",
    names.DIAGNOSTICS: "every node reports its health there",
}
# The topics that show which processes a part has; those of objects are in ``_proofs``.
_PROOFS = {
    Part.MANAGER: names.SESSION_STATE,
    Part.WORLD: names.WORLD_TICK,
    Part.RECORDER: names.RECORDER_STATUS,
    Part.CAMERA: names.CAMERA_IMAGE,
}


def declarations(run: RunSpec) -> tuple[str, ...]:
    """List the topics on which several may say what a participant is, as long as they agree.

    A rehearsal declares what it plays, and an object target the mirrors and test objects that are
    known to be models; who declares something else ends the session.
    """
    return tuple(map(names.declared_topic, declaring(run))) if run.mode == "live" else ()


def expected_publishers(run: RunSpec | None) -> dict[str, tuple[Part, ...]]:
    """Return the parts that share each topic of a session, ``ONE`` where it has one publisher.

    Args:
        run: None: no run is loaded, and nothing is known of its objects.
    """
    topic_parts = dict(_OF_SESSION)
    if run is not None and run.driven is not None:
        driver = run.driven.driver
        topic_parts |= dict.fromkeys(
            (
                names.vla_request_topic(driver),
                names.vla_response_topic(driver),
                names.vla_latency_topic(driver),
                names.reference_topic(run.vut.id),
                names.ack_topic(run.vut.id),
            ),
            ONE,
        )
    for target in () if run is None else run.targets:
        topic_parts |= dict.fromkeys(_of_object(target.id), ONE)
        if run is not None and _asks_for_references(run, target.id):
            topic_parts[names.reference_topic(target.id)] = (Part.MANAGER, Part.RUNNER)
    return topic_parts


def _of_object(object_id: str) -> tuple[str, ...]:
    return (
        names.state_topic(object_id),
        names.reference_topic(object_id),
        names.ack_topic(object_id),
        names.iso_frames_topic(object_id),
        names.rules_topic(object_id),
    )


def _asks_for_references(run: RunSpec, object_id: str) -> bool:
    """Tell whether the run's own faults have the runner send this object references."""
    return any(f.target == object_id and f.kind.startswith("reference_") for f in run.faults)


def _proofs(run: RunSpec | None) -> dict[str, Part]:
    """Give, by topic with one publisher, the part that its publisher's process belongs to."""
    proofs = {topic: part for part, topic in _PROOFS.items()}
    for target in () if run is None else run.targets:
        proofs |= dict.fromkeys(
            (names.ack_topic(target.id), names.state_topic(target.id)), Part.OBJECTS
        )
    return proofs


@dataclass(frozen=True, slots=True)
class Publisher:
    """A publisher as the graph shows it.

    Args:
        node: full name of its node; empty while the graph doesn't know it.
        process: what tells its process from others.
        whence: which process that is, in words; empty where it isn't known.
    """

    node: str
    process: bytes
    whence: str = ""

    @property
    def name(self) -> str:
        """Its node, or else what is known of it."""
        if self.node:
            return self.node
        return f"{NAMELESS} ({self.whence})" if self.whence else NAMELESS


def whence(process: bytes, own: bytes) -> str:
    """Give the id of a process on this host, by the prefix of Fast DDS's GUIDs.

    A prefix begins with two bytes of the vendor, two of the host and two of the process id. The
    graph knows it at once, and a node's name only when a message of that node has come.

    Args:
        process: prefix of a publisher.
        own: prefix of a publisher of this process; empty while there is none.

    Returns:
        Words; empty for another host or another vendor's DDS.
    """
    if len(own) < _ID.stop or process[: _ID.start] != own[: _ID.start]:
        return ""
    return f"process {_process_id(process)} of this host"


def is_process(process: bytes, pid: int) -> bool:
    """Tell whether a prefix is one of the process of this id."""
    return _process_id(process) == pid & 0xFFFF


def _process_id(process: bytes) -> int:
    return int.from_bytes(process[_ID], "little")


@dataclass(frozen=True, slots=True)
class Strangers:
    """Publishers of one topic that shouldn't be: how many, and a sentence that names them."""

    count: int
    text: str


class PublisherRules:
    """Judges the publishers of a session's topics, and remembers the processes of its parts.

    A process that is known stays known, so that a session's end doesn't make strangers of those
    whose topics go one after the other.

    Args:
        run: as for ``expected_publishers``.
    """

    def __init__(self, run: RunSpec | None = None) -> None:
        self.expected = expected_publishers(run)
        self._of_drivers: frozenset[str] = frozenset()
        self._proofs = _proofs(run)
        self._accepted_processes: dict[Part, set[bytes]] = {part: set() for part in Part}
        self._doubtful = frozenset[Part]()

    def expect_one(self, topics: Collection[str]) -> None:
        """Let each of these topics have one publisher, and forget those of the call before.

        Args:
            topics: that drivers outside the session publish, by full names.
        """
        for topic in self._of_drivers.difference(topics):
            del self.expected[topic]
        self._of_drivers = frozenset(topics)
        self.expected |= dict.fromkeys(topics, ONE)

    def know(self, graph: Mapping[str, Sequence[Publisher]]) -> None:
        """Learn from topics that have one publisher which processes belong to the session.

        Of a part that has shown two, and no single one before, none is known to be its own.
        """
        doubtful = set()
        for topic, part in self._proofs.items():
            if len(publishers := graph.get(topic, ())) == 1:
                self._accepted_processes[part].add(publishers[0].process)
            elif len(publishers) > 1:
                doubtful.add(part)
        self._doubtful = frozenset(part for part in doubtful if not self._accepted_processes[part])

    @property
    def proofs(self) -> frozenset[str]:
        """Topics that ``know`` learns from."""
        return frozenset(self._proofs)

    def strangers(self, topic: str, publishers: Sequence[Publisher]) -> Strangers | None:
        """Name who publishes a topic and shouldn't; None while all is well.

        Args:
            topic: one of ``expected``.
            publishers: all of the topic.
        """
        parts = self.expected[topic]
        if not parts:
            return _too_many(topic, publishers) if len(publishers) > 1 else None
        own_processes = set[bytes]().union(*(self._accepted_processes[part] for part in parts))
        strange, processes = [], set[bytes]()
        for one in publishers:
            ours = Part.RUNNER in parts and one.node == _RUNNER
            if one.process in processes or not (ours or one.process in own_processes):
                strange.append(one)
            processes.add(one.process)
        if not strange:
            return None
        text = f"{topic} has {' and '.join(_names(strange))}"
        if self._doubtful.intersection(parts):
            return Strangers(len(strange), f"{text}; which is this session's own isn't known")
        return Strangers(len(strange), f"{text} beside this session's own")


def _names(publishers: Sequence[Publisher]) -> list[str]:
    return sorted(one.name for one in publishers)


_RUNNER = names.absolute(names.RUNNER)


def _too_many(topic: str, publishers: Sequence[Publisher]) -> Strangers:
    return Strangers(len(publishers) - 1, f"{topic} has {' and '.join(_names(publishers))}")
