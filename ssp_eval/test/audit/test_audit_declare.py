"""A domain is shown by who took part, or said by a named person (METHOD 4.4b)."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.seals.append import append_attachment
from ssp_core.bag.seals.declaration import load_declaration, seal_declaration
from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_eval.audit.evidence.recording import read_recording
from ssp_eval.audit.judge import judge
from ssp_eval.data.audit import RecordingEntry
from ssp_eval.data.provenance import Provenance, read_provenance

BagMaker = Callable[..., Path]
REAL = dict.fromkeys(("vut", "vut/positioning", "vut/camera", "ot1", "ot1/body"), "real")
WORD = {
    "schema": "ssp.declaration/1",
    "who": "A. Engineer",
    "date": "2023-11-14",
    "place": "north track",
}


def provenance(bag: Path) -> Provenance:
    with BagReader(bag) as reader:
        return read_provenance(reader)


def audited(make_bag: BagMaker, physical: Path) -> RecordingEntry:
    bags = [make_bag("syn/bag", domain="synthetic"), make_bag("sim/bag"), physical]
    return judge([read_recording(bag) for bag in bags]).audit.recordings[2]


def codes(entry: RecordingEntry) -> set[str]:
    return {one.code for reason in entry.reasons for one in (reason, *reason.consequences)}


def word(path: Path, **participants: str) -> Path:
    said = {
        who.replace("__", "/"): {"kind": kind, "device": "car", "serial": "AB 12"}
        for who, kind in participants.items()
    }
    path.write_text(yaml.safe_dump({**WORD, "participants": said}))
    return path


def test_a_session_in_lockstep_is_a_stand_in_whatever_its_site_says(make_bag: BagMaker) -> None:
    bag = make_bag("phy/bag", domain="physical", stand_in=False)
    assert provenance(bag).stand_in
    entry = audited(make_bag, bag)
    assert entry.stand_in
    assert "a simulated world (lockstep)" in entry.domain_said_by


def test_a_simulation_is_no_stand_in(make_bag: BagMaker) -> None:
    assert not provenance(make_bag("sim/bag")).stand_in


def test_a_rehearsed_live_session_is_a_stand_in(make_bag: BagMaker) -> None:
    bag = make_bag("phy/bag", domain="physical", declared={**REAL, "vut": "simulated"})
    found = provenance(bag)
    assert found.stand_in
    assert not found.is_undeclared
    assert "undeclared" not in codes(audited(make_bag, bag))


def test_what_nobody_declares_is_refused_until_a_person_does(
    make_bag: BagMaker, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = make_bag(
        "phy/bag",
        domain="physical",
        declared=dict.fromkeys(("vut/positioning", "vut/camera"), "real"),
    )
    assert provenance(bag).is_undeclared
    entry = audited(make_bag, bag)
    assert "undeclared" in codes(entry)
    detail = next(r.detail for r in entry.reasons if r.code == "undeclared")
    assert detail.startswith("vut, ot1, ot1/body; ")
    draft = tmp_path / "word.yaml"
    assert main(["audit", "declare", str(bag), "--template", str(draft)]) == 0
    assert {*yaml.safe_load(draft.read_text())["participants"]} == {"vut", "ot1", "ot1/body"}
    # An unfilled template is no word.
    assert main(["audit", "declare", str(bag), str(draft)]) == 1
    assert "who" in capsys.readouterr().err
    said = word(draft, vut="real", ot1="real", ot1__body="real")
    assert main(["audit", "declare", str(bag), str(said)]) == 0
    assert "the session is real" in " ".join(capsys.readouterr().err.split())
    found = provenance(bag)
    assert (found.is_undeclared, found.stand_in) == (False, False)
    entry = judge([read_recording(b) for b in (tmp_path / "syn/bag", tmp_path / "sim/bag", bag)])
    physical = entry.audit.recordings[2]
    assert "undeclared" not in codes(physical)
    assert "by the word of A. Engineer, 2023-11-14, north track" in physical.domain_said_by
    assert physical.declaration_sha256 is not None


def recorded(bag: Path, kinds: dict[str, str], *topics: str) -> Path:
    """A bag with the report that its recorder leaves on what these participants declared."""
    names = [*(f"/ssp/declared/{who}" for who in kinds), *topics]
    rows = [{"name": name, "written": 1} for name in names]
    report = json.dumps({"schema": "ssp.recording/1", "topics": rows}).encode()
    append_attachment(bag, "recording.json", report, "application/json")
    return bag


@pytest.mark.parametrize("kind", ["real", "simulated"])
def test_a_word_does_not_stand_for_a_declaration_that_was_taken_out(
    kind: str, make_bag: BagMaker, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kinds = dict.fromkeys(REAL, kind)
    bag = recorded(make_bag("phy/bag", domain="physical", declared=kinds), kinds)
    cut = tmp_path / "cut" / "bag"
    assert main(["bag", "cut", str(bag), "--exclude", "/ssp/declared/ot1*", "-o", str(cut)]) == 0
    shutil.copy(bag / "verdict.json", cut)
    said = word(tmp_path / "word.yaml", ot1="real", ot1__body="real")
    assert main(["audit", "declare", str(cut), str(said)]) == 1
    assert "that was taken out of this bag" in " ".join(capsys.readouterr().err.split())
    # Nor does one that is put there by hand.
    with BagReader(cut) as reader:
        run = read_provenance(reader).run
    assert run is not None
    seal_declaration(load_declaration(said, run), cut)
    found = provenance(cut)
    assert found.participation is not None
    assert found.participation.lost == ("ot1", "ot1/body")
    assert not (kind == "real" and found.stand_in)
    assert found.is_undeclared == (kind == "real")
    entry = audited(make_bag, cut)
    if kind == "real":
        (reason,) = (r for r in entry.reasons if r.code == "undeclared")
        assert "take the bag as it was recorded: it held the words of ot1, ot1/body" in (
            reason.detail
        )
    else:
        assert entry.stand_in


def test_a_cut_that_keeps_the_declarations_says_the_same(
    make_bag: BagMaker, tmp_path: Path
) -> None:
    bag = recorded(make_bag("phy/bag", domain="physical", declared=REAL), REAL)
    cut = tmp_path / "cut" / "bag"
    assert main(["bag", "cut", str(bag), "--end", "1", "-o", str(cut)]) == 0
    found = provenance(cut).participation
    assert found is not None
    assert (found.standing.value, found.lost) == ("real", ())


def test_a_word_that_was_changed_or_is_of_another_bag_is_refused(
    make_bag: BagMaker, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = make_bag("phy/bag", domain="physical", declared={})
    said = word(tmp_path / "word.yaml", vut="real")
    assert main(["audit", "declare", str(bag), str(said)]) == 0
    assert main(["audit", "declare", str(bag), str(said)]) == 1
    assert "exists already" in capsys.readouterr().err
    file = bag / "declaration.json"
    other = make_bag("other/bag", domain="physical", declared={"vut": "played"})
    shutil.copyfile(file, other / "declaration.json")
    with pytest.raises(InputError, match="is of another bag"):
        audited(make_bag, other)
    file.write_text(file.read_text().replace("AB 12", "AB 13"))
    assert main(["bag", "info", str(bag)]) == 0
    assert main(["audit", "observe", str(bag), "--template"]) == 1
    assert "was changed after A. Engineer sealed it" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("declared", "participants", "why"),
    [
        ({}, {"ot7": "real"}, "takes no part in this session"),
        ({}, {"vut": "true"}, "participants.vut.kind"),
        (None, {"vut": "real"}, "simulated world"),
    ],
)
def test_a_word_that_does_not_fit_the_session_is_refused(
    make_bag: BagMaker,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    declared: dict[str, str] | None,
    participants: dict[str, str],
    why: str,
) -> None:
    bag = make_bag("phy/bag", domain="physical", declared=declared)
    said = word(tmp_path / "word.yaml", **participants)
    assert main(["audit", "declare", str(bag), str(said)]) == 1
    assert why in " ".join(capsys.readouterr().err.split())
    assert not (bag / "declaration.json").exists()


def test_a_contradiction_refuses_the_recording(make_bag: BagMaker) -> None:
    sound = make_bag("sound/bag", domain="physical", declared=REAL)
    assert (provenance(sound).refusal, provenance(sound).stand_in) == (None, False)
    bag = make_bag("phy/bag", domain="physical", declared={**REAL, "vut": "real,simulated"})
    assert provenance(bag).refusal == "vut is declared real and simulated"
    assert "run_invalid" in codes(audited(make_bag, bag))


@pytest.mark.parametrize("kind", ["simulated", "real"])
def test_a_result_that_says_another_thing_of_a_stand_in_is_refused(
    kind: str, make_bag: BagMaker
) -> None:
    bag = make_bag("phy/bag", domain="physical", declared={**REAL, "vut": kind})
    stands_in = kind == "simulated"
    result = {"schema": "ssp.result/1", "bag": "bag", "participants": "as it was worded then"}
    file = bag.parent / "result.json"
    file.write_text(json.dumps({**result, "stand_in": stands_in}))
    assert provenance(bag).stand_in == stands_in
    file.write_text(json.dumps({**result, "stand_in": not stands_in}))
    with pytest.raises(InputError, match="stand_in: says another thing than its bag"):
        provenance(bag)


def test_a_result_may_be_older_than_a_persons_word(make_bag: BagMaker, tmp_path: Path) -> None:
    bag = make_bag("phy/bag", domain="physical", declared={})
    part = provenance(bag).participation
    assert part is not None
    result = {"schema": "ssp.result/1", "bag": "bag", "stand_in": False, "participants": part.text}
    (bag.parent / "result.json").write_text(json.dumps(result))
    said = word(tmp_path / "word.yaml", **dict.fromkeys(("vut", "ot1"), "simulated"))
    assert main(["audit", "declare", str(bag), str(said)]) == 0
    assert provenance(bag).stand_in


def test_topics_that_were_cut_out_of_a_session_are_disclosed(
    make_bag: BagMaker, tmp_path: Path
) -> None:
    topics = ("/ssp/object_states", "/ssp/safety_event", "/ssp/vut/state")
    bag = recorded(make_bag("phy/bag", domain="physical"), {}, *topics)
    cut = tmp_path / "cut" / "bag"
    assert main(["bag", "cut", str(bag), "--exclude", "/ssp/vut/state", "-o", str(cut)]) == 0
    shutil.copy(bag / "verdict.json", cut)
    with BagReader(cut) as reader:
        gone = sorted(set(topics) - set(reader.topics))
    assert "/ssp/vut/state" in gone
    found = audited(make_bag, cut).disclosures
    assert found["topics that were left out"] == ", ".join(gone)
