"""Verifying evidence packages: every changed byte and every broken link is named."""

from __future__ import annotations

import json
import os
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.cli import main
from ssp_core.hashing import sha256_file
from ssp_eval.evaluate.store.cell_file import sealed as sealed_cell
from ssp_eval.package.model import Package, load_table, object_path, sealed, table_bytes
from ssp_eval.package.verify import verify_package

MODEL = "constant_velocity"


def reseal(folder: Path, change: Callable[[dict[str, Any]], None]) -> None:
    """Rewrites the table as somebody would who knows how it is made."""
    value = json.loads((folder / "package.json").read_text())
    change(value)
    (folder / "package.json").write_bytes(table_bytes(sealed(Package.model_validate(value))))


def test_a_package_as_it_was_made_is_sound(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["package", "verify", str(made), "--json"]) == 0
    value = json.loads(capsys.readouterr().out)
    assert value["ok"] is True
    assert (value["findings"], value["scores"]) == ([], 27)
    stand_in = "physical is a software stand-in, not a vehicle: a simulated world (lockstep)"
    assert value["notes"] == [f"demo/runs/cut_in-physical/bag: {stand_in}"]
    assert value["links"] == len(load_table(made).links) > 60
    assert main(["package", "verify", str(made), "--id", value["id"]]) == 0
    assert "27 scores walk back to K*" in capsys.readouterr().out
    assert main(["package", "verify", str(made), "--id", "sha256:" + "0" * 64]) == 1
    assert "expected was sha256:000" in capsys.readouterr().out


def flip(path: Path, position: int, value: int) -> Callable[[], None]:
    """Changes a byte in a file of its own, and gives what puts the old one back."""
    data = path.read_bytes()
    changed = bytearray(data)
    changed[position] ^= value
    path.unlink()
    path.write_bytes(changed)

    def undo() -> None:
        path.write_bytes(data)

    return undo


def test_a_flipped_byte_anywhere_is_named(made: Path, tmp_path: Path) -> None:
    package = Path(shutil.copytree(made, tmp_path / "package"))
    paths: dict[str, set[str]] = {}
    for entry in load_table(package).files:
        paths.setdefault(entry.sha256.removeprefix("sha256:"), set()).add(entry.path)
    files = sorted(p for p in package.rglob("*") if p.is_file() and p.stat().st_size)
    assert len(files) > 40

    @settings(max_examples=60, deadline=None)
    @given(st.sampled_from(files), st.integers(0, 1 << 40), st.integers(1, 255))
    def check(file: Path, position: int, value: int) -> None:
        undo = flip(file, position % file.stat().st_size, value)
        try:
            verdict = verify_package(package)
        finally:
            undo()
        assert not verdict.ok
        named = {finding.file for finding in verdict.findings}
        assert named == paths.get(file.name, {"package.json"})

    check()
    assert verify_package(package).ok


def test_every_file_is_watched(made: Path, tmp_path: Path) -> None:
    """No file escapes: one byte in each of them, at a place that the seed chooses."""
    package = Path(shutil.copytree(made, tmp_path / "package"))
    dice = random.Random(4)
    undone = []
    wanted = set()
    for entry in load_table(package).files:
        path = object_path(package, entry.sha256)
        wanted.add(entry.path)
        if path.name not in undone and entry.bytes:
            undone.append(path.name)
            flip(path, dice.randrange(entry.bytes), 1 << dice.randrange(8))
    found = verify_package(package).findings
    assert {finding.file for finding in found} == wanted
    assert {finding.kind for finding in found} == {"changed"}


