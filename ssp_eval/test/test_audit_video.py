"""A video without states: what persons reviewed counts, and nothing else (METHOD 4)."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from ssp_core.cli import main
from ssp_core.files import write_json
from ssp_eval.audit.examined import Examined, version_findings
from ssp_eval.audit.expected import expected_properties, review_of, timeline
from ssp_eval.audit.imported import examine_video
from ssp_eval.audit.reasons import explain
from ssp_eval.audit.recording import Recording, read_recording
from ssp_eval.recordings.properties import FIELDS
from ssp_scenario_manager.spec.load import event_version, load_event
from ssp_scenario_manager.spec.model import Event
from ssp_scenario_manager.spec.seal import seal_event

EVENT, VERSION = load_event("cut_in")
TIMES = timeline(EVENT)


def phase_at(t_s: float) -> str:
    starts = (TIMES.trigger, TIMES.conflict, TIMES.resolution)
    names = ("approach", "trigger", "conflict", "resolution")
    return names[sum(when is not None and t_s >= when.middle_s for when in starts)]


def labels(**changed: Any) -> dict[str, Any]:
    times = [1.3 + 0.5 * k for k in range(9)]
    return {
        "schema": "ssp.labels/1", "scenario": "cut_in", "domain": "synthetic",
        "event_version": VERSION, "risk_time_s": 3.21, "first_frame_dynamics": False,
        "labels": [
            {
                "t_s": t, "phase": phase_at(t), "risk_visible": t > 3.2, "objects": ["car"],
                "position": "front", "motion": "same_direction", "conflict": "potential",
                "lon_actions": ["maintain"], "lat_actions": ["straight"],
            }
            for t in times
        ],
        **changed,
    }  # fmt: skip


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Nine seconds of grey at 12 Hz: nobody here looks at it."""
    path = tmp_path_factory.mktemp("clip") / "clip.mp4"
    fourcc = cv2.VideoWriter.fourcc(*"mp4v")
    writer = cv2.VideoWriter(str(path), fourcc, 12.0, (96, 54))
    for k in range(108):
        writer.write(np.full((54, 96, 3), 60 + k, np.uint8))
    writer.release()
    return path


@pytest.fixture
def video(clip: Path, tmp_path: Path) -> Callable[..., Recording]:
    """The clip as an imported bag with labels beside it."""

    def make(*options: str, beside: dict[str, Any] | None = None) -> Recording:
        target = tmp_path / "syn"
        given = [
            "--scenario", "cut_in", "--event-version", VERSION, "--generator", "ssp-clip/1",
            "--ego-unknown", "--out", str(target / "bag"), *options,
        ]  # fmt: skip
        assert main(["import-video", str(clip), *given]) == 0
        if beside is not None:
            write_json(target / "labels.json", beside)
        return read_recording(target)

    return make


def codes(one: Examined) -> dict[str, list[str]]:
    return {r.finding.code: [c.code for c in r.consequences] for r in explain(one.findings)}


def test_a_reviewed_clip_has_everything(video: Callable[..., Recording]) -> None:
    one = examine_video(video(beside=labels()), EVENT, VERSION)
    assert codes(one) == {}
    wanted = expected_properties(EVENT)
    for field in FIELDS:
        assert one.properties[field].words == wanted[field].words
        assert one.properties[field].how.startswith("reviewed in the K*; evidence: ")
    assert one.phases is not None
    assert TIMES.trigger is not None
    assert one.phases.trigger_s == TIMES.trigger.middle_s
    assert one.phi["trigger"] == pytest.approx(TIMES.trigger.middle_s / 9.0)
    assert one.coverage.participants["ot1"].fraction == 1.0


def unreviewed(path: str, **changed: Any) -> Event:
    """The K* with another entry for one field, which no person has decided."""
    entry = next(iter(EVENT.uncertainty.values())).model_copy(
        update={"review": "unreviewed", "seal": None, **changed}
    )
    event = EVENT.model_copy(update={"uncertainty": {**EVENT.uncertainty, path: entry}})
    return seal_event(event, [key for key in EVENT.uncertainty if key != path])


