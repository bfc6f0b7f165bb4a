"""ssp spec review, line by line through a pipe: from a candidate to a K*."""

from __future__ import annotations

import io
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_core.hashing import sha256_file
from ssp_scenario_manager.checks.check import check_event, undecided
from ssp_scenario_manager.event_spec.fields import get, granules
from ssp_scenario_manager.event_spec.load import (
    body,
    event_version,
    load_event,
    safety_critical_fields,
    seal_event,
    seals,
    write_event,
)
from ssp_scenario_manager.event_spec.log import Record, append_record, read_log
from ssp_scenario_manager.event_spec.model import UNRESOLVED, Doubt, Event, Interval
from ssp_scenario_manager.review import session as desk_module
from ssp_scenario_manager.review.decisions import (
    Unreadable,
    accept,
    edit,
    read_value,
    value_text,
)
from ssp_scenario_manager.scenarios.events.kinds import KINDS

Review = Callable[..., int]
SHIPPED = tuple(sorted(KINDS))


@cache
def unreviewed(name: str = "cut_in") -> Event:
    """A shipped event whose part U names a model as its only source, and no review."""
    event, _ = load_event(name)
    doubt = Doubt(
        confidence=0.6, provenance="model", source="seer-7b; frames 4, 9", review="unreviewed"
    )
    return event.model_copy(update={"uncertainty": dict.fromkeys(body(event), doubt)})


@pytest.fixture
def candidate(tmp_path: Path) -> Path:
    path = tmp_path / "cut_in.candidate.yaml"
    write_event(path, unreviewed())
    return path


@pytest.fixture
def review(monkeypatch: pytest.MonkeyPatch) -> Review:
    """Runs the command with these lines on its standard input."""

    def run(path: Path, *lines: str, options: tuple[object, ...] = ()) -> int:
        monkeypatch.setattr("sys.stdin", io.StringIO("".join(line + "\n" for line in lines)))
        return main(["spec", "review", str(path), "--who", "A. Author", *map(str, options)])

    return run


def critical(event: Event | None = None) -> list[str]:
    return safety_critical_fields(event or unreviewed())


def lines_until(field: str, *then: str) -> list[str]:
    """Skips to a field, then says this."""
    return ["s"] * critical().index(field) + list(then)


def log_of(path: Path) -> list[Record]:
    return read_log(path.with_name("cut_in.log.jsonl"))


def text_of(capsys: pytest.CaptureFixture[str]) -> str:
    captured = capsys.readouterr()
    assert "Traceback" not in captured.err
    return " ".join((captured.out + captured.err).split())


def test_a_candidate_becomes_a_k_star(
    candidate: Path, review: Review, capsys: pytest.CaptureFixture[str]
) -> None:
    assert review(candidate, *["a"] * len(critical())) == 0
    event, version = load_event(str(candidate.with_name("cut_in.event.yaml")))
    assert check_event(event) == []
    assert f"K* {version}" in text_of(capsys)
    assert load_event(str(candidate)) == (event, version)


def test_each_decision_is_a_record_and_names_the_version_before(
    candidate: Path, review: Review
) -> None:
    _, before = load_event(str(candidate))
    assert review(candidate, "a", "accept", "q") == 1
    first, second = log_of(candidate)
    assert (first.kind, first.who, first.subject) == ("accept", "A. Author", "cut_in")
    assert first.field == critical()[0]
    assert first.old == first.new == get(body(unreviewed()), critical()[0])
    assert first.when.endswith("Z")
    assert first.version == before
    assert first.details["version_after"] == second.version
    assert second.details["version_after"] == load_event(str(candidate))[1]


def test_a_review_goes_on_where_it_stopped(
    candidate: Path, review: Review, capsys: pytest.CaptureFixture[str]
) -> None:
    assert review(candidate, "a", "s", "a") == 1  # and the end of input
    left = f"{len(critical()) - 2} fields are left to decide"
    assert left in text_of(capsys)
    assert review(candidate, "q") == 1
    text = text_of(capsys)
    assert left in text
    assert f"[1/{len(critical()) - 2}] {critical()[1]}" in text
    assert review(candidate, *["a"] * (len(critical()) - 2)) == 0


def test_what_is_known_is_shown(
    candidate: Path, review: Review, capsys: pytest.CaptureFixture[str]
) -> None:
    assert review(candidate, *lines_until("constraints.trigger.below"), "q") == 1
    text = text_of(capsys)
    assert "value 16..20 m" in text
    assert "known by model, confidence 0.60: seer-7b; frames 4, 9" in text
    assert "frames 4, 9" in text
    assert "may be a range such as 2..3 m, within 2..100 m" in text
    assert "may be stationary, same_direction, oncoming" in text


