"""A session in one process gives the states of the session over DDS, to the last bit.

So states depend on the run and its seed alone, whatever the camera, the load, and the order in
which processes start.
"""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from rosbags.highlevel import AnyReader

from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.types import typestore
from ssp_core.cdr.messages import object_state
from ssp_core.files.folders import make_folder
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import load_run
from ssp_core.safety.arming import ARM_FAILED
from ssp_scenario_manager.compile.targets.folder import prepare_run
from ssp_scenario_manager.run.in_process import Record, result_json, run_in_process
from ssp_scenario_manager.run.over_dds import session as runner
from ssp_scenario_manager.run.sweep import for_one_process
from tests.support.bags.messages import messages
from tests.system.conftest import processes_of
from tests.system.frames import check_frames
from tests.system.recordings import Recordings

pytestmark = [pytest.mark.ros, pytest.mark.system]

# Faults that a run survives, and a last one at which everything brakes.
FAULTS = """schema: ssp.faults/1
disturbance: {state_delay_s: 0.02, state_jitter_s: 0.02, reorder: 0.1, command_delay_s: 0.02,
              position_noise_m: 0.02, speed_noise_mps: 0.02, clock_offset_s: 0.01}
faults:
  - {kind: link_delay, target: ot1, at_s: 3.0, duration_s: 1.0, value: 0.06}
  - {kind: link_loss, target: ot1, at_s: 5.0, duration_s: 2.0, value: 0.2}
  - {kind: link_cut, target: vut, at_s: 6.0, duration_s: 0.1}
  - {kind: position_jump, target: ot1, at_s: 11.0, value: 2.0}
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
    states = [object_state(one) for one in messages(bag, f"/ssp/{object_id}/state")]
    return by_number(states)


def by_number(states: list[ObjectState]) -> list[ObjectState]:
    return sorted((s for s in states if s.sequence > 1), key=lambda s: s.sequence)


def agreed(folder: Path, result: dict[str, Any]) -> Record:
    """Return the record of the run of one process, once it is known to be the session's."""
    spec = for_one_process(load_run(folder / "run.yaml"))
    ours, record = run_in_process(spec)
    said = json.loads(json.dumps(result_json(spec, ours)))
    assert {key: result[key] for key in KEYS} == {key: said[key] for key in KEYS}
    assert (result["in_process"], said["in_process"]) == (False, True)
    for object_id in ("vut", "ot1"):
        theirs = recorded(folder / "bag", object_id)
        mine = by_number(record.arrived(object_id))
        # At its end the world holds and says its state again, as often as there is time.
        assert len(mine) > 300
        assert [repr(s) for s in theirs[: len(mine) - 1]] == [repr(s) for s in mine[:-1]]
    return record


# Decided by the wall clock, or by how often the world held before the start.
OF_THE_CLOCK = {
    *("/ssp/manager/heartbeat", "/ssp/manager/heartbeat_reply", "/ssp/manager/link_status"),
    *("/ssp/recorder_status", "/ssp/ot1/rules"),
}


def contents(bag: Path) -> dict[str, list[str]]:
    """Return the messages of each topic with their times, in any order."""
    found: dict[str, set[str]] = {}
    with BagReader(bag) as reader:
        known = {name: topic.msgtype for name, topic in reader.topics.items()}
        for message in reader.messages():
            value = typestore().deserialize_cdr(message.data, known[message.topic])
            # On a busy machine an object may refuse to arm at first, and is asked again.
            if getattr(value, "event", "") == ARM_FAILED:
                continue
            # Of these, how often the manager has spoken, and how long it took to decide.
            for name in ("heartbeat", "vut_states_sent", "processing"):
                if hasattr(value, name):
                    object.__setattr__(value, name, 0)
            found.setdefault(message.topic, set()).add(f"{message.log_time_ns} {value}")
    return {name: sorted(values) for name, values in found.items() if name not in OF_THE_CLOCK}


