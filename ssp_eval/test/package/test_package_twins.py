"""The answers about twins lead back to the twins' bags."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from ssp_core.errors import InputError
from ssp_core.files.writing import write_json
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.clients.model_client import InProcessClients
from ssp_eval.evaluate.clients.models import bridge_spec
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.evaluate.store.admission import load_admissions
from ssp_eval.evaluate.store.cell_file import sealed
from ssp_eval.package.make import make_package
from ssp_eval.package.model import load_table
from ssp_eval.package.verify import verify_package
from ssp_eval.twins.files import bag_of, twins_folder
from tests.support.events.twin_sets import audit_of_twin, bag_sha256, write_twin_set

NAME = "without.ot1"
CELL = f"cells/cut_in__simulation__constant_velocity+twin.{NAME}/cell.json"


def bright(index: int) -> bytes:
    return cv2.imencode(".jpg", np.full((54, 96, 3), 200, np.uint8))[1].tobytes()


@pytest.fixture
def with_twin(
    own: Path, bag_writer: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> tuple[Path, Path]:
    """Evidence with answers about a twin of the simulated recording, and that recording."""
    run = own / "runs" / "cut_in-simulation"
    with monkeypatch.context() as patched:
        patched.setitem(bag_writer.__globals__, "picture", bright)
        place = bag_of(run / "bag", NAME)
        place.parent.mkdir(parents=True)
        bag_writer(place, domain="simulation", task=run / "task")
    write_twin_set(run / "bag", {NAME: audit_of_twin()})
    run_campaign(
        [(run / "bag", None)],
        [bridge_spec("constant_velocity")],
        InProcessClients(),
        own,
        CellOptions(),
        admissions=load_admissions([own / "audits" / "cut_in"]),
        twins=True,
    )
    return own, run / "bag"


def test_an_answer_about_a_twin_walks_back_to_the_twin(
    with_twin: tuple[Path, Path], tmp_path: Path
) -> None:
    own, bag = with_twin
    package = tmp_path / "package"
    make_package([own], package)
    verdict = verify_package(package)
    assert verdict.ok
    assert [note.partition(":")[0] for note in verdict.notes] == [
        f"{own.name}/runs/cut_in-physical/bag"
    ]
    links = {(link.at, link.hash) for link in load_table(package).links if CELL in link.source}
    assert ("hashes.twin", bag_sha256(bag_of(bag, NAME))) in links
    assert ("hashes.bag", bag_sha256(bag)) in links


def test_a_twin_that_is_missing_or_another_is_named(
    with_twin: tuple[Path, Path], tmp_path: Path
) -> None:
    own, bag = with_twin
    value = json.loads((own / CELL).read_text())
    value["hashes"]["twin"] = value["hashes"]["bag"]
    write_json(own / CELL, sealed(value))
    with pytest.raises(InputError, match="has another frame there"):
        make_package([own], tmp_path / "other")
    value["hashes"]["twin"] = bag_sha256(bag_of(bag, NAME))
    write_json(own / CELL, sealed(value))
    shutil.rmtree(twins_folder(bag))
    with pytest.raises(InputError, match=r"hashes\.twin: names a recording that is not in"):
        make_package([own], tmp_path / "missing")
