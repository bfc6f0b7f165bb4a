"""The messages of latched topics that stay valid.

Later files of a bag, cuts and late subscribers begin with them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import NamedTuple, Protocol

from ssp_core.bag.metadata import is_latched, parse_offered_qos, stated_depth
from ssp_core.names import TF_STATIC
from ssp_core.world.transforms import TF_TYPE, Transform, decode_transforms, encode_transforms

# What a claimed depth may make us remember, and what is kept without one.
MOST_KEPT = 1000
UNTOLD_DEPTH = 100
KEPT_BYTES = 16 << 20
# Of static transforms; a tree has some hundred frames.
MOST_FRAMES = 10_000


class LatchedMessage(NamedTuple):
    """A latched message that later files repeat."""

    cdr: bytes
    publish_time_ns: int
    sequence: int


class LateJoiner(Protocol):
    """The messages of a topic that stay valid for late subscribers."""

    def keep(self, message: LatchedMessage) -> None:
        """Take the newest message."""
        ...

    @property
    def messages(self) -> Iterable[LatchedMessage]:
        """The messages that a late joiner gets, the oldest first."""
        ...


class LatchedTopic:
    """The newest messages of a latched topic, as many as its publishers offer to late joiners.

    A later file begins with them: with the publish time that they had and the log time at which
    that file begins, so that the order by log time holds. They stand in a channel of their own,
    of the same topic, which carries ``ssp_repeated: "true"`` in its metadata: a reader of the
    whole bag skips these channels in all files but the first, a reader of one file takes them.

    Where the publishers don't say how many they offer, which is what a graph tells of another
    process's publishers, there are UNTOLD_DEPTH: one message per publisher may be valid, and more
    publishers may have come later. In any case they are bounded by KEPT_BYTES, beyond which only
    one for each publisher is kept.

    Args:
        offered_qos: the topic's publishers, as YAML.
    """

    def __init__(self, offered_qos: str) -> None:
        self._most = stated_depth(offered_qos, MOST_KEPT) or UNTOLD_DEPTH
        self._least = min(max(1, len(parse_offered_qos(offered_qos))), self._most)
        self._bytes = 0
        self.messages: deque[LatchedMessage] = deque()

    def keep(self, message: LatchedMessage) -> None:
        """Add the newest message and drop the oldest ones that are too many or too large."""
        self.messages.append(message)
        self._bytes += len(message.cdr)
        while len(self.messages) > self._most or (
            self._bytes > KEPT_BYTES and len(self.messages) > self._least
        ):
            self._bytes -= len(self.messages.popleft().cdr)


class StaticTransforms:
    """The static transforms that are valid, merged by child frame into one message, as tf2 does.

    Each of several publishers sends its own, and keeps one message: what any of them offers, or a
    bag says of it, is no measure of how many there are. A message that says all is kept as it is.
    What can't be decoded is kept beside them as of a latched topic that doesn't tell its depth.
    """

    def __init__(self) -> None:
        self._newest: dict[str, Transform] = {}
        self._last: LatchedMessage | None = None
        self._is_whole = True  # the last message says all
        self._others = LatchedTopic("")

    def keep(self, message: LatchedMessage) -> None:
        """Take the transforms of a message; each replaces the one of its child frame."""
        try:
            transforms = decode_transforms(message.cdr)
            encode_transforms(transforms)
        except ValueError:
            self._others.keep(message)
            return
        for one in transforms:
            self._newest.pop(one.child, None)
            self._newest[one.child] = one
        while len(self._newest) > MOST_FRAMES:
            del self._newest[next(iter(self._newest))]
        self._last = message
        self._is_whole = len(self._newest) == len({one.child for one in transforms})

    def take(self, message: LatchedMessage) -> bytes:
        """Take a message, and give the one that says all from then on."""
        self.keep(message)
        if self._last is not message:
            return message.cdr
        return self._merged(message).cdr

    def says(self, cdr: bytes) -> bool:
        """Tell whether all transforms of a message are valid already."""
        try:
            return all(self._newest.get(one.child) == one for one in decode_transforms(cdr))
        except ValueError:
            return False

    def _merged(self, last: LatchedMessage) -> LatchedMessage:
        if self._is_whole:
            return last
        return last._replace(cdr=encode_transforms(self._newest.values()))

    @property
    def messages(self) -> list[LatchedMessage]:
        """The transforms in one message, behind what couldn't be decoded."""
        return [*self._others.messages, *([] if self._last is None else [self._merged(self._last)])]


def is_static(topic: str, msgtype: str) -> bool:
    """Tell whether a topic is one of static transforms, in any namespace."""
    return msgtype == TF_TYPE and f"/{topic.rpartition('/')[2]}" == TF_STATIC


def late_joiner(
    topic: str, msgtype: str, offered_qos: str, *, latched: bool | None = None
) -> LateJoiner | None:
    """Make the store for the messages of a topic that stay valid; None: none do.

    Args:
        topic: full name.
        msgtype: full type name, ``package/msg/Name``.
        offered_qos: the topic's publishers, as YAML; what is none says nothing.
        latched: whether they keep messages for late joiners; None: as the QoS says.
    """
    if is_static(topic, msgtype):
        return StaticTransforms()
    if latched is None:
        latched = is_latched(offered_qos)
    return LatchedTopic(offered_qos) if latched else None
