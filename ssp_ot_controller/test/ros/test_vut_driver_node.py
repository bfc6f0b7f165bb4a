"""The vut_driver node as a process, with a model that is still being loaded."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from ssp_core.host.environment import session_environment
from ssp_core.run_file.driven import Driven
from ssp_core.run_file.model import Camera, RunSpec
from ssp_core.world.driver import driver_options
from tests.support.processes.waiting import DEADLINE_S
from tests.support.runs import cut_in_run

pytestmark = pytest.mark.ros


def test_a_node_that_is_ended_while_its_model_loads_ends_at_once(
    domain: int, tmp_path: Path
) -> None:
    loads = tmp_path / "loads"
    os.mkfifo(loads)
    (tmp_path / "loading_models.py").write_text(
        f"import time\n\nopen({str(loads)!r}, 'w').close()\ntime.sleep(3600.0)\n"
    )
    given = {"backend": "python", "function": "loading_models:drive", "folder": str(tmp_path)}
    driven = Driven(
        driver="slow",
        options=driver_options("slow", given),
        first_request_s=0.2,
        hand_over_s=1.0,
        end_s=9.0,
    )
    run = RunSpec.model_validate(cut_in_run()).model_copy(
        update={"driven": driven, "camera": Camera(width_px=64, height_px=64)}
    )
    (tmp_path / "run.yaml").write_text(run.model_dump_json(by_alias=True))
    module, run_file = "ssp_ot_controller.ros.vut_driver", tmp_path / "run.yaml"
    node = subprocess.Popen(
        [sys.executable, "-m", module, "--ros-args", "-p", f"run_file:={run_file}"],
        env=session_environment(domain),
    )
    try:
        loads.read_text()  # until the model opens it
        node.terminate()
        assert node.wait(DEADLINE_S) == 0
    finally:
        node.kill()
        node.wait()