def test_a_change_says_what_rests_on_the_file(
    package: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    entry = next(
        e for e in load_table(package).files if e.path.endswith("simulation/task/task.json")
    )
    flip(object_path(package, entry.sha256), 7, 1)
    assert main(["package", "verify", str(package)]) == 1
    out = capsys.readouterr().out
    assert f"changed: {entry.path} (objects/{entry.sha256[7:]})" in out
    assert f"breaks 9 scores of demo/cells/cut_in__simulation__{MODEL}/cell.json" in out
    assert "breaks audit demo/audits/cut_in/audit.json" in out
    # The physical task was validated by this simulation, and so its scores rest on it too.
    assert "breaks task demo/runs/cut_in-physical/task/task.json" in out
    assert f"breaks 9 scores of demo/cells/cut_in__physical__{MODEL}/cell.json" in out
    assert "breaks audit demo/audits/cut_in/audit.json" in out


def test_missing_and_superfluous_files_are_named(package: Path) -> None:
    table = load_table(package)
    gone = next(e for e in table.files if e.role == "video")
    object_path(package, gone.sha256).unlink()
    (package / "objects" / ("f" * 64)).write_text("more")
    (package / "notes.txt").write_text("more")
    (package / "extra").mkdir()
    found = {(f.kind, f.file) for f in verify_package(package).findings}
    assert found == {
        ("missing", "demo/clips/cut_in.avi"),
        ("superfluous", "objects/" + "f" * 64),
        ("superfluous", "notes.txt"),
        ("superfluous", "extra"),
    }


@pytest.mark.parametrize("kind", ["link", "folder", "pipe"])
def test_what_stands_in_for_an_object_is_named(kind: str, package: Path, tmp_path: Path) -> None:
    entry = next(e for e in load_table(package).files if e.role == "video")
    path = object_path(package, entry.sha256)
    shutil.move(path, tmp_path / "elsewhere")
    if kind == "link":
        path.symlink_to(tmp_path / "elsewhere")
    elif kind == "folder":
        path.mkdir()
    else:
        os.mkfifo(path)
    (finding,) = verify_package(package).findings
    assert (finding.kind, finding.file) == ("changed", entry.path)


def test_objects_that_lie_outside_the_package_are_named(package: Path, tmp_path: Path) -> None:
    shutil.move(package / "objects", tmp_path / "elsewhere")
    (package / "objects").symlink_to(tmp_path / "elsewhere")
    (finding,) = verify_package(package).findings
    assert (finding.kind, finding.file) == ("changed", "objects")


def replace_content(folder: Path, path: str, change: Callable[[bytes], bytes]) -> None:
    """Changes a file as somebody would who also mends its hash in the table."""
    table = load_table(folder)
    entry = next(e for e in table.files if e.path == path)
    data = change(object_path(folder, entry.sha256).read_bytes())
    scratch = folder / "new"
    scratch.write_bytes(data)
    digest = sha256_file(scratch)
    scratch.rename(object_path(folder, digest))
    others = [e for e in table.files if e.sha256 == entry.sha256 and e.path != path]
    if not others:
        object_path(folder, entry.sha256).unlink()

    def mend(value: dict[str, Any]) -> None:
        for file in value["files"]:
            if file["path"] == path:
                file.update(sha256=digest, bytes=len(data))

    reseal(folder, mend)


CELL = f"demo/cells/cut_in__simulation__{MODEL}"
RUN = "demo/runs/cut_in-simulation"


@pytest.mark.parametrize(
    ("path", "old", "new", "named", "text"),
    [
        # A file that its cell names by hash.
        (f"{CELL}/records.jsonl", b'"t_s": ', b'"t_s":  ', f"{CELL}/cell.json", "hashes.records"),
        (f"{CELL}/raw.jsonl", b'"text": "', b'"text": "X', f"{CELL}/cell.json", "hashes.raw"),
        (f"{CELL}/requests.jsonl", b"}\n", b" }\n", f"{CELL}/cell.json", "hashes.requests"),
        (f"{CELL}/score.json", b'"ivcs"', b' "ivcs"', f"{CELL}/cell.json", "hashes.score"),
        (f"{CELL}/labels.json", b'"labels"', b' "labels"', f"{CELL}/cell.json", "hashes.labels"),
        # A version that nothing has any more.
        (f"{RUN}/labels.json", b"sha256:", b"sha256:9", f"{RUN}/labels.json", "event_version"),
        (f"{RUN}/task/task.json", b'"seed": 1', b'"seed": 2', f"{RUN}/task", "was changed"),
        (f"{RUN}/task/event.yaml", b"\n", b"\n\n", f"{RUN}/bag", "event.yaml"),
        (f"{RUN}/task/site.yaml", b"400.0", b"401.0", f"{RUN}/bag", "site"),
        (f"{RUN}/run.yaml", b"{", b"{ ", f"{RUN}/bag", "run.yaml"),
        (f"{RUN}/task/log.jsonl", b"middle", b"centre", f"{RUN}/bag", "log.jsonl"),
        ("demo/clips/cut_in.avi", b"movi", b"mowi", "demo/runs/cut_in-synthetic", "source video"),
        ("demo/audits/cut_in/audit.json", b'6": "sha', b'6": "sha0', "demo/audits", "recording"),
        ("log.jsonl", b"middle", b"centre", "log.jsonl", "not what the parts"),
    ],
)
def test_a_forged_file_is_caught_by_what_names_it(
    path: str, old: bytes, new: bytes, named: str, text: str, package: Path
) -> None:
    def change(data: bytes) -> bytes:
        assert old in data
        return data.replace(old, new, 1)

    replace_content(package, path, change)
    verdict = verify_package(package)
    assert not verdict.ok
    assert any(f.file.startswith(named) and text in f.text for f in verdict.findings)


def test_a_forged_score_is_caught_even_where_its_cell_was_mended(package: Path) -> None:
    replace_content(
        package,
        f"{CELL}/score.json",
        lambda data: json.dumps({**json.loads(data), "ivcs": 0.99}).encode(),
    )
    digest = next(e.sha256 for e in load_table(package).files if e.path == f"{CELL}/score.json")

    def mend(data: bytes) -> bytes:
        value = json.loads(data)
        value["hashes"]["score"] = digest
        return json.dumps(sealed_cell(value)).encode()

    replace_content(package, f"{CELL}/cell.json", mend)
    texts = [f.text for f in verify_package(package).findings if f.kind == "link"]
    assert texts == ["is not what its records and labels give"]


def test_a_forged_admission_is_caught(package: Path) -> None:
    def forge(data: bytes, seal: Callable[[dict[str, Any]], dict[str, Any]]) -> bytes:
        value = json.loads(data)
        value["admission"]["status"] = "unpaired"
        return json.dumps(seal(value)).encode()

    replace_content(package, f"{CELL}/cell.json", lambda data: forge(data, dict))
    assert any("hashes.cell: isn't the hash" in f.text for f in verify_package(package).findings)
    replace_content(package, f"{CELL}/cell.json", lambda data: forge(data, sealed_cell))
    (finding,) = verify_package(package).findings
    assert finding.file == f"{CELL}/cell.json"
    assert (
        "admission.status: is unpaired, and by demo/audits/cut_in/audit.json it is admitted"
        in finding.text
    )


def test_a_forged_table_is_caught(package: Path) -> None:
    def mend(value: dict[str, Any]) -> None:
        value["links"].pop()
        value["chains"][0]["frames"].pop()
        value["missing"] = ["something"]

    reseal(package, mend)
    texts = " ".join(f.text for f in verify_package(package).findings)
    for part in ("links: lacks", "chains: lacks", "chains: says", "missing: says"):
        assert part in texts


MALFORMED = {
    "empty": lambda text: "",
    "cut": lambda text: text[: len(text) // 2],
    "no object": lambda text: "[1]",
    "deep": lambda text: "[" * 100_000,
    "other schema": lambda text: text.replace("ssp.package/1", "ssp.package/2"),
    "unknown key": lambda text: text.replace('"files"', '"filez"'),
    "way out": lambda text: text.replace('"demo/clips/cut_in.avi"', '"../../etc/passwd"'),
    "absolute": lambda text: text.replace('"demo/clips/cut_in.avi"', '"/etc/passwd"'),
    "no hash": lambda text: text.replace('"sha256:', '"md5:'),
    "white space": lambda text: text + "\n",
    "number": lambda text: text.replace('"bytes": ', '"bytes": -'),
    "not finite": lambda text: text.replace('"t_s": ', '"t_s": NaN, "x": '),
}


@pytest.mark.parametrize("how", MALFORMED)
def test_a_malformed_table_is_one_finding(
    how: str, package: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = package / "package.json"
    table.write_text(MALFORMED[how](table.read_text()))
    assert main(["package", "verify", str(package)]) == 1
    text = capsys.readouterr()
    assert text.out.startswith("table: package.json: ")
    assert "Traceback" not in text.out + text.err
    assert main(["package", "show", str(package)]) == 1
    assert "package.json" in capsys.readouterr().err


@settings(max_examples=40, deadline=None)
@given(st.data())
def test_no_table_makes_verify_raise(made: Path, data: st.DataObject) -> None:
    """Any content of a table, resealed or not, makes verify report something, never raise."""
    value = json.loads((made / "package.json").read_text())
    place, key = value, data.draw(st.sampled_from(["files", "links", "chains", "missing", "id"]))
    if isinstance(place[key], list) and place[key]:
        place, key = place[key], data.draw(st.integers(0, len(place[key]) - 1))
        if isinstance(place[key], dict) and data.draw(st.booleans()):
            place, key = place[key], data.draw(st.sampled_from(sorted(place[key])))
    place[key] = data.draw(
        st.none()
        | st.integers()
        | st.text(max_size=5)
        | st.just([])
        | st.just("demo/clips/cut_in.avi")
    )
    folder = made.parent / "fuzzed"
    folder.mkdir(exist_ok=True)
    if not (folder / "objects").is_dir():
        shutil.copytree(made / "objects", folder / "objects", copy_function=os.link)
    before = json.loads((made / "package.json").read_text())
    try:
        table = table_bytes(sealed(Package.model_validate(value)))
    except ValueError:
        table = json.dumps(value).encode()
    (folder / "package.json").write_bytes(table)
    verdict = verify_package(folder)
    assert verdict.ok == (json.loads(table) == before)


def test_what_no_package_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["package", "verify", str(tmp_path / "nothing")]) == 1
    assert "nothing: is not there; name a folder of `ssp package make`" in capsys.readouterr().err
    assert main(["package", "verify", str(tmp_path)]) == 1
    told = capsys.readouterr().out
    assert "holds no package.json" in told
    assert told.endswith("not sound: 1 finding\n")
