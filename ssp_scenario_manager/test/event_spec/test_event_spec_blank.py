"""``ssp spec new``: files that lack nothing but decisions, and say which."""

from __future__ import annotations

import io
import json
import shlex
from pathlib import Path
from typing import Any

import pytest
import yaml

from ssp_core.cli import main
from ssp_scenario_manager.checks.check import check_event
from ssp_scenario_manager.event_spec.load import event_text, load_event, read_event_file
from ssp_scenario_manager.event_spec.log import log_path, read_log
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.extract import blank
from ssp_scenario_manager.extract.blank import changed_by_hand
from ssp_scenario_manager.review.session import to_decide
from ssp_scenario_manager.scenarios.events.kinds import KINDS

ROAD = {
    "road_type": "urban",
    "segment": "straight",
    "lanes_same_direction": 2,
    "lanes_opposite": 1,
    "vut_lane": "rightmost",
    "left_boundary": "kerb",
    "right_boundary": "sidewalk",
}


def failures(path: Path, capsys: pytest.CaptureFixture[str]) -> list[dict[str, Any]]:
    capsys.readouterr()
    main(["spec", "check", str(path), "--json"])
    (report,) = json.loads(capsys.readouterr().out)
    found: list[dict[str, Any]] = report["failures"]
    return found


def seconds(value: float) -> dict[str, Any]:
    return {"min": value, "max": value, "unit": "s"}


def fill_in(path: Path) -> None:
    """Fill in the fields that an author reads off a clip: the road, the start of the phases."""
    value = yaml.safe_load(path.read_text())
    crossed = KINDS[value["interaction"]["type"]].at_junction
    for name, word in (ROAD | ({"segment": "junction"} if crossed else {})).items():
        value["topology"][name]["value"] = word
    starts = {"approach": 0.0, "trigger": 2.0, "conflict": 3.0, "resolution": 6.0, "end": 8.0}
    ends = list(starts.values())[1:]
    for (phase, start), end in zip(list(starts.items())[:4], ends, strict=True):
        value["events"][phase] = {"start": seconds(start), "evidence": [{"span_s": [start, end]}]}
    value["events"]["clip"]["end"] = seconds(8.0)
    value["source"] |= {"generator": "mine/3", "original": "take 4"}
    path.write_text(yaml.safe_dump(value))


def accept_everything(path: Path, monkeypatch: pytest.MonkeyPatch) -> int:
    event, _ = load_event(str(path))
    lines = ["a"] * len(to_decide(event)) + [""]
    monkeypatch.setattr("sys.stdin", io.StringIO("\n".join(lines)))
    options = ["--who", "A. Author", "--accept-all", "--reason", "as usual"]
    return main(["spec", "review", str(path), *options])


