"""Twins in a campaign: asked about in the recording's place, each under its hash, or refused."""

from __future__ import annotations

import json
import pickle
import shutil
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_eval.causes.findings import Word, moved_by
from ssp_eval.evaluate.campaign import Plan, run_campaign
from ssp_eval.evaluate.clients.model_client import InProcessClients
from ssp_eval.evaluate.clients.model_replies import ModelReply
from ssp_eval.evaluate.clients.models import ModelSpec, bridge_spec
from ssp_eval.evaluate.conditions.expansion import with_controls
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.evaluate.executors import Job, JobRunner, Settings
from ssp_eval.evaluate.run import ENGINES, run_parallel
from ssp_eval.evaluate.store.cell_file import CellResult
from ssp_eval.evaluate.store.requests import key_of
from ssp_eval.evaluate.store.results import load_cells, load_facts
from ssp_eval.report.page import write_report
from ssp_eval.statistics.rows import entering, rows_from_cells
from ssp_eval.twins.files import SET_FILE, bag_of, twins_folder
from ssp_vla_bridge.messages import Request, Response
from tests.support.events.twin_sets import audit_of_twin, bag_sha256, write_twin_set
from tests.support.models.answering import Answering

BagMaker = Callable[..., Path]
WITHOUT, OTHER = "without.ot1", "control.car"
SEEING = ModelSpec("seeing", backend="opencv_baseline")


def bright(index: int) -> bytes:
    """A frame unlike those of the recording."""
    return cv2.imencode(".jpg", np.full((54, 96, 3), 200, np.uint8))[1].tobytes()


