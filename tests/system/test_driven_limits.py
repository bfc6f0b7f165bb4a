"""The ends of a session that a model drives over DDS: fence, limit, the operator's abort."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any

import pytest

from ssp_core.run_file.latency import Latency
from ssp_core.run_file.model import Camera
from ssp_scenario_manager.closed_loop.starts.start import make_start
from ssp_scenario_manager.compile.targets.folder import prepare_run
from ssp_scenario_manager.event_spec.load import load_event
from tests.support.bags.messages import last_speeds
from tests.support.processes.children import is_alive
from tests.support.processes.waiting import until
from tests.system.conftest import Beside

pytestmark = [pytest.mark.ros, pytest.mark.system]

LATENCY = "fixed:0.3"
# A part of the right lane that the fence leaves out: the VUT's lane, up to 1.75 m to the right.
NOTCH = [(80.0, -1.5), (110.0, -1.5)]

MODELS = """
import itertools
import os
import pathlib

NUMBERS = itertools.count(1)
FOLDER = pathlib.Path(__file__).parent
# The first questions are of frames before the hand-over.
DRIVING = 4


def plan(request, along_mps=None, left_mps=0.0):
    v = request.history[-1].speed_mps if along_mps is None else along_mps
    return "I drive.", [(0.5 * v * k, 0.5 * left_mps * k) for k in range(11)]


def veers(request):
    number = next(NUMBERS)
    if number == DRIVING:
        # 40 m/s^2 over half a second.
        v = request.history[-1].speed_mps
        return "I jump.", [(0.5 * v * k + (10.0 if k else 0.0), 0.0) for k in range(11)]
    return plan(request, left_mps=-1.5 if number > DRIVING else 0.0)


def races(request):
    return plan(request, 17.0 if next(NUMBERS) >= DRIVING else None)


def hangs(request):
    if next(NUMBERS) == DRIVING:
        (FOLDER / "asked").write_text(str(os.getpid()))
        (FOLDER / "never").read_text()
    return plan(request)
"""
# Calls the session's abort while the model is asked; prints its answer, and the model's process.
OPERATOR = """
import sys
import rclpy
from ssp_core import ros
from ssp_msgs.srv import SessionCommand
from tests.support.processes.waiting import answer_of
rclpy.init()
node = ros.make_node("operator")
abort = node.create_client(SessionCommand, "abort")
executor = ros.make_executor()
executor.add_node(node)
def spin_until(condition, what):
    while not condition():
        executor.spin_once(timeout_sec=0.2)
spin_until(abort.service_is_ready, "the abort")
print("there", flush=True)
asked = open(sys.argv[1]).read()
request = SessionCommand.Request(requested_by="operator", reason="seen enough")
print(answer_of(abort, request, spin_until).accepted, asked, flush=True)
"""


@pytest.fixture(scope="module")
def start_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A start of ``cut_in`` with a notch of the fence in the VUT's lane; its camera is cheap."""
    folder = tmp_path_factory.mktemp("limits") / "start"
    run = prepare_run("cut_in", "boulevard", folder, seed=1, mode="lockstep")
    first, *others = run.geofence
    (x_m, _), (further_m, _) = NOTCH
    notch = [(x_m, first[1]), *NOTCH, (further_m, first[1])]
    camera = Camera(width_px=64, height_px=64)
    small = run.model_copy(update={"geofence": [first, *notch, *others], "camera": camera})
    start = make_start(small, load_event("cut_in")[0], 1, latency_max_s=0.3)
    driven_run = start.driven_by("oracle", {}, Latency(0.3)).model_copy(update={"camera": camera})
    (folder / "run.yaml").write_text(driven_run.model_dump_json(by_alias=True))
    (folder / "limit_models.py").write_text(MODELS)
    return folder


def model(folder: Path, name: str) -> str:
    """The model of a name, as behind ``--drive``; only an abort ends the one that hangs."""
    options = {"backend": "python", "function": f"limit_models:{name}", "folder": str(folder)}
    return f"{name}={json.dumps({**options, 'timeout_s': 600.0})}"


def check_end(session: Any, verdict: str) -> dict[str, Any]:
    """Holds that all stand, and that the outcome has the verdict's reason; the outcome's part."""
    result = session.finish()
    assert (session.process.returncode, result["verdict"]) == (1, verdict), session.lines
    driven: dict[str, Any] = result["driven"]
    assert (driven["outcome"], [driven["why"]]) == ("fence", result["reasons"])
    assert driven["outcome_s"] > driven["hand_over_s"]
    assert last_speeds(session.folder / "bag") == {"vut": 0.0, "ot1": 0.0}
    return driven


@pytest.mark.parametrize(
    ("name", "why"), [("veers", "outside_geofence: vut: "), ("races", "over_speed: vut: 15")]
)
def test_a_model_that_leaves_the_fence_or_is_too_fast_ends_the_session(
    start_session: Any, start_folder: Path, name: str, why: str
) -> None:
    session = start_session(
        str(start_folder), "--drive", model(start_folder, name), "--latency", LATENCY
    )
    driven = check_end(session, "failed_safety")
    assert driven["why"].startswith(why)
    refused = [one["why"] for one in driven["refused"]]
    if name == "veers":
        # It asked for too hard an acceleration before; the VUT kept its plan.
        (hard,) = refused
        assert re.fullmatch(r"needs [45]\d(\.\d)? m/s\^2, at most 12 m/s\^2", hard)
    else:
        assert refused == []


def test_the_operator_aborts_a_session_while_its_model_is_asked(
    start_session: Any, start_folder: Path, beside: Beside
) -> None:
    """A model that hangs holds the world, and ends with the abort."""
    for pipe in ("asked", "never"):
        os.mkfifo(start_folder / pipe)
    session = start_session(
        str(start_folder), "--drive", model(start_folder, "hangs"), "--latency", LATENCY
    )
    operator = beside(session, "-c", OPERATOR, str(start_folder / "asked"))
    driven = check_end(session, "aborted")
    assert driven["why"].startswith("abort by operator: seen enough at ")
    # The question that the abort cut off has no answer any more.
    assert (driven["questions"], driven["answers"]) == (4, 3)
    accepted, pid = operator.communicate()[0].split()
    assert accepted == "True"
    until(lambda: not is_alive(int(pid)), "end of the model")
