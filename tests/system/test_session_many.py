"""Twenty object targets and the VUT at 100 Hz: states as one message, complete and in order."""

from __future__ import annotations

import math
from itertools import groupby, pairwise
from pathlib import Path

import pytest

from ssp_core.bag.reading.reader import BagReader, object_states
from ssp_core.cdr.states import decode_states
from ssp_core.run_file.model import Fault, RunSpec
from ssp_core.run_file.participants import Motion, ParticipantSpec
from ssp_core.run_file.values import Start
from ssp_core.vocabulary import Verdict
from ssp_scenario_manager.compile.compiler import Request, compile_task
from ssp_scenario_manager.run.over_dds.session import run_session

pytestmark = [pytest.mark.ros, pytest.mark.system]

STEP_NS = 10_000_000
STOPPED_S = 1.5


def walker(number: int) -> ParticipantSpec:
    """Make a walker on the pavement to the left or the right, far from all others."""
    x_m, y_m = 20.0 + 36.0 * (number // 2), 14.0 if number % 2 else -2.9
    motion = Motion(
        path=[(x_m, y_m), (x_m + 12.0, y_m)],
        cruise_mps=1.4,
        acceleration_mps2=1.0,
        deceleration_mps2=1.0,
    )
    start = Start(x_m=x_m, y_m=y_m, yaw_rad=0.0)
    return ParticipantSpec(
        id=f"walker{number:02d}", object_class="pedestrian", start=start, approach=motion
    )


@pytest.fixture
def run() -> RunSpec:
    """The cut-in with nineteen more targets; somebody ends it soon."""
    task = compile_task(Request(event="cut_in", target="sumo", site="boulevard")).task
    targets = [*task.run.targets, *map(walker, range(1, 20))]
    return task.run.model_copy(
        update={
            "targets": targets,
            "step_s": 0.01,
            "camera": None,
            "traffic": [],
            "faults": [Fault(kind="operator_abort", at_s=STOPPED_S)],
        }
    )


def test_states_of_twenty_targets_are_complete(run: RunSpec, tmp_path: Path) -> None:
    result = run_session(run, tmp_path, lambda line: None)
    assert result.outcome.verdict is Verdict.ABORTED
    assert all("abort" in reason for reason in result.outcome.reasons), result.outcome.reasons
    ids = sorted(target.id for target in run.targets)
    with BagReader(result.bag) as bag:
        assert not {f"/ssp/{name}/state" for name in ids} & bag.topics.keys()
        arrays = [decode_states(m.data) for m in bag.messages(["/ssp/object_states"])]
        of_each = object_states(bag, [run.vut.id, *ids])
    assert all([state.object_id for state in array.states] == ids for array in arrays)
    assert {array.source for array in arrays} == {"object_target"}
    for name, states in of_each.items():
        # The world repeats its last state while it holds, before the start and at the end.
        moving = [state for state, _ in groupby(states) if state.stamp_ns > 0]
        assert len(moving) >= STOPPED_S / run.step_s, name
        for before, state in pairwise(moving):
            assert (state.stamp_ns - before.stamp_ns, state.sequence - before.sequence) == (
                STEP_NS,
                1,
            ), name
        if name != run.vut.id:
            assert any(state.reference_id for state in moving), name
            assert max(abs(state.error_lateral_m) for state in moving) < 0.1
            assert math.isfinite(moving[-1].x_m)
