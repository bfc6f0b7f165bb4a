"""Making evidence packages: all that a score rests on, whole or not at all."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_core.hashing import sha256_file
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.clients.model_client import InProcessClients, ModelClient
from ssp_eval.evaluate.clients.model_replies import IgnoredAnswers, Loss, ModelReply
from ssp_eval.evaluate.clients.models import ModelSpec, bridge_spec
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.package.contents import Index, Recording
from ssp_eval.package.links import Links
from ssp_eval.package.make import make_package
from ssp_eval.package.model import content_id, load_table, object_path
from ssp_eval.package.verify import verify_package, work_out
from ssp_scenario_manager.event_spec.log import Record, append_record
from ssp_scenario_manager.maps.site import find_shipped
from ssp_vla_bridge.messages import Request, Response

Writer = Callable[..., Path]
MODEL = "constant_velocity"
DOMAINS = ("synthetic", "simulation", "physical")


def files_below(folder: Path) -> dict[str, str]:
    return {
        str(p.relative_to(folder)): sha256_file(p) for p in sorted(folder.rglob("*")) if p.is_file()
    }


def test_a_package_holds_every_file_by_its_hash(evidence: Path, made: Path) -> None:
    table = load_table(made)
    below = {f"demo/{path}": digest for path, digest in files_below(evidence).items()}
    stored = {entry.path: entry.sha256 for entry in table.files}
    assert stored.pop("log.jsonl")
    assert stored == below
    assert {p.name for p in (made / "objects").iterdir()} == {
        digest.removeprefix("sha256:") for digest in {e.sha256 for e in table.files}
    }
    for entry in table.files:
        assert object_path(made, entry.sha256).stat().st_size == entry.bytes
        assert sha256_file(object_path(made, entry.sha256)) == entry.sha256
    assert table.missing == []


def test_roles_come_from_what_files_hold(made: Path) -> None:
    roles = {entry.path: entry.role for entry in load_table(made).files}
    run, cell = "demo/runs/cut_in-physical", f"demo/cells/cut_in__physical__{MODEL}"
    expected = {
        f"{run}/task/task.json": "task",
        f"{run}/task/event.yaml": "event",
        f"{run}/task/site.yaml": "site",
        f"{run}/task/log.jsonl": "log",
        f"{run}/run.yaml": "run",
        f"{run}/bag/metadata.yaml": "bag_metadata",
        f"{run}/labels.json": "labels",
        f"{cell}/labels.json": "labels",
        f"{cell}/cell.json": "cell",
        f"{cell}/raw.jsonl": "raw",
        f"{cell}/requests.jsonl": "requests",
        f"{cell}/records.jsonl": "records",
        f"{cell}/score.json": "score",
        "demo/clips/cut_in.avi": "video",
        "demo/audits/cut_in/audit.json": "audit",
        "log.jsonl": "log_merged",
    }
    assert {path: roles[path] for path in expected} == expected
    assert {r for p, r in roles.items() if p.startswith("demo/frames/")} == {"frame"}
    assert {r for p, r in roles.items() if p.endswith(".mcap")} == {"recording"}


def test_every_score_can_be_walked_back(made: Path) -> None:
    table = load_table(made)
    assert len(table.chains) == 3 * 9
    for chain in table.chains:
        assert chain.record is not None
        assert chain.raw is not None
        assert chain.frames
    links = {(link.source, link.kind): link.target for link in table.links}
    for domain in ("simulation", "physical"):
        cell = f"demo/cells/cut_in__{domain}__{MODEL}/cell.json"
        bag = links[(cell, "bag")]
        task = links[(bag, "task_version")]
        assert task == f"demo/runs/cut_in-{domain}/task/task.json"
        assert links[(task, "event_version")].endswith("event.yaml")
    physical = "demo/runs/cut_in-physical/task/task.json"
    assert links[(physical, "bag")].startswith("demo/runs/cut_in-simulation/bag/")
    cell = f"demo/cells/cut_in__synthetic__{MODEL}/cell.json"
    assert links[(links[(cell, "bag")], "source_video")] == "demo/clips/cut_in.avi"


def make(*args: object) -> int:
    return main(["package", "make", *map(str, args)])


def test_the_same_evidence_gives_the_same_package(evidence: Path, tmp_path: Path) -> None:
    one = make_package([evidence], tmp_path / "one")[0]
    two = make_package([evidence], tmp_path / "two", copy=True)[0]
    assert one == two
    assert files_below(tmp_path / "one") == files_below(tmp_path / "two")
    assert content_id(one) == one.id


def test_recordings_are_linked_and_logs_are_not(evidence: Path, tmp_path: Path) -> None:
    for name, copy in (("linked", False), ("copied", True)):
        table = make_package([evidence], tmp_path / name, copy=copy)[0]
        for entry in table.files:
            if entry.path.startswith("demo/"):
                source = evidence.parent / entry.path
                same = source.samefile(object_path(tmp_path / name, entry.sha256))
                assert same is (not copy and entry.role in ("recording", "video", "frame"))


def test_a_later_entry_into_the_log_leaves_the_package_whole(own: Path, tmp_path: Path) -> None:
    out = tmp_path / "package"
    make_package([own], out)
    log = own / "runs" / "cut_in-simulation" / "task" / "log.jsonl"
    append_record(log, entry_of("2025-03-02T00:00:00Z", "later"))
    assert verify_package(out).ok
    make_package([own], out, force=True)
    assert verify_package(out).ok


def test_folders_are_named_apart(evidence: Path, tmp_path: Path) -> None:
    parts = {
        name: tmp_path / place
        for name, place in (
            ("runs", "a/part"),
            ("cells", "b/part"),
            ("frames", "c"),
            ("audits", "d"),
            ("clips", "e"),
        )
    }
    for name, place in parts.items():
        shutil.copytree(evidence / name, place)
    assert make(*parts.values(), "--out", tmp_path / "package") == 0
    tops = {e.path.split("/")[0] for e in load_table(tmp_path / "package").files}
    assert tops == {"part", "part-2", "c", "d", "e", "log.jsonl"}
    assert verify_package(tmp_path / "package").ok


@pytest.mark.parametrize(
    ("without", "message"),
    [
        ("clips/cut_in.avi", "names a source video that is not in the package"),
        ("runs/cut_in-simulation/task/task.json", "compiled task that is not in the package"),
        ("runs/cut_in-simulation/bag", "names a recording that is not in the package"),
        ("audits/cut_in/audit.json", "names an audit that is not in the package"),
        (f"cells/cut_in__physical__{MODEL}/raw.jsonl", "file raw.jsonl that is not in the package"),
        (f"cells/cut_in__physical__{MODEL}/labels.json", "file labels.json that is not"),
    ],
)
def test_a_hash_that_leads_nowhere_is_refused_and_nothing_left(
    without: str, message: str, own: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = own / without
    shutil.rmtree(target) if target.is_dir() else target.unlink()
    before = sorted(p.name for p in tmp_path.iterdir())
    assert make(own, "--out", tmp_path / "package") == 1
    error = capsys.readouterr().err
    assert message in error
    assert "Traceback" not in error
    assert sorted(p.name for p in tmp_path.iterdir()) == before


def test_a_recording_without_a_compiled_task_is_refused(
    make_bag: Writer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = make_bag("run/bag").parent
    run_campaign(
        [(run / "bag", None)],
        [bridge_spec(MODEL)],
        InProcessClients(),
        run,
        CellOptions(),
        propose_labels=True,
    )
    assert make(run, "--out", tmp_path / "package") == 1
    error = capsys.readouterr().err
    assert "names a K* that is not in the package" in error
    assert "names no attached task.json" in error
    assert not (tmp_path / "package").exists()


def test_parts_that_a_whole_package_would_hold_are_listed(
    own: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("runs/cut_in-physical", "cells", "audits"):
        shutil.rmtree(own / name)
    for domain in ("synthetic", "simulation"):
        bag = own / "runs" / f"cut_in-{domain}" / "bag"
        run_campaign([(bag, None)], [bridge_spec(MODEL)], InProcessClients(), own, CellOptions())
    assert make(own, "--out", tmp_path / "package", "--json") == 0
    missing = json.loads(capsys.readouterr().out)["missing"]
    assert missing == [
        "cut_in: no physical recording",
        f"demo/cells/cut_in__simulation__{MODEL}/cell.json: no audit",
        f"demo/cells/cut_in__synthetic__{MODEL}/cell.json: no audit",
    ]
    assert main(["package", "verify", str(tmp_path / "package")]) == 0
    assert "missing: cut_in: no physical recording" in capsys.readouterr().err


def test_the_clip_that_an_event_was_taken_from_is_linked_or_missing(
    own: Path, tmp_path: Path
) -> None:
    clip = own / "clips" / "cut_in.avi"
    event = find_shipped("cut_in", "event").read_text()
    for name, digest in (("with", sha256_file(clip)), ("without", "sha256:" + "0" * 64)):
        text, count = re.subn(r"sha256: null.*", f"sha256: {digest}", event)
        assert count == 1
        (own / f"{name}.event.yaml").write_text(text)
    table = make_package([own], tmp_path / "package")[0]
    links = {(link.source, link.at, link.target) for link in table.links}
    assert ("demo/with.event.yaml", "source.sha256", "demo/clips/cut_in.avi") in links
    assert table.missing == ["demo/without.event.yaml: no source video"]


def test_a_package_in_its_own_evidence_is_left_out(own: Path) -> None:
    assert make(own, "--out", own / "package") == 0
    one = load_table(own / "package")
    assert make(own, "--out", own / "package") == 1
    assert make(own, "--out", own / "package", "--force") == 0
    assert make(own, "--out", own / "second") == 0
    assert load_table(own / "package") == load_table(own / "second") == one


def test_what_is_no_package_is_never_replaced(
    evidence: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "file").write_text("mine")
    (tmp_path / "file").write_text("mine")
    (tmp_path / "link").symlink_to(tmp_path / "mine")
    for name in ("mine", "file", "link", "file/below"):
        assert make(evidence, "--out", tmp_path / name, "--force") == 1
        assert "error:" in capsys.readouterr().err
    assert (tmp_path / "mine" / "file").read_text() == (tmp_path / "file").read_text() == "mine"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "link", "mine"]


@pytest.mark.parametrize("force", [False, True])
def test_what_came_into_its_place_meanwhile_is_kept(
    own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, force: bool
) -> None:
    """A run that began while the package was made lost its folder to it."""
    out = tmp_path / "package"

    def slow(*arguments: Any) -> Any:
        out.mkdir()
        (out / "file").write_text("mine")
        return work_out(*arguments)

    monkeypatch.setattr("ssp_eval.package.make.work_out", slow)
    with pytest.raises(InputError, match="is there and is no package"):
        make_package([own], out, force=force)
    assert (out / "file").read_text() == "mine"


def test_an_interrupted_make_leaves_the_earlier_package(
    own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "package"
    make_package([own], out)
    before = files_below(tmp_path)

    def interrupted(*_: object, **__: object) -> Iterator[None]:
        raise KeyboardInterrupt

    monkeypatch.setattr("ssp_eval.package.make.work_out", interrupted)
    with pytest.raises(KeyboardInterrupt):
        make_package([own], out, force=True)
    assert files_below(tmp_path) == before


@pytest.mark.parametrize(
    "which", ["nothing", "file", "twice", "nested", "pipe", "loop", "link to itself", "empty"]
)
def test_folders_that_cannot_be_taken_in(
    which: str, own: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = [own]
    if which == "nothing":
        folders = [tmp_path / "nothing"]
    elif which == "file":
        folders = [own / "runs" / "cut_in-physical" / "run.yaml"]
    elif which == "twice":
        folders = [own, own / ".." / own.name]
    elif which == "nested":
        folders = [own / "runs", own]
    elif which == "pipe":
        os.mkfifo(own / "pipe")
    elif which == "loop":
        (own / "loop").symlink_to(own)
    elif which == "link to itself":
        (own / "loop").symlink_to("loop")
    else:
        folders = [tmp_path / "empty"]
        folders[0].mkdir()
    assert make(*folders, "--out", tmp_path / "package") == 1
    error = capsys.readouterr().err
    assert "error:" in error
    assert "Traceback" not in error
    assert not (tmp_path / "package").exists()


def entry_of(when: str, reason: str) -> Record:
    return Record.model_validate(
        {"kind": "disclosure", "when": when, "who": "A", "subject": "site x", "reason": reason}
    )


def test_a_broken_log_is_refused_by_line(own: Path, tmp_path: Path) -> None:
    log = own / "runs" / "cut_in-simulation" / "task" / "log.jsonl"
    with log.open("a") as stream:
        stream.write("{\n")
    with pytest.raises(InputError, match=r"task/log\.jsonl:2"):
        make_package([own], tmp_path / "package")


class Stateful:
    """Repeats the history before its plan, as OpenEMMA may, and loses one answer."""

    ignored = IgnoredAnswers()

    def __init__(self) -> None:
        self.carried: list[bool] = []

    def client(self, model: ModelSpec, options: Mapping[str, Any]) -> ModelClient:
        return self

    def ask(self, request: Request) -> ModelReply:
        self.carried.append(request.previous is not None)
        if len(self.carried) == 2:
            return ModelReply(None, "no answer within 1 s", Loss.SILENT)
        echo = ", ".join(f"[{s.speed_mps:.1f}, 0.0]" for s in request.history[:-1])
        text = f"{echo}\n" + ", ".join(["[9.0, 0.1]"] * 10)
        return ModelReply(Response(request.request_id, request.stamp_ns, "stateful", "s/1", text))


def test_records_that_need_their_question_are_made_again(own: Path, tmp_path: Path) -> None:
    bag = own / "runs" / "cut_in-simulation" / "bag"
    spec, model = ModelSpec("stateful", backend="openai", interface="openemma"), Stateful()
    (result,) = run_campaign([(bag, None)], [spec], model, own, CellOptions())
    assert result.missing == 1
    assert model.carried[:4] == [False, True, False, True]
    assert make(own, "--out", tmp_path / "package") == 0
    assert main(["package", "verify", str(tmp_path / "package")]) == 0


def test_the_list_that_chose_an_event_is_kept_and_linked(own: Path, tmp_path: Path) -> None:
    """Its hash stands in the log of the task that was compiled for the track."""
    task = own / "runs" / "cut_in-physical" / "task"
    listed = own / "shortlist.json"
    listed.write_text('{"schema": "ssp.shortlist/1"}')
    record = Record(
        kind="shortlist",
        when="2026-01-01T00:00:00Z",
        who="compiler",
        subject="cut_in",
        reason="no risk response",
        details={"sha256": sha256_file(listed)},
    )
    append_record(task / "log.jsonl", record)
    table, _ = make_package([own], tmp_path / "package")
    (entry,) = [one for one in table.files if one.role == "shortlist"]
    assert entry.path.endswith("/shortlist.json")
    (link,) = [one for one in table.links if one.kind == "shortlist"]
    assert (link.target, link.source.endswith("task/log.jsonl")) == (entry.path, True)
    assert verify_package(tmp_path / "package").ok
    listed.unlink()
    with pytest.raises(InputError, match="names a list that is not in the package"):
        make_package([own], tmp_path / "other")


def test_the_source_of_an_import_may_be_a_bag_of_several_files() -> None:
    digest = f"sha256:{'1' * 64}"
    contents = SimpleNamespace(with_hash=lambda *_: None)
    bags = {digest: SimpleNamespace(entry=SimpleNamespace(path="demo/theirs"))}
    index = SimpleNamespace(contents=contents, recordings=bags, events={}, sites={}, tasks={})
    links = Links(cast(Index, index))
    video = SimpleNamespace(source={"sha256": digest}, event_version=None)
    entry = SimpleNamespace(path="demo/import")
    links._recording(cast(Recording, SimpleNamespace(entry=entry, video=video, run=None)))
    (link,) = links.links
    assert (link.kind, link.source, link.target) == ("source_video", "demo/import", "demo/theirs")
