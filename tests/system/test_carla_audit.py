"""A session that CARLA's client drew, audited beside the clip and a session of our own camera.

The counterpart's pictures are never admitted. So the audit by the command line refuses them, and
the test audits the same recordings once more as if a server had drawn them, with the probe of the
counterpart beside them.
"""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from ssp_core.files import write_json
from ssp_eval.audit.judge import judge
from ssp_eval.audit.recording import Recording, read_recording
from ssp_eval.data.audit import AUDIT_FILE, load_audit
from ssp_eval.data.provenance import CARLA
from ssp_eval.data.server import PROBE_FILE
from support.carla_counterpart import Behaviour, Counterpart
from tests.system import recordings as made
from tests.system.recordings import Recordings, succeed
from tests.system.test_carla_camera import BLOCK, MAP, ssp

pytestmark = [pytest.mark.system, pytest.mark.carla]


def as_drawn_by_a_server(recording: Recording) -> Recording:
    facts = recording.provenance
    if facts.scene is None:
        return recording
    scene = facts.scene.model_copy(update={"counterpart": False})
    return replace(recording, provenance=replace(facts, scene=scene))


def test_a_session_of_carla_is_admitted_beside_clip_and_raster_and_scored(
    recordings: Recordings, tmp_path: Path
) -> None:
    event = "cut_in"
    synthetic, physical, simulation = (
        tmp_path / name for name in ("synthetic", "physical", "simulation")
    )
    for mine in (synthetic, physical):
        # Labels are written beside a recording.
        shutil.copytree(recordings.get(event, mine.name), mine)
    succeed(
        "compile",
        recordings.k_star(event),
        "--target",
        "sumo",
        "--map",
        MAP,
        "--choose",
        BLOCK,
        "--who",
        "A. Tester",
        "--out",
        tmp_path / "task",
    )
    with Counterpart(Behaviour(xodr=MAP.read_text())) as server:
        camera = f"carla://{server.address}"
        done = ssp("run", tmp_path / "task", "--seed", 11, "--camera", camera, "--out", simulation)
        assert done.returncode == 0, done.stdout + done.stderr
        probed = ssp("carla", "probe", server.address, "--out", simulation / PROBE_FILE)
        assert probed.returncode == 0, probed.stderr
    folders = synthetic, simulation, physical
    succeed("labels", "new", *folders, "--truth", recordings.folder / f"{event}.truth.json")
    assert made.ssp("audit", *folders, "--out", tmp_path / "refused") == 1
    entry = load_audit(tmp_path / "refused").recordings[1]
    assert [reason.code for reason in entry.reasons] == ["server_unproven"]

    audit = judge([as_drawn_by_a_server(read_recording(one)) for one in folders]).audit
    assert [one.status for one in audit.recordings] == ["admitted"] * 3, audit.recordings[1].reasons
    told = audit.recordings[1].disclosures
    assert told["renderer"] == CARLA
    assert "shares its renderer with" not in told
    assert "box 4.68 × 1.81 × 1.44 m" in told["body of ot1"]
    assert audit.recordings[1].kpr == 1.0
    write_json(tmp_path / "audit" / AUDIT_FILE, audit.model_dump(mode="json", by_alias=True))
    out = tmp_path / "out"
    bags = (folder / "bag" for folder in folders)
    bridge = ("--bridge", "constant_velocity", "--no-controls")
    succeed("evaluate", *bags, "--audit", tmp_path / "audit", *bridge, "--out", out)
    cells = [json.loads(file.read_text()) for file in sorted(out.glob("cells/*/cell.json"))]
    assert [cell["admission"]["status"] for cell in cells] == ["admitted"] * 3
    assert len(list(out.glob("cells/*/score.json"))) == 3
    bodies = {cell["domain"]: cell["clip"].get("carla") for cell in cells}
    assert bodies["synthetic"] is bodies["physical"] is None
    assert bodies["simulation"]["body of ot1"] == told["body of ot1"]
    succeed("report", out)
    page = (out / "index.html").read_text()
    assert "CARLA drew or moved cut_in in simulation" in page
    assert told["body of ot1"] in page
