"""A live session through the whole chain: recorded, labelled, audited, scored."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ssp_core.bag import BagReader
from ssp_core.domains import free_domain
from ssp_eval.audit.model import load_audit
from ssp_scenario_manager.spec.load import load_event

pytestmark = [pytest.mark.ros, pytest.mark.system, pytest.mark.alone]

STEP_S = 240.0
PORT = 19000


def ssp(*arguments: object) -> str:
    """A command that must succeed; what it printed."""
    done = subprocess.run(
        [sys.executable, "-m", "ssp_core.cli", *map(str, arguments)],
        capture_output=True, text=True, timeout=STEP_S, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def live_session(stage: Any, task: Path) -> Path:
    """The run's folder, once it ended well."""
    port = str(PORT + os.getpid() % 1000)
    run = stage.run_live(task, "--body", f"ot1=udp://127.0.0.1:{port}")
    stage.play("bodies", "--play", "bodies", "--first-port", port, "--log", str(stage.log))
    stage.play("camera", "--play", "camera")
    stage.play("vut", "--play", "vut")
    stage.ask_doctor()
    stage.begin(run)
    result = stage.finish(run)
    assert (result["verdict"], result["status"]) == ("valid", 0), (result, stage.said("ssp_run"))
    return Path(stage.folder / "run")


def test_a_live_rehearsal_is_admitted_and_scored_beside_its_partners(
    make_stage: Callable[[dict[str, str]], Any], task: Callable[[str], Path], tmp_path: Path
) -> None:
    chain = tmp_path / "chain"
    ssp("spec", "clip", "cut_in", "--out", chain)
    bound = chain / "cut_in.event.yaml"
    with free_domain() as domain:
        stage = make_stage(
            {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        )
        physical = live_session(stage, task(str(bound)))
        stage.close()
    simulation, synthetic = chain / "simulation", chain / "synthetic"
    ssp("run", bound, "--site", "boulevard", "--seed", 11, "--out", simulation)
    ssp(
        "import-video", chain / "cut_in.mp4", "--scenario", "cut_in",
        "--event-version", load_event(str(bound))[1], "--generator", "ssp-clip/1",
        "--ego-speed", 13, "--out", synthetic / "bag",
    )  # fmt: skip
    recordings = synthetic, simulation, physical
    ssp("labels", "new", *recordings, "--truth", chain / "cut_in.truth.json")
    ssp("audit", *recordings, "--out", chain / "audit")
    audit = load_audit(chain / "audit")
    assert [entry.status for entry in audit.recordings] == ["admitted"] * 3
    live = audit.recordings[2]
    with BagReader(physical / "bag") as bag:
        assert "/ssp/world/tick" not in bag.topics
    assert (live.evidence, live.measured_from) == (
        "states", "states that VUT and object targets reported",
    )  # fmt: skip
    assert live.kpr == 1.0
    assert live.epd is not None
    assert live.epd < 0.15
    assert audit.labels is not None
    assert "not comparable" not in audit.labels
    counts = [entry.labels.per_phase for entry in audit.recordings if entry.labels is not None]
    assert len(counts) == 3
    assert counts[0] == counts[1] == counts[2]
    ssp(
        "evaluate", *(folder / "bag" for folder in recordings), "--audit", chain / "audit",
        "--bridge", "constant_velocity", "--no-controls", "--out", chain / "out",
    )  # fmt: skip
    cells = [json.loads(file.read_text()) for file in sorted(chain.glob("out/cells/*/cell.json"))]
    assert [cell["admission"]["status"] for cell in cells] == ["admitted"] * 3
    scores = [
        json.loads(f.read_text())["ivcs"] for f in sorted(chain.glob("out/cells/*/score.json"))
    ]
    # A model that sees nothing of the picture scores nearly the same everywhere.
    assert max(scores) - min(scores) < 0.01
