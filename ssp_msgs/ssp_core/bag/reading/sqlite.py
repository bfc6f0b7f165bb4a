"""Bags that rosbag2 stored in SQLite, read as those in MCAP are, so that they can be cut."""

from __future__ import annotations

import heapq
import sqlite3
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import quote

from ssp_core.bag.metadata import FILE_NAME, ROOT_KEY
from ssp_core.bag.reading.reader import BagReader, TopicInfo, numbered_files
from ssp_core.bag.types import CDR, MSG_ENCODING, BagMessage, TypeDefinition, definition
from ssp_core.errors import InputError
from ssp_core.files.reading import read_mapping

SUFFIX = ".db3"
Row = tuple[Any, ...]


def open_bag(path: Path) -> BagReader:
    """Open a bag of either storage for reading.

    Raises:
        InputError: as BagReader.
    """
    if path.is_file() and path.suffix == SUFFIX:
        return SqliteBag(path, (path,))
    if path.is_dir():
        if (path / FILE_NAME).is_file():
            information = read_mapping(path / FILE_NAME).get(ROOT_KEY)
            if isinstance(information, dict) and information.get("storage_identifier") == "sqlite3":
                return SqliteBag(path, _files(path, information))
        elif not any(path.glob("*.mcap")) and (files := numbered_files(path, SUFFIX)):
            # Its recorder ended before it wrote metadata.yaml; the files are whole all the same.
            return SqliteBag(path, files)
    return BagReader(path)


def _files(folder: Path, information: dict[str, Any]) -> tuple[Path, ...]:
    """Return the bag's files in order.

    Raises:
        InputError: metadata.yaml names none, or they are compressed.
    """
    names = information.get("relative_file_paths")
    if not isinstance(names, list) or not names or not all(isinstance(n, str) for n in names):
        raise InputError(
            "must list the bag's files",
            file=folder / FILE_NAME,
            field=f"{ROOT_KEY}.relative_file_paths",
            remedy="convert the bag to mcap with `ros2 bag convert`",
        )
    # Only the name counts: a bag reads no file outside its directory.
    files = tuple(folder / PurePosixPath(name).name for name in names)
    for file in files:
        if file.suffix != SUFFIX:
            raise InputError(
                "is compressed, which is not read here",
                file=file,
                remedy="convert the bag with `ros2 bag convert`",
            )
    return files


def _known_definition(empty_definition: TypeDefinition) -> TypeDefinition:
    """Return the definition of a type that the file doesn't define, where it is known."""
    try:
        return definition(empty_definition.msgtype)
    except InputError:
        return empty_definition


