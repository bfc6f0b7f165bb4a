"""The fate of a recording, also of a live session: it is audited and scored with its partners."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.seals.declaration import participation_of
from ssp_core.run_file.model import load_run
from ssp_core.run_file.participation import participants
from ssp_eval.data.audit import Audit, load_audit
from tests.system.recordings import Recordings, succeed


def is_admitted_and_scored(
    recordings: Recordings, event: str, physical: Path, tmp_path: Path
) -> None:
    """Fails unless it is, as a recording of a simulation is.

    Args:
        physical: folder of the session.
    """
    live = admitted_and_scored(recordings, event, physical, tmp_path).recordings[2]
    with BagReader(physical / "bag") as bag:
        assert "/ssp/world/tick" not in bag.topics
    assert (live.evidence, live.measured_from) == (
        "states",
        "states that VUT and object targets reported",
    )
    assert live.kpr == 1.0
    assert live.epd is not None
    assert live.epd < 0.15


def admitted_and_scored(
    recordings: Recordings, event: str, physical: Path, tmp_path: Path
) -> Audit:
    """Label, audit and score a recording beside its partners, and return the audit.

    Fails unless all three are admitted, have as many labels in each phase, and give a model that
    sees nothing the same score.

    Args:
        physical: folder of the session, into which its labels are written.
    """
    simulation, synthetic = tmp_path / "simulation", tmp_path / "synthetic"
    for mine in (simulation, synthetic):
        # Labels are written beside a recording.
        shutil.copytree(recordings.get(event, mine.name), mine)
    folders = synthetic, simulation, physical
    truth = recordings.folder / f"{event}.truth.json"
    succeed("labels", "new", *folders, "--truth", truth)
    succeed("audit", *folders, "--out", tmp_path / "audit")
    audit = load_audit(tmp_path / "audit")
    assert [entry.status for entry in audit.recordings] == ["admitted"] * 3
    assert audit.labels is not None
    assert "not comparable" not in audit.labels
    counts = [entry.labels.per_phase for entry in audit.recordings if entry.labels is not None]
    assert len(counts) == 3
    assert counts[0] == counts[1] == counts[2]
    bags = (folder / "bag" for folder in folders)
    bridge = ("--bridge", "constant_velocity", "--no-controls")
    succeed("evaluate", *bags, "--audit", tmp_path / "audit", *bridge, "--out", tmp_path / "out")
    cells = [
        json.loads(file.read_text()) for file in sorted(tmp_path.glob("out/cells/*/cell.json"))
    ]
    assert [cell["admission"]["status"] for cell in cells] == ["admitted"] * 3
    scores = {
        json.loads((folder / "cell.json").read_text())["domain"]: json.loads(
            (folder / "score.json").read_text()
        )["ivcs"]
        for folder in (tmp_path / "out" / "cells").iterdir()
    }
    # A model that sees nothing of the picture scores the same on states of either kind, but for
    # label times at which a camera on a busy machine gave no frame.
    lost = sum(len(cell["answers"]["missing"]) for cell in cells) / sum(counts[0].values())
    assert abs(scores["physical"] - scores["simulation"]) < 0.01 + lost
    return audit


def everybody_declares_simulated(session: Path) -> None:
    """All whom the run file lists say so themselves: no part of a rehearsal is real or silent."""
    run = load_run(session / "run.yaml")
    with BagReader(session / "bag") as bag:
        part = participation_of(bag, run, session / "bag")
    assert run.declaring == participants(["ot1"], has_camera=True)
    assert dict(part.declared) == dict.fromkeys(run.declaring, ("simulated",))
