"""Times of messages that nobody decodes: the stamp at its fixed place in the serialised bytes."""

from __future__ import annotations

from dataclasses import dataclass

from rosbags.interfaces import Nodetype

from ssp_core.bag.types import typestore
from ssp_core.messages import leading_stamp_ns

_STAMPED = ("std_msgs/msg/Header", "builtin_interfaces/msg/Time")


def begins_with_stamp(msgtype: str) -> bool:
    """Whether the first thing in a message of this type is a stamp: a Header or a bare Time.

    Raises:
        KeyError: the type is not known.
    """
    fields = typestore().fielddefs[msgtype][1]
    if not fields:
        return False
    kind, what = fields[0][1]
    return kind == Nodetype.NAME and what in _STAMPED


@dataclass(slots=True)
class SimulatedTime:
    """Gives each message of a simulated session its time: its own stamp, or the newest one seen.

    The newest stamp, not that of /clock, so that the result doesn't depend on the order in which
    two topics happen to be read.
    """

    newest_ns: int = 0

    def of(self, cdr: bytes, stamped: bool) -> int:
        """Time of a message, ns.

        Args:
            cdr: the serialised message.
            stamped: its type begins with a stamp, see begins_with_stamp.
        """
        stamp_ns = leading_stamp_ns(cdr) if stamped else None
        if stamp_ns is None:
            return self.newest_ns
        self.newest_ns = max(self.newest_ns, stamp_ns)
        return stamp_ns
