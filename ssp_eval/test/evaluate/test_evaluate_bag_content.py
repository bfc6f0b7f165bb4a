"""A bag that is changed or lost while it is evaluated: nothing of it is asked from then on."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from ssp_core.bag.reading.reader import BagReader, content_sha256
from ssp_core.errors import InputError
from ssp_core.hashing import BLOCK_BYTES, sha256_file
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.clients.model_replies import ModelReply
from ssp_eval.evaluate.clients.models import bridge_spec
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.recordings import clip as bag_content
from ssp_eval.recordings.clip import BagContent
from ssp_vla_bridge.messages import Request
from tests.support.models.answering import Answering
from tests.support.processes.waiting import DEADLINE_S

BagMaker = Callable[..., Path]
MODELS = [bridge_spec("constant_velocity")]


class _Asking(Answering):
    """Lets something happen after the first answer."""

    def __init__(self, after_first: Callable[[], object]) -> None:
        super().__init__()
        self.after_first = after_first

    def ask(self, request: Request) -> ModelReply:
        reply = super().ask(request)
        if self.count == 1:
            self.after_first()
        return reply


def the_file(bag: Path) -> Path:
    return next(bag.glob("*.mcap"))


def swap(bag: Path, other: Path) -> None:
    """Puts another recording in the place of a bag's own, as a second recorder would."""
    os.replace(the_file(other), the_file(bag))


CHANGES: dict[str, Callable[[Path, Path], object]] = {
    "was changed while it was read": swap,
    "can't be read: No such file": lambda bag, _: the_file(bag).unlink(),
}


@pytest.mark.parametrize("says", CHANGES)
def test_what_happens_while_the_bag_is_hashed_is_noticed(
    says: str, make_bag: BagMaker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag, other = make_bag(), make_bag("other", domain="physical")

    def hashed(reader: BagReader, on_block: Callable[[], None]) -> str:
        CHANGES[says](bag, other)
        return content_sha256(reader, on_block)

    monkeypatch.setattr(bag_content, "content_sha256", hashed)
    clients, out = Answering(), tmp_path / "out"
    with pytest.raises(InputError, match=says):
        run_campaign([(bag, None)], MODELS, clients, out, CellOptions(), True)
    assert clients.count == 0
    assert not out.exists()


@pytest.mark.parametrize("says", CHANGES)
def test_what_happens_while_models_are_asked_ends_the_asking(
    says: str, make_bag: BagMaker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag, other = make_bag(), make_bag("other", domain="physical")
    # What was fetched before is of the recording that was hashed, and may be asked.
    monkeypatch.setattr("ssp_eval.evaluate.campaign._prepare", lambda *_: None)
    clients = _Asking(lambda: CHANGES[says](bag, other))
    with pytest.raises(InputError, match=says):
        run_campaign([(bag, None)], MODELS, clients, tmp_path / "out", CellOptions(), True)
    assert clients.count == 1
    (raw,) = (tmp_path / "out").rglob("raw.jsonl")
    assert len(raw.read_text().splitlines()) == 1  # what was paid for stays
    assert not list((tmp_path / "out").rglob("score.json"))


def test_closing_ends_the_hashing(make_bag: BagMaker, monkeypatch: pytest.MonkeyPatch) -> None:
    begun, ended = threading.Event(), threading.Event()

    def endless(_: BagReader, on_block: Callable[[], None]) -> str:
        begun.set()
        try:
            while not ended.wait(0.01):
                on_block()
        finally:
            ended.set()
        return ""

    monkeypatch.setattr(bag_content, "content_sha256", endless)
    with BagReader(make_bag()) as bag:
        content = BagContent(bag)
        assert begun.wait(DEADLINE_S)
        assert not content.is_hashed
        late = threading.Timer(DEADLINE_S, ended.set)
        late.start()
        content.close()
        assert late.is_alive()  # it wasn't what ended it
        late.cancel()


def test_what_is_called_for_each_block_may_end_the_reading(tmp_path: Path) -> None:
    file = tmp_path / "large"
    file.write_bytes(bytes(3 << 20))
    seen: list[int] = []

    def stop_at_two() -> None:
        seen.append(len(seen))
        if len(seen) == 2:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        sha256_file(file, stop_at_two)
    assert seen == [0, 1]
    assert sha256_file(file, lambda: seen.append(0)) == sha256_file(file)
    assert len(seen) == 2 + (3 << 20) // BLOCK_BYTES
