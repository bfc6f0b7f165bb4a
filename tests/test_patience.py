"""No test that judges something else fails for a silence of its own busy machine."""

from __future__ import annotations

import json
import re
import subprocess
import sys

import pytest

from tests.support.processes.patience import PATIENT_S, ROOT

pytest.importorskip("rclpy")
LIMITS = """
import json
import tests.support.processes.patient_manager
from ssp_core.run_file.model import RunSpec
from ssp_core.safety import arming, liveness
from ssp_scenario_manager.session import supervision
from tests.support.processes.patience import patient
from tests.support.runs import cut_in_run

found = {"recorder": arming.RECORDER_SIGN.limit_s, "world": supervision.WORLD_SILENT_LOCKSTEP_S}
for mode in ("lockstep", "live"):
    run = RunSpec.model_validate(patient({**cut_in_run(), "mode": mode, "camera": {}}))
    for sign in liveness.signs_of_life(run):
        found[f"{mode} {sign.code.name} {sign.who}"] = sign.limit_s
print(json.dumps(found))
"""
NODE = re.compile(r"""["']-m["'],\s*["']ssp_scenario_manager\.ros\.manager_node["']""")


def test_a_patient_manager_bears_a_minute_of_silence_of_everybody() -> None:
    command = [sys.executable, "-c", LIMITS]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    assert len(found) > 10
    assert {who: limit_s for who, limit_s in found.items() if limit_s < PATIENT_S} == {}


def test_no_test_starts_a_manager_with_its_own_limits() -> None:
    """The recorder that such a test plays stood for 2.03 s once, and the limit is 2 s."""
    files = [*ROOT.glob("ssp_*/test/**/*.py"), *ROOT.glob("tests/**/*.py")]
    assert len(files) > 500
    assert [str(one.relative_to(ROOT)) for one in files if NODE.search(one.read_text())] == []
