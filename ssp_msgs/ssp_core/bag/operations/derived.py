"""The beginning of a bag that is derived from another: shared topics, and its origin."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from ssp_core.bag.metadata import is_latched, usable_qos
from ssp_core.bag.reading.mcap_file import McapFile
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.seals.seal import REPORT_NAME, source_of
from ssp_core.bag.writing.writer import BagWriter

# Of the recorder, on what it received: a bag that is made of another one was recorded by nobody.
_LEFT_OUT = frozenset({REPORT_NAME})


def begin_derived(
    writer: BagWriter,
    source: BagReader,
    identity: Mapping[str, bytes],
    *,
    but: Collection[str] = (),
    types: Mapping[str, str] | None = None,
) -> None:
    """Name the source, copy its attachments, and announce its topics.

    Args:
        writer: of the new bag, to which nothing was written yet.
        source: the bag that the new one is derived from.
        identity: further attachments as JSON, by name, that say what the new bag is.
        but: topics that it hasn't.
        types: of topics whose type differs there.
    """
    writer.add_sources(source_of(source))
    for file in source.files:
        part = McapFile(file)
        for index in part.summary.attachment_indexes:
            data = part.attachment(index.name)
            if data is not None and index.name not in _LEFT_OUT:
                writer.attach(index.name, data, index.media_type)
    for name, data in identity.items():
        writer.attach(name, data, "application/json")
    for name, info in source.topics.items():
        if name in but:
            continue
        msgtype = (types or {}).get(name, info.msgtype)
        definition = source.definition(name) if msgtype == info.msgtype else None
        qos, latched = usable_qos(info.offered_qos), is_latched(info.offered_qos)
        writer.add_topic(name, msgtype, qos, written=definition, latched=latched)
