"""The transfer audit against real recordings: good ones pass, broken ones are refused (METHOD 4).

Every broken run is compiled from the shipped K* and then changed on site in one respect, and each
change is entered into the log unless that is what is wrong. It takes the place of the simulation.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ssp_eval.audit import judge
from ssp_eval.audit.evidence import pictures
from ssp_eval.audit.evidence.recording import Head, Recording
from ssp_eval.audit.examine import Examination
from ssp_eval.data.audit import Audit, RecordingEntry, load_audit
from ssp_eval.data.provenance import find_bag
from ssp_eval.pictures.footage import Grey, read_grey
from ssp_scenario_manager.event_spec.model import Event
from tests.system.recordings import Changes, Recordings, changed_run, ssp, succeed

EVENTS = ("cut_in", "vru_crossing")
# Runs the verbs with another program in place of the object target.
WITH_ROGUE = """
import sys
from ssp_core.cli import main
from ssp_scenario_manager.run.over_dds import session as over_dds
over_dds.NODE_MODULES["object_target"] = "rogue_target"
sys.exit(main(sys.argv[1:]))
"""


@pytest.fixture(scope="module", autouse=True)
def _sound_partners_are_examined_once(recordings: Recordings) -> Iterator[None]:
    """A sound recording of the other two domains shows the same beside each broken one.

    Each is read and examined in the first audit that it takes part in.
    """
    head, read, examine = judge.read_head, judge.read_recording, judge.examine
    partners = [f"{event}-{domain}" for event in EVENTS for domain in ("synthetic", "physical")]
    sound = {recordings.folder / partner / "bag" for partner in partners}
    known: dict[tuple[Any, ...], Any] = {}

    def once(path: Path, work: Callable[..., Any], *given: Any, key: tuple[Any, ...] = ()) -> Any:
        if path not in sound:
            return work(*given)
        if (work, path, *key) not in known:
            known[work, path, *key] = work(*given)
        return known[work, path, *key]

    def head_once(path: Path) -> Head:
        bag: Head = once(find_bag(path), head, path)
        return bag

    def read_once(path: Path, of: Head) -> Recording:
        recording: Recording = once(path, read, path, of)
        return recording

    def examine_once(recording: Recording, event: Event | None, version: str | None) -> Examination:
        given = recording, event, version
        examined: Examination = once(recording.path, examine, *given, key=(version,))
        return examined

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(judge, "read_head", head_once)
        patch.setattr(judge, "read_recording", read_once)
        patch.setattr(judge, "examine", examine_once)
        yield


def broken_run(
    folder: Path, recordings: Recordings, event: str, changes: Changes, **how: Any
) -> Path:
    """Make a broken run of the simulation, compiled and then changed."""
    changed_run(folder, recordings.k_star(event), changes, **how)
    return folder / "run"


def audit(
    tmp_path: Path, recordings: Recordings, event: str, simulation: Path
) -> tuple[int, Audit]:
    synthetic, physical = (recordings.get(event, d) for d in ("synthetic", "physical"))
    with redirect_stdout(io.StringIO()) as said:
        status = ssp("audit", synthetic, simulation, physical, "--out", tmp_path / "audit")
    page = (tmp_path / "audit" / "audit.html").read_text()
    found = load_audit(tmp_path / "audit")
    for reason in found.recordings[1].reasons:
        assert reason.text in page
        assert reason.text in said.getvalue()
    return status, found


def refused(found: Audit) -> RecordingEntry:
    """The simulation's entry; its partners have nothing wrong with them."""
    synthetic, simulation, physical = found.recordings
    assert [r.status for r in found.recordings] == ["unpaired", "refused", "unpaired"]
    assert (synthetic.reasons, physical.reasons) == ([], [])
    return simulation


def codes(entry: RecordingEntry) -> dict[str, list[str]]:
    return {r.code: [c.code for c in r.consequences] for r in entry.reasons}


# -- good runs -------------------------------------------------------------------------------------


