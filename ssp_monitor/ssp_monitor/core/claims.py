"""How many messages publishers say to have sent, out of the messages in which they say so.

The middleware can't show that the very last message of a publisher is missing, since nothing comes
behind it. Where another message of the same publisher counts, that one can.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress

from ssp_core import names
from ssp_core.cdr.steps import decode_heartbeat, decode_tick_head

TICK, HEARTBEAT = names.absolute(names.WORLD_TICK), names.absolute(names.HEARTBEAT)
SOURCES = frozenset({TICK, HEARTBEAT})


def claims(last: Mapping[str, bytes]) -> dict[str, int]:
    """By topic, how many messages its publisher has sent at the least.

    The world doesn't count the states of the VUT that it repeats before a run, so that its number
    may be lower than the truth; it is never higher.

    Args:
        last: the last message of each topic of SOURCES that has one. One that can't be read says
            nothing.
    """
    sent: dict[str, int] = {}
    with suppress(KeyError, ValueError):
        states = decode_tick_head(last[TICK]).vut_states_sent
        sent[names.absolute(names.state_topic(names.VUT_ID))] = states
    with suppress(KeyError, ValueError):
        for object_id, references in decode_heartbeat(last[HEARTBEAT]).references_sent.items():
            sent[names.absolute(names.reference_topic(object_id))] = references
    return sent
