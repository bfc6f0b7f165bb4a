"""The topics of a bag that is being written, with their channels, schemas and counts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from mcap.records import Channel, Schema

from ssp_core.bag.metadata import TopicFacts
from ssp_core.bag.split import REPEATED, LatchedTopic
from ssp_core.bag.types import TypeDefinition
from ssp_core.errors import InputError

_MAX_IDS = (1 << 16) - 1


@dataclass(slots=True)
class WrittenTopic:
    """One topic.

    Args:
        channel: of its messages.
        schema: of its type.
        latched: what later files repeat, None where nothing is.
        repeats: where later files put the repeated messages; made with the first of them.
    """

    channel: Channel
    schema: Schema
    latched: LatchedTopic | None
    repeats: Channel | None = None


class WrittenTopics:
    """All topics of a bag, the same in each of its files."""

    def __init__(self) -> None:
        self.by_name: dict[str, WrittenTopic] = {}
        self.schemas: dict[TypeDefinition, Schema] = {}
        self._channels = 0

    def add(
        self,
        topic: str,
        msgtype: str,
        offered_qos: str,
        written: TypeDefinition,
        *,
        latched: bool,
        file: Path,
    ) -> tuple[Schema | None, Channel]:
        """Takes a topic up.

        Args:
            topic: absolute name.
            msgtype: full type name.
            offered_qos: YAML, or empty.
            written: the definition that the file gets.
            latched: later files repeat its newest messages.
            file: that is being written, for messages.

        Returns:
            What a file has to be told: the schema, None where it knows it, and the channel.

        Raises:
            InputError: there are more topics or types than a file has numbers for.
            ValueError: the topic was added before.
        """
        if topic in self.by_name:
            raise ValueError(f"topic {topic} was added before")
        known = self.schemas.get(written)
        if known is None and len(self.schemas) == _MAX_IDS:
            raise InputError("is one type too many", file=file, field=topic)
        schema = known or Schema(
            len(self.schemas) + 1, written.text.encode(), written.encoding, msgtype
        )
        metadata = {"offered_qos_profiles": offered_qos, "topic_type_hash": written.type_hash}
        channel = self._channel(topic, metadata, schema, file)
        self.schemas[written] = schema
        kept = LatchedTopic(offered_qos) if latched else None
        self.by_name[topic] = WrittenTopic(channel, schema, kept)
        return (schema if known is None else None), channel

    def repeats_of(self, topic: str, *, file: Path) -> Channel:
        """The channel of a latched topic's repeated messages.

        Raises:
            InputError: a file has no number left for it.
        """
        entry = self.by_name[topic]
        if entry.repeats is None:
            entry.repeats = self._channel(
                topic, entry.channel.metadata | REPEATED, entry.schema, file
            )
        return entry.repeats

    def counts(self, by_channel: Mapping[int, int]) -> Counter[str]:
        """Messages by topic, those that were repeated included, from messages by channel."""
        return Counter(
            {
                name: by_channel.get(topic.channel.id, 0)
                + (by_channel.get(topic.repeats.id, 0) if topic.repeats is not None else 0)
                for name, topic in self.by_name.items()
            }
        )

    def facts(self, counts: Mapping[str, int]) -> tuple[TopicFacts, ...]:
        """What the bag's metadata says of the topics, with these numbers of messages."""
        return tuple(
            TopicFacts(
                name,
                topic.schema.name,
                topic.channel.metadata["offered_qos_profiles"],
                topic.channel.metadata["topic_type_hash"],
                counts.get(name, 0),
            )
            for name, topic in self.by_name.items()
        )

    def _channel(self, topic: str, metadata: dict[str, str], schema: Schema, file: Path) -> Channel:
        if self._channels == _MAX_IDS:
            raise InputError("is one topic too many", file=file, field=topic)
        self._channels += 1
        return Channel(self._channels, topic, "cdr", metadata, schema.id)
