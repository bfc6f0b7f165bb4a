"""Changes on site that were forgotten: an entry beside a recording counts, and is reported."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from ssp_core.bag.reading.reader import BagReader
from ssp_core.cli import main
from ssp_core.files.reading import parse_mapping, parse_model
from ssp_core.run_file.model import RunSpec
from ssp_eval.audit.evidence.recording import (
    BagAttachments,
    disclosed,
    read_attached,
    read_recording,
    site_changes,
)
from ssp_eval.audit.examine import examine
from ssp_eval.audit.judge import disclosures, order_remark
from ssp_scenario_manager.compile.compiler import LOGGED_AS
from ssp_scenario_manager.event_spec.log import Record

Maker = Callable[..., Path]
FIELD = "limits.speed_mps"


@pytest.fixture
def run(make_task: Maker, make_bag: Maker) -> Path:
    """A run whose speed limit was lowered without a word."""
    task = make_task("run/task")
    value = json.loads((task / "run.yaml").read_text())
    value["limits"]["speed_mps"] = 12.0
    (task / "run.yaml").write_text(json.dumps(value))
    return make_bag("run/bag", task=task, duration_s=0.1).parent


def read(run: Path) -> tuple[BagAttachments, RunSpec]:
    with BagReader(run / "bag") as bag:
        executed = parse_mapping(bag.attachment("run.yaml") or b"", "run.yaml")
        return read_attached(bag), parse_model(RunSpec, executed, "run.yaml")


def log(run: Path, *more: str) -> int:
    return main(
        [
            "package",
            "log-change",
            str(run),
            "--field",
            FIELD,
            "--old",
            "20",
            "--new",
            "12",
            "--who",
            "A. Engineer",
            "--reason",
            "wet road",
            *more,
        ]
    )


def test_a_change_that_nobody_entered_is_found(run: Path) -> None:
    entries, findings = site_changes(*read(run))
    assert [(e.field, e.logged, e.later) for e in entries] == [(FIELD, False, False)]
    assert [finding.code for finding in findings] == ["unlogged_change"]


def test_a_later_entry_explains_it_and_is_told(run: Path) -> None:
    assert log(run) == 0
    attached, executed = read(run)
    entries, findings = site_changes(attached, executed)
    assert findings == []
    assert attached.findings == ()
    (entry,) = entries
    assert (entry.field, entry.logged, entry.later, entry.who) == (FIELD, True, True, "A. Engineer")
    assert disclosed(attached) == {
        FIELD: "changed on site, entered after the run by A. Engineer: wet road"
    }


def test_an_entry_before_the_run_is_not_later(make_task: Maker, make_bag: Maker) -> None:
    task = make_task("run/task")
    assert log(task) == 0
    value = json.loads((task / "run.yaml").read_text())
    value["limits"]["speed_mps"] = 12.0
    (task / "run.yaml").write_text(json.dumps(value))
    attached, executed = read(make_bag("run/bag", task=task, duration_s=0.1).parent)
    entries, findings = site_changes(attached, executed)
    assert findings == []
    assert [entry.later for entry in entries] == [False]
    assert disclosed(attached) == {}


def test_it_is_found_for_the_file_in_the_bag_too(run: Path) -> None:
    assert log(run) == 0
    (file,) = (run / "bag").glob("*.mcap")
    with BagReader(file) as bag:
        assert len(read_attached(bag).later) == 1


def test_a_log_that_was_rewritten_is_a_broken_seal(run: Path) -> None:
    assert log(run) == 0
    path = run / "task" / "log.jsonl"
    path.write_text(path.read_text().replace("middle of the range", "a whim"))
    attached, executed = read(run)
    assert [finding.code for finding in attached.findings] == ["seal_broken"]
    assert "does not begin with the log in the bag" in attached.findings[0].detail
    assert [e.logged for e in site_changes(attached, executed)[0]] == [False]


def entry(when: str, who: str = "A. Engineer") -> Record:
    return Record.model_validate(
        {
            "kind": "site_change",
            "when": when,
            "who": who,
            "subject": "task",
            "field": FIELD,
            "old": 20,
            "new": 12,
            "reason": "wet",
        }
    )


def test_an_entry_older_than_the_one_above_it_is_remarked() -> None:
    log = [
        entry("2025-03-01T09:30:00Z"),
        entry("2025-03-01T09:30:00+00:00"),
        entry("2025-03-01T09:29:59.5Z", "B"),
        entry("2025-03-01T09:29:59.8Z", "C"),
        entry("2025-03-01T10:00:00Z"),
    ]
    assert order_remark(log) == {
        "times in the log": f"entry 3 ({FIELD}, B) says 2025-03-01T09:29:59.5Z, and one above it "
        f"2025-03-01T09:30:00Z; entry 4 ({FIELD}, C) says 2025-03-01T09:29:59.8Z, and one above it "
        "2025-03-01T09:30:00Z"
    }


def test_the_compiler_s_fixed_time_is_no_disorder() -> None:
    fixed = "1970-01-01T00:00:00Z"
    chosen = entry("2025-03-01T09:30:00Z")
    assert order_remark([entry(fixed, LOGGED_AS), chosen, entry(fixed, LOGGED_AS)]) == {}
    assert order_remark([chosen, entry(fixed, LOGGED_AS), entry("2025-03-01T09:00:00Z")]) != {}
    assert order_remark([]) == {}


def test_the_audit_tells_of_an_entry_that_was_dated_back(run: Path) -> None:
    assert log(run, "--when", "2025-03-01T10:00:00Z") == 0
    text = (run / "task" / "log.jsonl").read_text()
    with (run / "task" / "log.jsonl").open("a") as stream:
        stream.write(text.splitlines()[-1].replace("T10:", "T09:") + "\n")
    found = disclosures(examine(read_recording(run), None, None))
    assert "T09:00:00Z, and one above it 2025-03-01T10:00:00Z" in found["times in the log"]
