"""Runs the cells of the matrix, one session each, and judges what they leave."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ssp_core.clock import ns_to_seconds
from ssp_core.errors import HostError
from ssp_core.files.folders import make_folder
from ssp_core.files.writing import write_json, write_text
from ssp_core.hashing import sha256_json
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Fault, RunSpec
from ssp_core.run_file.verdict import RESULT_FILE
from ssp_core.safety.codes import MEANINGS
from ssp_core.vocabulary import Role, Verdict
from ssp_core.world.plant import StepReport, make_plant
from ssp_scenario_manager.compile.targets.folder import prepare_run
from ssp_scenario_manager.compile.task import TASK_FOLDER
from ssp_scenario_manager.faults.evidence import (
    Evidence,
    FaultNote,
    SafetyNote,
    Track,
    own_states,
    read_evidence,
    track_of,
)
from ssp_scenario_manager.faults.judge import (
    CellJudgement,
    Nominal,
    fault_of,
    judge,
    missed_its_run,
    nominal_of,
)
from ssp_scenario_manager.faults.kept import CELL_FILE, load_cell
from ssp_scenario_manager.faults.matrix import Cell, ExpectedOutcome, NotApplicable, Row, Stage
from ssp_scenario_manager.run.faults import NEED_PROCESSES
from ssp_scenario_manager.run.in_process import Record, judge_session
from ssp_scenario_manager.run.in_process_session import InProcessSession
from ssp_scenario_manager.run.result import RunEvents
from ssp_scenario_manager.run.sweep import for_one_process
from ssp_scenario_manager.session import outbox
from ssp_scenario_manager.session.limits import Violation

MANAGER = "scenario_manager"


def run_for_evidence(spec: RunSpec) -> Evidence:
    """Run a session in this process.

    Args:
        spec: in lockstep, with faults that need no process.

    Raises:
        InputError: a fault needs processes of its own.
    """
    spec = for_one_process(spec)
    reports: list[StepReport] = []
    plant = make_plant(spec)
    try:
        session = InProcessSession(spec, plant, reports.append, reports.append)
        session.run()
    finally:
        plant.close()
    outcome, happened = judge_session(spec, session, Record(reports))
    verdict = outcome.verdict
    if verdict is Verdict.NONE:
        verdict = Verdict.INVALID_HARNESS  # as the runner says of a session that never started
    safety = [
        SafetyNote(
            ns_to_seconds(limit.stamp_ns),
            MEANINGS[limit.code].limit_name,
            limit.source,
            limit.object_id,
        )
        for report in reports
        for limit in report.limits
    ]
    safety += [
        SafetyNote(
            ns_to_seconds(violation.stamp_ns),
            MEANINGS[violation.code].limit_name,
            MANAGER,
            violation.object_id,
        )
        for violation in session.of_kind(Violation)
    ]
    return Evidence(
        spec=spec,
        verdict=verdict.name.lower(),
        reasons=outcome.reasons,
        truth=_truth(reports),
        own_states=own_states(state for report in reports for state in report.target_states),
        session=tuple(
            (ns_to_seconds(c.stamp_ns), c.state) for c in session.of_kind(outbox.StateChanged)
        ),
        phases=tuple((ns_to_seconds(p.stamp_ns), p.phase) for p in happened.phases),
        triggers=tuple(ns_to_seconds(t.dispatched_ns) for t in happened.triggers),
        safety=tuple(sorted(safety, key=lambda note: note.t_s)),
        faults=_faults(spec, happened),
        has_wall=False,
    )


def _truth(reports: list[StepReport]) -> dict[str, Track]:
    rows: dict[str, list[tuple[float, ObjectState]]] = {}
    for report in reports:
        if report.running:
            for one in report.truths:
                if one.role in (Role.VUT, Role.OT):
                    rows.setdefault(one.object_id, []).append((ns_to_seconds(report.now_ns), one))
    return {object_id: track_of(samples) for object_id, samples in rows.items()}


def _faults(spec: RunSpec, happened: RunEvents) -> tuple[FaultNote, ...]:
    notes = [
        FaultNote(ns_to_seconds(f.stamp_ns), int(f.fault.partition(" ")[0]), f.active)
        for f in happened.faults
    ]
    indices = {note.index for note in notes}
    notes += [
        FaultNote(fault.at_s or 0.0, index, True)
        for index, fault in enumerate(spec.faults)
        if index not in indices and fault.kind == "operator_abort"
    ]
    return tuple(sorted(notes, key=lambda note: (note.t_s, note.index)))


def left_behind(folder: Path) -> list[str]:
    """Describe the processes that still write into a run's logs."""
    logs = (folder / "logs").resolve()
    leftovers = []
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            output = (entry / "fd" / "1").resolve()
            name = (entry / "comm").read_text().strip()
        except OSError:
            continue  # it ended meanwhile, or is another user's
        if output.parent == logs:
            leftovers.append(f"process {entry.name} ({name}) still runs and writes {output.name}")
    return leftovers


SAID_FILE = "said.txt"
NOMINAL = "nominal"
ATTEMPTS = 3
# So begins the runner's reason for a run that a person ended.
_INTERRUPTED = "interrupted"
Mode = Literal["lockstep", "realtime"]
Way = Literal["sessions", "in_process"]


