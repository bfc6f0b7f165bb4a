"""The matrix is whole, and every cell that needs no process is as expected on a real event."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from ssp_core.run_file.model import RunSpec
from ssp_core.safety.codes import MEANINGS
from ssp_scenario_manager.faults.campaign import FaultScenario, prepare_scene, run_cells
from ssp_scenario_manager.faults.matrix import MATRIX, ExpectedOutcome, NotApplicable, Row, Stage
from ssp_scenario_manager.run.faults import NEED_PROCESSES

LIMITS = {meaning.limit_name for meaning in MEANINGS.values()}
# What else a reason may begin with: words of the runner and of the readiness check.
WORDS = (
    "abort by",
    "monitor ",
    "object_target killed",
    "scenario_manager killed",
    "scenario_manager silent",
    "the ",
    "no answer",
    "ot1 is ",
    "time gap at the conflict point",
)
FAST = [row for row in MATRIX if row.kind not in NEED_PROCESSES]
EXPECTED = [
    (row, stage, cell)
    for row in MATRIX
    for stage in Stage
    for cell in (row.cells[stage], *([row.standing[stage]] if stage in row.standing else []))
    if isinstance(cell, ExpectedOutcome)
]


def test_the_rows_are_those_that_were_asked_for() -> None:
    assert [row.name for row in MATRIX] == [
        "manager_killed",
        "manager_stopped",
        "object_killed",
        "world_paused",
        "recorder_killed",
        "disk_full",
        "link_delay_50",
        "link_delay_150",
        "link_delay_225",
        "link_delay_500",
        "link_loss_5",
        "link_loss_20",
        "link_loss_50",
        "link_reorder",
        "clock_plus",
        "clock_minus",
        "position_jump",
        "state_nan",
        "state_frozen",
        "reference_stale",
        "reference_out_of_fence",
        "actuator_stuck",
        "vut_stop",
        "trigger_never",
        "operator_abort",
    ]
    assert all(re.fullmatch(r"[a-z0-9_]+", row.name) for row in MATRIX)


@pytest.mark.parametrize("name", ["state_nan", "state_frozen"])
def test_a_session_whose_standstill_nothing_confirms_ends_while_it_aborts(name: str) -> None:
    (row,) = (row for row in MATRIX if row.name == name)
    for stage in (Stage.BEFORE, Stage.AFTER, Stage.CONFLICT):
        expected = row.cells[stage]
        assert isinstance(expected, ExpectedOutcome)
        assert "the recording ends while the session is" in expected.also


def test_every_stage_has_a_cell_with_its_reason() -> None:
    for row in MATRIX:
        assert set(row.cells) == set(Stage), row.name
        assert set(row.standing) <= set(Stage)
        for cell in (*row.cells.values(), *row.standing.values()):
            words = cell.reason if isinstance(cell, NotApplicable) else cell.why
            assert len(words.split()) > 4, row.name


@pytest.mark.parametrize(
    ("row", "stage", "cell"), EXPECTED, ids=[f"{r.name}-{s.value}" for r, s, _ in EXPECTED]
)
def test_a_cell_says_what_it_must(
    row: Row, stage: Stage, cell: ExpectedOutcome, run: RunSpec
) -> None:
    assert cell.verdicts <= {"valid", "off_spec", "invalid_harness", "failed_safety", "aborted"}
    for beginning in (*cell.primary, *cell.also):
        limit = beginning.partition(":")[0]
        assert limit in LIMITS or beginning.startswith(WORDS), beginning
    assert set(cell.signs) <= LIMITS
    if cell.verdicts == {"valid"}:
        assert (cell.primary, cell.within, cell.stops) == ((), None, False)
    else:
        assert cell.primary
        assert cell.by
    for bound in (cell.within, cell.lockstep, cell.blind):
        assert bound is None or bound.seconds(run) > 0.0
    if stage is not Stage.ARMED:
        assert cell.starts


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> FaultScenario:
    folder = tmp_path_factory.mktemp("matrix")
    made = prepare_scene("cut_in", "boulevard", 1, "lockstep", folder, "in_process")
    # Nobody else is on the road, and nobody waits long for what doesn't come.
    end = made.run.end.model_copy(update={"at_latest_s": 20.0})
    return replace(made, run=made.run.model_copy(update={"traffic": [], "end": end}))


def test_the_stages_follow_the_undisturbed_run(scene: FaultScenario) -> None:
    nominal = scene.nominal
    assert 0.0 < nominal.trigger_s < nominal.conflict_s < nominal.end_s
    assert nominal.moves == dict.fromkeys(Stage, True)


@pytest.mark.parametrize("row", FAST, ids=lambda row: row.name)
def test_cells_without_processes_are_as_expected(row: Row, scene: FaultScenario) -> None:
    for result in run_cells(scene, [(row, stage) for stage in Stage]):
        findings = result.judgement.findings if result.judgement is not None else ()
        assert (result.stage, findings) == (result.stage, ())


def test_a_dummy_that_stands_at_the_kerb_shows_some_faults_only_later(tmp_path: Path) -> None:
    """The same where the initiator is a dummy that stands at the kerb: what shows only later."""
    scene = prepare_scene("vru_crossing", "boulevard", 1, "lockstep", tmp_path, "in_process")
    assert scene.nominal.moves[Stage.CONFLICT]
    assert not scene.nominal.moves[Stage.BEFORE]
    rows = [row for row in MATRIX if row.standing]
    results = list(run_cells(scene, [(row, Stage.BEFORE) for row in rows]))
    assert [r.row.name for r in results] == ["state_frozen", "actuator_stuck"]
    for result in results:
        assert result.judgement is not None
        assert result.judgement.findings == ()
        assert result.cell is result.row.standing[Stage.BEFORE]