@pytest.mark.parametrize(
    ("path", "field"),
    [
        ("topology.vut_lane", "topology"),
        ("participants.ot1.class", "participant roles"),
        ("interaction.dominant_motion", "dominant motion"),
        ("interaction.relation", "conflict type"),
        ("interaction.passing_order", "passing order"),
        ("events.conflict.start", "phases"),
    ],
)
def test_without_a_review_a_property_is_unverified(
    path: str, field: str, video: Callable[..., Recording]
) -> None:
    event = unreviewed(path)
    version = event_version(event)
    recording = video("--event-version", version, beside=labels(event_version=version))
    one = examine_video(recording, event, version)
    assert codes(one) == {"unverified": []}
    assert f"{field}: {path} is unreviewed" in one.findings[0].detail
    undetermined = [k for k in FIELDS if one.properties[k].words is None]
    assert undetermined == ([] if field == "phases" else [field.replace(" ", "_")])


def test_a_review_that_no_longer_fits_or_names_nothing_is_none() -> None:
    changed = EVENT.model_copy(
        update={
            "interaction": EVENT.interaction.model_copy(
                update={"dominant_motion": "cutting_in_from_right"}
            )
        }
    )
    assert review_of(EVENT).gaps["dominant_motion"] == ()
    assert "changed after its review" in review_of(changed).gaps["dominant_motion"][0]
    silent = unreviewed("interaction.relation", review="accepted", source=" ")
    silent = seal_event(silent)
    assert review_of(silent).gaps["conflict_type"] == ("interaction.relation names no evidence",)
    open_ = unreviewed("interaction.relation", review="accepted")
    assert "without a seal" in review_of(open_).gaps["conflict_type"][0]


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--generator", "somebody"], "was made by somebody"),
        (["--end", "6"], "the crop's end is 6 s, the K*'s clip's is 9 s"),
        (["--start", "1"], "the crop's start is 1 s"),
    ],
)
def test_another_source(options: list[str], text: str, video: Callable[..., Recording]) -> None:
    one = examine_video(video(*options, beside=labels()), EVENT, VERSION)
    assert set(codes(one)) == {"other_source"}
    assert text in one.findings[0].detail


def test_a_source_that_has_a_hash_is_known_by_it(
    clip: Path, video: Callable[..., Recording]
) -> None:
    recording = video("--generator", "whoever", beside=labels())
    assert recording.provenance.imported is not None
    digest = recording.provenance.imported.source_sha256
    same = EVENT.model_copy(update={"source": EVENT.source.model_copy(update={"sha256": digest})})
    other = EVENT.model_copy(update={"source": EVENT.source.model_copy(update={"sha256": "no"})})
    assert "other_source" not in codes(examine_video(recording, same, VERSION))
    assert "other_source" in codes(examine_video(recording, other, VERSION))


def test_labels_must_know_the_phases(video: Callable[..., Recording]) -> None:
    beside = labels()
    beside["labels"][0]["phase"] = "trigger"
    one = examine_video(video(beside=beside), EVENT, VERSION)
    assert codes(one) == {"labels_disagree": []}
    assert one.findings[0].detail == "labels[0] at 1.3 s says trigger, by the K* it is approach"


def test_labels_that_do_not_see_the_participant(video: Callable[..., Recording]) -> None:
    beside = labels()
    for label in beside["labels"][5:]:
        label["position"] = None
    one = examine_video(video(beside=beside), EVENT, VERSION)
    assert set(codes(one)) == {"participant_off_camera"}


