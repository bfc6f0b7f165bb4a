"""The fields that an entry of log L needs: a time that can be ordered, person, subject, reason."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any, get_args

import pytest
from pydantic import ValidationError

from ssp_scenario_manager.event_spec.log import EntryKind, Record


def entry(**changes: Any) -> Record:
    given = {"kind": "edit", "when": "2025-03-01T09:30:00Z", "who": "A", "subject": "event cut_in"}
    return Record.model_validate({**given, "reason": "seen in frame 31", **changes})


@pytest.mark.parametrize("when", ["2025-03-01T09:30:00Z", "2025-03-01T09:30:00.250000+00:00"])
def test_a_time_in_utc_is_taken(when: str) -> None:
    assert entry(when=when).when == when


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("when", "yesterday"),
        ("when", "2025-03-01"),
        ("when", "2025-03-01T09:30:00"),
        ("when", "2025-03-01T09:30:00+02:00"),
        ("who", ""),
        ("subject", ""),
        ("reason", ""),
        ("kind", "whim"),
    ],
)
def test_anything_else_is_refused_by_its_field(field: str, value: str) -> None:
    with pytest.raises(ValidationError) as caught:
        entry(**{field: value})
    assert [error["loc"] for error in caught.value.errors()] == [(field,)]


def test_the_document_shows_entries_that_are_valid_and_every_kind() -> None:
    text = (Path(__file__).resolve().parents[3] / "docs" / "log.md").read_text()
    blocks = re.findall(r"```json\n(.*?)```", text, re.DOTALL)
    entries = [Record.model_validate(json.loads(line)) for b in blocks for line in b.splitlines()]
    assert entries
    kinds = re.findall(r"`(\w+)`", " ".join(re.findall(r"^\| (.*?) \|", text, re.MULTILINE)))
    assert set(get_args(EntryKind)) <= set(kinds)
