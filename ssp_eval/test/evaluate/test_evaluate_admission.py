"""Evaluation takes the recordings that an audit admits, and no others (METHOD 4)."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from evaluation_files import CROP, audit_file, facts_of

from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_core.files.writing import write_json
from ssp_core.hashing import sha256_file
from ssp_eval.data.provenance import find_labels
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.clients.model_client import InProcessClients
from ssp_eval.evaluate.clients.models import bridge_spec
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.evaluate.run import show
from ssp_eval.evaluate.store.admission import load_admissions
from ssp_eval.evaluate.store.cell_file import CellResult
from ssp_eval.recordings.clip import Clip, NoQuestion, Question
from ssp_eval.recordings.event import Crop
from ssp_eval.report.page import write_report
from ssp_eval.statistics.rows import rows_from_campaign
from ssp_eval.statistics.tables.scores import all_tables

BagMaker = Callable[..., Path]


def verdict_hash(bag: Path) -> str:
    return sha256_file(bag / "verdict.json")


def evaluate(bag: Path, out: Path, *audits: Path) -> CellResult:
    (result,) = run_campaign(
        [(bag, None)],
        [bridge_spec("constant_velocity")],
        InProcessClients(),
        out,
        CellOptions(),
        propose_labels=True,
        admissions=load_admissions(audits),
    )
    return result


def facts(result: CellResult) -> dict[str, Any]:
    value = json.loads((result.folder / "cell.json").read_text())
    assert isinstance(value, dict)
    return value


def domain_rows(out: Path) -> tuple[int, int]:
    """Rows of the tables of means by domain and by model."""
    tables = {table.name: table for table in all_tables(rows_from_campaign(out))}
    return len(tables["by_domain"].rows), len(tables["by_model"].rows)


def test_an_admitted_recording_enters_domain_means(make_bag: BagMaker, tmp_path: Path) -> None:
    bag, out = make_bag(), tmp_path / "out"
    file = audit_file(tmp_path / "audit.json", "admitted", bag)
    result = evaluate(bag, out, file)
    assert (result.status, result.admission) == ("ok", "admitted")
    assert facts(result)["admission"] == {
        "status": "admitted",
        "audit_sha256": sha256_file(file),
        "reasons": [],
        "crop": {**CROP, "short_before_s": 0.0, "short_after_s": 0.0},
    }
    assert domain_rows(out) == (1, 1)
    page = write_report(out).read_text()
    assert "left out: the transfer audit" not in page
    assert "left out of domain means" not in page


def test_a_refused_recording_is_not_evaluated(make_bag: BagMaker, tmp_path: Path) -> None:
    bag, out = make_bag(), tmp_path / "out"
    file = audit_file(tmp_path / "audit.json", "refused", bag)
    result = evaluate(bag, out, file)
    assert (result.status, result.admission, result.sent) == ("refused", "refused", 0)
    assert result.reasons == ("refused by the audit: safety abort (separation at 7.10 s)",)
    assert not (result.folder / "score.json").exists()
    assert facts(result)["admission"]["reasons"] == ["safety abort (separation at 7.10 s)"]
    assert "separation at 7.10 s" in write_report(out).read_text()


@pytest.mark.parametrize("audited", [True, False])
def test_what_is_not_admitted_is_scored_and_stays_out_of_domain_means(
    audited: bool, make_bag: BagMaker, tmp_path: Path
) -> None:
    bag, out = make_bag(), tmp_path / "out"
    file = audit_file(tmp_path / "audit.json", "unpaired", bag if audited else "sha256:another")
    result = evaluate(bag, out, file)
    word, mark = ("unpaired", "†") if audited else ("unaudited", "‡")
    assert (result.status, result.admission) == ("ok", word)
    assert result.score is not None
    assert domain_rows(out) == (0, 1)
    page = write_report(out).read_text()
    assert f"{mark} {word}: scored, but left out of domain means" in page
    assert f"constant_velocity {mark}" in page or f"(control) {mark}" in page
    assert "1 cell left out: the transfer audit did not admit the recording" in page


def test_a_session_s_labels_are_not_bound_and_its_verdict_is(
    make_bag: BagMaker, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    bag, out = make_bag(), tmp_path / "out"
    file = audit_file(tmp_path / "audit.json", "admitted", bag)
    assert evaluate(bag, out, file).admission == "admitted"
    labels = bag.parent / "bag.labels.json"
    value = json.loads(labels.read_text())
    value["labels"].pop()
    write_json(labels, value)
    assert evaluate(bag, out, file).admission == "admitted"
    told = {"schema": "ssp.verdict/1", "verdict": "valid", "reasons": ["somebody looked again"]}
    before = verdict_hash(bag)
    write_json(bag / "verdict.json", told)
    result = evaluate(bag, out, file)
    assert (result.status, result.admission) == ("ok", "unaudited")
    why = f"the audit read the verdict {before}, the bag's is {verdict_hash(bag)}"
    assert facts(result)["admission"]["reasons"] == [why]
    assert facts(result)["hashes"]["verdict"] == verdict_hash(bag)
    assert domain_rows(out) == (0, 1)
    show([result], out)
    assert f"counts as unaudited, audit it again: {why}" in capfd.readouterr().err


def test_only_the_clip_that_was_audited_is_evaluated(make_bag: BagMaker, tmp_path: Path) -> None:
    """No frame and no state before the clip is in any question (METHOD 4.1)."""
    bag = make_bag()
    with Clip(bag) as clip:
        whole = clip.question(0.9)
        clip.crop_to(Crop(0.5, 6.0, "METHOD 4.1"))
        cut = clip.question(0.9)
        assert isinstance(whole, Question)
        assert isinstance(cut, Question)
        first_ns = clip.start_ns + 500_000_000
        assert min(f.stamp_ns for f in whole.request.frames) < first_ns
        assert min(f.stamp_ns for f in cut.request.frames) >= first_ns
        assert cut.request.frames[-1] == whole.request.frames[-1]
        assert len(cut.request.history) < len(whole.request.history)
        assert isinstance(clip.question(0.4), NoQuestion)
        assert isinstance(clip.question(6.3), NoQuestion)


def test_a_label_outside_the_audited_clip_is_not_scored(make_bag: BagMaker, tmp_path: Path) -> None:
    bag, out = make_bag(), tmp_path / "out"
    file = audit_file(tmp_path / "audit.json", "admitted", bag, crop={**CROP, "start_s": 3.9})
    result = evaluate(bag, out, file)
    assert (result.status, result.admission) == ("refused", "admitted")
    assert "lies outside the clip that the audit compared, 3.900 to 9.000 s" in result.reasons[0]


def test_audits_of_another_clip_contradict_each_other(tmp_path: Path) -> None:
    files = [
        audit_file(
            tmp_path / f"{end_s}.json",
            "admitted",
            "sha256:x",
            crop={**CROP, "end_s": end_s},
        )
        for end_s in (8.0, 9.0)
    ]
    with pytest.raises(InputError, match="is of another verdict or another clip of r-synthetic"):
        load_admissions(files)


def test_a_session_without_the_runner_s_word_is_refused(make_bag: BagMaker, tmp_path: Path) -> None:
    bag, out = make_bag(told=False), tmp_path / "out"
    result = evaluate(bag, out)
    assert result.status == "refused"
    assert "no verdict.json: the runner's word on how the run ended is missing" in result.reasons[0]


def test_one_recording_under_two_paths_is_refused(make_bag: BagMaker, tmp_path: Path) -> None:
    bag = make_bag()
    copy = Path(shutil.copytree(bag, tmp_path / "copy" / "bag"))
    for other in (copy, bag, next(bag.glob("*.mcap"))):
        with pytest.raises(InputError) as caught:
            run_campaign(
                [(bag, None), (other, None)],
                [bridge_spec("silent")],
                InProcessClients(),
                tmp_path / "out",
                CellOptions(),
                propose_labels=True,
            )
        assert caught.value.file == str(other)
        assert f"is the same recording as {bag}" in str(caught.value)
    assert not (tmp_path / "out").exists()
    assert not (bag.parent / "bag.labels.json").exists()


@pytest.mark.parametrize("place", ["bag/labels.json", "bag.labels.json", "labels.json"])
def test_labels_are_found_for_the_file_in_the_bag_too(
    place: str, make_bag: BagMaker, tmp_path: Path
) -> None:
    bag = make_bag()
    (tmp_path / place).write_text("{}")
    assert find_labels(bag) == find_labels(next(bag.glob("*.mcap"))) == tmp_path / place
    alone = tmp_path / "alone" / "x.mcap"
    alone.parent.mkdir()
    alone.touch()
    assert find_labels(alone) is None
    beside = alone.parent / "x.mcap.labels.json"
    beside.write_text("{}")
    assert find_labels(alone) == beside


def test_audits_that_contradict_each_other_are_refused(tmp_path: Path) -> None:
    first = audit_file(tmp_path / "a.json", "admitted", "sha256:x")
    again = audit_file(tmp_path / "b.json", "admitted", "sha256:x")
    other = audit_file(tmp_path / "c.json", "refused", "sha256:x")
    assert load_admissions([first, again])["sha256:x"].status == "admitted"
    with pytest.raises(InputError, match="says unpaired of r-synthetic"):
        load_admissions([first, other])


Change = Callable[[list[dict[str, Any]]], object]


@pytest.mark.parametrize(
    ("status", "change", "message"),
    [
        ("refused", lambda e: e[1].update(status="admitted"), "is admitted with reasons"),
        ("refused", lambda e: e[1].update(status="unpaired"), "is unpaired with reasons"),
        ("refused", lambda e: e[1].update(reasons=[]), "simulation is refused without a reason"),
        ("refused", lambda e: e[0].update(status="admitted"), "though simulation is refused"),
        ("admitted", lambda e: e[0].update(status="unpaired"), "though nobody is refused"),
        ("admitted", lambda e: e.reverse(), "must be of synthetic, simulation, physical"),
        ("admitted", lambda e: e[2].update(bag_sha256="sha256:x"), "it is the simulation"),
        ("admitted", lambda e: e[1].update(event_version="sha256:2"), "it realises sha256:2"),
        ("admitted", lambda e: e[1].update(event_version=None), "it realises None"),
        ("admitted", lambda e: e[1].update(scenario="vru_crossing"), "it is of vru_crossing"),
        ("admitted", lambda e: e[1].update(verdict="aborted"), "the run's verdict is aborted"),
        ("admitted", lambda e: e[1].update(safety_events=["x at 7 s"]), "it has x at 7 s"),
        ("admitted", lambda e: e[1].update(identities=["a switch"]), "it has a switch"),
        (
            "admitted",
            lambda e: e[1].update(changes=[{"field": "seed", "old": 1, "new": 2, "logged": False}]),
            "seed isn't logged",
        ),
        ("admitted", lambda e: e[1]["properties"].pop("topology"), "its properties aren't"),
        ("admitted", lambda e: e[1]["properties"]["topology"].update(equal=False), "y differs"),
        (
            "admitted",
            lambda e: e[1]["properties"]["topology"].update(words={"it": ["isn't"]}),
            "topology differs",
        ),
        (
            "admitted",
            lambda e: e[1]["properties"]["topology"].update(source="unverified"),
            "topology is unverified",
        ),
        ("admitted", lambda e: e[1].update(crop=None), "its phases aren't located"),
        ("admitted", lambda e: e[1]["phases"].update(conflict_s=None), "its phases aren't located"),
        ("admitted", lambda e: e[1]["phases"].update(conflict_s=3.0), "don't lie in its clip"),
        ("admitted", lambda e: e[1]["phases"].update(resolution_s=9.5), "don't lie in its clip"),
        ("admitted", lambda e: e[1]["phases"].update(conflict_s=4.6), "its phi is"),
        ("admitted", lambda e: e[1].update(epd=None), "its EPD is missing"),
        ("admitted", lambda e: e[1].update(epd=0.1), "its EPD of 0.1 isn't that of its phi"),
        ("admitted", lambda e: e[1].update(kpr=0.8), "its KPR is 0.8"),
        ("admitted", lambda e: e[1].update(coverage={"source": "none"}), "its camera covers"),
        ("admitted", lambda e: e[1]["coverage"]["zone"].update(fraction=0.5), "is visible for 0.5"),
        (
            "admitted",
            lambda e: e[1].update(
                pictures={
                    "checks": [
                        {"name": "ot1", "figure": 0.4, "low": 1.3, "told": "nothing is there"}
                    ]
                }
            ),
            "its pictures differ from its states: nothing is there",
        ),
    ],
)
def test_a_status_that_its_own_values_contradict_is_no_audit(
    status: str, change: Change, message: str, tmp_path: Path
) -> None:
    file = audit_file(tmp_path / "a.json", status, "sha256:x")
    load_admissions([file])
    value = json.loads(file.read_text())
    change(value["recordings"])
    write_json(file, value)
    with pytest.raises(InputError, match=re.escape(message)):
        load_admissions([file])


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("scenario", None),
        ("event_version", "sha256:2"),
        ("origin", "session another"),
        ("stand_in", True),
        ("verdict", None),
    ],
)
def test_an_entry_of_another_recording_under_this_bag_s_hash_ends_the_command(
    field: str, value: object, make_bag: BagMaker, tmp_path: Path
) -> None:
    """The entries of an audit were exchanged, and all else in the audit still holds together."""
    bag = make_bag()
    file = audit_file(tmp_path / "audit.json", "admitted", bag)
    audit = json.loads(file.read_text())
    audit["recordings"][1][field] = value
    if field == "event_version":
        audit = json.loads(json.dumps(audit).replace(facts_of(bag).event_version or "", "sha256:2"))
    write_json(file, audit)
    with pytest.raises(InputError, match="isn't of the recording bag that it names") as caught:
        evaluate(bag, tmp_path / "out", file)
    assert caught.value.field == f"recordings.simulation.{field}"
    assert not (tmp_path / "out").exists()


def test_an_observation_that_came_after_the_audit_makes_it_unaudited(
    make_bag: BagMaker, tmp_path: Path
) -> None:
    bag = make_bag()
    file = audit_file(tmp_path / "audit.json", "admitted", bag)
    (bag / "observation_ada.json").write_text("{}")
    result = evaluate(bag, tmp_path / "out", file)
    assert result.admission == "unaudited"
    assert result.admission_reasons == ("the audit read other observations: observation_ada.json",)


def test_what_is_no_audit_is_an_input_error(
    make_bag: BagMaker, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    wrong = tmp_path / "wrong.json"
    wrong.write_text('{"schema": "ssp.audit/9"}')
    arguments = ["--bridge", "silent", "--propose-labels", "--out", str(tmp_path / "out")]
    status = main(["evaluate", str(make_bag()), *arguments, "--audit", str(wrong)])
    assert status == 1
    assert "wrong.json: schema" in capfd.readouterr().err
    assert not (tmp_path / "out").exists()
