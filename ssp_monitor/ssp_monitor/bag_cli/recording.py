"""Tells people what a recorder said of its own recording (``recording.json`` in the bag)."""

from __future__ import annotations

from typing import Any

from ssp_core.bag.reader import BagReader
from ssp_core.errors import InputError
from ssp_core.files import parse_mapping
from ssp_monitor.core.report import REPORT_NAME, SCHEMA


def recording_report(bag: BagReader) -> dict[str, Any] | None:
    """The report in a bag, None when there is none or it is of another make.

    Raises:
        InputError: it is damaged.
    """
    data = bag.attachment(REPORT_NAME)
    if data is None:
        return None
    report = parse_mapping(data, f"{bag.path}:{REPORT_NAME}")
    return report if report.get("schema") == SCHEMA else None


def told(report: dict[str, Any]) -> list[str]:
    """The report in sentences: first whether anything is missing, then where.

    Raises:
        InputError: the report lacks what it must have.
    """
    try:
        lost, dropped = int(report["lost"]), int(report["dropped"])
        received, limit = int(report["received"]), int(report["lost_limit"])
        topics = [(str(t["name"]), int(t["lost"]), int(t["dropped"])) for t in report["topics"]]
        warnings = [str(warning) for warning in report["warnings"]]
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"is no report of a recording: {type(error).__name__} {error}", file=REPORT_NAME
        ) from error
    if not lost and not dropped:
        return [f"complete: {received} messages received, none lost, none dropped", *warnings]
    within = "within" if lost + dropped <= limit else "past"
    lines = [
        f"{lost} lost and {dropped} dropped of {received} received, {within} the limit of {limit}"
    ]
    lines += [
        f"{name}: {_missing(lost, dropped)}" for name, lost, dropped in topics if lost or dropped
    ]
    return [*lines, *warnings]


def _missing(lost: int, dropped: int) -> str:
    parts = [f"{lost} never received"] if lost else []
    parts += [f"{dropped} received and not written"] if dropped else []
    return ", ".join(parts)