@pytest.mark.parametrize("event", EVENTS)
def test_good_runs_are_admitted(event: str, recordings: Recordings, tmp_path: Path) -> None:
    simulation = recordings.get(event, "simulation")
    status, found = audit(tmp_path, recordings, event, simulation)
    assert [(r.status, r.reasons) for r in found.recordings] == [("admitted", [])] * 3
    assert status == 0
    version = recordings.version(event)
    assert {found.event_version, *(r.event_version for r in found.recordings)} == {version}
    synthetic, *driven = (recording.pictures for recording in found.recordings)
    assert synthetic is not None
    assert synthetic.note == "there are no states to compare the pictures with"
    for held in driven:
        assert held is not None
        names = {check.name for check in held.checks if check.state == "holds"}
        assert {"speed", "course of the speed", "turning", "ot1"} <= names
    for index, recording in enumerate(found.recordings):
        assert recording.kpr == 1.0
        assert recording.epd is not None
        assert (recording.epd == 0.0) == (index == 0)
        assert recording.evidence == ("reviewed" if index == 0 else "states")
        phi = recording.phases.phi
        assert 0.0 < phi["trigger"] < phi["conflict"] < phi["resolution"] < 1.0
        assert recording.contradictions == []
        for sight in recording.coverage.participants.values():
            assert sight.fraction is not None
            assert sight.fraction >= sight.needed
    assert found.response is not None
    assert [(p.reference, p.comparison) for p in found.response.pairs] == [
        ("physical", "simulation")
    ]
    assert found.response.pairs[0].verdict in ("alike", "unlike")
    physical = found.recordings[2]
    assert physical.stand_in
    assert {"stand-in", "communication", "local speed", "tracking error of ot1"} <= set(
        physical.disclosures
    )


# -- the negative set ------------------------------------------------------------------------------