def differ(theirs: list[str], ours: list[str]) -> str:
    """Say which messages of a topic only one of two recordings has; empty: both have the same."""
    alone = [sorted(set(a) - set(b)) for a, b in ((theirs, ours), (ours, theirs))]
    told = [f"{len(found)} as {found[0][:60]} to {found[-1][:60]}" for found in alone if found]
    return f"of {len(theirs)} and {len(ours)}: {'; '.join(told)}" if told else ""


def test_a_recording_of_one_process_says_what_that_of_a_session_says(
    recordings: Recordings,
) -> None:
    """Frames, states, poses, references, decisions and the run's end, to the last byte."""
    session = recordings.session("cut_in", "simulation")
    again = recordings.get("cut_in", "simulation")
    theirs, ours = contents(session / "bag"), contents(again / "bag")
    assert theirs.keys() == ours.keys()
    assert {name: differ(theirs[name], ours[name]) for name in theirs} == dict.fromkeys(theirs, "")
    assert len(ours["/ssp/vut/front_camera/image/compressed"]) > 100
    with BagReader(session / "bag") as one, BagReader(again / "bag") as other:
        attached = set(one.attachments) - {"recording.json", "verdict.json", "run.yaml"}
        assert attached == set(other.attachments) - {"recording.json", "verdict.json", "run.yaml"}
        assert all(one.attachment(name) == other.attachment(name) for name in attached)
        assert one.topics.keys() == other.topics.keys()


def test_faults_are_the_same(start_session: Any, tmp_path: Path) -> None:
    (tmp_path / "faults.yaml").write_text(FAULTS)
    plan = ("vru_crossing", "--faults", str(tmp_path / "faults.yaml"), "--no-camera")
    session = start_session(*plan)
    result = session.finish()
    agreed(session.folder, result)
    assert result["verdict"] == "failed_safety"
    # Who is stopped in the conflict was the first in it, and has no gap.
    assert (result["initiator_first"], result["time_gap_s"]) == (True, None)
    assert [(f["number"], f["kind"], f["active"]) for f in result["faults"]] == [
        (0, "link_delay", True),
        (0, "link_delay", False),
        (1, "link_loss", True),
        (2, "link_cut", True),
        (2, "link_cut", False),
        (1, "link_loss", False),
        (3, "position_jump", True),
    ]


def stall_in_turn(folder: Path, stalled: list[str]) -> None:
    """Stop each node process of a run for 50 ms, one after the other, until all have ended."""
    while nodes := processes_of(folder):
        for name, pid in nodes.items():
            with suppress(ProcessLookupError):  # it has ended meanwhile
                os.kill(pid, signal.SIGSTOP)
                stalled.append(name)
                time.sleep(0.05)
                os.kill(pid, signal.SIGCONT)


def test_states_depend_on_the_seed_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The runs have a camera, processes that are kept waiting, a reversed order of starts and
    disturbed links.
    """
    folder = make_folder(tmp_path / "filmed")
    spec = prepare_run("cut_in", "north_track", folder, seed=5, mode="lockstep")
    assert spec.disturbance.position_noise_m > 0.0
    assert spec.camera is not None
    small = spec.camera.model_copy(update={"width_px": 160, "height_px": 96})
    monkeypatch.setattr(runner, "NODE_MODULES", dict(reversed(runner.NODE_MODULES.items())))
    stalled: list[str] = []
    stalling = threading.Thread(target=stall_in_turn, args=(folder, stalled), daemon=True)

    def keep_waiting(line: str) -> None:
        """Stall nodes from the start of the run on: before, the camera may be compiled."""
        if line == "session RUNNING":
            stalling.start()

    filmed = runner.run_session(spec.model_copy(update={"camera": small}), folder, keep_waiting)
    stalling.join()
    assert len(set(stalled)) > 3, stalled
    assert (filmed.outcome.verdict.name, filmed.outcome.reasons) == ("VALID", ())
    with AnyReader([filmed.bag]) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
    assert counts["/ssp/vut/front_camera/image/compressed"] > 100
    check_frames(filmed.bag, load_run(folder / "run.yaml"))
    record = agreed(folder, json.loads((folder / "result.json").read_text()))
    other = run_in_process(for_one_process(spec.model_copy(update={"seed": 6})))[1]
    assert by_number(other.arrived("vut")) != by_number(record.arrived("vut"))