@pytest.mark.parametrize("kind", KINDS)
def test_a_new_event_lacks_only_decisions_and_with_them_is_a_k_star(
    kind: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path = tmp_path / "mine.event.yaml"
    assert main(["spec", "new", kind, "--name", "mine", "--out", str(path)]) == 0
    found = failures(path, capsys)
    assert {item["origin"] for item in found} == {"open decision", "missing review"}
    open_ = {item["field"] for item in found if item["origin"] == "open decision"}
    assert open_ == {
        *(f"topology.{name}" for name in ("segment", "vut_lane")),
        *(f"topology.lanes_{name}" for name in ("same_direction", "opposite")),
        "events.clip.end",
        *(f"events.{phase}.start" for phase in ("trigger", "conflict", "resolution")),
        *(f"events.{p}.evidence[0]" for p in ("approach", "trigger", "conflict", "resolution")),
    }
    text = path.read_text()
    for field in open_:
        # Each is marked in the file, by a comment above it.
        name = field.removesuffix("[0]").split(".")[-1]
        marks = [
            a
            for a, b in zip(text.splitlines(), text.splitlines()[1:], strict=False)
            if b.strip().startswith(f"{name}:")
        ]
        assert any("# decide:" in line for line in marks), field
    if kind == "cut_in":
        # Of every kind alike: decisions that are open are no K*, and a file is kept.
        assert accept_everything(path, monkeypatch) == 1
        assert main(["spec", "new", kind, "--name", "mine", "--out", str(path)]) == 1
        assert "exists already" in capsys.readouterr().err
    fill_in(path)
    assert accept_everything(path, monkeypatch) == 0
    assert check_event(read_event_file(str(path))[0]) == []
    assert load_event(str(path))[0].interaction.type == kind


def test_a_new_event_reads_no_shipped_event_of_another_kind(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    read: list[str] = []

    def load(path: str) -> tuple[Event, str]:
        read.append(Path(path).name)
        return load_event(path)

    monkeypatch.setattr(blank, "load_event", load)
    for kind in KINDS:
        assert blank.blank_event(kind, "mine").event.interaction.type == kind
    assert read == [f"{kind}.event.yaml" for kind in KINDS]


def test_what_was_changed_in_an_editor_names_its_author_and_no_default(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "mine.event.yaml"
    assert main(["spec", "new", "cut_in", "--name", "mine", "--out", str(path)]) == 0
    fill_in(path)
    value = yaml.safe_load(path.read_text())
    value["constraints"]["time_gap"]["max"] += 0.5
    path.write_text(yaml.safe_dump(value))
    capsys.readouterr()
    assert accept_everything(path, monkeypatch) == 0
    told = capsys.readouterr().out
    assert "constraints.time_gap: 0.2..6.5 s (the template has 0.2..6 s)" in told
    event, _ = load_event(str(path))
    entry = event.uncertainty["constraints.time_gap"]
    assert (entry.provenance, entry.source) == ("person", "A. Author, in an editor")
    assert (entry.review, entry.seal is None) == ("accepted", False)
    assert event.uncertainty["topology.segment"].source == "A. Author, in an editor"
    kept = event.uncertainty["interaction.type"]
    assert kept.source == "default of `ssp spec new`, as in the shipped cut_in"
    (record,) = [r for r in read_log(log_path(path)) if r.field == "constraints.time_gap"][:1]
    assert (record.kind, record.reason) == ("edit", "changed in an editor since `ssp spec new`")
    assert record.old["max"] + 0.5 == record.new["max"]
    assert changed_by_hand(event) == []
    # What is changed after its review isn't the default either.
    value = yaml.safe_load(path.read_text())
    value["constraints"]["safety"]["duration"]["max"] = 50.0
    path.write_text(yaml.safe_dump(value))
    (changed,) = changed_by_hand(load_event(str(path))[0])
    assert changed.field.startswith("constraints.safety")


def test_open_decisions_are_a_short_list_and_what_one_action_mends_is_said_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "mine.event.yaml"
    assert main(["spec", "new", "vru_crossing", "--out", str(path)]) == 0
    capsys.readouterr()
    assert main(["spec", "check", str(path)]) == 1
    told = capsys.readouterr().out
    assert "12 open decisions" in told
    assert "topology.segment" in told
    assert "straight, curve, junction\n" in told
    assert told.count("no person has decided it") == 1
    assert f"`ssp spec review {path} --who NAME`" in told
    assert len(told.splitlines()) < 30


def test_a_printed_command_can_be_pasted_whatever_the_file_is_called(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "my events" / "Kim's $1.event.yaml"
    assert main(["spec", "new", "vru_crossing", "--out", str(path)]) == 0
    printed = capsys.readouterr().err.split("`")[3]
    assert shlex.split(printed) == ["ssp", "spec", "check", str(path)]
    assert main(shlex.split(printed)[1:]) == 1
    printed = capsys.readouterr().out.split("`")[1]
    assert shlex.split(printed) == ["ssp", "spec", "review", str(path), "--who", "NAME"]


def test_a_missing_part_u_is_one_message_with_its_count_and_remedy(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    event, _ = load_event("cut_in")
    path = tmp_path / "bare.event.yaml"
    path.write_text(event_text(event.model_copy(update={"uncertainty": {}})))
    found = failures(path, capsys)
    assert len({item["field"] for item in found}) == len(event.uncertainty)
    assert "contradiction in the structure" not in {
        item["origin"] for item in found if item["check"] == "review"
    }
    assert main(["spec", "check", str(path)]) == 1
    told = capsys.readouterr().out
    assert told.count("part U is missing") == 1
    assert f"{len(event.uncertainty)} fields" in told
    assert (
        f"one entry in part U for each field, by `ssp spec review {path} --who NAME --all`" in told
    )


def test_an_id_that_changed_is_not_told_field_by_field(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = event_text(load_event("cut_in")[0])
    path = tmp_path / "other.event.yaml"
    path.write_text(text.replace("review: accepted", "review: edited"))
    found = failures(path, capsys)
    assert len(found) > 80
    assert main(["spec", "check", str(path)]) == 1
    assert capsys.readouterr().out.count("changed since it was reviewed") == 1
