"""The event under review and its log: each decision is on the disk before the next question."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from ssp_core.errors import InputError
from ssp_core.files import write_text
from ssp_core.hashing import sha256_bytes
from ssp_scenario_manager.spec.load import event_version, load_event
from ssp_scenario_manager.spec.log import Kind, Record
from ssp_scenario_manager.spec.log_file import append_records
from ssp_scenario_manager.spec.model import Event
from ssp_scenario_manager.spec.write import event_text


class Desk:
    """One file under review.

    The log is written first: should the machine die between the two, the log knows of a decision
    that the file lacks, and the field is asked about again.

    Args:
        path: of the event.
        log: of its log.
        who: decides.
        now: time in ISO 8601 UTC.

    Raises:
        InputError: the file is no event.
    """

    def __init__(self, path: Path, log: Path, who: str, now: Callable[[], str]) -> None:
        self.path, self.log, self.who = path, log, who
        self._now = now
        self.event, self.version = load_event(str(path))
        self._on_disk = sha256_bytes(path.read_bytes())

    def record(
        self,
        kind: Kind,
        reason: str,
        field: str | None = None,
        old: Any = None,
        new: Any = None,
        **details: Any,
    ) -> Record:
        """An entry of L about the event as it stands."""
        return Record(
            kind=kind,
            when=self._now(),
            who=self.who,
            subject=self.event.name,
            version=self.version,
            field=field,
            old=old,
            new=new,
            reason=reason,
            details=details,
        )

    def note(self, record: Record) -> None:
        """Appends an entry that changes nothing in the file."""
        append_records(self.log, [record])

    def decide(self, after: Event, records: Iterable[Record]) -> None:
        """Appends the entries, then writes the event as decided.

        Raises:
            InputError: the file was changed by somebody else meanwhile; nothing is written.
        """
        if sha256_bytes(self.path.read_bytes()) != self._on_disk:
            raise InputError(
                "was changed by somebody else during the review",
                file=self.path,
                remedy="start the review again; what was decided before is kept",
            )
        version = event_version(after)
        append_records(
            self.log,
            [
                record.model_copy(update={"details": {**record.details, "version_after": version}})
                for record in records
            ],
        )
        text = event_text(after)
        write_text(self.path, text)
        self.event, self.version = after, version
        self._on_disk = sha256_bytes(text.encode())
