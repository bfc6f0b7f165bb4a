"""Probe reports: the file, and what is decided by it."""

from __future__ import annotations

import json
import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from ssp_core.errors import InputError
from ssp_core.run_file.model import Limits
from ssp_ot_controller.bodies.iso22133.probe.clauses import CLAUSES
from ssp_ot_controller.bodies.iso22133.probe_report import (
    CLOCK,
    NEEDED,
    START_TIME,
    STATE_AGE,
    STOP_ON_ABORT,
    STOP_ON_HEARTBEAT_LOSS,
    STOPS,
    TIMES,
    Outcome,
    ProbeReport,
    Row,
    Stage,
    cannot_arm,
    honours_start_time,
    load_report,
    stops_on_abort_s,
    stops_on_heartbeat_loss_s,
    write_report,
)

P, F, N = Outcome.PASS, Outcome.FAIL, Outcome.NOT_RUN


def row(clause: str, verdict: Outcome, measured: float | None, **changes: Any) -> Row:
    return Row(
        clause=clause,
        stage=Stage.MOVE,
        title="t",
        verdict=verdict,
        measured=measured,
        bound=1.0,
        unit="s",
        **changes,
    )


def report(*rows: Row, firmware: str | None = "1.2") -> ProbeReport:
    return ProbeReport(
        host="10.0.0.5",
        port=53241,
        firmware=firmware,
        started=datetime(2026, 11, 23, 10, 0, tzinfo=UTC),
        wire_version=2,
        stages=tuple(Stage),
        rows=rows,
    )


def limits(stop_reaction_s: float, **more: float) -> Limits:
    return Limits(speed_mps=15.0, acceleration_mps2=4.0, stop_reaction_s=stop_reaction_s, **more)


REST = (*(row(clause, P, 0.0) for clause in NEEDED), row("move.normal_stop", P, 0.2))
TIMELY = (row(STATE_AGE, P, 0.02), row(CLOCK, P, 0.0))
ABORT, LOSS = row(STOP_ON_ABORT, P, 0.25), row(STOP_ON_HEARTBEAT_LOSS, P, 0.5)
GOOD = (*REST, *TIMELY, ABORT, LOSS)


def test_a_report_is_read_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "report.json"
    written = report(*GOOD, row("x", F, None, sent=("7f7e",), came=("", "00ff"), text="why"))
    write_report(path, written)
    assert json.loads(path.read_text())["schema"] == "ssp.iso_probe/1"
    assert load_report(path) == written


@pytest.mark.parametrize(
    ("field", "value", "named"),
    [
        ("schema", "ssp.iso_probe/2", "schema"),
        ("port", 1, "port"),
        ("started", "2026-11-23T10:00:00", "started"),
        ("stages", ["fly"], r"stages\[0\]"),
        ("more", 1, "more"),
        ("rows", [{"clause": "x"}], r"rows\[0\]\.stage"),
        ("rows", [row("x", P, 1.0, sent=("7f",)).model_dump() | {"sent": ["7F"]}], "sent"),
        ("rows", [row("x", P, 1.0).model_dump() | {"verdict": "maybe"}], "verdict"),
    ],
)
def test_a_report_that_is_none_is_refused_by_its_field(
    tmp_path: Path, field: str, value: object, named: str
) -> None:
    content = report(*GOOD).model_dump(mode="json", by_alias=True) | {field: value}
    path = tmp_path / "report.json"
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=f"(?s)report.json: .*{named}"):
        load_report(path)


def test_what_was_measured_is_told() -> None:
    found = report(ABORT, LOSS, row(START_TIME, P, -0.002))
    assert (stops_on_abort_s(found), stops_on_heartbeat_loss_s(found)) == (0.25, 0.5)
    assert honours_start_time(found) == -0.002