def test_an_edit_needs_a_reason_and_says_who(candidate: Path, review: Review) -> None:
    field = "constraints.trigger.below"
    lines = lines_until(field, "e", "17..18.5 m", "", "measured on site")
    assert review(candidate, *lines) == 1
    event, _ = load_event(str(candidate))
    assert event.constraints.trigger.below == Interval(min=17, max=18.5, unit="m")
    doubt = event.uncertainty[field]
    assert (doubt.provenance, doubt.review) == ("person", "edited")
    assert doubt.source == "A. Author; frames 4, 9"
    assert doubt.seal == seals(event)[field]
    (record,) = log_of(candidate)
    assert record.kind == "edit"
    assert record.old == {"min": 16, "max": 20, "unit": "m"}
    assert record.new == {"min": 17, "max": 18.5, "unit": "m"}
    assert record.reason == "measured on site"


def test_an_edit_without_reason_changes_nothing(
    candidate: Path, review: Review, capsys: pytest.CaptureFixture[str]
) -> None:
    before = candidate.read_bytes()
    assert review(candidate, *lines_until("constraints.trigger.below", "e", "17 m", "", "")) == 1
    assert "nothing was changed" in text_of(capsys)
    assert candidate.read_bytes() == before
    assert log_of(candidate) == []


@pytest.mark.parametrize(
    ("field", "typed", "what"),
    [
        ("interaction.dominant_motion", "swerving", "is not in the vocabulary"),
        ("interaction.passing_order", "ot1", "passing_order"),
        ("interaction.longitudinal_responses", "decelerate, hoot", "is not in the vocabulary"),
        ("motion.ot1.trigger", "motion=swerving", "motion.ot1.trigger.motion"),
        ("motion.ot1.trigger", "mood=grim", "there is no 'mood' here"),
        ("motion.ot1.trigger", "grim", "type words to change"),
        ("participants.ot1.class", "Car", "is not in the vocabulary"),
        ("constraints.trigger.below", "17 s", "is no unit of length"),
        ("constraints.trigger.below", "17 furlongs", "is no unit of length"),
        ("constraints.trigger.below", "17..18", "17..18"),
        ("constraints.trigger.below", "near", "type a range"),
        ("constraints.trigger.below", "{min: .inf, max: 3, unit: m}", "finite"),
        ("constraints.trigger.below", "{min: 1", "is no YAML"),
        ("constraints.trigger.below", "", "type a value"),
        ("events.trigger.start", "2.5", "type the unit"),
    ],
)
def test_an_edit_outside_vocabulary_or_unit_is_refused(
    candidate: Path,
    review: Review,
    capsys: pytest.CaptureFixture[str],
    field: str,
    typed: str,
    what: str,
) -> None:
    before = candidate.read_bytes()
    assert review(candidate, *lines_until(field, "e", typed)) == 1
    assert what in text_of(capsys)
    assert candidate.read_bytes() == before
    assert log_of(candidate) == []


def test_checks_are_shown_after_an_edit_and_decide_in_the_end(
    candidate: Path, review: Review, capsys: pytest.CaptureFixture[str]
) -> None:
    at = critical().index("interaction.passing_order")
    lines = ["a"] * at + ["e", "vut, ot1", "the VUT was first"]
    assert review(candidate, *lines, *["a"] * (len(critical()) - at - 1)) == 1
    text = text_of(capsys)
    assert "! now: C4 interaction.passing_order" in text
    assert "all is decided, and these checks don't hold: C4 interaction.passing_order" in text
    assert not candidate.with_name("cut_in.event.yaml").exists()


