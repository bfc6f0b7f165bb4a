"""ssp labels for clips without states: templates, what the check says, contact sheets."""

from __future__ import annotations

import base64
import io
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from ssp_core.bag.reading.reader import BagReader
from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_core.hashing import sha256_file
from ssp_eval.data.labels import load_labels, parse_labels, template_json, unfilled
from ssp_eval.data.provenance import read_provenance
from ssp_eval.labels.review import is_unreviewed, sidecar
from ssp_eval.labels.sheet import pictures
from ssp_scenario_manager.event_spec.load import load_event, write_event
from ssp_scenario_manager.event_spec.log import read_log

MakeBag = Callable[..., Path]


@pytest.fixture
def video(tmp_path: Path) -> Path:
    """Eight seconds at 25 Hz; frame k is a grey of level k."""
    path = tmp_path / "clip.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (320, 180))
    for k in range(200):
        writer.write(np.full((180, 320, 3), k, np.uint8))
    writer.release()
    return path


@pytest.fixture
def imported(video: Path, tmp_path: Path) -> Path:
    """The video from 1 s on as a bag, which names its scenario."""
    out = tmp_path / "imported"
    more = ["--ego-unknown", "--start", "1", "--scenario", "merge", "--rate", "25"]
    assert main(["import-video", str(video), "--out", str(out), *more]) == 0
    return out


def new(source: Path, out: Path, *more: object) -> int:
    return main(["labels", "new", str(source), "--out", str(out), *map(str, more)])


def check(path: Path, *more: object) -> int:
    return main(["labels", "check", str(path), *map(str, more)])


def times(path: Path) -> list[float]:
    return [label["t_s"] for label in json.loads(path.read_text())["labels"]]


def text_of(capsys: pytest.CaptureFixture[str]) -> str:
    captured = capsys.readouterr()
    assert "Traceback" not in captured.err
    return " ".join((captured.out + captured.err).split())


# Templates.