@pytest.mark.parametrize("event", EVENTS)
def test_mirrored_pictures(
    event: str, recordings: Recordings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All but the pictures is that of a good run: states, coverage, log and seals."""
    simulation = recordings.get(event, "simulation")

    def read(path: Path, *rest: Any) -> dict[int, Grey]:
        found = read_grey(path, *rest)
        if not path.is_relative_to(simulation):
            return found
        return {index: np.ascontiguousarray(grey[:, ::-1]) for index, grey in found.items()}

    monkeypatch.setattr(pictures, "read_grey", read)
    status, found = audit(tmp_path, recordings, event, simulation)
    entry = refused(found)
    assert status == 1
    assert codes(entry) == {"pictures_differ": []}
    assert "ot1: " in entry.reasons[0].detail
    assert "limit at least 1.3" in entry.reasons[0].detail


def mirrored() -> Changes:
    """The VUT in the left lane, the OT to its right and changing to the left."""
    return {
        "vut.start.y_m": 3.5,
        "vut.approach.path": [[15.0, 3.5], [390.0, 3.5]],
        "targets[0].start.y_m": 0.0,
        "targets[0].approach.path": [[58.874, 0.0], [390.0, 0.0]],
        "triggers[0].manoeuvre.lateral_shift_m": 3.5,
    }


def swapped() -> Changes:
    """The VUT changes from the left lane in front of the OT, which has to brake."""
    shift = [[113.0, 3.4], [119.0, 2.9], [125.0, 1.75], [131.0, 0.6], [137.0, 0.1], [143.0, 0.0]]
    return {
        "vut.start.x_m": 75.0,
        "vut.start.y_m": 3.5,
        "vut.approach.path": [[75.0, 3.5], [107.0, 3.5], *shift, [390.0, 0.0]],
        "vut.approach.cruise_mps": 5.0,
        "driver.cruise_mps": 5.0,
        "targets[0].start.x_m": 15.0,
        "targets[0].start.y_m": 0.0,
        "targets[0].approach.path": [[15.0, 0.0], [390.0, 0.0]],
        "targets[0].approach.cruise_mps": 11.0,
        "triggers[0].condition": {
            "type": "time_to_arrival",
            "anchor": [119.0, 2.9],
            "below_s": 0.1,
        },
        "triggers[0].manoeuvre": {"kind": "brake", "to_mps": 4.0, "deceleration_mps2": 4.0},
        "end.at_latest_s": 18.0,
    }


def harmless() -> Changes:
    """The OT changes lanes nearly as fast as the VUT drives."""
    return {
        "targets[0].start.x_m": 42.0,
        "targets[0].approach.path": [[42.0, 3.5], [390.0, 3.5]],
        "targets[0].approach.cruise_mps": 12.0,
        "triggers[0].manoeuvre.cruise_mps": 12.5,
        "end.at_latest_s": 14.0,
    }


def test_from_the_wrong_side(recordings: Recordings, tmp_path: Path) -> None:
    run = broken_run(tmp_path, recordings, "cut_in", mirrored())
    status, found = audit(tmp_path, recordings, "cut_in", run)
    entry = refused(found)
    assert status == 1
    assert codes(entry) == {"wrong_side": ["lane_differs", "place_differs"]}
    assert "cutting_in_from_right instead of cutting_in_from_left" in entry.reasons[0].detail
    # Topology (another lane of the VUT), roles (another start) and motion of five fields.
    assert entry.kpr == pytest.approx(2 / 5)
    assert {change.who for change in entry.changes} == {"A. Tester"}


def test_swapped_roles(recordings: Recordings, tmp_path: Path) -> None:
    run = broken_run(tmp_path, recordings, "cut_in", swapped())
    entry = refused(audit(tmp_path, recordings, "cut_in", run)[1])
    assert next(iter(codes(entry))) == "roles_swapped"
    under = codes(entry)["roles_swapped"]
    assert {"order_differs", "lane_differs", "place_differs"} <= set(under)
    assert {"motion_differs", "wrong_side"} & set(under)
    assert len(entry.reasons) == 1
    assert entry.properties["participant_roles"].words is not None
    assert entry.properties["participant_roles"].words["initiator"] == ["vut"]


def test_the_vut_passes_first(recordings: Recordings, tmp_path: Path) -> None:
    # With an adaptation, the session would end the run as soon as it sees that.
    changes = {
        "driver.reacts": False,
        "triggers[0].condition.below_s": 0.4,
        "triggers[0].adaptation": None,
    }
    run = broken_run(tmp_path, recordings, "vru_crossing", changes)
    assert json.loads((run / "result.json").read_text())["verdict"] == "off_spec"
    entry = refused(audit(tmp_path, recordings, "vru_crossing", run)[1])
    # Whom the VUT has passed its camera doesn't see.
    (under,) = codes(entry).values()
    assert entry.reasons[0].code == "order_differs"
    assert {"off_spec", "participant_off_camera"} <= set(under)
    assert "vut before ot1 instead of ot1 before vut" in entry.reasons[0].detail
    assert entry.kpr == pytest.approx(4 / 5)


def test_a_missing_conflict(recordings: Recordings, tmp_path: Path) -> None:
    run = broken_run(tmp_path, recordings, "cut_in", harmless())
    entry = refused(audit(tmp_path, recordings, "cut_in", run)[1])
    assert next(iter(codes(entry))) == "conflict_missing"
    assert {"conflict_phase", "resolution_phase", "epd_missing", "event_awaited"} <= set(
        codes(entry)["conflict_missing"]
    )
    assert len(entry.reasons) == 1
    assert "not under 3 s" in entry.reasons[0].detail
    assert (entry.epd, entry.phases.conflict_s) == (None, None)
    assert entry.phases.trigger_s is not None


def test_off_camera_in_the_conflict(recordings: Recordings, tmp_path: Path) -> None:
    # Looking up so far that the lower edge of the picture is about the horizon.
    up = {"camera.pitch_down_rad": -0.385}
    run = broken_run(tmp_path, recordings, "vru_crossing", up, size_px=(960, 540))
    entry = refused(audit(tmp_path, recordings, "vru_crossing", run)[1])
    assert next(iter(codes(entry))) == "participant_off_camera"
    assert "in the conflict" in entry.reasons[0].detail
    assert entry.kpr == 1.0
    assert entry.coverage.participants["ot1"].fraction is not None
    assert entry.coverage.participants["ot1"].fraction < 0.5


def test_a_safety_abort(recordings: Recordings, tmp_path: Path) -> None:
    run = broken_run(tmp_path, recordings, "cut_in", {"limits.separation_m": 16.0})
    assert json.loads((run / "result.json").read_text())["verdict"] == "failed_safety"
    entry = refused(audit(tmp_path, recordings, "cut_in", run)[1])
    assert next(iter(codes(entry))) == "safety_abort"
    assert "separation of ot1" in entry.reasons[0].detail
    assert "run_invalid" in codes(entry)["safety_abort"]
    assert len(entry.reasons) == 1
    assert len(entry.safety_events) >= 1


@pytest.mark.ros
@pytest.mark.system
def test_an_id_that_changes_mid_run(recordings: Recordings, tmp_path: Path) -> None:
    run = broken_run(tmp_path, recordings, "cut_in", {}, program=WITH_ROGUE)
    entry = refused(audit(tmp_path, recordings, "cut_in", run)[1])
    assert next(iter(codes(entry))) == "identity_switch"
    assert entry.reasons[0].detail.startswith("the states of ot1 say ot7 from 8.")
    under = {code for codes_under in codes(entry).values() for code in codes_under}
    # The manager hears no more of ot1 and aborts, so that there is no event.
    assert {"safety_abort", "trigger_phase", "epd_missing"} <= under
    assert set(codes(entry)) == {"identity_switch"}
    assert any("ot1 is gone" in text for text in entry.identities)


def test_an_unlogged_change(recordings: Recordings, tmp_path: Path) -> None:
    run = broken_run(tmp_path, recordings, "cut_in", {"driver.headway_s": 1.6}, logged=False)
    entry = refused(audit(tmp_path, recordings, "cut_in", run)[1])
    assert codes(entry) == {"unlogged_change": []}
    assert entry.reasons[0].detail == "driver.headway_s: 1.4 to 1.6"
    assert [(c.field, c.logged) for c in entry.changes] == [("driver.headway_s", False)]
    assert entry.kpr == 1.0


def test_the_same_change_with_a_record_is_admitted(recordings: Recordings, tmp_path: Path) -> None:
    status, found = audit(tmp_path, recordings, "cut_in", recordings.changed)
    assert (status, found.admitted) == (0, True)
    (change,) = found.recordings[1].changes
    assert (change.old, change.new, change.who, change.reason) == (
        1.4,
        1.6,
        "A. Tester",
        "to be refused",
    )


# -- what wasn't compiled, or belongs to something else --------------------------------------------


def test_recordings_of_two_events_are_refused(recordings: Recordings, tmp_path: Path) -> None:
    status, found = audit(
        tmp_path, recordings, "cut_in", recordings.get("vru_crossing", "simulation")
    )
    # The K* is the simulation's, so it is the partners that are of another one.
    assert status == 1
    assert found.recordings[0].reasons[0].code == "other_event"
    assert found.recordings[2].reasons[0].code == "other_event"


def test_a_video_that_is_not_the_source_clip_is_unverified(
    recordings: Recordings, tmp_path: Path
) -> None:
    """Another clip that names the K* and our generator: it has no q, and neither KPR nor EPD."""
    target, version = tmp_path / "other", recordings.version("cut_in")
    succeed(
        "import-video",
        recordings.clip("vru_crossing"),
        "--scenario",
        "cut_in",
        "--event-version",
        version,
        "--generator",
        "ssp-clip/1",
        "--ego-unknown",
        "--domain",
        "physical",
        "--out",
        target / "bag",
    )
    domains = [recordings.get("cut_in", domain) for domain in ("synthetic", "simulation")]
    assert ssp("audit", *domains, target, "--out", tmp_path / "audit") == 1
    *others, physical = load_audit(tmp_path / "audit").recordings
    assert next(iter(codes(physical))) == "unverified"
    assert (physical.kpr, physical.epd, physical.evidence) == (None, None, "unverified")
    assert [q.words for q in physical.properties.values()] == [None] * 5
    response = load_audit(tmp_path / "audit").response
    assert response is not None
    assert [p.verdict for p in response.pairs] == ["not assessable"]
    assert "physical has no states of the VUT" in response.pairs[0].why
    assert [r.status for r in others] == ["unpaired", "unpaired"]


def test_another_crop_of_the_source_is_refused(recordings: Recordings, tmp_path: Path) -> None:
    target, version = tmp_path / "other", recordings.version("cut_in")
    succeed(
        "import-video",
        recordings.clip("cut_in"),
        "--scenario",
        "cut_in",
        "--event-version",
        version,
        "--ego-unknown",
        "--end",
        "6",
        "--out",
        target / "bag",
    )
    domains = [recordings.get("cut_in", domain) for domain in ("simulation", "physical")]
    assert ssp("audit", target, *domains, "--out", tmp_path / "audit") == 1
    synthetic, *others = load_audit(tmp_path / "audit").recordings
    assert "other_source" in codes(synthetic)
    assert any("the crop's end is 6 s" in reason.detail for reason in synthetic.reasons)
    assert [r.status for r in others] == ["unpaired", "unpaired"]
