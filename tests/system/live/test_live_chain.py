"""A rehearsed session through the whole chain: begun by hand, recorded, audited, scored."""

from __future__ import annotations

import asyncio
import json
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from ssp_core import names
from ssp_core.bag.reading.reader import BagReader
from ssp_core.run_file.model import load_run
from ssp_scenario_manager.sros2 import rights
from tests.system.live.conftest import DEADLINE_S, ODOMETRY
from tests.system.live.scored import everybody_declares_simulated, is_admitted_and_scored
from tests.system.recordings import Recordings

pytestmark = [pytest.mark.ros, pytest.mark.system]

EVENT = "vru_crossing"


def rehearsed(stage: Any, task: Path) -> Path:
    """The rehearsal first, with the compiled folder alone; then its command, the page's buttons."""
    stage.play("rehearsal", "--first-port", "0", what=task)
    (said,) = re.findall(r"^  \S*ssp (run .*)$", stage.said("rehearsal"), re.M)
    arguments = [*shlex.split(said), "0", "--out", str(stage.folder / "run")]
    # The page on any free port: its option takes one, wherever it stands.
    page = arguments.index("--page")
    arguments.insert(page + 1, arguments.pop(arguments.index("0")))
    run = stage.start_run(arguments)
    (url,) = re.findall(r"operator page: (\S+)#token=(\S+)", stage.said_after(run, "#token="))
    stage.ask_doctor()
    check_policy(stage)
    for command, state in (("connect", "CONNECTED"), ("arm", "ARMED"), ("start", "RUNNING")):
        stage.wait_for(partial(pressed, *url, command), f"{command} to be accepted")
        stage.wait_for(lambda s=state: f"session {s}" in stage.said("ssp_run"), state)
    result = stage.finish(run)
    assert (result["verdict"], result["status"]) == ("valid", 0), result["reasons"]
    assert result["session_s"] > 10.0
    assert result["initiator_first"] is True
    low_s, high_s = result["wanted"]["least_gap_s"], result["wanted"]["most_gap_s"]
    assert low_s <= result["time_gap_s"] <= high_s
    return Path(stage.folder / "run")


def pressed(url: str, token: str, command: str) -> bool:
    """A button of the page, pressed for the state that it shows; False while it isn't taken."""
    return asyncio.run(_press(url, token, command))


async def _press(url: str, token: str, command: str) -> bool:
    bearer = {"Authorization": f"Bearer {token}", "Origin": url.rstrip("/")}
    async with aiohttp.ClientSession(timeout=aiohttp.ClientTimeout(20.0)) as client:
        async with client.ws_connect(f"{url}api/live", headers={"Origin": url.rstrip("/")}) as page:
            await page.send_json({"type": "hello", "token": token})
            told: dict[str, Any] = {}
            while told.get("type") != "snapshot":
                message = await page.receive(timeout=DEADLINE_S)
                if message.type is aiohttp.WSMsgType.BINARY:  # a picture of the camera
                    continue
                assert message.type is aiohttp.WSMsgType.TEXT, f"no snapshot came: {message}"
                told = json.loads(message.data)
                if told.get("type") == "mark":
                    await page.send_json({"echo": told["n"]})
        shown = {"shown": told["session"]["press"]}
        async with client.post(
            f"{url}api/command/{command}", json=shown, headers=bearer
        ) as response:
            return bool((await response.json())["accepted"])


def check_policy(stage: Any) -> None:
    """The SROS2 policy allows every endpoint that the running nodes have."""
    spec = load_run(stage.folder / "run" / "run.yaml")
    table = rights(spec, ODOMETRY)
    done = subprocess.run(
        [sys.executable, "-c", GRAPH, *EXPECTED],
        env=stage.env,
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
        check=True,
    )
    graph: dict[str, dict[str, list[str]]] = json.loads(done.stdout)
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


EXPECTED = (
    "scenario_manager",
    "monitor",
    "monitor_intake",
    "object_target",
    "vut_adapter",
    "ssp_run",
)
GRAPH = """
import json, sys, time, rclpy
rclpy.init()
node = rclpy.create_node("graph", namespace="/graph", start_parameter_services=False)
kinds = {"publishes": "publisher", "hears": "subscriber", "serves": "service", "calls": "client"}
while not set(sys.argv[1:]) <= set(node.get_node_names()):
    rclpy.spin_once(node, timeout_sec=0.1)
until = time.monotonic() + 2.0  # their endpoints are told after them
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


def test_a_rehearsal_is_admitted_and_scored_beside_its_partners(
    stage: Any, task: Callable[[str], Path], recordings: Recordings, tmp_path: Path
) -> None:
    physical = rehearsed(stage, task(str(recordings.k_star(EVENT))))
    check_bag(physical / "bag")
    stage.close()
    everybody_declares_simulated(physical)
    is_admitted_and_scored(recordings, EVENT, physical, tmp_path)
