"""Log L merged from its parts."""

from __future__ import annotations

import json

from hypothesis import given
from hypothesis import strategies as st

from ssp_eval.package.log import merged_log
from ssp_scenario_manager.event_spec.log import Record, record_line


def entry_of(when: str, reason: str) -> Record:
    return Record.model_validate(
        {"kind": "disclosure", "when": when, "who": "A", "subject": "site x", "reason": reason}
    )


def log_text(*entries: Record) -> str:
    return "".join(record_line(entry) + "\n" for entry in entries)


def reasons(merged: str) -> list[str]:
    return [json.loads(line)["record"]["reason"] for line in merged.splitlines()]


def test_a_log_is_merged_by_time_and_each_entry_given_once() -> None:
    a, b, c = (entry_of(f"2025-03-01T0{n}:00:00Z", name) for n, name in enumerate("abc"))
    merged = merged_log([("y", log_text(a, c)), ("x", log_text(a, b, b))])
    assert reasons(merged) == ["a", "b", "b", "c"]
    first = json.loads(merged.splitlines()[0])
    assert first["origins"] == [{"path": "x", "entry": 1}, {"path": "y", "entry": 1}]


def test_a_part_keeps_its_order_whatever_its_clock_said() -> None:
    early, late = entry_of("2025-03-01T01:00:00Z", "second"), entry_of("2025-03-01T09:00:00Z", "1")
    other = entry_of("2025-03-01T05:00:00+00:00", "other")
    merged = merged_log([("x", log_text(late, early)), ("y", log_text(other))])
    assert reasons(merged) == ["other", "1", "second"]


@given(st.lists(st.lists(st.integers(0, 5), max_size=6), max_size=4))
def test_no_entry_is_lost_or_made_up(parts: list[list[int]]) -> None:
    texts = [
        (str(n), log_text(*(entry_of(f"2025-03-01T0{k}:00:00Z", str(k)) for k in part)))
        for n, part in enumerate(parts)
    ]
    found = reasons(merged_log(texts))
    for k in range(6):
        assert found.count(str(k)) == max((part.count(k) for part in parts), default=0)
