"""Controls come with every campaign, are announced before they cost anything, and can be left."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from ssp_core.cli import main
from ssp_core.vocabulary import Verdict
from ssp_eval.evaluate.campaign import Plan, run_campaign
from ssp_eval.evaluate.cli import driving_before
from ssp_eval.evaluate.clients.model_client import InProcessClients
from ssp_eval.evaluate.clients.model_replies import Loss
from ssp_eval.evaluate.clients.models import ModelSpec, bridge_spec
from ssp_eval.evaluate.conditions.conditions import other_label_time
from ssp_eval.evaluate.conditions.expansion import with_controls
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.evaluate.store.cell_file import CellResult
from ssp_eval.report.page import write_report

BagMaker = Callable[..., Path]
MINE = ModelSpec("mine", backend="opencv_baseline")
OK = CellResult(Path(), "s", "d", "m", "ok", (), {}, 9, 0, {}, "admitted")


@pytest.mark.parametrize(
    ("plan", "line"),
    [
        (Plan(9, 1, 9, 0, 0), "1 cell, 9 questions"),
        (Plan(1, 1, 1, 0, 0), "1 cell, 1 question"),
        (Plan(0, 0, 0, 0, 0), "0 cells, 0 questions"),
        (
            Plan(9, 1, 9, 0, 0, goes_on=True),
            "1 cell, 9 questions (those with a stored answer are counted and not asked again)",
        ),
        (
            Plan(63, 7, 63, 36, 18),
            "7 cells, 63 questions; of these 54 for controls: 18 repeat the models' "
            "questions with spoilt frames, 36 go to the built-in answerers "
            "(--no-controls leaves them out)",
        ),
        (
            Plan(27, 3, 27, 0, 18),
            "3 cells, 27 questions; of these 18 for controls: 18 repeat the models' "
            "questions with spoilt frames (--no-controls leaves them out)",
        ),
        (
            Plan(153, 17, 153, 0, 18, 117),
            "17 cells, 153 questions; of these 18 for controls: 18 repeat the models' "
            "questions with spoilt frames (--no-controls leaves them out); 117 repeat the models' "
            "questions with corrupted pictures",
        ),
    ],
)
def test_the_plan_is_one_line(plan: Plan, line: str) -> None:
    assert plan.line() == line
    assert "-p controls:=false" not in line
    assert plan.line("nothing") == line.replace("--no-controls", "nothing")


def test_the_plan_counts_what_is_asked_and_not_what_is_refused(
    make_bag: BagMaker, tmp_path: Path
) -> None:
    good, told = make_bag(), list[Plan]()
    models = with_controls([MINE])
    run_campaign(
        [(good, None)], [MINE], InProcessClients(), tmp_path / "first", CellOptions(), True
    )
    aborted = make_bag("bad", domain="physical", verdict=Verdict.ABORTED, reasons=("stopped",))
    text = (tmp_path / "bag.labels.json").read_text().replace('"simulation"', '"physical"')
    (tmp_path / "bad.labels.json").write_text(text)
    records: list[int] = []
    results = run_campaign(
        [(good, None), (aborted, None)],
        models,
        InProcessClients(),
        tmp_path / "out",
        CellOptions(),
        on_plan=told.append,
        on_record=lambda: records.append(1),
    )
    (plan,) = told
    assert plan == Plan(label_times=126, cells=7, questions=63, to_answerers=36, spoilt=18)
    assert len(records) == plan.label_times
    assert sum(result.sent for result in results) == plan.questions
    assert [r.control for r in results if r.domain == "simulation"] == [False, *[True] * 6]


@pytest.mark.parametrize(
    ("result", "failure"),
    [
        (OK, False),
        (replace(OK, status="failed", losses={Loss.DIED: 9}), True),
        (replace(OK, status="refused"), True),
        # A model that won't answer about black frames, and a clip without a second label time.
        (replace(OK, status="failed", condition="black", losses={Loss.ERROR: 9}), False),
        (replace(OK, status="failed", condition="shuffled", losses={Loss.NO_QUESTION: 1}), False),
        (
            replace(OK, status="failed", condition="black", losses={Loss.DIED: 1, Loss.ERROR: 8}),
            True,
        ),
        (replace(OK, status="failed", condition="black", losses={}), True),
        (replace(OK, status="refused", condition="black"), True),
        # An answerer of our own that can't answer is a fault of ours.
        (replace(OK, status="failed", control=True, losses={Loss.ERROR: 9}), True),
    ],
)
def test_what_a_control_finds_out_is_no_failure(result: CellResult, failure: bool) -> None:
    assert result.is_failure is failure


def test_silence_is_a_score_and_one_label_time_can_t_be_shuffled(
    make_bag: BagMaker, tmp_path: Path
) -> None:
    assert other_label_time([1.0], 0) is None
    bag, out = make_bag(), tmp_path / "out"
    run_campaign([(bag, None)], [MINE], InProcessClients(), tmp_path / "first", CellOptions(), True)
    labels = tmp_path / "bag.labels.json"
    value = json.loads(labels.read_text())
    value["labels"], value["risk_time_s"] = value["labels"][4:5], value["labels"][4]["t_s"]
    labels.write_text(json.dumps(value))
    one_frame = replace(MINE, preprocessing={"frames": 1})
    results = run_campaign(
        [(bag, None)], with_controls([one_frame]), InProcessClients(), out, CellOptions()
    )
    status = {result.model: result.status for result in results}
    assert status.pop("mine+shuffled") == "failed"
    assert set(status.values()) == {"ok"}
    assert "silent" in status
    assert not any(result.is_failure for result in results)


def test_a_campaign_goes_on_with_and_without_controls(make_bag: BagMaker, tmp_path: Path) -> None:
    bag, out = make_bag(), tmp_path / "out"
    plain = [bridge_spec("opencv_baseline")]
    bags: list[tuple[Path, Path | None]] = [(bag, None)]
    run_campaign(bags, plain, InProcessClients(), out, CellOptions(), True)
    told = "These cells have no controls"
    assert told in write_report(out).read_text()
    later = run_campaign(bags, with_controls(plain), InProcessClients(), out, CellOptions())
    assert [(r.sent, r.reused) for r in later] == [(0, 9), *[(9, 0)] * 6]
    assert told not in write_report(out).read_text()
    again = run_campaign(bags, plain, InProcessClients(), out, CellOptions())
    assert [(r.sent, r.reused) for r in again] == [(0, 9)]
    assert len(list((out / "cells").iterdir())) == 7


def test_the_command_has_controls_unless_it_is_told_otherwise(
    make_bag: BagMaker, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Answers that are stored need no ROS, so that this is the command as it is."""
    bag, out = make_bag(), tmp_path / "out"
    specs = with_controls([bridge_spec("constant_velocity")])
    run_campaign([(bag, None)], specs, InProcessClients(), out, CellOptions(), True)
    command = ["evaluate", str(bag), "--bridge", "constant_velocity", "--out", str(out), "--json"]
    counts = {}
    for options in ((), ("--controls",), ("--no-controls",)):
        assert main([*command, *options]) == 0
        printed = capfd.readouterr()
        lines = [json.loads(line) for line in printed.out.splitlines()]
        counts[options] = [line["model"] for line in lines], printed.err.count("for controls")
        assert {line["sent"] for line in lines} == {0}
    everybody = ["constant_velocity", "copy_history", "perfect", "silent"]
    assert counts == {
        (): (everybody, 1),
        ("--controls",): (everybody, 1),
        ("--no-controls",): (everybody[:1], 0),
    }


