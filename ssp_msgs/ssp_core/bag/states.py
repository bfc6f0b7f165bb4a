"""States that objects reported of themselves, from whichever topics a session sent them on."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from ssp_core.bag.message import BagMessage
from ssp_core.bag.reader import BagReader
from ssp_core.errors import InputError
from ssp_core.messages import object_state
from ssp_core.names import OBJECT_STATES, absolute, state_topic
from ssp_core.state import ObjectState

_ARRAYS = absolute(OBJECT_STATES)


def object_states(bag: BagReader, ids: Iterable[str]) -> dict[str, list[ObjectState]]:
    """The states of each of these objects in the order in which they were recorded.

    An object has a topic of its own, or its process sends one message for all its objects
    (ObjectStates.msg); a bag may hold both.

    Args:
        bag: open for reading.
        ids: objects; those that the bag knows nothing of get an empty list.

    Returns:
        By id. What came on an object's own topic counts as that object's, whatever it names.

    Raises:
        InputError: a message is damaged, or holds a number that stands for nothing.
    """
    topics = {absolute(state_topic(name)): name for name in ids}
    found: dict[str, list[ObjectState]] = {name: [] for name in topics.values()}
    for message in bag.messages([*topics, _ARRAYS]):
        for state in _states(bag, message):
            name = topics.get(message.topic, state.object_id)
            if name in found:
                found[name].append(state)
    return found


def _states(bag: BagReader, message: BagMessage) -> Iterator[ObjectState]:
    decoded = bag.decode(message)
    try:
        if message.topic == _ARRAYS:
            yield from map(object_state, decoded.states)
        else:
            yield object_state(decoded)
    except ValueError as error:
        raise InputError(
            f"holds a state at {message.log_time_ns} ns that is none: {error}",
            file=bag.path,
            field=message.topic,
        ) from error
