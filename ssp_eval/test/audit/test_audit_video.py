"""A video without states: what persons reviewed or saw counts, and nothing else (METHOD 4.3)."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from ssp_core.bag.operations.cut import cut_bag
from ssp_core.bag.reading.reader import BagReader
from ssp_core.cli import main
from ssp_core.hashing import sha256_file
from ssp_eval.audit.checks import version_findings
from ssp_eval.audit.evidence.evidence import expected_properties, review_of
from ssp_eval.audit.evidence.reasons import explain
from ssp_eval.audit.evidence.recording import Recording, read_recording
from ssp_eval.audit.examine import Examination, examine
from ssp_eval.data.audit import FIELDS
from ssp_eval.recordings.event import source_times
from ssp_scenario_manager.event_spec.load import event_version, load_event, seal_event
from ssp_scenario_manager.event_spec.model import Event

EVENT, VERSION = load_event("cut_in")
TIMES = source_times(EVENT)


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Nine seconds of grey at 12 Hz; the tests never look at its pictures."""
    path = tmp_path_factory.mktemp("clip") / "clip.mp4"
    fourcc = cv2.VideoWriter.fourcc(*"mp4v")
    writer = cv2.VideoWriter(str(path), fourcc, 12.0, (96, 54))
    for k in range(108):
        writer.write(np.full((54, 96, 3), 60 + k, np.uint8))
    writer.release()
    return path


@pytest.fixture(scope="module")
def event(clip: Path) -> Event:
    """The shipped K*, bound to that clip."""
    return bind(EVENT, clip)


def bind(event: Event, clip: Path) -> Event:
    source = event.source.model_copy(update={"sha256": sha256_file(clip)})
    return seal_event(event.model_copy(update={"source": source}))


@pytest.fixture
def video(clip: Path, event: Event, tmp_path: Path) -> Callable[..., Recording]:
    """The clip as an imported bag."""

    def make(*options: str, of: Event = event) -> Recording:
        target = tmp_path / "syn"
        given = [
            "--scenario",
            "cut_in",
            "--event-version",
            event_version(of),
            "--generator",
            "ssp-clip/1",
            "--ego-unknown",
            "--out",
            str(target / "bag"),
            *options,
        ]
        assert main(["import-video", str(clip), *given]) == 0
        return read_recording(target)

    return make


def look(recording: Recording, event: Event | None) -> Examination:
    return examine(recording, event, None if event is None else event_version(event))


def codes(one: Examination) -> dict[str, list[str]]:
    return {r.finding.code: [c.code for c in r.consequences] for r in explain(one.findings)}


def test_the_source_clip_has_what_was_reviewed_of_it(
    video: Callable[..., Recording], event: Event
) -> None:
    one = look(video(), event)
    assert codes(one) == {}
    wanted = expected_properties(event)
    for field in FIELDS:
        assert one.values[field].source == "reviewed"
        assert one.properties[field].words == wanted[field].words
        assert one.properties[field].how.startswith("reviewed in the K*; evidence: ")
    assert one.phases is not None
    assert one.crop is not None
    assert (one.crop.start_s, one.crop.end_s) == (0.0, 9.0)
    assert one.phases.trigger_s == TIMES["trigger"].mid
    assert one.phi["trigger"] == pytest.approx(TIMES["trigger"].mid / 9.0)
    assert one.coverage.participants["ot1"].fraction == 1.0
    assert one.coverage.source == "reviewed"
    assert one.history.source == "the source gate of the K*"


@pytest.mark.parametrize(
    ("options", "source", "why"),
    [
        # An unrelated clip that names the K* and our generator.
        ([], "sha256:" + "0" * 64, "the K* was taken from sha256:000"),
        # A K* that doesn't know its source.
        ([], None, "the K* doesn't know its source's hash and qualifies no video"),
        # The source clip itself, declared to be another domain.
        (["--domain", "physical"], "clip", "the K*'s source clip is synthetic"),
    ],
)
def test_no_other_video_gets_the_values_of_the_specification(
    options: list[str],
    source: str | None,
    why: str,
    video: Callable[..., Recording],
    event: Event,
    clip: Path,
) -> None:
    digest = sha256_file(clip) if source == "clip" else source
    other = event.model_copy(update={"source": event.source.model_copy(update={"sha256": digest})})
    other = seal_event(other)
    one = look(video(*options, of=other), other)
    assert not one.is_verified
    assert all(one.properties[field].words is None for field in FIELDS)
    assert one.phases is None
    assert one.phi == {}
    assert next(iter(codes(one))) == "unverified"
    assert any(why in finding.detail for finding in one.findings)


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
    path: str, field: str, video: Callable[..., Recording], clip: Path
) -> None:
    entry = unreviewed(path).uncertainty[path]
    event = bind(unreviewed(path), clip)
    event = event.model_copy(update={"uncertainty": {**event.uncertainty, path: entry}})
    one = look(video(of=event), event)
    assert set(codes(one)) == {"unverified"}
    assert f"{field}: {path} is unreviewed" in one.findings[0].detail
    undetermined = [k for k in FIELDS if one.values[k].source == "unverified"]
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
        (["--end", "6"], "the crop's end is 6 s, the K*'s clip's is 9 s"),
        (["--start", "1"], "the crop's start is 1 s"),
    ],
)
def test_another_crop_of_the_source(
    options: list[str], text: str, video: Callable[..., Recording], event: Event
) -> None:
    one = look(video(*options), event)
    assert "other_source" in codes(one)
    assert text in one.findings[0].detail


