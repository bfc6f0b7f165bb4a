"""A campaign with twins, to the page: what moved the answers, and what they name."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from ssp_core.cli import main
from ssp_eval.causes.answers import Asked, asked
from ssp_eval.causes.findings import moved_by
from ssp_eval.causes.naming import Naming, Seen, namings, sights
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.cell import CellOptions
from ssp_eval.evaluate.model_client import ModelClient, ModelReply
from ssp_eval.evaluate.models import ModelSpec
from ssp_eval.evaluate.results import load_cells
from ssp_eval.recordings.clip import Clip
from ssp_eval.twins.files import bag_of
from ssp_vla_bridge.messages import Request, Response
from support.answering import Answering
from support.twin_sets import audit_of_twin, write_twin_set

BagMaker = Callable[..., Path]
TWINS = ("without.ot1", "control.car", "camera.0500")
CAR, PEDESTRIAN = "A car is ahead. I slow down.", "A pedestrian is ahead. I slow down."


@pytest.fixture
def campaign(make_bag: BagMaker, tmp_path: Path) -> Path:
    """A recording that shows a car all the time, and twins with the same states, answered by a
    model that names a pedestrian every third time and nobody where it is asked about the first.
    """
    bag = make_bag()
    for name in TWINS:
        bag_of(bag, name).parent.mkdir(parents=True)
        shutil.copytree(bag, bag_of(bag, name))
    write_twin_set(bag, {name: audit_of_twin() for name in TWINS})

    class Namer(Answering):
        """Whoever is asked, by the condition."""

        def client(self, model: ModelSpec, options: Mapping[str, Any]) -> ModelClient:
            told = count()

            def reply(_: int, request: Request) -> ModelReply:
                text = PEDESTRIAN if next(told) % 3 == 2 else CAR
                text = "The road is clear." if "without" in model.condition else text
                return ModelReply(Response(request.request_id, request.stamp_ns, "m", "m/1", text))

            return Answering(reply)

    models = [ModelSpec("m", backend="opencv_baseline")]
    out = tmp_path / "out"
    run_campaign([(bag, None)], models, Namer(), out, CellOptions(), True, twins=True)
    return out


def kept(campaign: Path) -> list[Asked]:
    return [one for cell in load_cells(campaign) if (one := asked(cell)) is not None]


def by_condition(found: list[Naming]) -> dict[str, Naming]:
    return {one.condition: one for one in found}


def test_what_is_named_is_held_against_what_the_frames_show(campaign: Path) -> None:
    cells = kept(campaign)
    found = by_condition(namings(cells))
    own = found[""]
    # A camera twin's frames aren't what its states say.
    assert "twin.camera.0500" not in found
    # Three of nine label times name a pedestrian, whom no frame shows.
    assert (own.named, own.hallucinated) == (9, pytest.approx(3 / 9))
    critical = [
        t_s for t_s, phase in cells[0].phases.items() if phase in ("trigger", "conflict")
    ]  # fmt: skip
    assert own.critical == len(critical) > 0
    factual = next(cell for cell in cells if not cell.condition)
    missed = [t_s for t_s in critical if "car" not in (factual.answers[t_s].objects or ())]
    assert own.omitted == pytest.approx(len(missed) / len(critical))
    mute = next(one for one in found.values() if one.named == 0)
    assert (mute.hallucinated, mute.omitted) == (None, 1.0)


def test_a_recording_that_is_another_one_says_nothing(campaign: Path) -> None:
    cells = [replace(cell, bag_sha256="sha256:other") for cell in kept(campaign)]
    assert namings(cells) == []
    gone = [replace(cell, bag=Path("nowhere")) for cell in kept(campaign)]
    assert namings(gone) == []


def test_a_frame_shows_the_classes_that_the_world_had_before_the_camera(make_bag: BagMaker) -> None:
    bag = make_bag()
    with Clip(bag) as clip:
        digest = clip.provenance.bag_sha256
        stamp_ns = clip.start_ns
    assert sights(bag, digest, [stamp_ns]) == {
        stamp_ns: Seen(frozenset({"car"}), frozenset({"car"}))
    }
    # Nothing is known before the first state.
    assert sights(bag, digest, [-1]) == {}


def test_report_shows_what_moved_the_answers(campaign: Path, tmp_path: Path) -> None:
    tables = tmp_path / "tables"
    assert main(["report", str(campaign), "--tables", str(tables), "--format", "json,csv"]) == 0
    page = (campaign / "index.html").read_text()
    assert '<section id="moved">' in page
    assert "1 recording can&#39;t carry a test" in page
    rows = json.loads((tables / "moved_answers.json").read_text())["data"]
    assert len(rows) == 5 * 9
    shown = {"", "repeat", *(f"twin.{name}" for name in TWINS)}
    assert {row["condition"] for row in rows} == shown
    moved = moved_by(load_cells(campaign))
    assert moved is not None
    assert len(json.loads((tables / "moved_naming.json").read_text())["data"]) == len(
        moved.namings
    )  # fmt: skip


def test_campaigns_given_with_repeat_are_taken_together(campaign: Path, tmp_path: Path) -> None:
    again, tables = tmp_path / "again", tmp_path / "tables"
    shutil.copytree(campaign, again)
    options = ["--repeat", str(again), "--tables", str(tables), "--format", "json"]
    assert main(["report", str(campaign), *options]) == 0
    rows = json.loads((tables / "moved_slots.json").read_text())["data"]
    # The same recording, asked twice, is one unit with twice the label times.
    assert {(row["n"], row["labels"]) for row in rows} == {(1, 18)}
    naming = json.loads((tables / "moved_naming.json").read_text())["data"]
    assert {row["n"] for row in naming} == {1}
    page = (campaign / "index.html").read_text()
    assert page.split('data-table="moved_slots"')[1].split("</tr>")[1].count(">18</td>") == 1