def test_an_imported_video_gets_a_template_and_a_note(
    imported: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "labels.json"
    assert new(imported, out) == 0
    assert "holds no states to propose labels from: a template" in text_of(capsys)
    # Around the middle of 0 to 6.96 s.
    assert times(out) == pytest.approx([1.5 + k / 2 for k in range(9)])
    value = json.loads(out.read_text())
    assert (value["scenario"], value["domain"]) == ("merge", "synthetic")
    label = value["labels"][0]
    assert [label[k] for k in ("phase", "objects", "position", "motion", "conflict")] == [None] * 5
    assert (label["lon_actions"], label["lat_actions"]) == ([], [])


def test_the_times_of_an_event_are_taken(video: Path, tmp_path: Path) -> None:
    event, version = load_event("cut_in")
    out = tmp_path / "labels.json"
    assert new(video, out, "--event", "cut_in") == 0
    value = json.loads(out.read_text())
    assert (value["scenario"], value["event_version"]) == (event.name, version)
    # The plan of METHOD 5.2b, and the phases with it; nothing is said about what is seen.
    phases = ["approach"] * 3 + ["trigger"] + ["conflict"] * 4 + ["resolution"]
    assert [label["phase"] for label in value["labels"]] == phases
    assert [label["at"]["phase"] for label in value["labels"]] == phases
    assert value["plan"] == "phase"
    starts = times(out)
    assert starts[:4] == pytest.approx([1.708, 2.208, 2.708, 3.2705])
    assert starts[4:] == pytest.approx([3.333 + 2.167 * k / 8 for k in (1, 3, 5, 7)] + [5.75])
    assert len(unfilled(value)) == 9 * 3
    with pytest.raises(InputError, match="template: fill in"):
        load_labels(out)
    # K*'s times are on the source's clock, a label's begin with its clip.
    assert new(video, out, "--event", "cut_in", "--start", "0.52", "--force") == 0
    assert times(out) == pytest.approx([t_s - 0.52 for t_s in starts])


def test_labels_that_no_frame_is_near_enough_to_are_warned_about(
    tmp_path: Path, video: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # At 5 Hz the frame shown at 4.146 s is that of 4.0 s, at 5.75 s that of 5.6 s.
    slow = tmp_path / "slow.avi"
    writer = cv2.VideoWriter(str(slow), cv2.VideoWriter.fourcc(*"MJPG"), 5.0, (320, 180))
    for k in range(45):
        writer.write(np.full((180, 320, 3), k, np.uint8))
    writer.release()
    assert new(slow, tmp_path / "slow.json", "--event", "cut_in") == 0
    told = text_of(capsys)
    assert f"{slow}: at 4.146, 5.750 s the clip's newest frame is more than 0.11 s old" in told
    assert new(video, tmp_path / "quick.json", "--event", "cut_in") == 0
    assert "newest frame" not in text_of(capsys)


def test_a_session_may_be_labelled_by_hand_too(make_bag: MakeBag, tmp_path: Path) -> None:
    out = tmp_path / "labels.json"
    bag = make_bag()
    assert new(bag, out) == 0
    assert is_unreviewed(out)
    with BagReader(bag) as reader:
        digest = read_provenance(reader).bag_sha256
    assert json.loads(sidecar(out).read_text())["source"] == digest
    assert new(bag, out, "--template", "--force") == 0
    assert not sidecar(out).exists()
    assert unfilled(json.loads(out.read_text()))


@pytest.mark.parametrize(
    ("more", "code", "what"),
    [
        ((), 1, "give --scenario or --event"),
        (("--scenario", "m", "--start", "nan"), 2, "is no number from 0"),
        (("--scenario", "m", "--start", 5), 1, "too short"),
        (("--scenario", "m", "--start", 8), 1, "has no frame from 8 s on"),
        (("--event", "no_such"), 1, "no such event"),
    ],
)
def test_what_gives_no_template_is_said(
    video: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    more: tuple[object, ...],
    code: int,
    what: str,
) -> None:
    out = tmp_path / "labels.json"
    assert new(video, out, *more) == code
    assert what in text_of(capsys)
    assert not out.exists()


def test_an_event_names_the_version_of_a_clips_truth(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["--out", str(tmp_path / "l.json"), "--truth", str(tmp_path / "none.json")]
    assert main(["labels", "new", *given, "--event", "no_such"]) == 1
    assert "no such event" in text_of(capsys)
    assert main(["labels", "new", *given, "--event", "cut_in"]) == 1
    assert "none.json" in text_of(capsys)


@pytest.mark.parametrize("name", ["run", "run/bag", "clip.mp4"])
def test_a_recording_that_is_not_there_is_missed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    """A folder that is missing isn't taken for a video file."""
    assert new(tmp_path / name, tmp_path / "l.json", "--event", "cut_in") == 1
    said = " ".join(text_of(capsys).split())
    assert f"{name}: is not there; name a recording: the folder of `ssp run`" in said


def test_what_is_no_video_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "no.mp4").write_bytes(b"no video")
    assert new(tmp_path / "no.mp4", tmp_path / "l.json", "--scenario", "m") == 1
    assert "no.mp4: is no video" in text_of(capsys)


def filled(**changes: Any) -> dict[str, Any]:
    """A template of four labels that was filled in."""
    value = template_json("merge", "synthetic", "unknown", [0.0, 0.5, 1.0, 1.5])
    phases = ["approach", "trigger", "conflict", "resolution"]
    for label, phase in zip(value["labels"], phases, strict=True):
        label.update(
            phase=phase,
            risk_visible=phase != "approach",
            objects=["car"],
            conflict="active",
            lon_actions=["decelerate"],
            lat_actions=["straight"],
        )
    for path, new_value in changes.items():
        if path.startswith("l"):
            index, key = int(path[1]), path[3:]
            value["labels"][index][key] = new_value
        else:
            value[path] = new_value
    return value


def test_a_template_is_no_answer() -> None:
    value = template_json("merge", "synthetic", "unknown", [0.0, 0.5])
    with pytest.raises(InputError, match="template: fill in") as caught:
        parse_labels(value, "l.json")
    assert caught.value.field == "labels[0].phase"
    assert len(unfilled(value)) == 8
    assert unfilled(filled()) == []
    assert parse_labels(filled(), "l.json").labels[1].position is None


def test_a_half_filled_template_is_still_one() -> None:
    value = filled(l2_phase=None, l3_lon_actions=[])
    assert unfilled(value) == ["labels[2].phase", "labels[3].lon_actions"]
    with pytest.raises(InputError, match="template: fill in"):
        parse_labels(value, "l.json")


@pytest.mark.parametrize("value", [None, 3, [], {}, {"labels": 3}, {"labels": [None, 3]}])
def test_anything_else_is_no_template(value: Any) -> None:
    assert unfilled(value) == []


@pytest.mark.parametrize("json_", [False, True])
def test_the_check_says_what_to_fill_in(
    video: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], json_: bool
) -> None:
    out = tmp_path / "labels.json"
    assert new(video, out, "--scenario", "m") == 0
    capsys.readouterr()
    assert check(out, *(["--json"] if json_ else [])) == 1
    text = capsys.readouterr().out
    if json_:
        value = json.loads(text)
        assert value["template"] is True
        assert len(value["unfilled"]) == 36
    else:
        assert "template: fill in 36 fields" in text
        assert "labels[1].lat_actions" in text


def test_evaluation_says_so_as_well(
    make_bag: MakeBag, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "labels.json"
    bag = make_bag()
    assert new(bag, out, "--template") == 0
    capsys.readouterr()
    more = ["--labels", str(out), "--bridge", "constant_velocity", "--out", str(tmp_path / "e")]
    assert main(["evaluate", str(bag), *more]) != 0
    assert "template: fill in" in text_of(capsys)


# What the check says about labels that have the right form.


def written(tmp_path: Path, value: dict[str, Any]) -> Path:
    path = tmp_path / "labels.json"
    path.write_text(json.dumps(value))
    return path


def test_good_labels_pass(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, filled())
    assert check(path, "--json") == 0
    value = json.loads(capsys.readouterr().out)
    assert (value["problems"], value["warnings"]) == ([], [])
    assert value["template"] is value["unreviewed"] is False


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"l2_phase": "approach"}, "labels[2].phase: approach at 1 s comes after trigger at 0.5 s"),
        ({"l3_phase": "conflict", "l2_phase": "resolution"}, "labels[3].phase: conflict"),
    ],
)
def test_phases_that_go_back_fail(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], changes: dict[str, Any], what: str
) -> None:
    path = written(tmp_path, filled(**changes))
    assert check(path) == 1
    assert what in text_of(capsys)
    assert check(path, "--json") == 1
    (problem,) = json.loads(capsys.readouterr().out)["problems"]
    assert problem.startswith(what)


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"risk_time_s": 0.9}, "labels[1].risk_visible: true at 0.5 s, before risk_time_s (0.9 s)"),
        ({"l0_risk_visible": True}, "labels[0].risk_visible: true in the approach"),
        ({"l2_risk_visible": False}, "labels[2].risk_visible: false in the conflict"),
        ({"l1_conflict": None, "l2_conflict": None}, "no model can get a risk response"),
    ],
)
def test_doubtful_labels_are_warned_about(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], changes: dict[str, Any], what: str
) -> None:
    path = written(tmp_path, filled(**changes))
    assert check(path) == 0
    assert what in text_of(capsys)


