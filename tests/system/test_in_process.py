"""A session in one process gives the states of the session over DDS, to the last bit."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from rosbags.highlevel import AnyReader

from ssp_core.messages import object_state
from ssp_core.run_spec import load_run
from ssp_core.state import ObjectState
from ssp_scenario_manager.in_process.command import for_one_process
from ssp_scenario_manager.in_process.outcome import result_json, run_in_process

pytestmark = [pytest.mark.ros, pytest.mark.system]

# Faults that a run survives, so that all of its states can be compared.
FAULTS = """schema: ssp.faults/1
disturbance: {state_delay_s: 0.02, state_jitter_s: 0.02, reorder: 0.1, command_delay_s: 0.02,
              position_noise_m: 0.02, speed_noise_mps: 0.02, clock_offset_s: 0.01}
faults:
  - {kind: link_delay, target: ot1, at_s: 3.0, duration_s: 1.0, value: 0.06}
  - {kind: link_loss, target: ot1, at_s: 5.0, duration_s: 2.0, value: 0.2}
  - {kind: link_cut, target: vut, at_s: 6.0, duration_s: 0.1}
"""
# This one it doesn't survive: everything brakes.
JUMP = """schema: ssp.faults/1
faults: [{kind: position_jump, target: ot1, at_s: 6.0, value: 2.0}]
"""

# What result.json says of both. An end is seen by each in its own way, and latencies by one.
KEYS = (
    *("schema", "run_id", "scenario", "site", "seed", "mode", "verdict", "reasons"),
    *("phases", "triggers", "faults", "initiator_first", "time_gap_s", "min_distance_m"),
)


def recorded(bag: Path, object_id: str) -> list[ObjectState]:
    """States of the run by their number; before it they are sent as often as there was time.

    A bag puts what came at the same instant in any order.
    """
    with AnyReader([bag]) as reader:
        chosen = [c for c in reader.connections if c.topic == f"/ssp/{object_id}/state"]
        states = [
            object_state(reader.deserialize(raw, c.msgtype))
            for c, _, raw in reader.messages(connections=chosen)
        ]
    return by_number(states)


def by_number(states: list[ObjectState]) -> list[ObjectState]:
    return sorted((s for s in states if s.sequence > 1), key=lambda s: s.sequence)


def test_states_are_the_same_to_the_last_bit(start_session: Any, tmp_path: Path) -> None:
    (tmp_path / "faults.yaml").write_text(FAULTS)
    (tmp_path / "jump.yaml").write_text(JUMP)
    plans = {
        "disturbed": ("cut_in", "--site", "north_track", "--seed", "7"),
        "faulty": ("vru_crossing", "--faults", str(tmp_path / "faults.yaml")),
        "stopped": ("cut_in", "--faults", str(tmp_path / "jump.yaml")),
    }
    # At the same time, on purpose: a loaded machine.
    sessions = {
        name: start_session(*plan, "--no-camera", name=name) for name, plan in plans.items()
    }
    verdicts, gaps, faults = {}, {}, {}
    for name, session in sessions.items():
        result = session.finish()
        spec = for_one_process(load_run(session.folder / "run.yaml"))
        ours, record = run_in_process(spec)
        said = json.loads(json.dumps(result_json(spec, ours)))
        assert {key: result[key] for key in KEYS} == {key: said[key] for key in KEYS}
        assert (result["in_process"], said["in_process"]) == (False, True)
        verdicts[name], gaps[name] = result["verdict"], result["time_gap_s"]
        faults[name] = [(f["number"], f["kind"], f["active"]) for f in result["faults"]]
        for object_id in ("vut", "ot1"):
            theirs = recorded(session.folder / "bag", object_id)
            mine = by_number(record.arrived(object_id))
            # At its end the world holds and says its state again, as often as there is time.
            assert len(mine) > 300
            assert [repr(s) for s in theirs[: len(mine) - 1]] == [repr(s) for s in mine[:-1]]
    assert verdicts == {"disturbed": "valid", "faulty": "valid", "stopped": "failed_safety"}
    # Who is stopped before the conflict rolls on, and has no gap.
    assert gaps["disturbed"] is not None
    assert gaps["faulty"] is not None
    assert gaps["stopped"] is None
    assert faults["stopped"] == [(0, "position_jump", True)]
    assert faults["faulty"] == [
        (0, "link_delay", True),
        (0, "link_delay", False),
        (1, "link_loss", True),
        (2, "link_cut", True),
        (2, "link_cut", False),
        (1, "link_loss", False),
    ]
    assert faults["disturbed"] == []