def test_a_frame_that_is_no_picture_costs_answers_and_no_campaign(
    make_bag: BagMaker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(make_bag.__globals__, "picture", lambda index: b"\xff\xd8 broken")
    models = with_controls([MINE])
    bag = make_bag("no_pictures")  # of its own, since equal bags are written once
    results = run_campaign(
        [(bag, None)], models, InProcessClients(), tmp_path / "o", CellOptions(), True
    )
    losses = {result.model: dict(result.losses) for result in results}
    assert losses["mine"] == {"bridge answered an error": 9}
    assert losses["mine+black"] == {"nothing to ask": 9}
    assert [r.model for r in results if r.is_failure] == [
        "mine",
        "constant_velocity",
        "copy_history",
        "perfect",
        "silent",
    ]


def test_an_answerer_that_was_named_as_a_model_stays_one(
    make_bag: BagMaker, tmp_path: Path
) -> None:
    bags: list[tuple[Path, Path | None]] = [(make_bag(), None)]
    out = tmp_path / "out"

    def evaluate(*names: str) -> dict[str, bool]:
        models = with_controls([bridge_spec(name) for name in names], driving_before(out))
        run_campaign(bags, models, InProcessClients(), out, CellOptions(), True)
        files = [json.loads(file.read_text()) for file in out.glob("cells/*/cell.json")]
        return {cell["model"]: cell["control"] for cell in files if not cell["condition"]}

    assert driving_before(out) == set()
    others = {"perfect": True, "silent": True, "copy_history": True}
    assert evaluate("constant_velocity") == {"constant_velocity": False, **others}
    assert driving_before(out) == {"constant_velocity"}
    mine = {"constant_velocity": False, "opencv_baseline": False, **others}
    assert evaluate("opencv_baseline") == mine
    assert evaluate("opencv_baseline", "copy_history") == {**mine, "copy_history": False}
    damaged = next(out.glob("cells/*__copy_history/cell.json"))
    damaged.write_text("{")
    assert driving_before(out) == {"constant_velocity"}