@pytest.mark.parametrize(
    ("shift_s", "what"),
    [
        (0.0, None),
        (-0.4, "labels[1].phase: trigger at 3.6 s, but it starts at 4 s at the earliest"),
        (1.0, "labels[0].phase: approach at 4.5 s, but trigger starts by 4.2 s"),
    ],
)
def test_phases_are_held_against_the_events_times(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], shift_s: float, what: str | None
) -> None:
    """The labels start at 3.5 s, and are compared with the times of K*.

    Its crop begins 1 s into its source, so that the trigger lies at 4–4.2 s and the conflict at
    4.4 s; the resolution is unresolved.
    """
    event, _ = load_event("cut_in")
    value = event.model_dump(mode="json", by_alias=True)
    value["events"]["trigger"]["start"] = {"min": 5.0, "max": 5.2, "unit": "s"}
    value["events"]["conflict"]["start"] = {"min": 5.4, "max": 5.4, "unit": "s"}
    value["events"]["clip"]["start"] = {"min": 1.0, "max": 1.0, "unit": "s"}
    value["events"]["resolution"]["start"] = "unresolved"
    file = tmp_path / "k.event.yaml"
    write_event(file, type(event).model_validate(value))
    _, version = load_event(str(file))
    labels = filled(event_version=version)
    for label in labels["labels"]:
        label["t_s"] += 3.5 + shift_s
    path = written(tmp_path, labels)
    assert check(path, "--event", file) == (0 if what is None else 1)
    if what is not None:
        assert what in text_of(capsys)


