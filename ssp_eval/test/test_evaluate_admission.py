"""What an audit admits enters evaluation; what it refuses doesn't (METHOD 4)."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_core.files import write_json
from ssp_core.hashing import sha256_file
from ssp_eval.analysis.rows import rows_from_campaign
from ssp_eval.analysis.tables import all_tables
from ssp_eval.audit.model import Audit, load_audit
from ssp_eval.evaluate.admission import load_admissions
from ssp_eval.evaluate.asker import DirectAskers
from ssp_eval.evaluate.campaign import find_labels, run_campaign
from ssp_eval.evaluate.cell import CellOptions, CellResult
from ssp_eval.evaluate.clip import Clip
from ssp_eval.evaluate.models import bridge_spec
from ssp_eval.evaluate.question import NoQuestion, Question
from ssp_eval.evaluate.show import show
from ssp_eval.recordings.crop import Crop
from ssp_eval.recordings.properties import FIELDS
from ssp_eval.report.load import load_cells
from ssp_eval.report.page import write_report

BagMaker = Callable[..., Path]


def bag_hash(bag: Path) -> str:
    return sha256_file(next(bag.glob("*.mcap")))


def verdict_hash(bag: Path) -> str:
    return sha256_file(bag / "verdict.json")


def entry(domain: str, sha256: str, status: str, **more: Any) -> dict[str, Any]:
    reason = {"code": "safety_abort", "text": "safety abort", "detail": "separation at 7.10 s"}
    return {
        "domain": domain, "name": f"r-{domain}", "bag": "bag", "bag_sha256": sha256,
        "origin": "made up", "stand_in": False, "evidence": "states", "measured_from": "ticks",
        "domain_said_by": "somebody", "log_said_by": "somebody", "crop": None,
        "scenario": "cut_in", "event_version": "sha256:1", "task_version": None, "status": status,
        "reasons": [{**reason, "consequences": []}] if status == "refused" else [],
        "properties": {
            k: {"source": "states", "words": None, "how": "", "equal": None} for k in FIELDS
        },
        "phases": {
            "source": "states", "start_s": 0.0, "end_s": 9.0, "trigger_s": 4.0, "conflict_s": 4.5,
            "resolution_s": 6.0,
        },
        "kpr": 1.0, "epd": 0.0, "coverage": {"source": "none"}, **more,
    }  # fmt: skip


def audit_file(path: Path, status: str, sha256: str, others: str = "unpaired", **more: Any) -> Path:
    entries = [
        entry("synthetic", "sha256:syn", others),
        entry("simulation", sha256, status, **more),
        entry("physical", "sha256:phy", others),
    ]
    audit = Audit.model_validate(
        {
            "schema": "ssp.audit/2", "software": "ssp", "scenario": "cut_in",
            "event_version": "sha256:1", "weights": dict.fromkeys(FIELDS, 1.0), "thresholds": {},
            "recordings": entries,
        }
    )  # fmt: skip
    write_json(path, audit.model_dump(mode="json", by_alias=True))
    return path


def evaluate(bag: Path, out: Path, *audits: Path) -> CellResult:
    (result,) = run_campaign(
        [(bag, None)], [bridge_spec("constant_velocity")], DirectAskers(), out, CellOptions(),
        propose_labels=True, admissions=load_admissions(audits),
    )  # fmt: skip
    return result


def facts(result: CellResult) -> dict[str, Any]:
    value = json.loads((result.folder / "cell.json").read_text())
    assert isinstance(value, dict)
    return value


def domain_rows(out: Path) -> tuple[int, int]:
    """Rows of the tables of means by domain and by model."""
    tables = {table.name: table for table in all_tables(rows_from_campaign(out))}
    return len(tables["by_domain"].rows), len(tables["by_model"].rows)


def test_an_audit_file_reads_back(tmp_path: Path) -> None:
    file = audit_file(tmp_path / "audit.json", "admitted", "sha256:x", "admitted")
    assert load_audit(file) == load_audit(tmp_path)
    assert load_audit(file).admitted


def test_an_admitted_recording_enters_domain_means(make_bag: BagMaker, tmp_path: Path) -> None:
    bag, out = make_bag(), tmp_path / "out"
    file = audit_file(
        tmp_path / "audit.json", "admitted", bag_hash(bag), "admitted",
        verdict_sha256=verdict_hash(bag),
    )  # fmt: skip
    result = evaluate(bag, out, file)
    assert (result.status, result.admission) == ("ok", "admitted")
    assert facts(result)["admission"] == {
        "status": "admitted", "audit_sha256": sha256_file(file), "reasons": [], "crop": None,
    }  # fmt: skip
    assert domain_rows(out) == (1, 1)
    page = write_report(out).read_text()
    assert "left out: the transfer audit" not in page
    assert "stay out of domain means" not in page


def test_a_refused_recording_is_not_evaluated(make_bag: BagMaker, tmp_path: Path) -> None:
    bag, out = make_bag(), tmp_path / "out"
    file = audit_file(tmp_path / "audit.json", "refused", bag_hash(bag))
    result = evaluate(bag, out, file)
    assert (result.status, result.admission, result.asked) == ("refused", "refused", 0)
    assert result.reasons == ("refused by the audit: safety abort (separation at 7.10 s)",)
    assert not (result.folder / "score.json").exists()
    assert facts(result)["admission"]["reasons"] == ["safety abort (separation at 7.10 s)"]
    assert "separation at 7.10 s" in write_report(out).read_text()


@pytest.mark.parametrize("audited", [True, False])
def test_what_is_not_admitted_is_scored_and_stays_out_of_domain_means(
    audited: bool, make_bag: BagMaker, tmp_path: Path
) -> None:
    bag, out = make_bag(), tmp_path / "out"
    digest = bag_hash(bag) if audited else "sha256:another"
    file = audit_file(tmp_path / "audit.json", "unpaired", digest, verdict_sha256=verdict_hash(bag))
    result = evaluate(bag, out, file)
    word, mark = ("unpaired", "†") if audited else ("unaudited", "‡")
    assert (result.status, result.admission) == ("ok", word)
    assert result.score is not None
    assert domain_rows(out) == (0, 1)
    page = write_report(out).read_text()
    assert f"{mark} {word}: scored, and left out of domain means" in page
    assert f"constant_velocity {mark}" in page or f"(control) {mark}" in page
    assert "1 cell left out: the transfer audit did not admit the recording" in page


def test_a_session_s_labels_are_not_bound_and_its_verdict_is(
    make_bag: BagMaker, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    bag, out = make_bag(), tmp_path / "out"
    file = audit_file(
        tmp_path / "audit.json", "admitted", bag_hash(bag), "admitted",
        verdict_sha256=verdict_hash(bag),
    )  # fmt: skip
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


CROP = {"start_s": 0.5, "end_s": 6.0, "chosen_by": "METHOD 4.1"}


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
    more = {"verdict_sha256": verdict_hash(bag), "crop": {**CROP, "end_s": 3.0}}
    file = audit_file(tmp_path / "audit.json", "admitted", bag_hash(bag), "admitted", **more)
    result = evaluate(bag, out, file)
    assert (result.status, result.admission) == ("refused", "admitted")
    assert "lies outside the clip that the audit compared, 0.500 to 3.000 s" in result.reasons[0]


def test_audits_of_another_clip_contradict_each_other(tmp_path: Path) -> None:
    files = [
        audit_file(
            tmp_path / f"{end_s}.json", "admitted", "sha256:x", "admitted",
            crop={**CROP, "end_s": end_s},
        )
        for end_s in (6.0, 7.0)
    ]  # fmt: skip
    with pytest.raises(InputError, match="is of another verdict or another clip of r-simulation"):
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
                [(bag, None), (other, None)], [bridge_spec("silent")], DirectAskers(),
                tmp_path / "out", CellOptions(), propose_labels=True,
            )  # fmt: skip
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


def test_a_cell_of_an_earlier_version_counts_as_unaudited(
    make_bag: BagMaker, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    result = evaluate(make_bag(), out)
    value = facts(result)
    del value["admission"]
    write_json(result.folder / "cell.json", value)
    (cell,) = load_cells(out)
    assert cell.admission == "unaudited"
    assert "unaudited" in write_report(out).read_text()


def test_audits_that_contradict_each_other_are_refused(tmp_path: Path) -> None:
    first = audit_file(tmp_path / "a.json", "admitted", "sha256:x", "admitted")
    again = audit_file(tmp_path / "b.json", "admitted", "sha256:x", "admitted")
    other = audit_file(tmp_path / "c.json", "refused", "sha256:x")
    assert load_admissions([first, again])["sha256:x"].status == "admitted"
    with pytest.raises(InputError, match="says unpaired of r-synthetic"):
        load_admissions([first, other])


@pytest.mark.parametrize(
    ("status", "others", "reasons", "differs", "message"),
    [
        ("admitted", "unpaired", True, False, "simulation is admitted with reasons against it"),
        ("unpaired", "unpaired", True, False, "simulation is unpaired with reasons against it"),
        ("refused", "unpaired", False, False, "simulation is refused without a reason"),
        ("refused", "admitted", True, False, "synthetic is admitted, though simulation is refused"),
        (
            "admitted",
            "admitted",
            False,
            True,
            "simulation is admitted, though its topology differs",
        ),
    ],
)
def test_a_verdict_that_its_findings_contradict_is_no_audit(
    status: str, others: str, reasons: bool, differs: bool, message: str, tmp_path: Path
) -> None:
    value = json.loads(audit_file(tmp_path / "a.json", "refused", "sha256:x").read_text())
    entries = value["recordings"]
    entries[1]["status"] = status
    entries[0]["status"] = entries[2]["status"] = others
    if not reasons:
        entries[1]["reasons"] = []
    entries[1]["properties"]["topology"]["equal"] = not differs
    write_json(tmp_path / "a.json", value)
    with pytest.raises(InputError, match=message):
        load_admissions([tmp_path / "a.json"])


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
