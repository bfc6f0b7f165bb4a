"""A campaign with twins, to the page: what moved the answers."""

from __future__ import annotations

import csv
import shutil
from collections.abc import Callable, Mapping
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from ssp_core.cli import main
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.clients.model_client import ModelClient
from ssp_eval.evaluate.clients.model_replies import ModelReply
from ssp_eval.evaluate.clients.models import ModelSpec
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.twins.files import bag_of
from ssp_vla_bridge.messages import Request, Response
from tests.support.events.twin_sets import audit_of_twin, write_twin_set
from tests.support.models.answering import Answering

BagMaker = Callable[..., Path]
TWINS = ("without.ot1", "control.car", "camera.0500")
CAR, PEDESTRIAN = "A car is ahead. I slow down.", "A pedestrian is ahead. I slow down."


@pytest.fixture
def campaign(make_bag: BagMaker, tmp_path: Path) -> Path:
    """A campaign on a recording that shows a car all the time, and on twins with the same states.

    The model answers with a car, but with a pedestrian in every third answer, and with a clear road
    in the condition that leaves out the object."""
    bag = make_bag()
    for name in TWINS:
        bag_of(bag, name).parent.mkdir(parents=True)
        shutil.copytree(bag, bag_of(bag, name))
    write_twin_set(bag, {name: audit_of_twin() for name in TWINS})

    class Namer(Answering):
        """A client whose answer depends on the model's condition."""

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


def test_report_shows_what_moved_the_answers(campaign: Path, tmp_path: Path) -> None:
    tables = tmp_path / "tables"
    assert main(["report", str(campaign), "--tables", str(tables), "--format", "csv"]) == 0
    page = (campaign / "index.html").read_text()
    assert '<section id="moved">' in page
    assert "1 recording can&#39;t support a test" in page
    assert (tables / "moved_findings.csv").is_file()


def test_campaigns_given_with_repeat_are_taken_together(campaign: Path, tmp_path: Path) -> None:
    again, tables = tmp_path / "again", tmp_path / "tables"
    shutil.copytree(campaign, again)
    options = ["--repeat", str(again), "--tables", str(tables), "--format", "csv"]
    assert main(["report", str(campaign), *options]) == 0
    with (tables / "moved_slots.csv").open(encoding="utf-8", newline="") as lines:
        rows = [*csv.DictReader(lines)]
    # The same recording, asked twice, is one unit with twice the label times.
    assert {(row["n"], row["labels"]) for row in rows} == {("1", "18")}
    page = (campaign / "index.html").read_text()
    assert page.split('data-table="moved_slots"')[1].split("</tr>")[1].count(">18</td>") == 1
