"""A driver in a process of its own: its session has the states of the run in one process."""

from __future__ import annotations

import hashlib
import json
import os
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from ssp_core import names
from ssp_core.bag.reading.reader import BagReader
from ssp_core.compiled import core_in_use
from ssp_core.run_file.latency import Latency
from ssp_core.run_file.model import Camera
from ssp_core.vocabulary import SessionPhase
from ssp_core.world.driver import driver_options
from ssp_scenario_manager.closed_loop.starts.start import make_start
from ssp_scenario_manager.compile.targets.folder import prepare_run
from ssp_scenario_manager.event_spec.load import load_event
from tests.support.events.walls import with_wall
from tests.system.conftest import Beside

pytestmark = [pytest.mark.ros, pytest.mark.system]


def test_a_driver_leads_the_vut_over_dds_to_the_states_of_one_process(start_session: Any) -> None:
    """Its outcome would be ``harness`` otherwise: each session is held against one process."""
    session = start_session("cut_in", "--drive", "oracle", "--latency", "fixed:0.2", name="driven")
    result = session.finish()
    assert (result["verdict"], result["in_process"]) == ("valid", False), session.lines
    driven = result["driven"]
    assert (driven["outcome"], driven["why"]) == ("avoided", "no contact until T_end")
    assert "oracle: avoided at" in session.out
    assert "oracle, L = 0.2 s: avoided at" in (session.folder / "top_view.svg").read_text()
    with BagReader(session.folder / "bag") as bag:
        counts = Counter(message.topic for message in bag.messages())
    # The world goes on for a few steps behind T_end, and one frame may fall on them.
    assert counts["/ssp/vla/oracle/request"] - driven["questions"] in (0, 1)
    assert counts["/ssp/vla/oracle/response"] - driven["answers"] in (0, 1)
    assert counts["/ssp/vut/reference_ack"] == counts["/ssp/vla/oracle/response"]
    assert counts["/ssp/vut/reference"] > 50


@pytest.mark.parametrize(
    ("driver", "outcome"), [("no_response", "collision"), ("built_in", "avoided")]
)
def test_a_vut_that_is_commanded_without_plans_has_the_states_of_one_process(
    start_session: Any, driver: str, outcome: str
) -> None:
    """The world leads it: there is no node that could answer with a plan."""
    session = start_session("cut_in", "--drive", driver, "--no-camera", name=driver)
    result = session.finish()
    assert (result["verdict"], result["reasons"]) == ("valid", []), session.lines
    assert (result["driven"]["outcome"], result["in_process"]) == (outcome, False), result["driven"]
    assert result["driven"]["questions"] == 0
    assert result["compiled_core"] == core_in_use()
    assert not (session.folder / "logs" / "vut_driver.log").exists()
    if driver == "no_response":
        assert result["driven"]["v_i_mps"] == result["driven"]["v_r_mps"]


MODEL = """
import pathlib

ASKED = []
SLOW_ONCE = pathlib.Path(__file__).with_name("slow")


def drive(request):
    ASKED.append(request)
    if len(ASKED) == 3 and not SLOW_ONCE.exists():
        SLOW_ONCE.touch()
        pathlib.Path(__file__).with_name("held").read_text()
    v = request.history[-1].speed_mps
    # The first questions are of frames before the hand-over.
    aside = -0.3 if len(ASKED) == 5 else 0.0
    return "I keep my speed.", [(0.5 * v * k, aside * k) for k in range(11)]
"""
# Lets the model answer when the world has said a step again, twice: it holds for the model alone.
LISTENER = """
import collections
import sys
import rclpy
from ssp_core import names, ros
from ssp_core.cdr.steps import decode_tick
from ssp_msgs import msg
rclpy.init()
node = ros.make_node("listener")
said = collections.Counter()

def hear(data):
    tick = decode_tick(data)
    said[tick.step] += tick.running

node.create_subscription(msg.WorldTick, names.WORLD_TICK, hear, ros.STATE, raw=True)
executor = ros.make_executor()
executor.add_node(node)
print("there", flush=True)
while max(said.values(), default=0) < 3:
    executor.spin_once(timeout_sec=0.2)
open(sys.argv[1], "w").close()
"""


def test_a_model_drives_over_dds_into_a_wall_and_is_never_lost_for_being_slow(
    start_session: Any, beside: Beside, tmp_path: Path
) -> None:
    """It answers once when the world has said that it holds; its outcome would be ``harness``."""
    os.mkfifo(tmp_path / "held")
    (tmp_path / "slow_models.py").write_text(MODEL)
    options: dict[str, Any] = {
        "backend": "python",
        "function": "slow_models:drive",
        "folder": str(tmp_path),
    }
    # The hold has no other limit.
    options["timeout_s"] = 600.0
    given = f"slow={json.dumps(options)}"
    # A start with a camera of few pixels, which cost nothing to draw.
    made = tmp_path / "start"
    run = with_wall(prepare_run("cut_in", "boulevard", made, seed=1, mode="lockstep"))
    small = run.model_copy(update={"camera": Camera(width_px=64, height_px=64)})
    start = make_start(small, load_event("cut_in")[0], 1, latency_max_s=0.3)
    driven_run = start.driven_by("slow", driver_options("slow", options), Latency(0.3))
    (made / "run.yaml").write_text(driven_run.model_dump_json(by_alias=True))
    session = start_session(
        str(made), "--drive", given, "--latency", "fixed:0.3", folder=tmp_path / "model"
    )
    beside(session, "-c", LISTENER, str(tmp_path / "held"))
    result = session.finish()
    assert (result["verdict"], result["reasons"]) == ("valid", []), session.lines
    driven = result["driven"]
    assert (driven["outcome"], driven["frames"]) == ("collision", True)
    assert driven["why"].startswith("with building road.scenery[0], ")
    assert driven["unled_s"] == 0.0
    with BagReader(session.folder / "bag") as bag:
        requests = [bag.decode(m) for m in bag.messages(["/ssp/vla/slow/request"])]
        images = [bag.decode(m) for m in bag.messages([names.absolute(names.CAMERA_IMAGE)])]
        responses = list(bag.messages(["/ssp/vla/slow/response"]))
        session_topic = [names.absolute(names.SESSION_STATE)]
        changes = [bag.decode(m) for m in bag.messages(session_topic)]
    # It drives into a wall, which ends its run as it does in one process.
    (stop,) = (one.header.stamp for one in changes if one.state == SessionPhase.STOPPING)
    assert stop.sec + stop.nanosec / 1e9 == pytest.approx(driven["outcome_s"] + 1.0)
    assert len(requests) - driven["questions"] in (0, 1)
    assert len(responses) - driven["answers"] in (0, 1)
    drawn = {hashlib.sha256(bytes(image.data)).hexdigest() for image in images}
    shown = {frame.format.rpartition(":")[2] for one in requests for frame in one.frames}
    assert shown <= drawn
    kept = json.loads((session.folder / "answers.json").read_text())
    assert len(kept["event"]) == driven["questions"]
    # The session may end before the question of its last frame has been answered.
    assert driven["answers"] >= driven["questions"] - 1
    answered = kept["event"][: driven["answers"]]
    assert {one["given"]["answer"]["text"] for one in answered} == {"I keep my speed."}
    assert kept["free"]
    assert (tmp_path / "slow").exists()
