"""Entries of a log that say they are older than what was entered before them."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime

from ssp_scenario_manager.compile.records import COMPILER
from ssp_scenario_manager.spec.log import Record


def order_remark(records: Iterable[Record]) -> dict[str, str]:
    """A remark on entries that are older by their own words than one that stands above them.

    A log is only appended to, so such a time was typed wrongly, or a clock was. The compiler's
    entries carry a fixed time (docs/log.md) and are not judged.

    Args:
        records: one log, in the order in which its entries were appended.

    Returns:
        Empty, or one text under ``times in the log``.
    """
    newest: Record | None = None
    found = []
    for number, record in enumerate(records, start=1):
        if newest is not None and _time(record) < _time(newest) and record.who != COMPILER:
            found.append(
                f"entry {number} ({record.field or record.kind}, {record.who}) says "
                f"{record.when}, and one above it {newest.when}"
            )
        if newest is None or _time(record) > _time(newest):
            newest = record
    return {"times in the log": "; ".join(found)} if found else {}


def _time(record: Record) -> datetime:
    return datetime.fromisoformat(record.when)
