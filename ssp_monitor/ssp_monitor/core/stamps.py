"""Times of messages that nobody decodes: the stamp at its fixed place in the serialised bytes."""

from __future__ import annotations

from dataclasses import dataclass

from rosbags.interfaces import Nodetype

from ssp_core.bag.types import typestore
from ssp_core.cdr.codec import START
from ssp_core.cdr.messages import leading_stamp_ns
from ssp_core.world.transforms import TF_TYPE

_STAMPED = ("std_msgs/msg/Header", "builtin_interfaces/msg/Time")


def stamp_at(msgtype: str) -> int | None:
    """Where the first stamp stands in a message of this type; None: it doesn't begin with one.

    A Header or a bare Time stands behind the encapsulation, that of a first transform behind their
    number.

    Raises:
        KeyError: the type is not known.
    """
    if msgtype == TF_TYPE:
        return START + 4
    fields = typestore().fielddefs[msgtype][1]
    if not fields:
        return None
    kind, what = fields[0][1]
    return START if kind == Nodetype.NAME and what in _STAMPED else None


@dataclass(slots=True)
class SimulatedTime:
    """Gives each message of a simulated session its time: its own stamp, or the newest one seen.

    The newest stamp, not that of /clock, so that the result doesn't depend on the order in which
    two topics happen to be read.
    """

    newest_ns: int = 0

    def of(self, cdr: bytes, at: int | None) -> int:
        """Time of a message, ns.

        Args:
            cdr: the serialised message.
            at: where its stamp stands, see stamp_at.
        """
        stamp_ns = None if at is None else leading_stamp_ns(cdr, at)
        if stamp_ns is None:
            return self.newest_ns
        self.newest_ns = max(self.newest_ns, stamp_ns)
        return stamp_ns
