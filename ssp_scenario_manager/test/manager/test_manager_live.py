"""A live session as a process: the system clock's time, no world, silence seen by a timer."""

from __future__ import annotations

import json
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest
import rclpy

from ssp_core import names, ros
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_msgs import msg
from tests.support.processes.patience import SILENCE_S, patient

pytestmark = pytest.mark.ros
S = 1_000_000_000


@pytest.fixture
def live(peers: Any, tmp_path: Path, run_mapping: dict[str, Any]) -> Any:
    """Peers of a live session."""
    peers.run_file = tmp_path / "run.yaml"
    peers.live_run = {**run_mapping, "mode": "live", "step_s": 0.1}
    peers.live = True
    return peers


def arm(peers: Any, **limits: float) -> None:
    """Arm a session that waits for a minute, but for these limits."""
    run = patient(peers.live_run, clock_offset_s=2.0, **limits)
    peers.run_file.write_text(json.dumps(run))
    assert peers.load(peers.run_file).accepted
    peers.appear()
    for command in ("connect", "arm"):
        peers.obtain(command)
    # The manager may accept before the object is asked, which then appears anew.
    peers.spin_until(
        lambda: peers.ot1.control_state is ControlState.ARMED, "the object's own arming"
    )


def wait_for_event(peers: Any, code: SafetyCode) -> None:
    peers.spin_until(lambda: code in codes(peers), code.name)
    peers.wait_for(SessionPhase.ABORTED)


def codes(peers: Any) -> set[int]:
    return {event.code for event in peers.safety}


def test_a_live_session(live: Any, manager: subprocess.Popen[str]) -> None:
    """One manager, four sessions: each start of a process costs seconds."""
    runs_on_the_system_clock(live)
    live.safety.clear()
    misses_states_of_an_object(live)
    live.safety.clear()
    misses_answers_to_heartbeats(live)
    live.safety.clear()
    notices_a_second_manager(live)
    assert manager.poll() is None


def runs_on_the_system_clock(live: Any) -> None:
    arm(live)
    live.obtain("start")
    live.wait_for(SessionPhase.RUNNING)
    started_ns = ros.ns_from_stamp(live.session_states[-1].header.stamp)
    assert abs(time.time_ns() - started_ns) < 20 * S
    # A stray world moves nothing: its time is not ours.
    live.tick.publish(msg.WorldTick(step=5, running=True, lockstep=True))
    # The one before the objects appeared has nothing of them.
    live.spin_until(
        lambda: live.links and all(live.links[-1].states_received), "a report on the links of both"
    )
    status = live.links[-1]
    assert list(status.object_ids) == ["vut", "ot1"]
    assert abs(status.clock_offset[1]) < 2.0
    assert 0.0 <= status.delay[1] < 4.0
    live.spin_until(
        lambda: time.time_ns() - ros.ns_from_stamp(live.beats[-1].header.stamp) < S, "a young beat"
    )
    # tf2 hears where everybody is, at the stamps of their states, and never the same twice.
    frames = {("map", "vut/base_link"), ("map", "ot1/base_link")}

    def transforms_of_poses() -> list[Any]:
        return [one for message in live.poses for one in message.transforms]

    live.spin_until(
        lambda: (
            {(one.header.frame_id, one.child_frame_id) for one in transforms_of_poses()} == frames
        ),
        "poses",
    )
    stamps = [
        (one.child_frame_id, ros.ns_from_stamp(one.header.stamp)) for one in transforms_of_poses()
    ]
    assert len(set(stamps)) == len(stamps)
    assert transforms_of_poses()[-1].transform.translation.x in (live.vut.x_m, live.ot1.x_m)
    assert live.command("abort").accepted
    live.wait_for(SessionPhase.ABORTED)
    live.obtain("all_clear")


def misses_states_of_an_object(live: Any) -> None:
    """Silence is noticed by a timer, since no world steps a live session."""
    arm(live, state_age_s=SILENCE_S)
    live.ot1 = None
    live.spin_until(lambda: SafetyCode.OBJECT_SILENT in codes(live), "the event")
    live.wait_for(SessionPhase.ABORTING)
    assert not live.command("all_clear").accepted
    live.ot1 = live.make_state("ot1", x_m=40.0, y_m=3.5, control_state=ControlState.ABORTING)
    live.wait_for(SessionPhase.ABORTED)
    live.obtain("all_clear")


def misses_answers_to_heartbeats(live: Any) -> None:
    """States of the object go on: the link in the other direction is what is cut."""
    arm(live, heartbeat_s=SILENCE_S)
    live.answers = False
    wait_for_event(live, SafetyCode.REPLY_MISSING)
    assert SafetyCode.OBJECT_SILENT not in codes(live)
    live.answers = True
    live.obtain("all_clear")


def notices_a_second_manager(live: Any) -> None:
    arm(live)
    other = rclpy.create_node("other", namespace=names.NAMESPACE, context=live.context)
    other.create_publisher(msg.Heartbeat, names.HEARTBEAT, ros.STATE)
    wait_for_event(live, SafetyCode.FOREIGN_MANAGER)
    other.destroy_node()
    live.obtain("all_clear")
