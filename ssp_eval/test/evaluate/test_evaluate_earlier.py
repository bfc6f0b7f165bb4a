"""Going back to earlier settings asks for nothing that was answered before."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from ssp_core.errors import InputError
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.clients.model_replies import ModelReply
from ssp_eval.evaluate.clients.models import ModelSpec
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.evaluate.store.cell_file import CellResult
from ssp_eval.evaluate.store.raw_store import EARLIER_FILE, RawStore
from ssp_eval.evaluate.store.requests import RAW_FILE
from ssp_vla_bridge.messages import ErrorCode, Request, Response
from tests.support.models.answering import Answering

BagMaker = Callable[..., Path]
MODEL = ModelSpec(
    "m", {"base_url": "http://host:1/v1", "model": "q"}, backend="openai", interface="waypoints"
)


class Numbered(Answering):
    """Numbers its answers, so that they can be distinguished; fails, or stops, at some of them."""

    def __init__(self) -> None:
        super().__init__(self.numbered)
        self.errors_at: set[int] = set()
        self.decoding_at: dict[int, dict[str, Any]] = {}
        self.stops_at: int | None = None

    def numbered(self, number: int, request: Request) -> ModelReply:
        if number == self.stops_at:
            self.requests.pop()
            raise KeyboardInterrupt
        answer = Response(request.request_id, request.stamp_ns, "m", "m/1", f"answer {number}")
        answer = replace(answer, decoding=self.decoding_at.get(number, {}))
        if number in self.errors_at:
            answer = replace(answer, error_code=int(ErrorCode.BACKEND), error_msg="broken")
        return ModelReply(answer)


class Campaign:
    """One cell that is evaluated with changing settings."""

    def __init__(self, bag: Path, out: Path) -> None:
        self.bag, self.out, self.model = bag, out, Numbered()
        self.folder = out / "cells" / "cut_in__simulation__m"

    def __call__(self, temperature: float, **options: Any) -> CellResult:
        spec = replace(MODEL, options={**MODEL.options, "temperature": temperature})
        bags: list[tuple[Path, Path | None]] = [(self.bag, None)]
        (result,) = run_campaign(
            bags, [spec], self.model, self.out, CellOptions(**options), propose_labels=True
        )
        return result

    def texts(self, name: str = RAW_FILE) -> list[str]:
        file = self.folder / name
        lines = file.read_text().splitlines() if file.exists() else []
        return [json.loads(line)["text"] for line in lines]


@pytest.fixture
def campaign(make_bag: BagMaker, tmp_path: Path) -> Campaign:
    return Campaign(make_bag(), tmp_path / "out")


def answers(*numbers: range) -> list[str]:
    return [f"answer {n}" for span in numbers for n in span]


def test_going_back_asks_nothing_and_the_files_don_t_grow(campaign: Campaign) -> None:
    first = campaign(0.0)
    assert campaign.texts(EARLIER_FILE) == []
    assert not (campaign.folder / EARLIER_FILE).exists()
    campaign(1.0)
    assert (campaign.texts(), campaign.texts(EARLIER_FILE)) == (
        answers(range(9, 18)),
        answers(range(9)),
    )
    for _ in range(3):
        back = campaign(0.0)
        assert (back.sent, back.reused, back.score) == (0, 9, first.score)
        assert campaign.texts() == answers(range(9))
        assert campaign.texts(EARLIER_FILE) == answers(range(9, 18))
        assert campaign(1.0).sent == 0
    assert campaign.model.count == 18
    campaign(0.5)
    assert campaign.model.count == 27
    assert sorted(campaign.texts(EARLIER_FILE)) == sorted(answers(range(18)))


def test_a_new_answer_to_the_same_question_replaces_the_old_one(campaign: Campaign) -> None:
    campaign(0.0)
    campaign(1.0)
    campaign(0.0, fresh=True)
    assert campaign.texts() == answers(range(18, 27))
    assert campaign.texts(EARLIER_FILE) == answers(range(9, 18))
    campaign(1.0)
    assert campaign(0.0).sent == 0
    assert campaign.texts() == answers(range(18, 27))


def test_errors_are_not_kept(campaign: Campaign) -> None:
    campaign.model.errors_at = {2, 5}
    campaign(0.0)
    campaign(1.0)
    kept = campaign.texts(EARLIER_FILE)
    assert kept == [f"answer {n}" for n in range(9) if n not in (2, 5)]
    back = campaign(0.0)
    assert (back.sent, back.reused, back.missing) == (2, 7, 0)


def test_broken_answers_of_an_older_store_are_asked_again(campaign: Campaign) -> None:
    campaign.model.decoding_at = {
        2: {"finish_reason": "abort"},
        5: {"finish_reason": "content_filter"},
        6: {"finish_reason": "length"},
    }
    campaign(0.0)
    assert len([text for text in campaign.texts() if text]) == 9
    back = campaign(0.0)
    # What a filter held back is final.
    assert (back.sent, back.reused, back.missing) == (1, 8, 1)
    assert back.losses == {"the model declined": 1}
    assert campaign.texts()[2] == "answer 9"


def test_labels_that_move_leave_their_answers(campaign: Campaign) -> None:
    campaign(0.0)
    labels = campaign.bag.parent / "bag.labels.json"
    before = labels.read_text()
    value = json.loads(before)
    del value["labels"][3:5]
    labels.write_text(json.dumps(value))
    assert campaign(0.0).sent == 0
    assert campaign.texts(EARLIER_FILE) == ["answer 3", "answer 4"]
    labels.write_text(before)
    assert campaign(0.0).sent == 0
    assert campaign.texts() == answers(range(9))
    assert not (campaign.folder / EARLIER_FILE).exists()


def test_nothing_is_lost_by_an_interruption_in_between(campaign: Campaign) -> None:
    campaign(0.0)
    campaign(1.0)
    # Asked anew and stopped after three answers: they count, wherever one goes from here.
    campaign.model.stops_at = 21
    with pytest.raises(KeyboardInterrupt):
        campaign(0.0, fresh=True)
    campaign.model.stops_at = None
    assert campaign(1.0).sent == 0
    assert campaign(0.0).sent == 0
    assert campaign.texts() == answers(range(18, 21), range(3, 9))
    # A kill between the two files leaves an answer in both, and no cell.json.
    (campaign.folder / "cell.json").unlink()
    (campaign.folder / EARLIER_FILE).write_bytes(
        (campaign.folder / EARLIER_FILE).read_bytes() + (campaign.folder / RAW_FILE).read_bytes()
    )
    assert campaign(0.0).sent == 0
    assert campaign.texts(EARLIER_FILE) == answers(range(9, 18))


def test_the_file_may_be_deleted_and_a_broken_one_is_named(campaign: Campaign) -> None:
    campaign(0.0)
    campaign(1.0)
    earlier = campaign.folder / EARLIER_FILE
    content = earlier.read_text()
    earlier.unlink()
    assert campaign(1.0).sent == 0
    earlier.write_text(content[:-5])
    with pytest.raises(InputError, match=r"earlier.jsonl:9: is not valid JSON"):
        RawStore(campaign.folder)


@pytest.mark.parametrize("name", [RAW_FILE, EARLIER_FILE])
def test_a_stored_answer_with_a_key_twice_is_refused(campaign: Campaign, name: str) -> None:
    campaign(0.0)
    campaign(1.0)
    file = campaign.folder / name
    file.write_text(file.read_text().rstrip("\n")[:-1] + ', "text": "another"}')
    with pytest.raises(InputError, match=rf"{name}:9: text: stands twice.*keep one of the two"):
        RawStore(campaign.folder)