@pytest.fixture
def bag(make_bag: BagMaker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A recording with two twins: other frames, and another end, after the last question."""
    recording = make_bag()
    for name, options in ((WITHOUT, {}), (OTHER, {"duration_s": 8.98})):
        with monkeypatch.context() as patched:
            if name == WITHOUT:
                patched.setitem(make_bag.__globals__, "picture", bright)
            made = make_bag(f"{name}_bag", **options)
        place = bag_of(recording, name)
        place.parent.mkdir(parents=True)
        shutil.move(made, place)
    write_twin_set(recording, {WITHOUT: audit_of_twin(), OTHER: audit_of_twin()})
    return recording


def brightness(_: int, request: Request) -> ModelReply:
    """Says how bright the newest frame is."""
    image = cv2.imdecode(np.frombuffer(request.frames[-1].jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    text = f"mean {image.mean():.0f}"
    return ModelReply(Response(request.request_id, request.stamp_ns, "seeing", "s/1", text))


def evaluated(
    bag: Path, out: Path, models: list[ModelSpec], client: Any = None, **options: Any
) -> list[CellResult]:
    clients = client or InProcessClients()
    return run_campaign([(bag, None)], models, clients, out, CellOptions(), True, **options)


def cell_of(out: Path, model: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(
        (out / f"cells/cut_in__simulation__{model}/cell.json").read_text()
    )
    return found


def test_a_model_is_asked_about_each_twin_at_the_labels_times(bag: Path, tmp_path: Path) -> None:
    client, out = Answering(brightness), tmp_path / "out"
    results = evaluated(bag, out, [SEEING], client, twins=True)
    names = ["seeing", f"seeing+twin.{WITHOUT}", f"seeing+twin.{OTHER}", "seeing+repeat"]
    assert [(r.model, r.status, r.control) for r in results] == [
        (names[0], "ok", False),
        *((name, "ok", True) for name in names[1:]),
    ]
    said = {c.model: [(r.t_s, r.text) for r in c.records] for c in load_cells(out)}
    assert [t_s for t_s, _ in said[names[1]]] == [t_s for t_s, _ in said[names[0]]]
    assert {text for _, text in said[names[1]]} == {"mean 200"}
    assert said[names[2]] == said[names[3]] == said[names[0]]
    assert all(text != "mean 200" for _, text in said[names[0]])
    assert {row.model for row in entering(rows_from_cells(load_cells(out)))} == {"seeing"}
    assert names[1] in write_report(out).read_text()
    again = evaluated(bag, out, [SEEING], client, twins=True)
    assert [(r.sent, r.reused) for r in again] == [(0, 9)] * 4
    # A later command without it asks nothing anew and leaves their cells.
    assert [(r.sent, r.reused) for r in evaluated(bag, out, [SEEING], client)] == [(0, 9)]
    assert len(load_cells(out)) == 4


def test_the_cell_names_the_twin_by_its_hash(bag: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    evaluated(bag, out, [SEEING], Answering(brightness), twins=True)
    cell, own = cell_of(out, f"seeing+twin.{WITHOUT}"), cell_of(out, "seeing")
    assert cell["hashes"]["twin"] == bag_sha256(bag_of(bag, WITHOUT))
    assert cell["hashes"]["bag"] == own["hashes"]["bag"] == bag_sha256(bag)
    assert (cell["condition"], cell["twin"]["words"]) == (f"twin.{WITHOUT}", f"with {WITHOUT}")
    assert (out / cell["twin"]["path"]).resolve() == bag_of(bag, WITHOUT).resolve()
    assert (own["twin"], "twin" in own["hashes"]) == (None, False)
    facts = load_facts(out / f"cells/cut_in__simulation__seeing+twin.{WITHOUT}/cell.json")
    assert facts.twin is not None
    assert facts.twin.name == WITHOUT


def test_the_plan_counts_the_questions_about_twins(bag: Path, tmp_path: Path) -> None:
    told = list[Plan]()
    models = with_controls([SEEING])
    results = evaluated(bag, tmp_path / "out", models, twins=True, on_plan=told.append)
    asked = [result.model for result in results]
    # Who answers from labels, or not at all, isn't asked about twins.
    assert [name for name in asked if f"twin.{WITHOUT}" in name] == [
        f"{name}+twin.{WITHOUT}" for name in ("seeing", "constant_velocity", "copy_history")
    ]
    (plan,) = told
    assert plan == Plan(144, 16, 144, to_answerers=36, spoilt=18, about_twins=54, repeated=27)
    assert sum(result.sent for result in results) == plan.questions
    assert plan.line().endswith(
        "leaves them out); 54 once more about twins; 27 as before, to see what changes without a "
        "cause"
    )


def test_who_sees_no_frame_is_not_moved(bag: Path, tmp_path: Path) -> None:
    evaluated(bag, tmp_path / "out", [bridge_spec("constant_velocity")], twins=True)
    own, *others = ([r.trajectory for r in c.records] for c in load_cells(tmp_path / "out"))
    assert others == [own] * 3


def test_a_twin_whose_audit_does_not_hold_is_refused_and_the_others_asked(
    bag: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    bad = audit_of_twin("1,204 px differ outside the object's image and shadow")
    write_twin_set(bag, {WITHOUT: bad, OTHER: audit_of_twin()})
    told, client = list[Plan](), Answering(brightness)
    results = evaluated(bag, tmp_path, [SEEING], client, twins=True, on_plan=told.append)
    shown = ["seeing", f"seeing+twin.{OTHER}", "seeing+repeat"]
    assert [result.model for result in results] == shown
    assert told[0].questions == told[0].label_times == client.count == 27
    said = capfd.readouterr().err.replace("\n", " ")
    assert f"{WITHOUT}/bag: isn't asked about, its audit doesn't hold: 1,204 px differ" in said
    write_twin_set(bag, {WITHOUT: bad})
    with pytest.raises(InputError, match="no twins beside the recordings that could be asked"):
        evaluated(bag, tmp_path, [SEEING], client, twins=True)


def test_twins_of_another_recording_are_refused_before_anything_is_asked(
    bag: Path, make_bag: BagMaker, tmp_path: Path
) -> None:
    client, out, file = Answering(brightness), tmp_path / "out", twins_folder(bag) / SET_FILE
    before, other = file.read_text(), "sha256:" + "5" * 64
    file.write_text(json.dumps({**json.loads(before), "of_sha256": other}))
    with pytest.raises(InputError, match="is of another recording") as caught:
        evaluated(bag, out, [SEEING], client, twins=True)
    assert caught.value.value == other
    assert "ssp twins" in (caught.value.remedy or "")
    file.write_text(before)
    shutil.rmtree(bag_of(bag, WITHOUT))
    shutil.copytree(bag_of(bag, OTHER), bag_of(bag, WITHOUT))
    with pytest.raises(InputError, match=f"isn't the bag that was audited as the twin {WITHOUT}"):
        evaluated(bag, out, [SEEING], client, twins=True)
    shutil.rmtree(twins_folder(bag))
    with pytest.raises(InputError, match="no twins beside"):
        evaluated(bag, out, [SEEING], client, twins=True)
    assert client.count == 0


def test_workers_ask_the_same(bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each job as a worker does it, in this process, where nothing has to be started."""

    def here(jobs: Sequence[Job], settings: Settings, *_: object) -> list[CellResult]:
        with JobRunner(settings, "here") as runner:
            return [one for job in jobs for one in runner.run(pickle.loads(pickle.dumps(job)))]

    monkeypatch.setitem(ENGINES, "processes", here)
    models = [bridge_spec("constant_velocity"), SEEING]
    alone, parallel = tmp_path / "alone", tmp_path / "parallel"
    evaluated(bag, alone, models, twins=True)
    settings = Settings(parallel, direct=InProcessClients)
    results = run_parallel([(bag, None)], models, settings, 2, twins=True)
    assert {result.status for result in results} == {"ok"}
    names = [path.name for path in sorted((alone / "cells").iterdir())]
    assert [path.name for path in sorted((parallel / "cells").iterdir())] == names
    assert len(names) == 8
    for name in names:
        records = [
            (root / "cells" / name / "records.jsonl").read_bytes() for root in (alone, parallel)
        ]
        assert records[0] == records[1]


def order(client: Answering) -> list[str]:
    """The questions in the order in which they were asked, by what finds their answers again."""
    return [key_of(request.request_id) for request in client.requests]


def test_conditions_take_turns_and_the_recording_is_asked_about_again_at_the_end(
    bag: Path, tmp_path: Path
) -> None:
    client = Answering(brightness)
    evaluated(bag, tmp_path, [SEEING], client, twins=True)
    cells = {
        path.name.rpartition("+")[2] if "+" in path.name else "": [
            key_of(json.loads(line)["request_id"])
            for line in (path / "requests.jsonl").read_text().splitlines()
        ]
        for path in (tmp_path / "cells").iterdir()
    }
    # No condition finds another one's answers, whatever they show.
    assert len({key for keys in cells.values() for key in keys}) == 4 * 9
    of = {key: (name, index) for name, keys in cells.items() for index, key in enumerate(keys)}
    asked = [of[key] for key in order(client)]
    assert asked[27:] == [("repeat", index) for index in range(9)]
    blocks = [asked[3 * index : 3 * index + 3] for index in range(9)]
    assert all({index for _, index in block} == {k} for k, block in enumerate(blocks))
    assert {name for name, _ in asked[:27]} == {"", f"twin.{WITHOUT}", f"twin.{OTHER}"}
    for place in range(3):
        # Whole squares of six rows, and three more of another.
        counts = Counter(block[place][0] for block in blocks)
        assert set(counts.values()) == {3}


@pytest.mark.parametrize("cut", [1, 4, 17, 30])
def test_a_campaign_that_was_cut_goes_on_in_the_same_order(
    bag: Path, tmp_path: Path, cut: int
) -> None:
    whole, first, second = (Answering(brightness) for _ in range(3))
    evaluated(bag, tmp_path / "whole", [SEEING], whole, twins=True)

    def until(number: int, request: Request) -> ModelReply:
        if number == cut:
            raise KeyboardInterrupt
        return brightness(number, request)

    first.reply = until
    with pytest.raises(KeyboardInterrupt):
        evaluated(bag, tmp_path / "cut", [SEEING], first, twins=True)
    evaluated(bag, tmp_path / "cut", [SEEING], second, twins=True)
    assert order(first)[:cut] + order(second) == order(whole)


def seeing_or_blind(switch: int | None) -> Callable[[int, Request], ModelReply]:
    """Says what it sees; or, switched after so many requests, looks at nothing."""

    def reply(number: int, request: Request) -> ModelReply:
        bright = brightness(number, request).response
        assert bright is not None
        sees = bright.text != "mean 200" if switch is None else number < switch
        text = "A car is ahead, I brake." if sees else "The road is clear, I keep my speed."
        return ModelReply(replace(bright, text=text))

    return reply


@pytest.mark.parametrize("switch", [None, *range(0, 37, 3)])
def test_an_answer_that_changes_with_time_is_not_put_down_to_the_object(
    bag: Path, tmp_path: Path, switch: int | None
) -> None:
    evaluated(bag, tmp_path, [SEEING], Answering(seeing_or_blind(switch)), twins=True)
    moved = moved_by(load_cells(tmp_path))
    assert moved is not None
    (finding,) = moved.findings
    uses = finding.word in (Word.OBJECT, Word.EXPLAINS_LATER)
    assert uses == (switch is None), (finding.word, finding.text)


def test_the_command_asks_about_twins_when_it_is_told(
    bag: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Answers that are stored need no ROS, so that this is the command as it is."""
    out = tmp_path / "out"
    evaluated(bag, out, [bridge_spec("constant_velocity")], twins=True)
    command = ["evaluate", str(bag), "--bridge", "constant_velocity", "--out", str(out)]
    assert main([*command, "--no-controls", "--twins", "--json"]) == 0
    printed = capfd.readouterr()
    told = [json.loads(line) for line in printed.out.splitlines()]
    assert [(line["model"], line["sent"]) for line in told] == [
        ("constant_velocity", 0),
        (f"constant_velocity+twin.{WITHOUT}", 0),
        (f"constant_velocity+twin.{OTHER}", 0),
        ("constant_velocity+repeat", 0),
    ]
    assert "of these 18 once more about twins" in printed.err
    shutil.rmtree(twins_folder(bag))
    assert main([*command, "--twins"]) == 1
    assert "no twins beside the recordings" in capfd.readouterr().err
