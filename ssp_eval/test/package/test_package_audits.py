"""Verifying audits: they are made again from the recordings, so that no forged one passes."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_core.files.writing import write_json
from ssp_core.hashing import sha256_bytes
from ssp_eval.evaluate.store.cell_file import sealed as sealed_cell
from ssp_eval.package.make import make_package
from ssp_eval.package.model import Package, load_table, object_path, sealed, table_bytes
from ssp_eval.package.verify import Finding, verify_package

AUDIT = "demo/audits/cut_in/audit.json"
RUNS = "demo/runs/cut_in-"
Value = dict[str, Any]


def replace(package: Path, path: str, change: Callable[[Value], object]) -> None:
    """Rewrites a JSON file and all that names its bytes, as somebody would who knows the format."""
    table = load_table(package).model_dump(mode="json", by_alias=True)
    (old,) = (e["sha256"] for e in table["files"] if e["path"] == path)
    value = json.loads(object_path(package, old).read_bytes())
    change(value)
    renamed = {old: _store(package, json.dumps(value).encode())}
    for entry in table["files"]:
        if entry["role"] == "cell":
            text = object_path(package, entry["sha256"]).read_text()
            if old in text:
                value = sealed_cell(json.loads(text.replace(old, renamed[old])))
                mended = json.dumps(value).encode()
                renamed[entry["sha256"]] = _store(package, mended)
    for entry in table["files"]:
        if entry["sha256"] in renamed and (entry["role"] == "cell" or entry["path"] == path):
            entry["sha256"] = renamed[entry["sha256"]]
            entry["bytes"] = object_path(package, entry["sha256"]).stat().st_size
    for link in table["links"]:
        link["hash"] = renamed.get(link["hash"], link["hash"])
    kept = {entry["sha256"] for entry in table["files"]}
    for gone in set(renamed) - kept:
        object_path(package, gone).unlink()
    (package / "package.json").write_bytes(table_bytes(sealed(Package.model_validate(table))))


def _store(package: Path, data: bytes) -> str:
    digest = sha256_bytes(data)
    object_path(package, digest).write_bytes(data)
    return digest


def recording(number: int, **changed: object) -> Callable[[Value], None]:
    return lambda value: value["recordings"][number].update(changed)


def unpair(value: Value) -> None:
    for entry in value["recordings"]:
        entry["status"] = "unpaired"


def findings_in(package: Path, path: str) -> list[Finding]:
    return [f for f in verify_package(package).findings if f.file == path]


@pytest.mark.parametrize(
    ("change", "field"),
    [
        (recording(1, kpr=0.75), "recordings[1].kpr: says 0.75, and the recordings give 1.0"),
        (recording(2, epd=0.5), "recordings[2].epd: says 0.5, and the recordings give"),
        (recording(2, contradictions=[]), "recordings[2].contradictions: says []"),
        (recording(1, disclosures={}), "is missing; the recordings give"),
        (recording(1, stand_in=True), "recordings[1].stand_in: says true"),
        (recording(1, verdict="aborted"), 'recordings[1].verdict: says "aborted"'),
        (
            lambda v: v["recordings"][1]["phases"].update(trigger_s=2.0),
            "recordings[1].phases.trigger_s: says 2.0, and the recordings give 3.08",
        ),
        (
            lambda v: v["recordings"][1]["coverage"]["participants"]["ot1"].update(fraction=0.95),
            "recordings[1].coverage.participants.ot1.fraction: says 0.95",
        ),
        (
            lambda v: v["recordings"][0]["properties"]["topology"]["words"].update(lanes=["9"]),
            "recordings[0].properties.topology.words.lanes: isn't among what the recordings give",
        ),
        (
            lambda v: v["recordings"][1]["changes"].append(
                {"field": "limits.speed_mps", "old": 1, "new": 2, "logged": True, "who": "W"}
            ),
            "recordings[1].changes: says [{",
        ),
        (lambda v: v["weights"].update(topology=0.5), "weights.topology: says 0.5"),
        (lambda v: v["thresholds"].update(ttc_s=9.0), "thresholds.ttc_s: says 9.0"),
        (
            lambda v: v["response"]["pairs"][0].update(verdict="unlike", why=[]),
            'response.pairs[0].verdict: says "unlike"',
        ),
    ],
)
def test_a_forged_value_is_named_with_what_rests_on_it(
    change: Callable[[Value], object], field: str, package: Path
) -> None:
    replace(package, AUDIT, change)
    findings = verify_package(package).findings
    assert {f.file for f in findings} == {AUDIT}
    assert any(field in f.text for f in findings), [f.text for f in findings]
    assert len(findings[0].breaks) == 3  # the scores of three cells
    assert findings[0].breaks[0].startswith("9 scores of demo/cells/cut_in__")


def test_forged_statuses_come_first(package: Path) -> None:
    replace(package, AUDIT, unpair)
    texts = [f.text for f in findings_in(package, AUDIT)]
    assert texts == [
        f'recordings[{n}].status: says "unpaired", and the recordings give "admitted"'
        for n in range(3)
    ]


def test_an_audit_made_by_another_version_is_said_and_compared(package: Path) -> None:
    replace(package, AUDIT, lambda value: value.update(software="ssp 9.9"))
    verdict = verify_package(package)
    assert verdict.ok
    told = f"{AUDIT}: made by ssp 9.9, compared with what ssp"
    assert [note for note in verdict.notes if note.startswith(told)]
    replace(package, AUDIT, recording(1, kpr=0.75))
    assert [f.text.split(":")[0] for f in verify_package(package).findings] == ["recordings[1].kpr"]


def test_where_a_recording_lay_decides_nothing(package: Path) -> None:
    replace(package, AUDIT, recording(1, bag="/elsewhere/bag"))
    assert verify_package(package).ok
    replace(package, AUDIT, recording(1, name="another"))
    (finding,) = verify_package(package).findings
    assert finding.file == AUDIT.replace(".json", ".html")  # which says its name


def test_a_refusal_that_was_wiped_out_is_caught(
    own: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An audit that refused, made to admit, with every hash mended that names it."""
    runs = [str(own / "runs" / f"cut_in-{d}") for d in ("synthetic", "simulation", "physical")]
    told = {"schema": "ssp.verdict/1", "verdict": "invalid_harness", "reasons": ["a node died"]}
    write_json(own / "runs" / "cut_in-physical" / "bag" / "verdict.json", told)
    shutil.rmtree(own / "cells")
    file = own / "audits" / "cut_in" / "audit.json"
    assert main(["audit", *runs, "--out", str(file.parent), "--force"]) == 1
    make_package([own], tmp_path / "honest")
    assert verify_package(tmp_path / "honest").ok
    value = json.loads(file.read_text())
    assert [entry["status"] for entry in value["recordings"]] == ["unpaired", "unpaired", "refused"]
    for entry in value["recordings"]:
        entry.update(status="admitted", reasons=[])
    write_json(file, value)
    with pytest.raises(InputError) as caught:
        make_package([own], tmp_path / "forged")
    text = str(caught.value)
    assert f'{AUDIT}: recordings[2].status: says "admitted", and the recordings give' in text
    assert f'{AUDIT}: recordings[2].reasons: says [], and the recordings give ["run_inv' in text
    # The same in a package that was whole.
    for number in range(3):
        replace(tmp_path / "honest", AUDIT, recording(number, status="admitted", reasons=[]))
    capsys.readouterr()
    assert main(["package", "verify", str(tmp_path / "honest")]) == 1
    assert f"link: {AUDIT} (objects/" in (out := capsys.readouterr().out)
    assert 'recordings[2].status: says "admitted", and the recordings give "refused"' in out