def test_the_kind_of_interaction_takes_its_fields_along(
    candidate: Path, review: Review, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = lines_until("interaction.type", "e", "vru_crossing", "it is a person")
    assert review(candidate, *lines) == 1
    event, _ = load_event(str(candidate))
    assert (event.interaction.relation, event.interaction.zone) == ("crossing", "corridor_crossing")
    assert event.constraints.manoeuvre == dict.fromkeys(KINDS["vru_crossing"].manoeuvre, UNRESOLVED)
    assert event.constraints.trigger.quantity == "time_to_arrival"
    assert event.constraints.trigger.below == UNRESOLVED
    records = log_of(candidate)
    assert records[0].field == "interaction.type"
    assert {record.reason for record in records[1:]} == {"follows from interaction.type"}
    fields = {record.field for record in records[1:]}
    assert fields == {
        "interaction.relation",
        "interaction.zone",
        "constraints.manoeuvre",
        "constraints.trigger.quantity",
        "constraints.trigger.below",
    }
    assert event.uncertainty["interaction.relation"].review == "unreviewed"
    assert "and with it constraints.manoeuvre" in text_of(capsys)


def test_unresolved_and_critical_is_no_decision(
    candidate: Path, review: Review, capsys: pytest.CaptureFixture[str]
) -> None:
    field = "constraints.trigger.below"
    assert review(candidate, *lines_until(field, "u", "can't be seen")) == 1
    event, _ = load_event(str(candidate))
    assert event.constraints.trigger.below == UNRESOLVED
    assert event.uncertainty[field].review == "unresolved"
    assert event.uncertainty[field].seal == seals(event)[field]
    (record,) = log_of(candidate)
    assert (record.new, record.details["review"]) == (UNRESOLVED, "unresolved")
    text_of(capsys)
    assert review(candidate, *lines_until(field, "a")) == 1
    text = text_of(capsys)
    assert "is unresolved and safety-critical: edit it" in text
    assert f"{field}: unresolved (unresolved)" in text


def test_a_refused_clip_stays_refused(
    candidate: Path, review: Review, capsys: pytest.CaptureFixture[str]
) -> None:
    before = candidate.read_bytes()
    assert review(candidate, "s", "r", "2", "the red car turns blue") == 1
    assert "the clip is refused" in text_of(capsys)
    (record,) = log_of(candidate)
    assert (record.kind, record.reason) == ("gate", "identity drift")
    assert record.details["seen"] == "the red car turns blue"
    assert record.version == event_version(unreviewed())
    assert candidate.read_bytes() == before
    assert review(candidate, "a") == 1
    assert "refused by A. Author" in text_of(capsys)
    assert len(log_of(candidate)) == 1
    out = ("--target", "sumo", "--site", "boulevard", "--out", str(candidate.parent / "o"))
    assert main(["compile", str(candidate), *out]) == 1


@pytest.mark.parametrize("lines", [["r", "", "q"], ["r", "6", "q"], ["r", "1", "", ""], ["r"]])
def test_a_refusal_can_be_taken_back(candidate: Path, review: Review, lines: list[str]) -> None:
    assert review(candidate, *lines) == 1
    assert log_of(candidate) == []


def test_accept_all_takes_what_is_not_critical(
    candidate: Path, review: Review, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ("--accept-all", "--reason", "usual for this road")
    assert review(candidate, options=options) == 1
    event, _ = load_event(str(candidate))
    waiting = undecided(event)
    assert [item.field for item in waiting] == critical()
    records = log_of(candidate)
    assert {record.field for record in records} == set(granules(body(event))) - set(critical())
    assert {record.reason for record in records} == {"usual for this road"}
    assert all(record.details["together"] for record in records)
    assert review(candidate, *["a"] * len(critical())) == 0
    assert {doubt.review for doubt in load_event(str(candidate))[0].uncertainty.values()} == {
        "accepted",
        "unreviewed",  # the coarse entries, which cover nothing any more
    }


def test_all_goes_through_every_field(candidate: Path, review: Review) -> None:
    everything = list(granules(body(unreviewed())))
    assert review(candidate, *["a"] * len(everything), options=("--all",)) == 0
    assert [record.field for record in log_of(candidate)] == everything


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_event_has_nothing_left_to_decide(
    tmp_path: Path, review: Review, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    path = tmp_path / f"{name}.event.yaml"
    event, version = load_event(name)
    write_event(path, event)
    assert review(path) == 0
    assert f"K* {version}" in text_of(capsys)
    assert read_log(tmp_path / f"{name}.log.jsonl") == []


def test_a_field_changed_by_hand_is_asked_about_again(
    tmp_path: Path, review: Review, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "cut_in.event.yaml"
    event, _ = load_event("cut_in")
    safety = event.constraints.safety.model_copy(update={"speed": Interval(max=14.5, unit="m/s")})
    constraints = event.constraints.model_copy(update={"safety": safety})
    write_event(path, event.model_copy(update={"constraints": constraints}))
    assert any(failure.check == "review" for failure in check_event(load_event(str(path))[0]))
    assert review(path) == 1
    assert "changed since its review" in text_of(capsys)
    assert review(path, *["a"] * 10) == 0
    assert check_event(load_event(str(path))[0]) == []
    assert "constraints.safety.speed" in {
        record.field for record in read_log(tmp_path / "cut_in.log.jsonl")
    }


def test_a_machine_that_dies_in_between_leaves_a_whole_file(
    candidate: Path, review: Review, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = candidate.read_bytes()

    def die(*_: Any) -> None:
        raise InputError("can't be written: No space left on device", file=candidate)

    with monkeypatch.context() as patch:
        patch.setattr(desk_module, "write_text", die)
        assert review(candidate, "a") == 1
    assert candidate.read_bytes() == before
    assert len(log_of(candidate)) == 1
    assert review(candidate, *["a"] * len(critical())) == 0


def test_a_file_that_somebody_else_changes_is_not_overwritten(
    candidate: Path,
    review: Review,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    class Meddling(io.StringIO):
        def readline(self, *_: Any) -> str:  # type: ignore[override]
            candidate.write_text(candidate.read_text() + "# mine\n")
            return "a\n"

    monkeypatch.setattr("sys.stdin", Meddling())
    assert main(["spec", "review", str(candidate), "--who", "A"]) == 1
    assert "was changed by somebody else" in text_of(capsys)
    assert candidate.read_text().endswith("# mine\n")
    assert log_of(candidate) == []


def test_another_event_of_that_name_is_not_overwritten(
    candidate: Path, review: Review, capsys: pytest.CaptureFixture[str]
) -> None:
    other = candidate.with_name("cut_in.event.yaml")
    event, _ = load_event("cut_in")
    write_event(other, event)
    assert review(candidate, *["a"] * len(critical())) == 1
    assert "exists already" in text_of(capsys)
    assert load_event(str(other))[0] == event


def test_a_k_star_is_renewed_after_a_further_review(candidate: Path, review: Review) -> None:
    assert review(candidate, *["a"] * len(critical())) == 0
    event, _ = load_event(str(candidate))
    after, _ = edit(event, "constraints.trigger.below", {"min": 17, "max": 20, "unit": "m"}, "B")
    record = Record(
        kind="edit",
        when="2025-01-01T00:00:00Z",
        who="B",
        subject="cut_in",
        reason="r",
        details={"version_after": event_version(after)},
    )
    write_event(candidate, after)
    append_record(candidate.with_name("cut_in.log.jsonl"), record)
    assert review(candidate) == 0
    assert load_event(str(candidate.with_name("cut_in.event.yaml")))[0] == after


@pytest.mark.parametrize(
    "options",
    [
        ("--accept-all",),
        ("--reason", "r"),
        ("--accept-all", "--reason", " "),
        ("--who", " "),
        ("--log",),
    ],
)
def test_wrong_usage_is_exit_2(candidate: Path, review: Review, options: tuple[str, ...]) -> None:
    assert review(candidate, options=options) == 2


def test_what_is_no_event_is_named(
    tmp_path: Path, review: Review, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "x.yaml"
    path.write_text("schema: ssp.site/1\n")
    assert review(path) == 1
    assert "is nothing that can be reviewed" in text_of(capsys)


# Evidence.


def video_of(path: Path, frames: int = 30) -> Path:
    """Frame k is a grey of level 8 k."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (64, 48))
    for k in range(frames):
        writer.write(np.full((48, 64, 3), 8 * k, np.uint8))
    writer.release()
    return path


def test_contact_sheets_show_the_frames_of_the_crop(
    candidate: Path, review: Review, capsys: pytest.CaptureFixture[str]
) -> None:
    video = video_of(candidate.with_name("clip.avi"))
    crop = {"start_s": 1.0, "end_s": 3.0, "first_frame": 10}
    record = Record(
        kind="source",
        when="2025-01-01T00:00:00Z",
        who="x",
        subject="cut_in",
        reason="r",
        details={"sha256": "s", "crop": crop},
    )
    append_record(candidate.with_name("cut_in.log.jsonl"), record)
    assert review(candidate, "q", options=("--video", video)) == 1
    sheet = candidate.with_name("cut_in.review") / "frames-000004-000009-6.jpg"
    assert f"see {sheet}" in text_of(capsys)
    image = cv2.imread(str(sheet))
    assert image is not None
    # Six frames from 4 to 9 of the crop, three in a row, each 640 px wide.
    levels = [image[200, 8 + 648 * i + 300].mean() for i in range(3)]
    assert levels == pytest.approx([8 * 14, 8 * 15, 8 * 16], abs=4)


def test_another_video_is_refused(
    candidate: Path, review: Review, capsys: pytest.CaptureFixture[str]
) -> None:
    video = video_of(candidate.with_name("clip.avi"))
    event = unreviewed()
    mine = sha256_file(video_of(candidate.with_name("other.avi"), frames=20))
    source = event.source.model_copy(update={"sha256": mine})
    write_event(candidate, event.model_copy(update={"source": source}))
    assert review(candidate, "q", options=("--video", video)) == 1
    assert "is not the video that the event was taken from" in text_of(capsys)
    assert review(candidate, "q", options=("--video", candidate.with_name("none.avi"))) == 1


# Values, decisions and seals by themselves.


@pytest.mark.parametrize("name", SHIPPED)
def test_every_value_is_read_back_as_it_is_shown(name: str) -> None:
    event = unreviewed(name)
    value = body(event)
    for path in granules(value):
        old = get(value, path)
        quantity = isinstance(old, dict) and "unit" in old
        if isinstance(old, str) and not old:
            continue
        assert read_value(value_text(old), old, quantity) == old, path


@pytest.mark.parametrize(
    ("typed", "value"),
    [
        ("2..3 s", {"min": 2.0, "max": 3.0, "unit": "s"}),
        ("2.5 m", {"min": 2.5, "max": 2.5, "unit": "m"}),
        ("..3 s", {"min": None, "max": 3.0, "unit": "s"}),
        ("2.. s", {"min": 2.0, "max": None, "unit": "s"}),
        ("0.8..1 1", {"min": 0.8, "max": 1.0, "unit": "1"}),
        ("1e-3..2e-3 1/m", {"min": 0.001, "max": 0.002, "unit": "1/m"}),
        ("{min: 1, max: 2, unit: s}", {"min": 1, "max": 2, "unit": "s"}),
        ("unresolved", "unresolved"),
    ],
)
def test_quantities_may_be_typed_in_several_ways(typed: str, value: Any) -> None:
    assert read_value(typed, "unresolved", quantity=True) == value


@given(
    st.text(max_size=40),
    st.sampled_from([None, "word", ["a"], {"min": 1, "max": 2}]),
    st.booleans(),
)
def test_no_line_breaks_the_reader(text: str, old: Any, quantity: bool) -> None:
    with suppress(Unreadable):
        read_value(text, old, quantity)


@settings(max_examples=20, deadline=None)
@given(st.data())
def test_no_order_of_decisions_breaks_a_seal(data: st.DataObject) -> None:
    """Entries at any depth, decided in any order: whatever was sealed stays valid."""
    event, _ = load_event("vru_crossing")
    paths = list(granules(body(event)))
    doubt = Doubt(confidence=1.0, provenance="person", source="x", review="accepted")
    event = seal_event(event.model_copy(update={"uncertainty": dict.fromkeys(body(event), doubt)}))
    for path in data.draw(st.lists(st.sampled_from(paths), max_size=6)):
        value = get(body(event), path)
        if data.draw(st.booleans()):
            event = accept(event, path)
        else:
            event, _ = edit(event, path, value, "B")
        expected = seals(event)
        assert {at: entry.seal for at, entry in event.uncertainty.items()} == expected


@settings(max_examples=20, deadline=None)
@given(
    st.lists(
        st.sampled_from(
            [
                "a",
                "e",
                "u",
                "s",
                "r",
                "?",
                "",
                "q",
                "1",
                "17..18 m",
                "car",
                "because",
                "unresolved",
                "motion=stationary",
                "[",
                "null",
                "\x1b[2J",
            ]
        ),
        max_size=30,
    )
)
def test_no_line_leaves_a_broken_file(
    tmp_path_factory: pytest.TempPathFactory, lines: list[str]
) -> None:
    path = tmp_path_factory.mktemp("r") / "cut_in.candidate.yaml"
    write_event(path, unreviewed())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.stdin", io.StringIO("".join(line + "\n" for line in lines)))
        assert main(["spec", "review", str(path), "--who", "A"]) == 1
    event, version = load_event(str(path))
    sealed = seals(event)
    for at, entry in event.uncertainty.items():
        assert entry.seal == (None if entry.review == "unreviewed" else sealed[at])
    records = log_of(path)
    if records and records[-1].kind != "gate":
        assert records[-1].details["version_after"] == version
