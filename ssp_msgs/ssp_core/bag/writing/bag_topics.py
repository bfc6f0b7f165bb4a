"""The topics of one bag that is being written, the same in each of its files.

This file owns the numbers of channels and schemas: each is given once, and none is given back.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from mcap.records import Channel, Schema

from ssp_core.bag.metadata import TopicFacts, parse_offered_qos
from ssp_core.bag.types import TypeDefinition, definition
from ssp_core.bag.writing.latched import LateJoiner, late_joiner
from ssp_core.bag.writing.split import REPEATED

_MAX_IDS = (1 << 16) - 1


class TooMany(Exception):
    """The kind of thing that a file has no number left for: a topic, or a type."""


@dataclass(slots=True)
class WrittenTopic:
    """One topic.

    Args:
        latched: what later files repeat, None where nothing is.
        repeats: where later files put the repeated messages; made with the first of them.
    """

    channel: Channel
    schema: Schema
    latched: LateJoiner | None
    repeats: Channel | None = None


class BagTopics:
    """Topics by name, and the schemas of their types.

    Attributes:
        by_name: in the order in which they were added.
    """

    def __init__(self) -> None:
        self.by_name: dict[str, WrittenTopic] = {}
        self._schemas: dict[TypeDefinition, Schema] = {}
        self._channels = 0

    @property
    def schemas(self) -> Iterable[Schema]:
        """The schemas, in the order of their numbers."""
        return self._schemas.values()

    def add(
        self,
        topic: str,
        msgtype: str,
        offered_qos: str,
        type_definition: TypeDefinition | None,
        *,
        latched: bool,
    ) -> tuple[Channel, Schema | None]:
        """Add a topic; see ``BagWriter.add_topic``.

        Returns:
            Its channel, and its schema where no topic before has it.

        Raises:
            InputError: the type is not known and no definition was given.
            TooMany: there are more topics or types than a file has numbers for.
            ValueError: the topic was added before, or the QoS is no complete YAML list.
        """
        parse_offered_qos(offered_qos)
        type_definition = type_definition or definition(msgtype)
        if topic in self.by_name:
            raise ValueError(f"topic {topic} was added before")
        known_schema = self._schemas.get(type_definition)
        if not type_definition.msgtype:
            known_schema = Schema(0, b"", "", "")  # MCAP's way to say that a topic has no type
        if known_schema is None and len(self._schemas) == _MAX_IDS:
            raise TooMany("type")
        schema = known_schema or Schema(
            len(self._schemas) + 1, type_definition.data, type_definition.encoding, msgtype
        )
        metadata = {
            "offered_qos_profiles": offered_qos,
            "topic_type_hash": type_definition.type_hash,
        }
        channel = self._channel(topic, metadata, schema, type_definition.message_encoding)
        if known_schema is None:
            self._schemas[type_definition] = schema
        joiner = late_joiner(topic, msgtype, offered_qos, latched=latched)
        self.by_name[topic] = WrittenTopic(channel, schema, joiner)
        return channel, schema if known_schema is None else None

    def repeats_of(self, topic: WrittenTopic) -> Channel:
        """Return the channel of a topic's repeated messages.

        Raises:
            TooMany: there is no number left for it.
        """
        if topic.repeats is None:
            channel = topic.channel
            metadata = channel.metadata | REPEATED
            topic.repeats = self._channel(
                channel.topic, metadata, topic.schema, channel.message_encoding
            )
        return topic.repeats

    def _channel(
        self, topic: str, metadata: dict[str, str], schema: Schema, encoding: str
    ) -> Channel:
        if self._channels == _MAX_IDS:
            raise TooMany("topic")
        self._channels += 1
        return Channel(self._channels, topic, encoding, metadata, schema.id)

    def counts(self, by_channel: Mapping[int, int]) -> Counter[str]:
        """Count the messages of a file by topic, those that were repeated included.

        Args:
            by_channel: the file's messages by channel.
        """
        return Counter(
            {
                name: by_channel[topic.channel.id]
                + (by_channel[topic.repeats.id] if topic.repeats is not None else 0)
                for name, topic in self.by_name.items()
            }
        )

    def facts(self, counts: Mapping[str, int]) -> tuple[TopicFacts, ...]:
        """Return the facts of all topics, with their numbers of messages by name."""
        return tuple(
            TopicFacts(
                name,
                topic.schema.name,
                topic.channel.metadata["offered_qos_profiles"],
                topic.channel.metadata["topic_type_hash"],
                counts.get(name, 0),
                topic.channel.message_encoding,
            )
            for name, topic in self.by_name.items()
        )
