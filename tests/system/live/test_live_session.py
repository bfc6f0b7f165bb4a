"""A physical session whose hardware is played by a second process group; nothing is simulated."""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from ssp_core import names
from ssp_core.bag import BagReader
from ssp_core.domains import free_domain
from ssp_core.run_spec import load_run
from ssp_scenario_manager.sros2 import rights

pytestmark = [pytest.mark.ros, pytest.mark.system, pytest.mark.alone]


@pytest.fixture
def stage(make_stage: Callable[[dict[str, str]], Any]) -> Iterator[Any]:
    """One host: all processes on loopback, in a domain of their own."""
    with free_domain() as domain:
        made = make_stage(
            {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        )
        yield made
        made.close()


def bodies_of(stage: Any) -> tuple[str, ...]:
    """Where the played bodies listen; they need no run to be heard of."""
    return ("--body", f"ot1=udp://127.0.0.1:{PORT + os.getpid() % 1000}")


PORT = 18000
ODOMETRY = "/ins/odometry"


def play_bodies(stage: Any) -> subprocess.Popen[Any]:
    port = str(PORT + os.getpid() % 1000)
    parts = ("--play", "bodies", "--first-port", port, "--log", str(stage.log))
    played: subprocess.Popen[Any] = stage.play("bodies", *parts)
    return played


def play_vut(stage: Any, name: str = "vut", *faults: str) -> subprocess.Popen[Any]:
    played: subprocess.Popen[Any] = stage.play(name, "--play", "vut", *faults)
    return played


def test_a_session_that_the_doctor_lets_arm(stage: Any, task: Callable[[str], Path]) -> None:
    """Doctor with a bad GNSS/INS, with a good one, and the whole run after it."""
    run = stage.run_live(task("cut_in"), *bodies_of(stage))
    play_bodies(stage)
    stage.play("camera", "--play", "camera")
    bad = play_vut(stage, "bad_vut", "--frame", "odom", "--rate", "10", "--clock-offset", "0.4")
    told = stage.doctor()
    assert told["odometry"]["status"] == "fail"
    for culprit in ("frame 'odom', must be 'map'", "the run wants 50 Hz", "ahead of this host's"):
        assert culprit in told["odometry"]["text"]
    assert "no state of the VUT arrives" in told["arming"]["text"]
    bad.terminate()
    bad.wait()
    play_vut(stage)
    stage.ask_doctor()
    check_policy(stage)
    stage.begin(run)
    result = stage.finish(run)
    assert (result["verdict"], result["status"]) == ("valid", 0), (result, stage.said("ssp_run"))
    check_bag(stage.folder / "run" / "bag")


def test_the_rehearsal_says_how_its_session_is_begun(
    stage: Any, task: Callable[[str], Path]
) -> None:
    """Started first, with the compiled folder alone; then its command, then the page's buttons."""
    stage.play("rehearsal", "--first-port", "0", what=task("vru_crossing"))
    (said,) = re.findall(r"^  \S*ssp (run .*)$", stage.said("rehearsal"), re.M)
    arguments = [*shlex.split(said), "0", "--out", str(stage.folder / "run")]
    # The page on any free port: its option takes one, wherever it stands.
    page = arguments.index("--page")
    arguments.insert(page + 1, arguments.pop(arguments.index("0")))
    run = stage.start_run(arguments)
    (url,) = re.findall(r"operator page: (\S+)#token=(\S+)", stage.said_after(run, "operator page"))
    for command, state in (("connect", "CONNECTED"), ("arm", "ARMED"), ("start", "RUNNING")):
        stage.wait_for(partial(pressed, *url, command), f"{command} to be accepted")
        stage.wait_for(lambda s=state: f"session {s}" in stage.said("ssp_run"), state)
    result = stage.finish(run)
    assert (result["verdict"], result["status"]) == ("valid", 0), (result, stage.said("ssp_run"))
    assert 10.0 < result["session_s"] < 40.0
    assert result["initiator_first"] is True
    low_s, high_s = result["wanted"]["least_gap_s"], result["wanted"]["most_gap_s"]
    assert low_s <= result["time_gap_s"] <= high_s


def pressed(url: str, token: str, command: str) -> bool:
    """A button of the page; False while it isn't taken."""
    request = urllib.request.Request(
        f"{url}api/command/{command}",
        data=b"",
        headers={"Authorization": f"Bearer {token}", "Origin": url.rstrip("/")},
    )
    try:
        with urllib.request.urlopen(request, timeout=5.0) as response:
            return bool(json.load(response)["accepted"])
    except urllib.error.HTTPError:
        return False


def check_policy(stage: Any) -> None:
    """The SROS2 policy allows every endpoint that the running nodes have."""
    spec = load_run(stage.folder / "run" / "run.yaml")
    table = rights(spec, ODOMETRY)
    done = subprocess.run(
        [sys.executable, "-c", GRAPH],
        env=stage.env,
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    graph: dict[str, dict[str, list[str]]] = json.loads(done.stdout)
    expected = {"scenario_manager", "monitor", "monitor_intake", "object_target", "vut_adapter"}
    assert expected | {"ssp_run"} <= set(graph)
    not_allowed = []
    for node, found in graph.items():
        if node not in table:
            continue
        right = table[node]
        own = tuple(f"{node}/{service}" for service in right.own)
        allowed = {
            "publishes": (*right.publishes, "/rosout", "/parameter_events"),
            # A node hears of its own clock and parameters where it asks to.
            "hears": (*right.hears, "/clock", "/parameter_events"),
            "serves": (*right.serves, *own),
            "calls": right.calls,
        }
        for kind, has in found.items():
            may = {names.absolute(name) for name in allowed[kind]}
            more = {name for name in has if "/_action/" not in name} - may
            not_allowed += [(node, kind, name) for name in sorted(more)]
    assert not_allowed == []


GRAPH = """
import json, time, rclpy
rclpy.init()
node = rclpy.create_node("graph", namespace="/graph", start_parameter_services=False)
kinds = {"publishes": "publisher", "hears": "subscriber", "serves": "service", "calls": "client"}
until = time.monotonic() + 4.0
while time.monotonic() < until:
    rclpy.spin_once(node, timeout_sec=0.1)
found = {}
for name, namespace in node.get_node_names_and_namespaces():
    if namespace == "/ssp":
        asked = {k: getattr(node, f"get_{w}_names_and_types_by_node") for k, w in kinds.items()}
        found[name] = {k: [n for n, _ in ask(name, namespace)] for k, ask in asked.items()}
print(json.dumps(found))
"""


def check_bag(bag: Path) -> None:
    checked = subprocess.run([sys.executable, "-m", "ssp_core.cli", "bag", "check", str(bag)])
    assert checked.returncode == 0
    with BagReader(bag) as reader:
        counts = {name: info.count for name, info in reader.topics.items()}
    for topic in (
        *(names.state_topic(who) for who in ("vut", "ot1")),
        *(names.CAMERA_IMAGE, names.CAMERA_INFO, names.SESSION_STATE, names.TRIGGER_EVENT),
        *(names.reference_topic("ot1"), names.ack_topic("ot1"), names.HEARTBEAT_REPLY),
    ):
        assert counts.get(names.absolute(topic), 0) > 0, topic
    assert counts[names.absolute(names.CAMERA_IMAGE)] >= 50
    assert names.absolute(names.WORLD_TICK) not in counts


def start_driving(stage: Any, task: Path) -> tuple[Any, Any, Any]:
    run = stage.run_live(task, "--no-camera", *bodies_of(stage))
    bodies, vut = play_bodies(stage), play_vut(stage)
    stage.begin(run)
    stage.wait_for_motion(run, 1.0)
    return run, bodies, vut


PRESS = """
import sys, time
import rclpy
from ssp_core import names
from ssp_msgs.srv import SessionCommand

rclpy.init()
node = rclpy.create_node("page_of_somebody", namespace=names.NAMESPACE)
for command in sys.argv[1:]:
    client = node.create_client(SessionCommand, command)
    client.wait_for_service(20.0)
    until = time.monotonic() + 40.0
    while time.monotonic() < until:
        call = client.call_async(SessionCommand.Request(requested_by="page_of_somebody"))
        rclpy.spin_until_future_complete(node, call, timeout_sec=20.0)
        if call.result().accepted:
            break
        time.sleep(0.2)
    print(command, call.result().accepted, call.result().error_msg, flush=True)
"""


def test_a_start_and_an_abort_from_the_page_are_followed(
    stage: Any, task: Callable[[str], Path]
) -> None:
    """Nobody presses Enter at the terminal: the commands come as the operators' page gives them."""
    run = stage.run_live(task("cut_in"), *bodies_of(stage))
    play_bodies(stage)
    stage.play("camera", "--play", "camera")
    play_vut(stage)
    stage.start("pressed", [sys.executable, "-c", PRESS, "connect", "arm", "start"])
    stage.wait_for_motion(run, 1.0)
    assert "begun or aborted from elsewhere" in stage.said("ssp_run")
    stage.start("pressed", [sys.executable, "-c", PRESS, "abort"])
    result = stage.finish(run)
    assert (result["verdict"], result["status"]) == ("aborted", 1), result
    assert "page_of_somebody" in " ".join(result["reasons"]), result
    assert stage.rows()[-1].speed_mps == 0.0


def test_the_vut_falls_silent(stage: Any, task: Callable[[str], Path]) -> None:
    run, _, vut = start_driving(stage, task("cut_in"))
    os.killpg(vut.pid, signal.SIGKILL)
    result = stage.finish(run)
    assert (result["verdict"], result["status"]) == ("aborted", 1), result
    reasons = " ".join(result["reasons"])
    assert "vut_silent" in reasons or "state_stale" in reasons, reasons
    assert stage.rows()[-1].speed_mps == 0.0


def test_a_body_falls_silent(stage: Any, task: Callable[[str], Path]) -> None:
    run, bodies, _ = start_driving(stage, task("cut_in"))
    bodies.kill()
    result = stage.finish(run)
    assert (result["verdict"], result["status"]) == ("aborted", 1), result
    reasons = " ".join(result["reasons"])
    assert "ot1" in reasons, reasons
    assert "state_stale" in reasons or "object_silent" in reasons, reasons
