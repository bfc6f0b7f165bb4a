"""The verdict that lies in a bag's folder."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ssp_core.bag.seals.verdict import leave_verdict
from ssp_core.errors import InputError
from ssp_core.run_file.verdict import RecordedVerdict, read_verdict
from ssp_core.vocabulary import Verdict


@pytest.mark.parametrize("verdict", Verdict)
def test_what_was_written_is_read(tmp_path: Path, verdict: Verdict) -> None:
    assert read_verdict(tmp_path) is None
    leave_verdict(tmp_path, verdict, ["one", "two"], "monitor")
    assert read_verdict(tmp_path) == RecordedVerdict(verdict, ("one", "two"))
    leave_verdict(tmp_path, Verdict.VALID, [], "runner")
    assert read_verdict(tmp_path) == RecordedVerdict(Verdict.VALID, ())
    written = json.loads((tmp_path / "verdict.json").read_text())
    assert (written["schema"], written["told_by"]) == ("ssp.verdict/1", "runner")


@pytest.mark.parametrize(
    "text",
    [
        "[]",
        "{}",
        '{"schema": "ssp.verdict/1", "verdict": "fine", "reasons": []}',
        '{"schema": "ssp.verdict/2", "verdict": "valid", "reasons": []}',
        '{"schema": "ssp.verdict/1", "verdict": ["valid"], "reasons": []}',
        '{"schema": "ssp.verdict/1", "verdict": "valid", "reasons": "none"}',
    ],
)
def test_what_is_no_verdict(tmp_path: Path, text: str) -> None:
    (tmp_path / "verdict.json").write_text(text)
    with pytest.raises(InputError, match=r"verdict\.json"):
        read_verdict(tmp_path)
