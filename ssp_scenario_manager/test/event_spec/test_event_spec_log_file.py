"""The log L on disk: appended whole, read back, and what it says about a refused clip."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.errors import InputError
from ssp_scenario_manager.event_spec.log import (
    Record,
    append_record,
    append_records,
    check_not_refused,
    log_path,
    read_log,
    record_line,
    refusal,
)

WHEN = "2025-01-01T00:00:00Z"

values: st.SearchStrategy[Any] = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(10**9), 10**9)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(alphabet=st.characters(codec="utf-8")),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.text(alphabet=st.characters(codec="utf-8")), inner, max_size=3)
    ),
    max_leaves=6,
)


def entry(kind: Any = "edit", **changes: Any) -> Record:
    given = {"kind": kind, "when": WHEN, "who": "A. Author", "subject": "cut_in", "reason": "r"}
    return Record.model_validate({**given, **changes})


@settings(max_examples=60)
@given(st.lists(st.tuples(values, st.text(alphabet=st.characters(codec="utf-8"), min_size=1))))
def test_what_is_appended_is_read_back(
    tmp_path_factory: pytest.TempPathFactory, given_records: list[tuple[Any, str]]
) -> None:
    path = tmp_path_factory.mktemp("log") / "a.log.jsonl"
    records = [entry(old=value, reason=text) for value, text in given_records]
    for record in records:
        append_record(path, record)
    assert read_log(path) == records


def test_a_line_is_one_line_and_keeps_what_stands(tmp_path: Path) -> None:
    path = tmp_path / "a.log.jsonl"
    append_record(path, entry(reason="two\nlines\u2028here"))
    before = path.read_bytes()
    append_records(path, [entry(), entry()])
    assert path.read_bytes().startswith(before)
    assert path.read_bytes().count(b"\n") == 3
    assert read_log(path)[0].reason == "two\nlines\u2028here"


def test_no_log_has_no_records(tmp_path: Path) -> None:
    assert read_log(tmp_path / "none.log.jsonl") == []


def test_a_torn_last_line_is_not_written_after(tmp_path: Path) -> None:
    path = tmp_path / "a.log.jsonl"
    path.write_text(record_line(entry())[:40])
    with pytest.raises(InputError, match="middle of a record"):
        append_record(path, entry())
    assert path.read_text() == record_line(entry())[:40]


def test_a_nan_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    path = tmp_path / "a.log.jsonl"
    with pytest.raises(ValueError, match="finite numbers"):
        append_record(path, entry(new=float("nan")))
    assert not path.exists()


def test_a_log_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.log.jsonl").mkdir()
    with pytest.raises(InputError, match=r"a\.log\.jsonl: can't be written"):
        append_record(tmp_path / "a.log.jsonl", entry())


@pytest.mark.parametrize(
    ("line", "what"),
    [
        ("{", "is no JSON"),
        ("[]", "valid dictionary"),
        (record_line(entry()).replace('"old": null', '"old": NaN'), "no number"),
        (record_line(entry()).replace('"edit"', '"whim"'), "kind"),
        (record_line(entry()).replace('"who"', '"whose"'), "who"),
        ("[" * 100_000, "is no JSON"),
        (r'{"who": "\ud800"}', "no character"),
        (json.dumps({"schema": "ssp.log/2"}), "schema"),
    ],
)
def test_a_line_that_is_no_record_is_located(tmp_path: Path, line: str, what: str) -> None:
    path = tmp_path / "a.log.jsonl"
    path.write_text(record_line(entry()) + "\n\n" + line + "\n")
    with pytest.raises(InputError, match=what) as caught:
        read_log(path)
    assert caught.value.line == 3
    assert caught.value.file == str(path)


@pytest.mark.parametrize(
    ("subject", "log"),
    [
        ("a/cut_in.event.yaml", "a/cut_in.log.jsonl"),
        ("a/cut_in.candidate.yaml", "a/cut_in.log.jsonl"),
        ("labels.json", "labels.log.jsonl"),
        ("task/event.yaml", "task/log.jsonl"),
        ("odd.name.yaml", "odd.name.log.jsonl"),
    ],
)
def test_where_a_log_stands(subject: str, log: str) -> None:
    assert log_path(subject) == Path(log)


def source(sha256: str, start_s: float) -> Record:
    return entry("source", details={"sha256": sha256, "crop": {"start_s": start_s, "end_s": 9.0}})


GATE = entry("gate", reason="identity drift")


@pytest.mark.parametrize(
    ("records", "refused"),
    [
        ([], False),
        ([source("a", 0)], False),
        ([source("a", 0), GATE], True),
        ([source("a", 0), GATE, entry("edit")], True),
        ([source("a", 0), GATE, source("a", 0)], True),
        ([source("a", 0), GATE, source("a", 1)], False),
        ([source("a", 0), GATE, source("b", 0)], False),
        ([GATE], True),
        ([source("a", 0), entry("gate", subject="other")], False),
        ([source("a", 0), GATE, source("b", 0).model_copy(update={"subject": "other"})], True),
    ],
)
def test_a_refusal_is_about_the_clip(records: list[Record], refused: bool) -> None:
    assert (refusal(records, "cut_in") is GATE) is refused


def test_a_refused_clip_is_refused_from_the_log_beside_the_file(tmp_path: Path) -> None:
    event = tmp_path / "cut_in.event.yaml"
    check_not_refused(event, "cut_in")
    append_record(log_path(event), GATE)
    check_not_refused(event, "cut_in", tmp_path / "other.jsonl")
    with pytest.raises(InputError, match=r"refused by A\. Author on .*: identity drift"):
        check_not_refused(event, "cut_in")
