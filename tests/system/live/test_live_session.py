"""A physical session whose hardware is played by a second process group; nothing is simulated."""

from __future__ import annotations

import math
import os
import pty
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from ssp_core.run_file.model import load_run
from ssp_scenario_manager.compile.task import RUN_FILE
from ssp_scenario_manager.run.over_dds.word import HOLDS_S
from tests.system.live.conftest import ASKS, DATUM, GNSS, ODOMETRY

PORT = 18000
# What the rehearsal says of what it plays.
pytestmark = [pytest.mark.ros, pytest.mark.system]


def bodies_of(stage: Any) -> tuple[str, ...]:
    """Return the option with the played bodies' address; they need no run to be heard."""
    return ("--body", f"ot1=udp://127.0.0.1:{PORT + os.getpid() % 1000}")


def play_bodies(stage: Any) -> subprocess.Popen[Any]:
    port = str(PORT + os.getpid() % 1000)
    parts = ("--play", "bodies", "--first-port", port, "--log", str(stage.log))
    played: subprocess.Popen[Any] = stage.play("bodies", *parts)
    return played


def play_vut(stage: Any, name: str = "vut", *faults: str) -> subprocess.Popen[Any]:
    played: subprocess.Popen[Any] = stage.play(name, "--play", "vut", *faults)
    return played


def start_driving(stage: Any, task: Path) -> tuple[Any, Any, Any]:
    run = stage.run_live(task, "--no-camera", *bodies_of(stage))
    bodies, vut = play_bodies(stage), play_vut(stage)
    stage.begin(run)
    stage.wait_for_motion(run, 1.0)
    return run, bodies, vut


def test_only_the_word_after_the_prompt_starts_anything(
    stage: Any, task: Callable[[str], Path]
) -> None:
    """A real terminal gets words typed ahead, other words, a paste, and ``abort``."""
    folder, run_folder = task("cut_in"), stage.folder / "run"
    hand, terminal = pty.openpty()
    arguments = ["run", str(folder), "--mode", "live", "--wait", "--no-camera"]
    arguments += ["--out", str(run_folder), "--odometry", ODOMETRY, *bodies_of(stage)]
    run = stage.call(arguments, stdin=terminal)
    try:
        stage.said_after(run, "live session in ROS domain")
        os.write(hand, b"\nstart\n")
        stage.said_after(run, ASKS)
        play_bodies(stage)
        play_vut(stage)
        shown = partial(stage.said, "ssp_run")

        def asked_again(text: bytes) -> None:
            before = shown().count(ASKS)
            os.write(hand, text)
            stage.wait_for(lambda: shown().count(ASKS) > before, f"a new prompt after {text!r}")

        for text in (b"\n", b"go\n", b"start\nls\n"):
            asked_again(text)

        def both_connected() -> bool:
            asked_again(b"\n")
            return "NOT CONNECTED" not in shown().rpartition("mode live")[2]

        stage.wait_for(both_connected, "everybody to be connected")
        os.write(hand, b"abort\n")
        result = stage.finish(run)
    finally:
        os.close(hand)
        os.close(terminal)
    assert (result["verdict"], result["status"]) == ("aborted", 1), result["reasons"]
    assert result["reasons"][0] == "abort before the start"
    assert "session CONNECTED" not in stage.said("ssp_run")
    assert all(row.speed_mps == 0.0 for row in stage.rows())


PRESS = """
import sys, time
import rclpy
from ssp_core import names
from ssp_core.run_file.model import load_run
from ssp_msgs.srv import SessionCommand

rclpy.init()
node = rclpy.create_node("page_of_somebody", namespace=names.NAMESPACE)
token = load_run(sys.argv[1]).session_token
for command in sys.argv[2:]:
    client = node.create_client(SessionCommand, command)
    client.wait_for_service(300.0)
    until = time.monotonic() + 300.0
    answer = None
    while time.monotonic() < until and (answer is None or not answer.accepted):
        # An answer may be lost when two ends have just found each other.
        call = client.call_async(SessionCommand.Request(
            requested_by="page_of_somebody", session_token="" if command == "abort" else token))
        rclpy.spin_until_future_complete(node, call, timeout_sec=5.0)
        answer = call.result() if call.done() else answer
        time.sleep(0.2)
    print(command, answer and answer.accepted, answer and answer.error_msg, flush=True)
"""


