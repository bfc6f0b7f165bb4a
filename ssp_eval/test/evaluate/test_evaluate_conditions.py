"""Control conditions: what is spoilt, what stays, and that they enter no mean."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.errors import InputError
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.clients.model_client import ClientsWithAnswerers
from ssp_eval.evaluate.clients.model_replies import ModelReply
from ssp_eval.evaluate.clients.models import (
    ANSWERERS,
    BLACK,
    CONDITION_SEED,
    SHUFFLED,
    ModelSpec,
    attached_spec,
    bridge_spec,
)
from ssp_eval.evaluate.conditions.conditions import (
    blackened,
    derangement,
    other_label_time,
    shuffled,
    under,
)
from ssp_eval.evaluate.conditions.expansion import with_controls
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.evaluate.store.results import load_cells
from ssp_eval.recordings.clip import NoQuestion, Question
from ssp_eval.report.page import write_report
from ssp_eval.statistics.rows import entering, rows_from_cells
from ssp_vla_bridge.messages import Frame, Request, Response
from tests.support.models.answering import Answering

BagMaker = Callable[..., Path]


def jpeg(grey: int, width: int = 32, height: int = 24) -> bytes:
    done, data = cv2.imencode(".jpg", np.full((height, width, 3), grey, np.uint8))
    assert done
    return data.tobytes()


def request(count: int) -> Request:
    frames = tuple(Frame(k * 100, jpeg(40 + 20 * k)) for k in range(1, count + 1))
    return Request("id", count * 100, frames)


def test_black_frames_have_the_sizes_and_stamps_of_the_others() -> None:
    before = request(3)
    odd = replace(before, frames=(*before.frames[:2], Frame(300, jpeg(9, 50, 20))))
    after = blackened(odd)
    assert [f.stamp_ns for f in after.frames] == [100, 200, 300]
    shapes = []
    for frame in after.frames:
        image = cv2.imdecode(np.frombuffer(frame.jpeg, np.uint8), cv2.IMREAD_COLOR)
        assert image is not None
        assert image.max() == 0
        shapes.append(image.shape)
    assert shapes == [(24, 32, 3), (24, 32, 3), (20, 50, 3)]
    assert replace(after, frames=odd.frames) == odd
    for broken in (b"no jpeg", b""):
        without = replace(before, frames=(Frame(1, broken),))
        with pytest.raises(InputError, match="no picture"):
            blackened(without)
        nothing = under(BLACK, Question(0.0, 0.0, without), None)
        assert isinstance(nothing, NoQuestion)
        assert "no picture" in nothing.reason


@given(count=st.integers(2, 40), seed=st.integers(0, 1000), salt=st.integers(0, 2**62))
def test_no_picture_keeps_its_time_and_none_is_lost(count: int, seed: int, salt: int) -> None:
    order = derangement(count, seed, salt)
    assert sorted(order) == list(range(count))
    assert all(place != index for index, place in enumerate(order))
    assert order == derangement(count, seed, salt)


def test_shuffled_frames_are_the_same_pictures_at_other_times() -> None:
    before = request(8)
    after = shuffled(before)
    assert sorted(f.jpeg for f in after.frames) == sorted(f.jpeg for f in before.frames)
    assert [f.stamp_ns for f in after.frames] == [f.stamp_ns for f in before.frames]
    for old, new in zip(before.frames, after.frames, strict=True):
        assert old.jpeg != new.jpeg
    assert shuffled(before) == after
    assert shuffled(before, seed=2) != after
    with pytest.raises(ValueError, match="single frame"):
        shuffled(request(1))


def test_a_single_frame_is_replaced_by_that_of_another_label_time() -> None:
    question = Question(0.0, 0.0, request(1))
    other = Question(1.0, 1.0, Request("", 900, (Frame(900, jpeg(200)),)))
    found = under(SHUFFLED, question, other)
    assert isinstance(found, Question)
    assert found.request.frames == (Frame(100, jpeg(200)),)
    nothing = under(SHUFFLED, question, None)
    assert isinstance(nothing, NoQuestion)
    assert under("", question, None) is question
    times = [0.0, 0.5, 1.0]
    chosen = [other_label_time(times, k) for k in range(3)]
    assert sorted(t for t in chosen if t is not None) == times
    assert all(a != b for a, b in zip(times, chosen, strict=True))
    assert other_label_time([0.0], 0) is None


def test_controls_are_added_once_and_checks_get_no_conditions() -> None:
    mine = ModelSpec("mine", backend="opencv_baseline")
    specs = with_controls([mine, bridge_spec("perfect")])
    names = [spec.result_name for spec in specs]
    assert names == [
        "mine",
        "mine+black",
        "mine+shuffled",
        "perfect",
        "constant_velocity",
        "copy_history",
        "silent",
    ]
    assert [spec.control for spec in specs] == [False, True, True, False, True, True, True]
    attached = with_controls([attached_spec("far"), attached_spec("silent")])
    shown = [spec.result_name for spec in attached if spec.attached]
    assert shown == ["far", "far+black", "far+shuffled", "silent"]
    ours = [spec.result_name for spec in attached if not spec.attached]
    assert ours == ["constant_velocity", "copy_history", "perfect"]
    assert set(ANSWERERS) <= set(names)


def how_bright(_: int, request: Request) -> ModelReply:
    """Says how bright the newest frame is."""
    image = cv2.imdecode(np.frombuffer(request.frames[-1].jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    text = "I keep my speed and stay in my lane." if image.max() > 0 else "I see nothing."
    return ModelReply(Response(request.request_id, request.stamp_ns, "seeing", "s/1", text))


def test_a_campaign_with_controls(make_bag: BagMaker, tmp_path: Path) -> None:
    client = Answering(how_bright)
    clients = ClientsWithAnswerers(client)
    seeing = ModelSpec("seeing", backend="opencv_baseline")
    models = with_controls([seeing])
    bags: list[tuple[Path, Path | None]] = [(make_bag(), None)]
    results = run_campaign(bags, models, clients, tmp_path, CellOptions(), True)
    assert all(result.status == "ok" or result.model == "silent" for result in results)
    black = json.loads((tmp_path / "cells/cut_in__simulation__seeing+black/cell.json").read_text())
    assert (black["model"], black["condition"], black["condition_seed"], black["control"]) == (
        "seeing+black",
        BLACK,
        CONDITION_SEED,
        True,
    )
    keys = {request.request_id.split("-")[0] for request in client.requests}
    assert len(keys) == len(client.requests) == 27
    raw = (tmp_path / "cells/cut_in__simulation__seeing+black/raw.jsonl").read_text()
    assert raw.count("I see nothing.") == 9
    cells = load_cells(tmp_path)
    assert {row.model for row in entering(rows_from_cells(cells))} == {"seeing"}
    page = write_report(tmp_path).read_text()
    section = page.split('<section id="controls">')[1].split("</section>")[0]
    assert "does the harness measure seeing?" in section
    assert section.count("<td>seeing</td>") == 2
    assert "constant_velocity" in section
    again = run_campaign(bags, models, clients, tmp_path, CellOptions())
    assert sum(result.sent for result in again) == 0
    assert len(client.requests) == 27