def test_without_labels_or_a_version_or_a_k_star(video: Callable[..., Recording]) -> None:
    recording = video()
    assert codes(examine_video(recording, EVENT, VERSION)) == {"coverage_unknown": []}
    assert set(codes(examine_video(recording, EVENT, "sha256:other"))) == {
        "other_event", "coverage_unknown",
    }  # fmt: skip
    bare = examine_video(recording, None, None)
    assert set(codes(bare)) == {"not_compiled"}
    assert all(bare.properties[field].words is None for field in FIELDS)
    nameless = replace(
        recording, provenance=replace(recording.provenance, event_version=None, scenario=None)
    )
    assert "other_event" in codes(examine_video(nameless, EVENT, VERSION))


def test_a_recording_of_another_event_is_one_cause(video: Callable[..., Recording]) -> None:
    recording = video(beside=labels())
    foreign = replace(recording.provenance, event_version="sha256:other", scenario="swerve")
    (found,) = version_findings(replace(recording, provenance=foreign), EVENT, VERSION)
    assert found.code == "other_event"
    assert found.detail == (
        f"it realises sha256:other, the audit is of {VERSION}; it is of swerve, the audit is of "
        "cut_in"
    )


def test_open_times_are_not_filled_in(video: Callable[..., Recording]) -> None:
    events = EVENT.events.model_copy(
        update={"conflict": EVENT.events.conflict.model_copy(update={"start": "unresolved"})}
    )
    event = seal_event(EVENT.model_copy(update={"events": events}))
    version = event_version(event)
    recording = video("--event-version", version, beside=labels(event_version=version))
    one = examine_video(recording, event, version)
    assert {"conflict_phase", "epd_missing"} <= set(codes(one))
    assert set(one.phi) == {"trigger", "resolution"}


def test_an_interval_stays_one(video: Callable[..., Recording]) -> None:
    start = EVENT.events.trigger.start
    assert start != "unresolved"
    wide = start.model_copy(update={"min": 2.8, "max": 3.3})
    events = EVENT.events.model_copy(
        update={"trigger": EVENT.events.trigger.model_copy(update={"start": wide})}
    )
    event = seal_event(EVENT.model_copy(update={"events": events}))
    version = event_version(event)
    recording = video("--event-version", version, beside=labels(event_version=version))
    one = examine_video(recording, event, version)
    assert codes(one) == {}
    assert one.phi["trigger"] == pytest.approx(3.05 / 9.0)
    assert one.phi_half == {"trigger": pytest.approx(0.25 / 9.0)}


def test_the_command_line_says_what_is_missing(
    make_bag: Callable[..., Path],
    video: Callable[..., Recording],
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    video(beside=labels())
    capfd.readouterr()
    simulation, physical = make_bag("sim"), make_bag("phy", domain="physical", stand_in=True)
    arguments = ["audit", str(tmp_path / "syn"), str(simulation), str(physical)]
    out = tmp_path / "audit"
    status = main([*arguments, "--event", "cut_in", "--out", str(out), "--json"])
    told = capfd.readouterr()
    value = json.loads(told.out)
    assert status == 1
    assert [r["status"] for r in value["recordings"]] == ["unpaired", "refused", "refused"]
    assert [r["reasons"][0]["code"] for r in value["recordings"][1:]] == ["not_compiled"] * 2
    assert "the bag has no attachment task.json" in (out / "audit.html").read_text()
    assert json.loads((out / "audit.json").read_text()) == value

    assert main([*arguments, "--event", "cut_in", "--out", str(out)]) == 1
    assert "audit.json: exists already" in capfd.readouterr().err
    assert main([*arguments, "--event", "cut_in", "--out", str(out), "--force"]) == 1
    shown = capfd.readouterr()
    assert "not compiled from a K*" in shown.out
    assert "software stand-in" in shown.err

    turned = [arguments[0], arguments[2], arguments[1], arguments[3]]
    assert main([*turned, "--out", str(tmp_path / "other")]) == 1
    assert "in its place stands synthetic" in capfd.readouterr().err
    assert main([*arguments[:3], str(tmp_path), "--out", str(tmp_path / "other")]) == 1
    assert "is neither a bag nor a folder with one" in capfd.readouterr().err
    assert not (tmp_path / "other").exists()
