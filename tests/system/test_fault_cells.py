"""Each fault of a process once, in a session of processes, as the fault matrix expects it.

`ssp faults` runs them all; faults of objects and links are tested without processes.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace

import pytest

from ssp_scenario_manager.faults.campaign import (
    SAID_FILE,
    FaultScenario,
    prepare_scene,
    run_cells,
)
from ssp_scenario_manager.faults.matrix import MATRIX, ExpectedOutcome, Stage
from tests.support.processes.patience import SILENCE_S

pytestmark = [pytest.mark.ros, pytest.mark.system]

ROWS = {row.name: row for row in MATRIX}
# The recorder is killed in test_session_faults.py, where a person's abort is tried too.
CELLS = [
    ("manager_killed", Stage.AFTER),
    ("manager_stopped", Stage.AFTER),
    ("object_killed", Stage.CONFLICT),
    ("world_paused", Stage.BEFORE),
    ("disk_full", Stage.BEFORE),
    ("reference_out_of_fence", Stage.ARMED),
]

# Of a manager that a busy machine kept waiting; then it blames nobody else.
BUSY = re.compile("overrun:? scenario_manager")
# Noticed on the wall's clock, so that the run has to last.
NEVER_TRIGGERED = {"disk_full"}
HELD_S = 30.0


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> FaultScenario:
    """The event's times come from a run without processes, which has the same states."""
    folder = tmp_path_factory.mktemp("cells")
    made = prepare_scene("cut_in", "boulevard", 1, "lockstep", folder, "in_process")
    # Until a session begins its heartbeats are judged by the wall's clock, on a busy machine.
    limits = made.run.limits.model_copy(update={"heartbeat_s": SILENCE_S})
    return replace(made, way="sessions", run=made.run.model_copy(update={"limits": limits}))


@pytest.mark.parametrize(("name", "stage"), CELLS)
def test_a_fault_of_a_process_is_answered_as_it_is_written(
    name: str, stage: Stage, scene: FaultScenario
) -> None:
    if name in NEVER_TRIGGERED:
        triggers = [t.model_copy(update={"held_for_s": HELD_S}) for t in scene.run.triggers]
        scene = replace(scene, run=scene.run.model_copy(update={"triggers": triggers}))
    (result,) = run_cells(scene, [(ROWS[name], stage)])
    assert result.judgement is not None
    assert result.folder is not None
    # How soon on the wall's clock says nothing on a busy machine, nor that the manager itself was
    # kept waiting; `ssp faults` judges that too.
    findings = [
        f for f in result.judgement.findings if not f.endswith("(wall)") and not BUSY.search(f)
    ]
    assert findings == [], (result.folder / SAID_FILE).read_text()
    expected = ROWS[name].cells[stage]
    assert isinstance(expected, ExpectedOutcome)
    reasons = json.loads((result.folder / "result.json").read_text())["reasons"]
    named = [reason for reason in reasons if not BUSY.search(reason)]
    assert named == [] or named[0].startswith(tuple(expected.primary)), reasons
    assert result.judgement.reaction is None or result.judgement.reaction.seconds is not None
    if stage is not Stage.ARMED:
        assert set(result.judgement.stops) == {"ot1", "vut"}
        assert all(stop.is_within_bound for stop in result.judgement.stops.values())
