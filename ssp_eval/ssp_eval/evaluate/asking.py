"""Asks one model about one clip, label by label in time order, and stores what it says."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from ssp_core.errors import PeerError
from ssp_core.files import write_bytes
from ssp_core.hashing import sha256_json
from ssp_eval.evaluate.answer_key import AnswerKeys, new_request_id
from ssp_eval.evaluate.asker import PASSING, Asker, Askers, Ignored, Loss, loss_of
from ssp_eval.evaluate.cell_file import LABELS_FILE, CellPlace, frame_path
from ssp_eval.evaluate.conditions import other_label_time, under
from ssp_eval.evaluate.controls import SHUFFLED
from ssp_eval.evaluate.question import NoQuestion, Question
from ssp_eval.evaluate.raw_store import RawStore
from ssp_eval.evaluate.store import Asked
from ssp_eval.labels.model import labels_to_json
from ssp_vla_bridge.messages import Frame, Response

Progress = Callable[[], None]
_LONGEST_PAUSE_S = 30.0


@dataclass(frozen=True)
class Repeats:
    """When a question is asked once more.

    Args:
        fresh: also where an answer is stored.
        errors: at most this often after an error that may pass (asker.PASSING).
        pause_s: before the first repetition; doubled from each to the next, to 30 s at most.
    """

    fresh: bool = False
    errors: int = 0
    pause_s: float = 1.0


def ask_all(
    place: CellPlace, askers: Askers, out: Path, repeats: Repeats, on_record: Progress
) -> tuple[list[Asked], Ignored]:
    """Asks about every label time that isn't answered in the cell's folder already.

    Args:
        place: the cell.
        askers: gives the way to the model; not touched when every answer is stored already.
        out: campaign folder, which keeps the newest frame of each request.
        repeats: what is asked again.
        on_record: called once per label time.
    """
    cell = _Conversation(place, askers, repeats)
    for label in place.labelled.labels.labels:
        question = cell.question(label.t_s)
        if isinstance(question, Question):
            _keep_frame(out, question.request.frames[-1])
        cell.about(question)
        on_record()
    return cell.finish()


class _Conversation:
    """What one model was asked so far; its own last answer goes into the next request.

    Args:
        place: the cell.
        askers: gives the way to the model.
        repeats: what is asked again.
    """

    def __init__(self, place: CellPlace, askers: Askers, repeats: Repeats) -> None:
        self._place, self._askers, self._repeats = place, askers, repeats
        self._store = RawStore(place.folder)
        if repeats.fresh:
            self._store.forget()
        labels = place.labelled.labels
        labels_sha256 = sha256_json(labels_to_json(labels))
        self._keys = AnswerKeys(place.model, labels_sha256, place.labelled.clip.start_ns)
        self._carries = place.model.spoken.carries_previous
        self._asker: Asker | None = None
        self._unreachable = ""
        self._asked: list[Asked] = []

    def question(self, label_t_s: float) -> Question | NoQuestion:
        """What is asked about a label time, with the model's previous answer if it takes one."""
        question = self._put(label_t_s)
        if isinstance(question, NoQuestion):
            return question
        if any(one.t_s == question.t_s for one in self._asked):
            reason = f"the newest frame, at {question.t_s:.3f} s, was asked about before"
            return NoQuestion(label_t_s, reason)
        previous, _ = self._previous()
        return replace(question, request=replace(question.request, previous=previous))

    def _put(self, label_t_s: float) -> Question | NoQuestion:
        """What the clip gives to ask, under the model's condition."""
        clip, model = self._place.labelled.clip, self._place.model
        question = clip.question(label_t_s, model.rules)
        if not model.condition or isinstance(question, NoQuestion):
            return question
        another = None
        if model.condition == SHUFFLED and len(question.request.frames) == 1:
            times = [label.t_s for label in self._place.labelled.labels.labels]
            other_t_s = other_label_time(times, times.index(label_t_s))
            another = None if other_t_s is None else clip.question(other_t_s, model.rules)
        return under(model.condition, question, another)

    def _previous(self) -> tuple[Response | None, str]:
        """The last answer, or why there is none although something was asked."""
        last = next((one for one in reversed(self._asked) if one.request is not None), None)
        if not self._carries or last is None:
            return None, ""
        if last.record_from is None:
            return None, f"the one before is missing: {last.loss}"
        return last.record_from, ""

    def about(self, question: Question | NoQuestion) -> None:
        """Asks the question, unless its answer is stored."""
        if isinstance(question, NoQuestion):
            nothing = Asked(question.label_t_s, None, None, None, question.reason, Loss.NO_QUESTION)
            self._asked.append(nothing)
            return
        _, no_previous = self._previous()
        key = self._keys.of(question.request)
        stored = self._store.find(key)
        if stored is not None:
            asked = Asked(question.label_t_s, question.t_s, question.request, stored, reused=True)
        else:
            asked = self._ask(question, key)
            while (
                asked.loss in PASSING
                and self._asker is not None
                and asked.again < self._repeats.errors
            ):
                time.sleep(min(self._repeats.pause_s * 2**asked.again, _LONGEST_PAUSE_S))
                asked = replace(self._ask(question, key), again=asked.again + 1)
        self._asked.append(replace(asked, no_previous=no_previous))

    def _ask(self, question: Question, key: str) -> Asked:
        request = replace(question.request, request_id=new_request_id(key))
        asked = Asked(question.label_t_s, question.t_s, request, None)
        asker = self._reached()
        if asker is None:
            return replace(asked, missing=self._unreachable, loss=Loss.UNREACHABLE)
        reply = asker.ask(request)
        if reply.response is None:
            return replace(asked, missing=reply.reason, loss=reply.loss)
        self._store.append(reply.response)
        loss, why = loss_of(reply.response)
        return replace(asked, response=reply.response, missing=why, loss=loss)

    def _reached(self) -> Asker | None:
        """The way to the model; what can't be reached once is not tried again in this cell."""
        if self._asker is None and not self._unreachable:
            labels_file = str(self._place.folder / LABELS_FILE)
            options = self._place.model.options_for(labels_file, self._place.labelled.clip.start_ns)
            try:
                self._asker = self._askers.asker(self._place.model, options)
            except PeerError as error:
                self._unreachable = str(error)
        return self._asker

    def finish(self) -> tuple[list[Asked], Ignored]:
        """Leaves the stored answers and questions in order."""
        self._store.finish(self._asked)
        return self._asked, Ignored() if self._asker is None else self._asker.ignored


def _keep_frame(out: Path, frame: Frame) -> None:
    """Keeps the newest frame of a request for the report, once for all models."""
    path = frame_path(out, frame.sha256)
    if not path.exists():
        write_bytes(path, frame.jpeg)
