"""``recording.json`` in a bag (``ssp.recording/1``): what is in it, and exactly what is missing."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from ssp_core import __version__
from ssp_monitor.core.attachments import Attachment
from ssp_monitor.core.records import TopicRecord

REPORT_NAME = "recording.json"
SCHEMA = "ssp.recording/1"


@dataclass(frozen=True, slots=True)
class TopicReport:
    """One topic of a recording.

    Args:
        name: in the bag.
        type: in the bag.
        received: by the recorder; 0 for a topic that only the recorder itself writes.
        written: into the bag.
        bytes: written, message data only.
        lost: published and never received, as far as known.
        dropped: received and not written.
        first_ns: earliest log time, None without a message.
        last_ns: latest log time.
    """

    name: str
    type: str
    received: int
    written: int
    bytes: int
    lost: int
    dropped: int
    first_ns: int | None
    last_ns: int | None


def topic_reports(
    records: Iterable[TopicRecord],
    received: Mapping[str, int],
    lost: Mapping[str, int],
    dropped: Mapping[str, int],
) -> list[TopicReport]:
    """The counts of each topic side by side, in the order of the bag."""
    return [
        TopicReport(
            name=record.name,
            type=record.msgtype,
            received=received.get(record.name, 0),
            written=record.messages,
            bytes=record.bytes,
            lost=lost.get(record.name, 0),
            dropped=dropped.get(record.name, 0),
            first_ns=record.first_ns,
            last_ns=record.last_ns,
        )
        for record in records
    ]


def seals(attachments: Iterable[Attachment]) -> dict[str, str]:
    """Hash of each attachment by name, so that a bag says what was put into it."""
    return {name: f"sha256:{hashlib.sha256(data).hexdigest()}" for name, _, data in attachments}


def report_attachment(
    topics: Sequence[TopicReport],
    *,
    run_id: str | None,
    lost_limit: int,
    warnings: Sequence[str],
    sealed: Mapping[str, str],
) -> Attachment:
    """The report as it is put into the bag.

    Args:
        topics: in the order of the bag.
        run_id: of the run, None for a recording without one.
        lost_limit: lost and dropped messages that the run may have.
        warnings: sentences, in the order in which they were said.
        sealed: hashes of the other attachments.
    """
    value: dict[str, Any] = {
        "schema": SCHEMA,
        "recorder": f"ssp {__version__}",
        "run_id": run_id,
        "received": sum(topic.received for topic in topics),
        "written": sum(topic.written for topic in topics),
        "lost": sum(topic.lost for topic in topics),
        "dropped": sum(topic.dropped for topic in topics),
        "lost_limit": lost_limit,
        "warnings": list(warnings),
        "seals": dict(sealed),
        "topics": [asdict(topic) for topic in topics],
    }
    return REPORT_NAME, "application/json", (json.dumps(value, indent=1) + "\n").encode()