def test_labels_may_be_reviewed_after_the_audit_that_counted_them(package: Path) -> None:
    path = f"{RUNS}simulation/labels.json"
    replace(package, path, lambda value: value["labels"].pop())
    assert findings_in(package, AUDIT) == []


def test_a_verdict_is_bound_to_audit_and_cell(package: Path) -> None:
    path = f"{RUNS}simulation/bag/verdict.json"
    table = load_table(package).model_dump(mode="json", by_alias=True)
    (entry,) = (e for e in table["files"] if e["path"] == path)
    assert {link["source"] for link in table["links"] if link["target"] == path} == {
        AUDIT,
        "demo/cells/cut_in__simulation__constant_velocity/cell.json",
    }
    shared = [e["path"] for e in table["files"] if e["sha256"] == entry["sha256"]]
    assert len(shared) == 2  # simulation and physical end alike
    data = json.dumps({"schema": "ssp.verdict/1", "verdict": "valid", "reasons": ["hm"]}).encode()
    entry.update(sha256=_store(package, data), bytes=len(data))
    (package / "package.json").write_bytes(table_bytes(sealed(Package.model_validate(table))))
    findings = verify_package(package).findings
    texts = {(f.file, f.text.split(":")[0]) for f in findings if f.kind == "link"}
    assert (AUDIT, "recordings[1].verdict_sha256") in texts
    cell = "demo/cells/cut_in__simulation__constant_velocity/cell.json"
    assert (cell, "hashes.verdict") in texts


def test_paths_that_cannot_lie_side_by_side_are_a_finding(package: Path) -> None:
    """A file where the bag's folder should be: nothing that an evidence folder can hold."""
    table = load_table(package).model_dump(mode="json", by_alias=True)
    data = b"in the way"
    path = f"{RUNS}simulation/bag"
    table["files"].append(
        {"path": path, "role": "other", "sha256": _store(package, data), "bytes": len(data)}
    )
    (package / "package.json").write_bytes(table_bytes(sealed(Package.model_validate(table))))
    (finding,) = verify_package(package).findings
    assert finding.file == AUDIT
    assert "can't be made again: " in finding.text
    assert "can't be laid out beside its files" in finding.text


def test_recordings_in_another_order_are_a_finding(package: Path) -> None:
    replace(package, AUDIT, lambda value: value["recordings"].reverse())
    texts = [f.text for f in findings_in(package, AUDIT)]
    assert any("in its place stands synthetic" in text for text in texts), texts
    assert not any("ssp-package-" in text for text in texts)
