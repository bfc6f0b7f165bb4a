"""``ssp faults``: what it writes, how it ends, and that finished cells are not run again."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest

from ssp_core.cli import main
from ssp_core.files.writing import write_json, write_text
from ssp_core.run_file.model import Fault, RunSpec
from ssp_scenario_manager.faults import campaign
from ssp_scenario_manager.faults.campaign import FaultScenario, run_cells
from ssp_scenario_manager.faults.judge import Nominal, at_s, fault_of
from ssp_scenario_manager.faults.matrix import MATRIX, Row, Stage

ROWS = {row.name: row for row in MATRIX}
NOMINAL = Nominal(10.34, 10.96, 14.6, dict.fromkeys(Stage, True))


def faults(*arguments: str) -> int:
    return main(["faults", *arguments])


def test_the_table_is_written_for_people_and_programs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, junit = tmp_path / "out", tmp_path / "junit.xml"
    chosen = ("--in-process", "--scenario", "vru_crossing", "--only", "operator|killed")
    assert faults(*chosen, "--out", str(out), "--junit", str(junit), "--json") == 0
    table = json.loads(capsys.readouterr().out)
    assert table == json.loads((out / "faults.json").read_text())
    assert table["as_expected"] is True
    cells = {(c["fault"], c["stage"]): c for c in table["cells"]}
    assert len(cells) == 16
    assert cells["manager_killed", "before"]["applicable"] is False
    aborted = cells["operator_abort", "conflict"]
    assert (aborted["verdict"], aborted["findings"]) == ("aborted", [])
    assert 0.0 < aborted["stops"]["vut"]["distance_m"] <= aborted["stops"]["vut"]["bound_m"]
    assert aborted["injected"]["at_s"] > 9.0

    page = (out / "faults.html").read_text()
    assert "Operator aborts" in page
    assert "needs processes of its own" in page
    suite = ElementTree.parse(junit).getroot()
    assert (suite.get("tests"), suite.get("failures")) == ("4", "0")


def test_a_cell_that_is_not_as_expected_fails_and_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    wrong = Row(
        "operator_abort",
        "Operator aborts",
        "operator_abort",
        cells=dict.fromkeys(Stage, ROWS["link_loss_5"].cells[Stage.BEFORE]),
    )
    monkeypatch.setattr("ssp_scenario_manager.cli.faults.MATRIX", (wrong,))
    arguments = ("--scenario", "cut_in", "--stage", "armed", "--out", str(tmp_path))
    assert faults("--in-process", *arguments, "--junit", str(tmp_path / "j.xml")) == 1
    said = capsys.readouterr()
    assert "0 of 1 cells as expected" in said.out
    assert "cut_in operator_abort armed: verdict aborted, not valid" in said.out
    assert "NOT AS EXPECTED" in said.err
    assert "not as expected</dt><dd>1<" in (tmp_path / "faults.html").read_text()
    assert ElementTree.parse(tmp_path / "j.xml").getroot().get("failures") == "1"


def test_wrong_usage_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert faults("--only", "(", "--out", str(tmp_path)) == 1
    assert "--only: is no regular expression" in capsys.readouterr().err
    assert faults("--only", "meteorite", "--out", str(tmp_path)) == 1
    assert "--list shows the rows' names" in capsys.readouterr().err
    assert faults("--in-process", "--mode", "realtime", "--out", str(tmp_path)) == 2
    assert faults("--list", "--only", "clock", "--stage", "after") == 0
    assert capsys.readouterr().out == "clock_plus after\nclock_minus after\n"


@pytest.mark.parametrize(
    ("event", "site", "why"),
    [
        ("cut_in", "none.yaml", "none.yaml: can't be read"),
        ("cut_in", "tee", "no block of it fits"),
        ("none.yaml", "boulevard", "none.yaml: can't be read"),
    ],
)
def test_what_cannot_be_compiled_leaves_nothing_behind(
    event: str, site: str, why: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    chosen = ("--in-process", "--scenario", event, "--site", site, "--only", "operator_abort")
    assert faults(*chosen, "--out", str(out)) == 1
    assert why in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize(
    ("stage", "when_s"),
    [(Stage.ARMED, None), (Stage.BEFORE, 9.34), (Stage.AFTER, 10.64), (Stage.CONFLICT, 11.26)],
)
def test_a_fault_strikes_on_a_step_of_its_stage(
    stage: Stage, when_s: float | None, run: RunSpec
) -> None:
    assert at_s(stage, NOMINAL, 0.02) == (None if when_s is None else pytest.approx(when_s))
    fault = fault_of(ROWS["position_jump"], stage, NOMINAL, run)
    at = None if when_s is None else pytest.approx(when_s)
    assert (fault.kind, fault.target, fault.value, fault.at_s) == ("position_jump", "ot1", 2.0, at)


def test_where_there_is_no_room_a_fault_strikes_as_near_as_it_can() -> None:
    tight = Nominal(0.5, 0.51, 0.6, {})
    assert at_s(Stage.BEFORE, tight, 0.02) == pytest.approx(0.02)
    assert at_s(Stage.AFTER, tight, 0.02) == pytest.approx(0.52)
    assert at_s(Stage.CONFLICT, tight, 0.02) == pytest.approx(0.58)


def test_a_finished_cell_is_judged_again_and_not_run_again(
    run: RunSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran: list[tuple[Fault, ...]] = []

    def session(spec: RunSpec, folder: Path, key: str) -> list[str]:
        ran.append(tuple(spec.faults))
        write_text(folder / "run.yaml", spec.model_dump_json(by_alias=True))
        write_json(folder / "result.json", {"verdict": "aborted", "reasons": ["x"], "bag": "bag"})
        write_json(folder / "cell.json", {"key": key, "leftovers": ["a process"]})
        return ["a process"]

    monkeypatch.setattr(campaign, "_run_session", session)
    scene = FaultScenario("cut_in", "lockstep", tmp_path, run, NOMINAL)
    cell = [(ROWS["state_nan"], Stage.BEFORE)]
    first, again = (next(run_cells(scene, cell)) for _ in range(2))
    assert len(ran) == 1
    assert first == again
    assert first.judgement is not None
    assert {"a process", "the run left no bag"} <= set(first.judgement.findings)
    # Another run file is another run.
    other = FaultScenario(
        "cut_in", "lockstep", tmp_path, run.model_copy(update={"seed": 9}), NOMINAL
    )
    next(run_cells(other, cell))
    assert len(ran) == 2
    # What didn't come to its end is run again.
    (tmp_path / "state_nan" / "before" / "cell.json").unlink()
    next(run_cells(other, cell))
    assert len(ran) == 3


@pytest.mark.parametrize("late", [0, 1, 2, 3])
def test_a_run_that_was_complete_before_its_fault_came_is_run_anew(
    late: int, run: RunSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran: list[float] = []

    def session(spec: RunSpec, folder: Path, key: str) -> list[str]:
        begun_s = 16.0 if len(ran) < late else 9.4
        ran.append(begun_s)
        noted = {"index": 0, "active": True, "session_s": begun_s, "wall_s": 20.0}
        heard = {
            "kind": "session",
            "name": "STOPPING",
            "detail": "",
            "session_s": 14.6,
            "wall_s": 19.0,
        }
        write_text(folder / "run.yaml", spec.model_dump_json(by_alias=True))
        write_json(folder / "result.json", {"verdict": "valid", "reasons": [], "bag": "bag"})
        write_json(folder / "faults.json", {"injected": [noted], "heard": [heard]})
        write_json(folder / "cell.json", {"key": key, "leftovers": []})
        return []

    monkeypatch.setattr(campaign, "_run_session", session)
    scene = FaultScenario("cut_in", "lockstep", tmp_path, run, NOMINAL)
    (result,) = run_cells(scene, [(ROWS["world_paused"], Stage.BEFORE)])
    assert len(ran) == min(late + 1, campaign.ATTEMPTS)
    assert result.judgement is not None
    missed = "not injected: pause came at 16.00 s, the run was complete at 14.60 s"
    assert (result.judgement.findings == (missed,)) == (late >= campaign.ATTEMPTS)
