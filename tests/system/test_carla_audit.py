"""Sessions that CARLA's client drew, audited beside the clips and sessions of our own camera.

Events with a car, a pedestrian and a parked vehicle, each in one process. The counterpart's
pictures are never admitted. So the audit by the command line refuses them, and the test audits the
same recordings once more as if a server had drawn them, with the probe of the counterpart beside
them.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from ssp_core.bag.reading.reader import BagReader
from ssp_core.files.writing import write_json
from ssp_core.names import CAMERA_IMAGE, absolute
from ssp_core.run_file.model import load_run
from ssp_eval.audit.evidence.recording import Recording, read_recording
from ssp_eval.audit.judge import judge
from ssp_eval.audit.server import server_disclosures
from ssp_eval.data.audit import AUDIT_FILE, load_audit
from ssp_eval.data.provenance import CARLA, read_provenance
from ssp_eval.data.server import PROBE_FILE
from tests.support.carla.commands import left_as_found, ssp
from tests.support.carla.counterpart import Behaviour, Counterpart
from tests.support.carla.tasks import MAP, compiled, equal_states
from tests.system import recordings as made
from tests.system.recordings import Recordings, succeed

pytestmark = [pytest.mark.programs, pytest.mark.carla]
EVENTS = ("cut_in", "vru_crossing", "occluded_crossing")
WALKING = ("vru_crossing", "occluded_crossing")
# Those whose recordings of the other domains are there.
AUDITED = ("cut_in", "vru_crossing")
DOMAINS = ("synthetic", "simulation", "physical")


@dataclass(frozen=True)
class Drawn:
    """The sessions of all events that one server drew, each in a folder of the event's name.

    Args:
        walks: role, height of the feet and speed of each state that a pedestrian was given.
    """

    folder: Path
    walks: list[tuple[str, float, float]]


@pytest.fixture(scope="module")
def drawn(recordings: Recordings, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Drawn]:
    folder = tmp_path_factory.mktemp("drawn")
    tasks = {one: compiled(recordings.k_star(one), folder / f"{one}.task") for one in EVENTS}
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(folder / "state"))
        with Counterpart(Behaviour(xodr=MAP.read_text())) as server:
            how = (
                "--seed",
                11,
                "--in-process",
                "--record",
                "--camera",
                f"carla://{server.address}",
            )
            told = ssp(
                ("carla", "probe", server.address, "--out", folder / PROBE_FILE),
                *(("run", task, *how, "--out", folder / one) for one, task in tasks.items()),
            )
            for status, text in told:
                assert status == 0, text
            left_as_found(server)
            yield Drawn(folder, list(server.walks))


def test_what_carla_draws_moves_nothing_and_its_pedestrians_walk(drawn: Drawn) -> None:
    pictures = 0
    for event in EVENTS:
        carla, ours = drawn.folder / event, drawn.folder / f"{event}.ours"
        # Our own camera's session is the one without a camera, byte by byte (test_in_process).
        succeed("run", carla, "--in-process", "--record", "--no-camera", "--out", ours)
        run = load_run(carla / "run.yaml")
        assert run.camera is not None
        assert run.camera.renderer == "carla"
        equal_states(carla / "bag", ours / "bag", run.object_ids)
        pedestrians = {t.id for t in run.targets if t.object_class == "pedestrian"}
        assert pedestrians == ({"ot1"} if event in WALKING else set())
        with BagReader(carla / "bag") as bag:
            bodies = server_disclosures(read_provenance(bag))
        assert ("body of ot2" in bodies) == (event == "occluded_crossing")
        if pedestrians:
            with BagReader(carla / "bag") as bag:
                pictures += len(list(bag.messages([absolute(CAMERA_IMAGE)])))
    # Its feet are on the ground, and it stands before it walks.
    assert len(drawn.walks) == pictures
    assert {(role, feet_m) for role, feet_m, _ in drawn.walks} == {("ot1", 0.0)}
    speeds = [speed_mps for _, _, speed_mps in drawn.walks]
    assert min(speeds) == 0.0
    assert max(speeds) > 0.8


def as_drawn_by_a_server(recording: Recording) -> Recording:
    facts = recording.provenance
    if facts.scene is None:
        return recording
    scene = facts.scene.model_copy(update={"counterpart": False})
    return replace(recording, provenance=replace(facts, scene=scene))


def three(event: str, drawn: Drawn, recordings: Recordings, folder: Path) -> list[Path]:
    """The recordings of an event, by domain; labels are written beside each."""
    found = []
    for domain in DOMAINS:
        mine = folder / event / domain
        if domain == "simulation":
            shutil.copytree(drawn.folder / event, mine)
            shutil.copyfile(drawn.folder / PROBE_FILE, mine / PROBE_FILE)
        else:
            shutil.copytree(recordings.get(event, domain), mine)
        found.append(mine)
    truth = recordings.folder / f"{event}.truth.json"
    succeed("labels", "new", *found, "--truth", truth)
    return found


@pytest.mark.parametrize("event", AUDITED)
def test_a_session_of_carla_is_admitted_beside_clip_and_raster_and_scored(
    event: str, drawn: Drawn, recordings: Recordings, tmp_path: Path
) -> None:
    folders = three(event, drawn, recordings, tmp_path)
    if event == "cut_in":
        assert made.ssp("audit", *folders, "--out", tmp_path / "refused") == 1
        entry = load_audit(tmp_path / "refused").recordings[1]
        assert [reason.code for reason in entry.reasons] == ["server_unproven"]
    audit = judge([as_drawn_by_a_server(read_recording(one)) for one in folders]).audit
    assert [one.status for one in audit.recordings] == ["admitted"] * 3, audit.recordings[1].reasons
    told = audit.recordings[1].disclosures
    assert told["renderer"] == CARLA
    assert "shares its renderer with" not in told
    if event == "cut_in":
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
    if event == "cut_in":
        succeed("report", out)
        page = (out / "index.html").read_text()
        assert "CARLA drew or moved cut_in in simulation" in page
        assert told["body of ot1"] in page