def test_labels_of_another_version_are_found_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert check(written(tmp_path, filled()), "--event", "cut_in") == 1
    assert "event_version: unknown is not the event's, sha256:" in text_of(capsys)


# Pictures and contact sheets.


def level(image: Any) -> float:
    return float(np.asarray(image).mean())


def test_a_picture_is_the_newest_frame_at_its_time(video: Path, imported: Path) -> None:
    for source, start_s in ((video, 1.0), (imported, 0.0)):
        found = pictures(source, [0.0, 0.05, 2.0, 6.96, 7.5], start_s)
        assert found[4] is None
        shots = [picture for picture in found[:4] if picture is not None]
        assert [picture.t_s for picture in shots] == pytest.approx([0.0, 0.04, 2.0, 6.96], abs=1e-3)
        levels = [level(picture.image) for picture in shots]
        # MJPEG shifts all greys alike by a little; the steps between frames are exact.
        assert levels[0] == pytest.approx(25, abs=2)
        steps = [found_level - levels[0] for found_level in levels]
        assert steps == pytest.approx([0, 1, 50, 174], abs=0.4)


def sheet(source: Path, labels: Path, out: Path, *more: object) -> int:
    given = ["labels", "sheet", source, "--labels", labels, "--out", out, *more]
    return main([*map(str, given)])


def test_a_page_shows_every_frame_large_enough(
    imported: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path, filled(scenario="<b>merge</b>"))
    out = tmp_path / "sheet.html"
    assert sheet(imported, path, out) == 0
    page = out.read_text()
    assert "<b>merge" not in page
    assert "&lt;b&gt;merge" in page
    shown = re.findall(r'src="data:image/jpeg;base64,([^"]+)" width="(\d+)"', page)
    assert len(shown) == 4
    for k, (data, width) in enumerate(shown):
        assert int(width) >= 640
        image = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR)
        assert image is not None
        assert level(image) == pytest.approx([25, 37, 50, 62][k], abs=2)
    assert "http" not in page.replace("http-equiv", "")
    assert "decelerate" in page
    assert "4 frames" in text_of(capsys)


def test_a_template_can_be_shown_as_well(video: Path, tmp_path: Path) -> None:
    labels = tmp_path / "labels.json"
    assert new(video, labels, "--scenario", "merge", "--start", 1) == 0
    out = tmp_path / "sheet.html"
    assert sheet(video, labels, out, "--start", 1) == 0
    page = out.read_text()
    assert page.count("data:image/jpeg") == 9
    assert page.count('class="empty">empty') == 9 * 8