class SqliteBag(BagReader):
    """A bag of SQLite files, open for reading; it has neither attachments nor checksums.

    Raises:
        InputError: a file isn't there or is no SQLite file of rosbag2.
    """

    def __init__(self, path: Path, files: tuple[Path, ...]) -> None:
        self.path = path
        self.topics: dict[str, TopicInfo] = {}
        self.files = ()
        # Messages that SQLite hasn't moved into its file stand in the log beside it.
        logs = [file.with_name(f"{file.name}-wal") for file in files]
        self.stored = (*files, *(log for log in logs if log.is_file() and log.stat().st_size))
        self._parts = []
        self._definitions: dict[str, TypeDefinition] = {}
        self._ambiguous: dict[str, InputError] = {}
        self._invalid: dict[str, int] = {}  # messages without a time or data, by topic
        self._stores: list[sqlite3.Connection] = []
        self._span: list[int] = []
        for file in files:
            if not file.is_file():
                raise InputError("is not there", file=file, remedy="put the file back")
            with self._failures(file):
                # Of a file without a log beside it nothing is written, also on read-only media.
                is_whole = not file.with_name(f"{file.name}-wal").exists()
                where = f"file:{quote(str(file))}?mode=ro" + "&immutable=1" * is_whole
                self._stores.append(sqlite3.connect(where, uri=True))
                self._read(self._stores[-1], file)

    @contextmanager
    def _failures(self, file: Path) -> Iterator[None]:
        try:
            yield
        except sqlite3.Error as error:
            raise InputError(
                f"can't be read as SQLite: {error}",
                file=file,
                remedy="give a whole copy of the bag",
            ) from error

    def _read(self, store: sqlite3.Connection, file: Path) -> None:
        """Take the topics of a file."""
        columns = {row[1] for row in store.execute("PRAGMA table_info(topics)")}
        tables = {row[0] for row in store.execute("SELECT name FROM sqlite_master")}
        definition_rows: dict[str, Row] = {}
        if "message_definitions" in tables:
            definition_rows = {
                row[0]: row
                for row in store.execute(
                    "SELECT topic_type, COALESCE(encoding, ''), "
                    "COALESCE(encoded_message_definition, '') FROM message_definitions"
                )
            }
        # Which rosbag2 added one after the other.
        column_names = ("serialization_format", "offered_qos_profiles", "type_description_hash")
        expressions = ", ".join(
            f"COALESCE({name}, '')" if name in columns else "''" for name in column_names
        )
        counts = {
            number: (count, invalid)
            for number, count, invalid in store.execute(
                "SELECT topic_id, COUNT(*), SUM(typeof(timestamp) != 'integer' OR timestamp < 0 "
                "OR typeof(data) != 'blob') FROM messages GROUP BY topic_id"
            )
        }
        for number, name, kind, form, profiles, hashed in store.execute(
            f"SELECT id, name, type, {expressions} FROM topics"
        ):
            values = (name, kind, form, profiles, hashed)
            if not all(isinstance(value, str) for value in values):
                raise InputError(
                    "holds what isn't text",
                    file=file,
                    field=f"topics, id {number}",
                    value=values,
                    remedy="convert the bag to mcap with `ros2 bag convert`",
                )
            before = self.topics.get(name)
            count, invalid = counts.get(number, (0, 0))
            count += before.count if before else 0
            self.topics[name] = TopicInfo(kind, count, profiles, hashed)
            self._invalid[name] = self._invalid.get(name, 0) + invalid
            _, encoding, text = definition_rows.get(kind, (kind, "", ""))
            if not (isinstance(encoding, str) and isinstance(text, str)):
                self._ambiguous[name] = InputError(
                    "has a definition that isn't text",
                    file=file,
                    field=kind,
                    remedy="leave the topic out, or record the bag again",
                )
                encoding = text = ""
            type_definition = TypeDefinition(
                kind, encoding or MSG_ENCODING, text, hashed, form or CDR
            )
            self._definitions[name] = (
                type_definition if text.strip() else _known_definition(type_definition)
            )
        first, last = store.execute(
            "SELECT MIN(timestamp), MAX(timestamp) FROM messages "
            "WHERE typeof(timestamp) = 'integer'"
        ).fetchone()
        if first is not None:
            self._span += [first, last]

    @property
    def start_ns(self) -> int | None:
        """Earliest log time, None for a bag without messages."""
        return min(self._span, default=None)

    @property
    def end_ns(self) -> int | None:
        """Latest log time, None for a bag without messages."""
        return max(self._span, default=None)

    def messages(
        self,
        topics: Collection[str] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
    ) -> Iterator[BagMessage]:
        """Return the messages by log time; SQLite keeps no publish times or sequence numbers."""
        return heapq.merge(
            *(self._of(store, topics, start_ns, stop_ns) for store in self._stores),
            key=lambda message: message.log_time_ns,
        )

    def _of(
        self,
        store: sqlite3.Connection,
        topics: Collection[str] | None,
        start_ns: int | None,
        stop_ns: int | None,
    ) -> Iterator[BagMessage]:
        for name, invalid in self._invalid.items():
            if invalid and (topics is None or name in topics):
                raise InputError(
                    f"holds {invalid} messages whose time or data is none",
                    file=self.path,
                    field=name,
                    remedy="leave the topic out, or record the bag again",
                )
        with self._failures(self.path):
            topic_names = dict(store.execute("SELECT id, name FROM topics"))
            numbers = [
                int(k) for k, name in topic_names.items() if topics is None or name in topics
            ]
            rows = store.execute(
                "SELECT topic_id, timestamp, data FROM messages "
                f"WHERE topic_id IN ({', '.join(map(str, numbers))}) "
                "AND timestamp >= ? AND timestamp < ? ORDER BY timestamp, id",
                (start_ns or 0, 2**63 - 1 if stop_ns is None else stop_ns),
            )
            for number, at_ns, data in rows:
                yield BagMessage(topic_names[number], at_ns, at_ns, data, 0)

    def close(self) -> None:
        """End the reading."""
        for store in self._stores:
            store.close()