@dataclass(frozen=True, slots=True)
class FaultScenario:
    """A scenario that the matrix is run on.

    Args:
        name: of the scenario.
        mode: of its sessions.
        folder: receives the scenario's runs.
        run: without faults.
        nominal: its times.
        way: each cell a session of processes, or a run in this one.
    """

    name: str
    mode: Mode
    folder: Path
    run: RunSpec
    nominal: Nominal
    way: Way = "sessions"


@dataclass(frozen=True, slots=True)
class CellResult:
    """A cell and what came of it; nothing came of one that isn't applicable."""

    scene: FaultScenario
    row: Row
    stage: Stage
    cell: Cell
    fault: Fault | None = None
    judgement: CellJudgement | None = None
    folder: Path | None = None
    wall_s: float = 0.0

    @property
    def ok(self) -> bool:
        return self.judgement is None or self.judgement.ok


def prepare_scene(
    scenario: str,
    site: str,
    seed: int,
    mode: Mode,
    out: Path,
    way: Way = "sessions",
) -> FaultScenario:
    """Compile a scenario and find its times with a run without faults.

    Args:
        scenario: name or K* file.
        site: name or file of the site.
        seed: of the run.
        mode: of the run.
        out: the campaign's folder.
        way: sessions over DDS, or ``in_process``.

    Raises:
        InputError: it can't be compiled, or isn't valid even without faults.
    """
    name = Path(scenario).name.split(".")[0]
    folder = out / f"{name}-{mode if way == 'sessions' else way}"
    scratch = folder / NOMINAL
    task = scratch / TASK_FOLDER
    if task.is_dir():
        shutil.rmtree(task)
    run = prepare_run(scenario, site, scratch, seed=seed, mode=mode)
    run = run.model_copy(update={"camera": None, "run_id": NOMINAL, "faults": []})
    if way == "in_process":
        return FaultScenario(name, mode, folder, run, nominal_of(run_for_evidence(run)), way)
    evidence, _ = _evidence(run, scratch)
    return FaultScenario(name, mode, folder, run, nominal_of(evidence), way)


def run_cells(scene: FaultScenario, cells: list[tuple[Row, Stage]]) -> Iterator[CellResult]:
    """Run and judge cells; one that was run before, with the same run file, is judged again.

    A session that was complete before its fault came is run anew, ``ATTEMPTS`` times in all.
    """
    for row, stage in cells:
        cell = row.cell(stage, scene.nominal.moves[stage])
        if (
            isinstance(cell, ExpectedOutcome)
            and scene.way == "in_process"
            and row.kind in NEED_PROCESSES
        ):
            cell = NotApplicable("needs processes of its own")
        if isinstance(cell, NotApplicable):
            yield CellResult(scene, row, stage, cell)
            continue
        fault = fault_of(row, stage, scene.nominal, scene.run)
        run = scene.run.model_copy(update={"faults": [fault]})
        if scene.way == "in_process":
            judgement = judge(cell, run_for_evidence(run), 0)
            yield CellResult(scene, row, stage, cell, fault, judgement)
            continue
        folder = make_folder(scene.folder / row.name / stage.value)
        name = f"{scene.name}-{row.name}-{stage.value}"
        run = run.model_copy(update={"run_id": name})
        evidence, leftovers = _evidence(run, folder)
        for _ in range(ATTEMPTS - 1):
            if not missed_its_run(evidence, 0):
                break
            (folder / CELL_FILE).unlink()
            evidence, leftovers = _evidence(run, folder)
        judgement = judge(cell, evidence, 0, leftovers)
        yield CellResult(scene, row, stage, cell, fault, judgement, folder, evidence.wall_s)


def _evidence(run: RunSpec, folder: Path) -> tuple[Evidence, list[str]]:
    """Run a session, unless the folder holds the same one already.

    Raises:
        KeyboardInterrupt: a person ended it; the campaign goes on from here the next time.
    """
    key = sha256_json(run.model_dump(mode="json", by_alias=True))
    leftovers = _finished(folder, key)
    if leftovers is None:
        leftovers = _run_session(run, folder, key)
    return read_evidence(folder), leftovers


def _finished(folder: Path, key: str) -> list[str] | None:
    """Read the outcome that a finished run of this file left behind; None when there is none."""
    cell = load_cell(folder)
    if cell is None or cell.key != key or not (folder / RESULT_FILE).is_file():
        return None
    return cell.leftovers


def _run_session(run: RunSpec, folder: Path, key: str) -> list[str]:
    from ssp_scenario_manager.run.over_dds.session import run_session

    for old in folder.iterdir():
        if old.name == TASK_FOLDER:
            continue
        shutil.rmtree(old) if old.is_dir() else old.unlink()
    notices: list[str] = []
    result = run_session(run, folder.resolve(), notices.append)
    if any(reason.startswith(_INTERRUPTED) for reason in result.outcome.reasons):
        raise KeyboardInterrupt
    if not (folder / RESULT_FILE).is_file():
        raise HostError("; ".join(result.unwritten))
    leftovers = left_behind(folder)
    write_text(folder / SAID_FILE, "".join(f"{line}\n" for line in notices))
    write_json(
        folder / CELL_FILE,
        {"schema": "ssp.fault_cell/1", "key": key, "leftovers": leftovers},
    )
    return leftovers