def test_a_part_that_was_cut_out_of_the_source_is_another_crop(
    video: Callable[..., Recording], event: Event, tmp_path: Path
) -> None:
    """Its import.json says what the whole one's says, and its clip begins at another time."""
    whole = video().path
    with BagReader(whole) as bag:
        topics, start_ns = list(bag.topics), bag.start_ns
    assert start_ns is not None
    cut_bag(whole, tmp_path / "part" / "bag", topics, start_ns + 2_000_000_000)
    one = look(read_recording(tmp_path / "part"), event)
    assert set(codes(one)) == {"other_source"}
    assert "6.92 s of it are left, the K*'s clip is 9 s long" in one.findings[0].detail


def test_a_k_star_that_was_bound_to_another_clip_after_its_review_qualifies_none(
    video: Callable[..., Recording], clip: Path
) -> None:
    source = EVENT.source.model_copy(update={"sha256": sha256_file(clip)})
    event = EVENT.model_copy(update={"source": source})
    one = look(video(of=event), event)
    assert set(codes(one)) == {"unverified"}
    assert "source.sha256 was changed after its review" in one.findings[0].detail
    assert not one.is_verified


def test_without_a_k_star_or_of_another_one(video: Callable[..., Recording], event: Event) -> None:
    recording = video()
    assert set(codes(examine(recording, event, "sha256:other"))) == {"other_event"}
    bare = look(recording, None)
    assert next(iter(codes(bare))) == "not_compiled"
    assert all(bare.properties[field].words is None for field in FIELDS)
    nameless = replace(
        recording, provenance=replace(recording.provenance, event_version=None, scenario=None)
    )
    assert "other_event" in codes(look(nameless, event))


def test_a_recording_of_another_event_is_one_cause(video: Callable[..., Recording]) -> None:
    recording = video()
    foreign = replace(recording.provenance, event_version="sha256:other", scenario="swerve")
    (found,) = version_findings(replace(recording, provenance=foreign), EVENT, VERSION)
    assert found.code == "other_event"
    assert found.detail == (
        f"it realises sha256:other, the audit is of {VERSION}; it is of swerve, the audit is of "
        "cut_in"
    )


def test_open_times_are_not_filled_in(video: Callable[..., Recording], clip: Path) -> None:
    events = EVENT.events.model_copy(
        update={"conflict": EVENT.events.conflict.model_copy(update={"start": "unresolved"})}
    )
    event = bind(EVENT.model_copy(update={"events": events}), clip)
    one = look(video(of=event), event)
    assert "conflict_phase" in codes(one) or "conflict_missing" in codes(one)
    assert set(one.phi) == {"trigger", "resolution"}


def test_an_interval_stays_one(video: Callable[..., Recording], clip: Path) -> None:
    start = EVENT.events.trigger.start
    assert start != "unresolved"
    wide = start.model_copy(update={"min": 2.8, "max": 3.3})
    events = EVENT.events.model_copy(
        update={"trigger": EVENT.events.trigger.model_copy(update={"start": wide})}
    )
    event = bind(EVENT.model_copy(update={"events": events}), clip)
    one = look(video(of=event), event)
    assert codes(one) == {}
    assert one.phi["trigger"] == pytest.approx(3.05 / 9.0)
    assert one.phi_half == {"trigger": pytest.approx(0.25 / 9.0)}


def test_the_command_line_says_what_is_missing(
    make_bag: Callable[..., Path],
    video: Callable[..., Recording],
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    video("--event-version", VERSION)
    capfd.readouterr()
    simulation, physical = make_bag("sim"), make_bag("phy", domain="physical", stand_in=True)
    arguments = ["audit", str(tmp_path / "syn"), str(simulation), str(physical)]
    out = tmp_path / "audit"
    status = main([*arguments, "--event", "cut_in", "--out", str(out), "--json"])
    told = capfd.readouterr()
    value = json.loads(told.out)
    assert status == 1
    assert [r["status"] for r in value["recordings"]] == ["refused", "refused", "refused"]
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
