"""Runs the cells of the matrix, one session each, and judges what they leave."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ssp_core.errors import HostError, InputError
from ssp_core.files import make_folder, read_mapping, write_json, write_text
from ssp_core.hashing import sha256_json
from ssp_core.run_file.model import Fault, RunSpec
from ssp_scenario_manager.compile.prepare import TASK_FOLDER, prepare_run
from ssp_scenario_manager.faults.evidence import Evidence
from ssp_scenario_manager.faults.in_one_process import possible, run_for_evidence
from ssp_scenario_manager.faults.judge import Judged, judge
from ssp_scenario_manager.faults.leftovers import left_behind
from ssp_scenario_manager.faults.model import Cell, Expected, NotApplicable, Row, Stage
from ssp_scenario_manager.faults.read_evidence import RESULT_FILE, read_evidence
from ssp_scenario_manager.faults.schedule import Nominal, fault_of, nominal_of

CELL_FILE = "cell.json"
SAID_FILE = "said.txt"
NOMINAL = "nominal"
# So begins the runner's reason for a run that a person ended.
_INTERRUPTED = "interrupted"
Mode = Literal["lockstep", "realtime"]
Way = Literal["sessions", "in_process"]


@dataclass(frozen=True, slots=True)
class Scene:
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

    scenario: str
    mode: Mode
    row: Row
    stage: Stage
    cell: Cell
    fault: Fault | None
    judged: Judged | None
    folder: Path | None
    wall_s: float = 0.0
    way: Way = "sessions"

    @property
    def ok(self) -> bool:
        return self.judged is None or self.judged.ok


def prepare_scene(
    scenario: str,
    site: str,
    seed: int,
    mode: Mode,
    out: Path,
    say: Callable[[str], None],
    way: Way = "sessions",
) -> Scene:
    """Compiles a scenario and finds its times with a run without faults.

    Args:
        scenario: name or K* file.
        site: name or file.
        seed: of all runs.
        mode: of all runs.
        out: folder of the campaign.
        say: takes one line for people per thing that happens.
        way: see Scene.

    Raises:
        InputError: it can't be compiled, or isn't valid even without faults.
    """
    name = Path(scenario).name.split(".")[0]
    folder = out / f"{name}-{mode if way == 'sessions' else way}"
    scratch = make_folder(folder / NOMINAL)
    task = scratch / TASK_FOLDER
    if task.is_dir():
        shutil.rmtree(task)
    run = prepare_run(scenario, site, scratch, seed=seed, mode=mode)
    run = run.model_copy(update={"camera": None, "run_id": NOMINAL, "faults": []})
    if way == "in_process":
        return Scene(name, mode, folder, run, nominal_of(run_for_evidence(run)), way)
    evidence, _ = _evidence(run, scratch, say)
    return Scene(name, mode, folder, run, nominal_of(evidence), way)


def run_cells(
    scene: Scene,
    cells: list[tuple[Row, Stage]],
    say: Callable[[str], None],
) -> Iterator[CellResult]:
    """Runs and judges cells; one that was run before, with the same run file, is judged again.

    Args:
        scene: the scenario.
        cells: which.
        say: takes one line for people per thing that happens in a run.
    """
    for row, stage in cells:
        cell = row.cell(stage, scene.nominal.moves[stage])
        if isinstance(cell, Expected) and scene.way == "in_process" and not possible(row.kind):
            cell = NotApplicable("needs processes of its own")
        if isinstance(cell, NotApplicable):
            yield CellResult(
                scene.name, scene.mode, row, stage, cell, None, None, None, way=scene.way
            )
            continue
        yield _run_cell(scene, row, stage, cell, say)


def _run_cell(
    scene: Scene, row: Row, stage: Stage, cell: Expected, say: Callable[[str], None]
) -> CellResult:
    fault = fault_of(row, stage, scene.nominal, scene.run)
    if scene.way == "in_process":
        run = scene.run.model_copy(update={"faults": [fault]})
        judged = judge(cell, run_for_evidence(run), 0)
        return CellResult(
            scene.name, scene.mode, row, stage, cell, fault, judged, None, way=scene.way
        )
    folder = make_folder(scene.folder / row.name / stage.value)
    name = f"{scene.name}-{row.name}-{stage.value}"
    run = scene.run.model_copy(update={"faults": [fault], "run_id": name})
    evidence, leftovers = _evidence(run, folder, say)
    judged = judge(cell, evidence, 0, leftovers)
    return CellResult(
        scene.name, scene.mode, row, stage, cell, fault, judged, folder, evidence.wall_s
    )


def _evidence(run: RunSpec, folder: Path, say: Callable[[str], None]) -> tuple[Evidence, list[str]]:
    """Runs a session, unless the folder holds the same one already.

    Raises:
        KeyboardInterrupt: a person ended it; the campaign goes on from here the next time.
    """
    key = sha256_json(run.model_dump(mode="json", by_alias=True))
    known = _finished(folder, key)
    if known is None:
        known = _run_session(run, folder, key, say)
    return read_evidence(folder), known


def _finished(folder: Path, key: str) -> list[str] | None:
    """What a finished run of this file left behind; None when there is none."""
    try:
        cell = read_mapping(folder / CELL_FILE)
    except InputError:
        return None
    if cell.get("key") != key or not (folder / RESULT_FILE).is_file():
        return None
    return [str(one) for one in cell.get("leftovers", ())]


def _run_session(run: RunSpec, folder: Path, key: str, say: Callable[[str], None]) -> list[str]:
    from ssp_scenario_manager.runner.session import run_session

    for old in folder.iterdir():
        if old.name == TASK_FOLDER:
            continue
        shutil.rmtree(old) if old.is_dir() else old.unlink()
    said: list[str] = []

    def both(line: str) -> None:
        said.append(line)
        say(line)

    result = run_session(run, folder.resolve(), both)
    if any(reason.startswith(_INTERRUPTED) for reason in result.outcome.reasons):
        raise KeyboardInterrupt
    if not (folder / RESULT_FILE).is_file():
        raise HostError("; ".join(result.unwritten))
    leftovers = left_behind(folder)
    write_text(folder / SAID_FILE, "".join(f"{line}\n" for line in said))
    write_json(
        folder / CELL_FILE,
        {"schema": "ssp.fault_cell/1", "key": key, "leftovers": leftovers},
    )
    return leftovers