def test_a_sheet_is_not_overwritten_unasked(
    video: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    labels, out = tmp_path / "labels.json", tmp_path / "sheet.html"
    assert new(video, labels, "--scenario", "merge") == 0
    out.write_text("mine")
    assert sheet(video, labels, out) == 1
    assert "give --force to overwrite it" in text_of(capsys)
    assert out.read_text() == "mine"
    assert sheet(video, labels, out, "--force") == 0
    assert "data:image/jpeg" in out.read_text()


@pytest.mark.parametrize(
    ("out", "change", "code", "what"),
    [
        ("sheet.pdf", {}, 2, "ends in .html"),
        ("s.html", {"labels": []}, 1, "labels: List should have at least 1 item"),
        ("s.html", {"labels": [{"phase": "approach"}]}, 1, "labels[0].t_s: Field required"),
        ("s.html", {"labels": [{"t_s": 99.0}]}, 1, "inside the clip"),
    ],
)
def test_what_gives_no_sheet_is_said(
    video: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    out: str,
    change: dict[str, Any],
    code: int,
    what: str,
) -> None:
    assert sheet(video, written(tmp_path, {**filled(), **change}), tmp_path / out) == code
    assert what in text_of(capsys)
    assert not (tmp_path / out).exists()


# Review of proposals.


@pytest.fixture
def proposal(make_bag: MakeBag, tmp_path: Path) -> Path:
    out = tmp_path / "labels.json"
    assert new(make_bag(), out) == 0
    return out


@pytest.fixture
def review(monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    def run(path: Path, *lines: str) -> int:
        monkeypatch.setattr("sys.stdin", io.StringIO("".join(line + "\n" for line in lines)))
        return main(["spec", "review", str(path), "--who", "A. Author"])

    return run


def test_accepted_labels_lose_their_mark(
    proposal: Path, review: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    before = proposal.read_bytes()
    assert review(proposal, *["a"] * 10) == 0
    assert f"reviewed, {sha256_file(proposal)}" in text_of(capsys)
    assert proposal.read_bytes() == before
    assert not is_unreviewed(proposal)
    records = read_log(proposal.with_name("labels.log.jsonl"))
    assert [record.kind for record in records] == ["label_review"] * 11
    fields = ["risk_time_s", *(f"labels[{i}]" for i in range(9)), None]
    assert [record.field for record in records] == fields
    assert {record.who for record in records} == {"A. Author"}
    assert records[-1].version == sha256_file(proposal)
    assert review(proposal) == 0
    assert "nothing to review" in text_of(capsys)


def test_an_unfinished_review_keeps_the_mark_and_goes_on(
    proposal: Path, review: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    edit = ["e", "position=front lon_actions=decelerate,stop motion=null", "I see it ahead"]
    assert review(proposal, "a", *edit, "s", "a", "q") == 1
    assert is_unreviewed(proposal)
    text = text_of(capsys)
    assert "7 left to decide: labels[1], labels[3]" in text
    label = load_labels(proposal).labels[0]
    assert (label.position, label.motion) == ("front", None)
    assert label.lon_actions == ("decelerate", "stop")
    records = read_log(proposal.with_name("labels.log.jsonl"))
    edits = [record for record in records if record.reason == "I see it ahead"]
    assert {record.field: record.new for record in edits} == {
        "labels[0].position": "front",
        "labels[0].lon_actions": ["decelerate", "stop"],
        "labels[0].motion": None,
    }
    assert edits[0].old == "front_right"
    assert review(proposal, *["a"] * 7) == 0
    assert not is_unreviewed(proposal)


@pytest.mark.parametrize(
    ("lines", "what"),
    [
        (["position=above"], "labels[0].position: is outside the vocabulary"),
        (["lon_actions="], "labels[0].lon_actions: Tuple should have at least 1 item"),
        (["phase=null"], "labels[0].phase: template"),
        (["risk_visible=maybe"], "risk_visible is true or false"),
        (["mood=grim"], "there is no slot 'mood'"),
        (["go away"], "type slots and values"),
        (["position=front", "", ""], "nothing was changed"),
    ],
)
def test_an_edit_that_cannot_be_is_refused(
    proposal: Path,
    review: Callable[..., int],
    capsys: pytest.CaptureFixture[str],
    lines: list[str],
    what: str,
) -> None:
    before = proposal.read_bytes()
    assert review(proposal, "s", "e", *lines) == 1
    assert what in text_of(capsys)
    assert proposal.read_bytes() == before


def test_the_risk_time_is_reviewed_too(
    proposal: Path, review: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert review(proposal, "e", "soon", "e", "nan", "e", "4.1 s", "seen earlier") == 1
    text = text_of(capsys)
    assert text.count("type a clip time") == 2
    assert load_labels(proposal).risk_time_s == 4.1


def test_contradicting_phases_are_not_confirmed(
    proposal: Path, review: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    lines = ["a"] * 9 + ["e", "phase=approach", "it starts over"]
    assert review(proposal, *lines) == 1
    assert "phases don't go back" in text_of(capsys)
    assert is_unreviewed(proposal)


def test_a_template_is_not_reviewed(
    video: Path, tmp_path: Path, review: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "labels.json"
    assert new(video, out, "--scenario", "m") == 0
    assert review(out, "a") == 1
    assert "template: fill in" in text_of(capsys)


def test_options_of_events_are_wrong_usage_here(proposal: Path) -> None:
    assert main(["spec", "review", str(proposal), "--who", "A", "--all"]) == 2