@pytest.mark.parametrize("rows", [(), (row(STOP_ON_ABORT, N, 0.1), row(START_TIME, F, -0.29))])
def test_what_was_not_shown_is_none(rows: tuple[Row, ...]) -> None:
    found = report(*rows)
    assert stops_on_abort_s(found) is None
    assert stops_on_heartbeat_loss_s(found) is None
    assert honours_start_time(found) is None


@pytest.mark.parametrize("firmware", ["1.2", None])
def test_an_object_that_stops_may_be_armed(firmware: str | None) -> None:
    assert cannot_arm(report(*GOOD, firmware=firmware), limits(0.5), firmware, None) == ()


@pytest.mark.parametrize(
    ("found", "bound_s", "firmware", "why"),
    [
        (None, 1.0, "1.2", ["no probe report"]),
        (
            report(*GOOD),
            1.0,
            "1.3",
            ["firmware is 1.3, the probe report of 2026-11-23 is of 1.2"],
        ),
        (report(*GOOD), 1.0, None, ["firmware is unknown"]),
        (report(*GOOD, firmware=None), 1.0, "1.2", ["is of unknown"]),
        (report(*GOOD), 0.49, "1.2", ["0.500 s from lost heartbeats .* allows 0.49 s"]),
        (report(*GOOD), 0.24, "1.2", ["0.250 s from an abort", "0.500 s from lost heartbeats"]),
        (report(*REST, *TIMELY, ABORT), 1.0, "1.2", ["stops on lost heartbeats"]),
        (report(*REST, *TIMELY, LOSS), 1.0, "1.2", ["doesn't show that it stops on an abort"]),
        (
            report(*REST, *TIMELY, row(STOP_ON_ABORT, F, None), LOSS),
            1.0,
            "1.3",
            ["firmware is 1.3", r"doesn't show that it stops on an abort \(move.abort\)"],
        ),
    ],
)
def test_everything_that_keeps_an_object_from_being_armed_is_told_and_a_name_lets_it(
    found: ProbeReport | None, bound_s: float, firmware: str | None, why: list[str]
) -> None:
    told = cannot_arm(found, limits(bound_s), firmware, None)
    assert len(told) == len(why), told
    for text, pattern in zip(told, why, strict=True):
        assert re.search(pattern, text), text
    assert cannot_arm(found, limits(bound_s), firmware, " ") == told
    assert cannot_arm(found, limits(bound_s), firmware, "A. Person") == ()


@pytest.mark.parametrize("clause", [*NEEDED, *STOPS, *TIMES])
@pytest.mark.parametrize("verdict", [F, N, None])
def test_an_object_that_fails_any_clause_that_is_needed_is_not_armed(
    clause: str, verdict: Outcome | None
) -> None:
    kept = [one for one in GOOD if one.clause != clause]
    other = [] if verdict is None else [row(clause, verdict, None)]
    (told,) = cannot_arm(report(*kept, *other), limits(1.0), "1.2", None)
    assert f"({clause})" in told


def test_every_clause_of_the_stage_arm_is_needed_and_each_needed_clause_is_asked_for() -> None:
    asked = {clause.id for clause in CLAUSES}
    assert {one for one in asked if one.startswith("arm.")} <= set(NEEDED)
    assert {*NEEDED, *STOPS, *TIMES} <= asked


def test_the_limits_of_the_site_say_how_old_a_report_and_how_far_ahead_a_stamp_may_be() -> None:
    late = report(*REST, row(STATE_AGE, F, 0.4), row(CLOCK, F, 0.08), ABORT, LOSS)
    age, ahead = cannot_arm(late, limits(1.0), "1.2", None)
    assert re.search(r"0\.400 s, the age .* allows 0\.3 s \(move\.age\)", age)
    assert re.search(r"0\.080 s, stamps ahead .* allows 0\.05 s \(move\.clock\)", ahead)
    wide = limits(1.0, state_age_s=0.5, clock_offset_s=0.1)
    assert cannot_arm(late, wide, "1.2", None) == ()
