"""The reasons for which a hit is no evidence."""

from __future__ import annotations


class Scope:
    """Reasons for which a hit is no evidence, as bits; 0 is asserted.

    Plain integers: an IntFlag costs more than all the rest of the stage.
    """

    NONE = 0
    DENIED = 1
    IMAGINED = 2  # if, when, until, option A
    POSSIBLE = 4  # may, could
    AHEAD = 8  # will, about to
    PAST = 16
    QUOTED = 32
    REJECTED = 64
    READY = 128
    GONE = 256  # no longer
