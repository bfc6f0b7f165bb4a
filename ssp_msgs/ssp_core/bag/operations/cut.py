"""Cutting a span of time and some topics out of a bag, so that the rest stays readable."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from ssp_core.bag.metadata import is_latched, usable_qos
from ssp_core.bag.pictures.frames import keyframe_before
from ssp_core.bag.reading.mcap_file import McapFile
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.reading.sqlite import open_bag
from ssp_core.bag.seals.seal import source_of
from ssp_core.bag.types import BagMessage
from ssp_core.bag.writing.chain import Maker
from ssp_core.bag.writing.latched import LatchedMessage, late_joiner
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.cdr.images import VIDEO_TYPE
from ssp_core.files.folders import new_folder
from ssp_core.names import SESSION_STATE, absolute
from ssp_core.run_file.verdict import VERDICT_FILE

_SESSION = absolute(SESSION_STATE)


@dataclass(slots=True)
class CutReport:
    """The content of a cut.

    Args:
        messages: written, by topic.
        repeated: of these, latched ones from before the span, by topic.
        led_in: of these, frames of video from the keyframe before the span on, by topic.
        start_ns: first log time in the new bag, None when it is empty.
    """

    messages: dict[str, int]
    repeated: dict[str, int] = field(default_factory=dict)
    led_in: dict[str, int] = field(default_factory=dict)
    attachments: list[str] = field(default_factory=list)
    start_ns: int | None = None
    end_ns: int | None = None

    @property
    def count(self) -> int:
        return sum(self.messages.values())


def cut_bag(
    source: Path,
    target: Path,
    topics: Iterable[str],
    start_ns: int | None = None,
    stop_ns: int | None = None,
    advance: Callable[[int], None] = lambda _: None,
) -> CutReport:
    """Write a new bag with the messages of a span; the source stays as it is.

    Types, quality of service, times, sequence numbers and attachments are kept. Of latched topics
    the messages that were valid when the span begins are written too, at its beginning and with
    the publish time they had; static transforms are merged, whatever their QoS says. Of video the
    frames from the keyframe before the span on are kept, at their own times, so that its first
    picture can be decoded. Of a session the last word on its state stands at the end of the span,
    and verdict.json goes with the bag: a part keeps the verdict of the whole. The new bag names the
    source with its seal. The target is whole or not there.

    Args:
        source: bag directory, .mcap or .db3 file.
        target: directory of the new bag; must not exist.
        topics: to keep; names that the bag doesn't have give nothing.
        start_ns: first log time, None: of the bag.
        stop_ns: the first log time that is left out, None: there is none.
        advance: called with the number of messages written since the last call.

    Raises:
        InputError: the source is no closed bag, is damaged or isn't what was sealed, or the target
            exists.
        HostError: the disk doesn't take it.
    """
    with open_bag(source) as bag, new_folder(target) as folder:
        topic_names = [name for name in bag.topics if name in frozenset(topics)]
        with BagWriter(folder, name=f"{target.name}_0", maker=Maker.CUT) as writer:
            writer.add_sources(source_of(bag))
            cut = _Cut(bag, writer, topic_names, advance)
            cut.copy(start_ns, stop_ns)
        verdict_file = (source if source.is_dir() else source.parent) / VERDICT_FILE
        if verdict_file.is_file():
            shutil.copyfile(verdict_file, folder / VERDICT_FILE)
    return cut.report


class _Cut:
    def __init__(
        self, bag: BagReader, writer: BagWriter, topics: list[str], advance: Callable[[int], None]
    ) -> None:
        self._bag, self._writer, self._topics = bag, writer, topics
        self._advance = advance
        self.report = CutReport(dict.fromkeys(topics, 0))

    def copy(self, start_ns: int | None, stop_ns: int | None) -> None:
        """Copy attachments, topics and what leads in, then the span itself."""
        self._attach()
        for name in self._topics:
            info = self._bag.topics[name]
            self._writer.add_topic(
                name,
                info.msgtype,
                usable_qos(info.offered_qos),
                written=self._bag.definition(name),
                latched=is_latched(info.offered_qos),
            )
        if start_ns is not None:
            self._before(start_ns)
        for message in self._bag.messages(self._topics, start_ns, stop_ns):
            self._write(message)
        if stop_ns is not None and _SESSION in self._topics:
            self._last_word(stop_ns)

    def _last_word(self, stop_ns: int) -> None:
        """Keep the message that says how the session ended, if it came after the span."""
        last = None
        for message in self._bag.messages([_SESSION], stop_ns):
            last = message
        if last is not None:
            end_ns = self.report.end_ns
            last = last._replace(log_time_ns=stop_ns - 1 if end_ns is None else end_ns)
            self._write(last)

    def _attach(self) -> None:
        for path in self._bag.files:
            file = McapFile(path)
            for index in file.summary.attachment_indexes:
                if index.name not in self.report.attachments:
                    data = file.attachment(index.name) or b""
                    self._writer.attach(index.name, data, index.media_type)
                    self.report.attachments.append(index.name)

    def _before(self, start_ns: int) -> None:
        """Keep the messages from before the span that a reader must know, at times that rise."""
        videos = [t for t in self._topics if self._bag.topics[t].msgtype == VIDEO_TYPE]
        keys = {topic: keyframe_before(self._bag, topic, start_ns) for topic in videos}
        since = {topic: key_ns for topic, key_ns in keys.items() if key_ns is not None}
        begin_ns = min([start_ns, *since.values()])
        for message in self._latched(start_ns):
            self._write(message._replace(log_time_ns=begin_ns), self.report.repeated)
        if begin_ns < start_ns:
            for message in self._bag.messages(list(since), begin_ns, start_ns):
                if message.log_time_ns >= since[message.topic]:
                    self._write(message, self.report.led_in)

    def _latched(self, start_ns: int) -> Iterator[BagMessage]:
        """Yield the messages that a late joiner would get at that time, topic by topic."""
        topics = self._bag.topics
        late_joiners = {
            topic: one
            for topic in self._topics
            if (one := late_joiner(topic, topics[topic].msgtype, topics[topic].offered_qos))
        }
        begin_ns = self._bag.start_ns
        if not late_joiners or begin_ns is None or begin_ns >= start_ns:
            return
        for topic, _, publish_time_ns, data, sequence in self._bag.messages(
            list(late_joiners), None, start_ns
        ):
            late_joiners[topic].keep(LatchedMessage(data, publish_time_ns, sequence))
        for topic, latched in late_joiners.items():
            for data, publish_time_ns, sequence in latched.messages:
                yield BagMessage(topic, start_ns, publish_time_ns, data, sequence)

    def _write(self, message: BagMessage, besides: dict[str, int] | None = None) -> None:
        """Write a message and count it, among others where it is not of the span itself."""
        self._writer.write_all([message])
        topic, report = message.topic, self.report
        report.messages[topic] += 1
        if besides is not None:
            besides[topic] = besides.get(topic, 0) + 1
        if report.start_ns is None:
            report.start_ns = message.log_time_ns
        report.end_ns = message.log_time_ns
        self._advance(1)
