"""Types of a bag's topics, made of its own definitions once each."""

from __future__ import annotations

from pathlib import Path

from rosbags.typesys.store import Typestore

from ssp_core.bag.types import TypeDefinition, store_from
from ssp_core.errors import InputError


class Stores:
    """The store of each topic's type.

    A definition takes time in proportion to its length, so it is parsed once: topics that share
    it share the store, and one that can't be used isn't tried again with each message.

    Args:
        path: the bag, for messages.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._by_topic: dict[str, Typestore] = {}
        self._by_definition: dict[TypeDefinition, Typestore | InputError] = {}

    def of(self, topic: str, written: TypeDefinition) -> Typestore:
        """Raises InputError when the definition can't be used."""
        store = self._by_topic.get(topic)
        if store is not None:
            return store
        found = self._by_definition.get(written)
        if found is None:
            try:
                found = store_from(written)
            except InputError as error:
                found = error
            self._by_definition[written] = found
        if isinstance(found, InputError):
            raise InputError(
                found.problem,
                file=self._path,
                field=found.field,
                value=found.value,
                remedy=found.remedy,
            )
        self._by_topic[topic] = found
        return found
