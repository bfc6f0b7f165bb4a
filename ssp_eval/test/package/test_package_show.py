"""Walking a score back to K* through an evidence package."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ssp_core.cli import main
from ssp_eval.package.cli import _notes
from ssp_eval.package.model import load_table, object_path

MODEL = "constant_velocity"


CELL = f"demo/cells/cut_in__simulation__{MODEL}"


def test_a_score_is_walked_back_to_the_event(
    made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = f"cut_in__physical__{MODEL}"
    assert main(["package", "show", str(made), f"{cell}:3", "--json"]) == 0
    steps = json.loads(capsys.readouterr().out)["steps"]
    kinds = list(dict.fromkeys(step["what"] for step in steps))
    assert kinds == [
        "score",
        "evidence",
        "raw output",
        "request",
        "frame sent",
        "recording",
        "compiled task",
        "K*",
        "labels",
        "audit",
    ]
    by_kind = {step["what"]: step for step in steps}
    assert by_kind["recording"]["says"] == [
        "physical is a software stand-in, not a vehicle: a simulated world (lockstep)"
    ]
    (version,) = {k.hash for k in load_table(made).links if k.kind == "event_version"}
    assert by_kind["K*"]["sha256"] == version
    assert by_kind["compiled task"]["path"] == "demo/runs/cut_in-physical/task/task.json"
    assert any("lon_action: maintain, by [" in line for line in by_kind["evidence"]["says"])
    assert main(["package", "show", str(made), f"cut_in__synthetic__{MODEL}:0"]) == 0
    assert "source video: demo/clips/cut_in.avi" in capsys.readouterr().out


def test_a_cell_means_all_its_scores(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["package", "show", str(made), f"cut_in__physical__{MODEL}", "--json"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 9
    assert main(["package", "show", str(made)]) == 0
    assert f"cut_in__physical__{MODEL}: 9 scores" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("score", "message"),
    [
        ("nothing:1", "is no cell of the package"),
        (f"cut_in__physical__{MODEL}:9", "has no score for label 9"),
        (f"cut_in__physical__{MODEL}:x", "is no label"),
        (f"cut_in__physical__{MODEL}:-1", "is no label"),
    ],
)
def test_a_score_that_is_not_there(
    score: str, message: str, made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["package", "show", str(made), score]) == 1
    assert message in capsys.readouterr().err


def test_a_walk_over_a_changed_file_is_refused(
    package: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    entry = next(e for e in load_table(package).files if e.path == f"{CELL}/raw.jsonl")
    object_path(package, entry.sha256).write_bytes(b"forged")
    assert main(["package", "show", str(package), f"cut_in__simulation__{MODEL}:0"]) == 1
    assert f"{CELL}/raw.jsonl: was changed" in capsys.readouterr().err
    assert main(["package", "show", str(package), f"cut_in__physical__{MODEL}:0"]) == 0


def test_a_remark_about_many_files_is_printed_once(capsys: pytest.CaptureFixture[str]) -> None:
    black = "a control, its frames are black"
    notes = [f"a/requests.jsonl: {black}", "no place", f"b/requests.jsonl: {black}", "c: one: two"]
    _notes(["K* of a"], notes)
    assert capsys.readouterr().err.splitlines() == [
        "missing: K* of a",
        f"note: a/requests.jsonl and 1 more: {black}",
        "note: no place",
        "note: c: one: two",
    ]
