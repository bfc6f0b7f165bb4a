"""The questions of a cell and the answers to them, stored as they come.

This file owns what was asked in a cell so far, and whether its model can be reached: a model that
wasn't reached isn't tried again in the cell. ``RawStore`` owns the answers on disk; each is stored
before the next question is made, so that a cell that is broken off goes on where it was.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from ssp_core.errors import PeerError
from ssp_core.files.writing import write_bytes
from ssp_core.hashing import sha256_json
from ssp_eval.data.labels import labels_to_json
from ssp_eval.evaluate.clients.model_client import ModelClient, ModelClients
from ssp_eval.evaluate.clients.model_replies import PASSING, IgnoredAnswers, Loss, loss_of
from ssp_eval.evaluate.conditions.conditions import question_under
from ssp_eval.evaluate.store.cell_file import LABELS_FILE, CellPlace, frame_path
from ssp_eval.evaluate.store.raw_store import RawStore
from ssp_eval.evaluate.store.requests import AnswerKeys, Exchange, new_request_id
from ssp_eval.extract.combined.extractor import Extractor
from ssp_eval.recordings.clip import NoQuestion, Question
from ssp_eval.score.thresholds import DEFAULT, Thresholds
from ssp_vla_bridge.messages import Frame, Response

Progress = Callable[[], None]
_LONGEST_PAUSE_S = 30.0


@dataclass(frozen=True)
class CellOptions:
    """The settings that a cell depends on besides its inputs.

    Args:
        adapter: that reads the raw answers; empty: each model's own.
        fresh: ask again even where an answer is stored.
        retry_errors: ask again at most this often after an error that may pass
            (model_replies.PASSING).
        retry_pause_s: before the first of these; doubled from each to the next, to 30 s at most.
    """

    adapter: str = ""
    fresh: bool = False
    retry_errors: int = 0
    retry_pause_s: float = 1.0
    extractor: Extractor = field(default_factory=Extractor)
    thresholds: Thresholds = DEFAULT


def ask_all(
    places: Sequence[CellPlace],
    rows: Sequence[Sequence[int]],
    clients: ModelClients,
    out: Path,
    options: CellOptions,
    on_record: Progress,
) -> list[tuple[list[Exchange], IgnoredAnswers]]:
    """Ask about every label time that isn't answered in a cell's folder already.

    Args:
        places: cells of one recording.
        rows: for each label time indices into ``places``, in the order of asking.
        clients: gives the way to the model; not touched when every answer is stored already.
        out: campaign folder, which keeps the newest frame of each request.
        options: of the cells.
        on_record: called after each label time of a cell.
    """
    cells = [_Conversation(place, clients, options) for place in places]
    for label, row in zip(places[0].labelled.labels.labels, rows, strict=True):
        for index in row:
            question = cells[index].question(label.t_s)
            if isinstance(question, Question):
                _keep_frame(out, question.request.frames[-1])
            cells[index].answer(question)
            on_record()
    return [cell.finish() for cell in cells]


class _Conversation:
    """The exchange with one model so far; its own last answer goes into the next request."""

    def __init__(self, place: CellPlace, clients: ModelClients, options: CellOptions) -> None:
        self._place, self._clients, self._options = place, clients, options
        self._store = RawStore(place.folder)
        if options.fresh:
            self._store.forget()
        labels = place.labelled.labels
        labels_sha256 = sha256_json(labels_to_json(labels))
        self._keys = AnswerKeys(place.model, labels_sha256, place.labelled.clip.start_ns)
        self._carries = place.model.model_interface.carries_previous
        self._client: ModelClient | None = None
        self._unreachable = ""
        self._exchanges: list[Exchange] = []
        self._ignored = IgnoredAnswers()

    def question(self, label_t_s: float) -> Question | NoQuestion:
        """Make the question about a label time, with the model's previous answer if it takes it."""
        question = question_under(self._place.labelled, self._place.model, label_t_s)
        if isinstance(question, NoQuestion):
            return question
        if any(one.t_s == question.t_s for one in self._exchanges):
            reason = f"the newest frame, at {question.t_s:.3f} s, was asked about before"
            return NoQuestion(label_t_s, reason)
        previous, _ = self._previous()
        return replace(question, request=replace(question.request, previous=previous))

    def _previous(self) -> tuple[Response | None, str]:
        """Return the last answer, or the reason for having none although a question was asked."""
        last = next((one for one in reversed(self._exchanges) if one.request is not None), None)
        if not self._carries or last is None:
            return None, ""
        if last.record_from is None:
            return None, f"the one before is missing: {last.loss}"
        return last.record_from, ""

    def answer(self, question: Question | NoQuestion) -> None:
        """Take the stored answer to a question, or ask for it."""
        if isinstance(question, NoQuestion):
            nothing = Exchange(
                question.label_t_s, None, None, None, question.reason, Loss.NO_QUESTION
            )
            self._exchanges.append(nothing)
            return
        _, no_previous = self._previous()
        key = self._keys.of(question.request)
        stored = self._store.find(key)
        if stored is not None:
            loss, why = loss_of(stored)
            exchange = Exchange(
                question.label_t_s, question.t_s, question.request, stored, why, loss, reused=True
            )
        else:
            exchange = self._ask(question, key)
            while (
                exchange.loss in PASSING
                and self._client is not None
                and exchange.again < self._options.retry_errors
            ):
                time.sleep(min(self._options.retry_pause_s * 2**exchange.again, _LONGEST_PAUSE_S))
                exchange = replace(self._ask(question, key), again=exchange.again + 1)
        self._exchanges.append(replace(exchange, no_previous=no_previous))

    def _ask(self, question: Question, key: str) -> Exchange:
        request = replace(question.request, request_id=new_request_id(key))
        exchange = Exchange(question.label_t_s, question.t_s, request, None)
        client = self._reached()
        if client is None:
            return replace(exchange, missing=self._unreachable, loss=Loss.UNREACHABLE)
        # Other cells may be asked over the same client in between.
        before = replace(client.ignored)
        reply = client.ask(request)
        self._ignored = self._ignored.plus(client.ignored, before)
        if reply.response is None:
            return replace(exchange, missing=reply.reason, loss=reply.loss)
        self._store.append(reply.response)
        loss, why = loss_of(reply.response)
        return replace(exchange, response=reply.response, missing=why, loss=loss)

    def _reached(self) -> ModelClient | None:
        """Return the way to the model; one not reached isn't tried again in this cell."""
        if self._client is None and not self._unreachable:
            labels_file = str(self._place.folder / LABELS_FILE)
            options = self._place.model.options_for(labels_file, self._place.labelled.clip.start_ns)
            try:
                self._client = self._clients.client(self._place.model, options)
            except PeerError as error:
                self._unreachable = str(error)
        return self._client

    def finish(self) -> tuple[list[Exchange], IgnoredAnswers]:
        """Leave the stored answers and questions in order."""
        self._store.finish(self._exchanges)
        return self._exchanges, self._ignored


def _keep_frame(out: Path, frame: Frame) -> None:
    """Keep the newest frame of a request for the report, once for all models."""
    path = frame_path(out, frame.sha256)
    if not path.exists():
        write_bytes(path, frame.jpeg)