def test_a_start_and_an_abort_from_elsewhere_are_followed(
    stage: Any, task: Callable[[str], Path]
) -> None:
    """The doctor first refuses a bad GNSS/INS; the terminal never gets the word."""
    run = stage.run_live(task("cut_in"), "--no-camera", *bodies_of(stage))
    play_bodies(stage)
    bad = play_vut(stage, "bad_vut", "--frame", "odom", "--rate", "10", "--clock-offset", "0.8")
    second = play_vut(stage, "second_vut", "--frame", "odom", "--rate", "10")
    told = stage.doctor()
    stranger = f"{ODOMETRY} has "
    assert stranger in told["publishers"]["text"], told["publishers"]
    assert stranger in told["arming"]["text"], told["arming"]
    assert told["odometry"]["status"] == "fail"
    for culprit in ("frame 'odom', must be 'map'", "the run wants 50 Hz", "ahead of this host's"):
        assert culprit in told["odometry"]["text"]
    assert "no state of the VUT arrives" in told["arming"]["text"]
    for receiver in (bad, second):
        receiver.terminate()
        receiver.wait()
    play_vut(stage)
    run_file = str(stage.folder / "run" / RUN_FILE)
    stage.start("pressed", [sys.executable, "-c", PRESS, run_file, "connect", "arm", "start"])
    stage.wait_for_motion(run, 1.0)
    followed = "this terminal only follows"
    stage.wait_for(lambda: followed in stage.said("ssp_run"), "the runner's word")
    stage.start("pressed", [sys.executable, "-c", PRESS, run_file, "abort"])
    result = stage.finish(run)
    assert (result["verdict"], result["status"]) == ("aborted", 1), result["reasons"]
    assert "page_of_somebody" in " ".join(result["reasons"]), result["reasons"]
    # Of a run that was begun elsewhere, too: live, both clocks are the wall's. A busy machine may
    # let the runner hear of the start late, and of the end however late.
    assert 0.0 < 0.5 * result["session_s"] <= result["running_wall_s"], result["reasons"]
    assert stage.rows()[-1].speed_mps == 0.0


def test_a_receiver_of_places_is_kept_from_arming_until_it_is_good_enough(
    stage: Any, task: Callable[[str], Path]
) -> None:
    folder = task("cut_in")
    surveyed = load_run(folder / RUN_FILE).model_copy(update={"datum": DATUM})
    (folder / RUN_FILE).write_text(surveyed.model_dump_json(by_alias=True))
    run = stage.run_live(folder, "--no-camera", *bodies_of(stage), receiver=GNSS)
    play_bodies(stage)
    poor = play_vut(stage, "poor_vut", *GNSS, "--fix-type", "1")
    why = "the VUT's GNSS/INS gives no state: fix type: SBAS, GBAS is asked for"
    told = stage.doctor(receiver=GNSS[:2])
    # A busy machine publishes with pauses.
    navsat = told["navsat"]
    assert navsat["status"] == "ok" or "a pause of" in navsat["text"], navsat
    assert why in told["arming"]["text"]
    assert run.stdin is not None
    run.stdin.write(b"start\n")
    run.stdin.flush()
    stage.wait_for(lambda: stage.said("ssp_run").count(ASKS) == 2, "the word to run out")
    asked = stage.said("ssp_run")
    assert f"not started within {HOLDS_S:g} s: " in asked
    assert why in asked.partition(f"not started within {HOLDS_S:g} s: ")[2].partition("\n")[0]
    poor.terminate()
    poor.wait()
    play_vut(stage, "good_vut", *GNSS)
    stage.said_after(run, "vut: connected now")
    assert "session ARM" not in stage.said("ssp_run"), "a word that ran out started it"
    stage.begin(run)
    result = stage.finish(run)
    assert (result["verdict"], result["status"]) == ("valid", 0), result["reasons"]


def test_the_vut_falls_silent(stage: Any, task: Callable[[str], Path]) -> None:
    run, _, vut = start_driving(stage, task("cut_in"))
    os.killpg(vut.pid, signal.SIGKILL)
    result = stage.finish(run)
    assert (result["verdict"], result["status"]) == ("aborted", 1), result["reasons"]
    reasons = " ".join(result["reasons"])
    assert "vut_silent" in reasons or "state_stale" in reasons, reasons
    assert stage.rows()[-1].speed_mps == 0.0


def test_a_body_falls_silent(stage: Any, task: Callable[[str], Path]) -> None:
    run, bodies, _ = start_driving(stage, task("cut_in"))
    bodies.kill()
    result = stage.finish(run)
    assert (result["verdict"], result["status"]) == ("aborted", 1), result["reasons"]
    reasons = " ".join(result["reasons"])
    assert "ot1" in reasons, reasons
    assert "state_stale" in reasons or "object_silent" in reasons, reasons


@pytest.mark.parametrize("kind", ["bodies", "iso"])
def test_a_rehearsal_that_stays_up_serves_the_next_run_too(
    stage: Any, task: Callable[..., Path], kind: str
) -> None:
    """Two runs in a row, without a pause: what it plays goes back to its starts for the second."""
    folder = task("cut_in", datum=kind == "iso")
    start = load_run(folder / RUN_FILE).targets[0].start.pose
    played = ("--play", "vut", "--play", kind, "--first-port", "0", "--log", str(stage.log))
    rehearsal = stage.play("rehearsal", *played, what=folder)
    bodies = re.findall(r"^(--body) (\S+)$", stage.said("rehearsal"), re.M)[0]
    if kind == "iso":
        bodies = (bodies[0], f"{bodies[1]}?waive=A. Tester")
    for number in (1, 2):
        run = stage.run_live(folder, "--no-camera", *bodies)
        stage.begin(run)
        stage.wait_for_motion(run, 1.0)
        run.send_signal(signal.SIGINT)
        result = stage.finish(run)
        assert (result["verdict"], result["status"]) == ("aborted", 1), (number, result)
        assert result["running_wall_s"] > 0.0
        if number == 1:
            stood = stage.rows()[-1]
            assert math.dist((stood.x_m, stood.y_m), (start.x_m, start.y_m)) > 0.05
            (stage.folder / "run").rename(stage.folder / "run_1")
    assert rehearsal.poll() is None, stage.said("rehearsal")
