"""Each fault of a process once, in a session of processes, as the fault matrix expects it.

`ssp faults` runs them all; faults of objects and links are tested without processes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import pytest

from ssp_scenario_manager.faults.campaign import Mode, Scene, prepare_scene, run_cells
from ssp_scenario_manager.faults.matrix import MATRIX
from ssp_scenario_manager.faults.model import Stage

# Until a session begins its heartbeats are judged by the wall's clock, and so is a full disk.
pytestmark = [pytest.mark.ros, pytest.mark.system, pytest.mark.alone]

ROWS = {row.name: row for row in MATRIX}
# Recorder and manager are killed in realtime, where there is time to notice
# (test_session_faults.py).
CELLS = [
    ("manager_stopped", Stage.AFTER),
    ("object_killed", Stage.CONFLICT),
    ("world_paused", Stage.BEFORE),
    ("disk_full", Stage.BEFORE),
    ("reference_out_of_fence", Stage.ARMED),
    ("operator_abort", Stage.AFTER),
]


# The recorder flushes by the wall's clock: in lockstep all may stand before the disk is full.
REALTIME = {"disk_full"}


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Mode], Scene]:
    """The event's times come from a run without processes, which has the same states."""
    folder = tmp_path_factory.mktemp("cells")

    @cache
    def scene(mode: Mode) -> Scene:
        # In one process there is no clock to follow; the times are of the session's own.
        made = prepare_scene(
            "cut_in", "boulevard", 1, "lockstep", folder / mode, print, "in_process"
        )
        run = made.run.model_copy(update={"mode": mode})
        return replace(made, way="sessions", mode=mode, run=run)

    return scene


@pytest.mark.parametrize(("name", "stage"), CELLS)
def test_a_fault_of_a_process_is_answered_as_it_is_written(
    name: str, stage: Stage, scenes: Callable[[Mode], Scene]
) -> None:
    said: list[str] = []
    scene = scenes("realtime" if name in REALTIME else "lockstep")
    (result,) = run_cells(scene, [(ROWS[name], stage)], said.append)
    assert result.judged is not None
    # How soon on the wall's clock says nothing on a busy machine; `ssp faults` judges that too.
    findings = [f for f in result.judged.findings if not f.endswith("(wall)")]
    assert findings == [], "\n".join(said)
    assert result.judged.reaction is None or result.judged.reaction.seconds is not None
    if stage is not Stage.ARMED:
        assert set(result.judged.stops) == {"ot1", "vut"}
        assert all(stop.kept for stop in result.judged.stops.values())
