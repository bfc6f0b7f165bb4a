"""Cells (scenario × domain × model): asks, stores, interprets, scores and writes their folders."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from ssp_core.errors import PeerError
from ssp_core.files import make_folder, write_bytes, write_json, write_text
from ssp_core.hashing import sha256_file, sha256_json
from ssp_eval.data.labels import Labels, labels_to_json
from ssp_eval.data.records import BehaviourRecord, record_to_json
from ssp_eval.evaluate.cell_file import (
    CELL_FILE,
    CELLS,
    LABELS_FILE,
    RECORDS_FILE,
    SCORE_FILE,
    CellPlace,
    CellResult,
    LabelledClip,
    frame_path,
    write_cell,
)
from ssp_eval.evaluate.conditions import question_under
from ssp_eval.evaluate.design import stages_of
from ssp_eval.evaluate.model_client import ModelClient, ModelClients
from ssp_eval.evaluate.model_replies import PASSING, IgnoredAnswers, Loss, loss_of
from ssp_eval.evaluate.models import ModelSpec
from ssp_eval.evaluate.raw_store import RawStore, check_unchanged
from ssp_eval.evaluate.requests import AnswerKeys, Asked, new_request_id
from ssp_eval.extract.combined.extractor import Extracted, Extractor
from ssp_eval.extract.language import NOT_READ
from ssp_eval.recordings.clip import NoQuestion, Question
from ssp_eval.score.cell import score_cell
from ssp_eval.score.thresholds import DEFAULT, Thresholds
from ssp_vla_bridge.adapters.registry import adapt
from ssp_vla_bridge.messages import Frame, Request, Response

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
) -> list[tuple[list[Asked], IgnoredAnswers]]:
    """Ask about every label time that isn't answered in a cell's folder already.

    Args:
        places: cells of one recording.
        rows: by label time the order in which the cells are asked about it, as places of these.
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
            cells[index].about(question)
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
        self._carries = place.model.spoken.carries_previous
        self._client: ModelClient | None = None
        self._unreachable = ""
        self._asked: list[Asked] = []
        self._ignored = IgnoredAnswers()

    def question(self, label_t_s: float) -> Question | NoQuestion:
        """Make the question about a label time, with the model's previous answer if it takes it."""
        question = question_under(self._place.labelled, self._place.model, label_t_s)
        if isinstance(question, NoQuestion):
            return question
        if any(one.t_s == question.t_s for one in self._asked):
            reason = f"the newest frame, at {question.t_s:.3f} s, was asked about before"
            return NoQuestion(label_t_s, reason)
        previous, _ = self._previous()
        return replace(question, request=replace(question.request, previous=previous))

    def _previous(self) -> tuple[Response | None, str]:
        """Return the last answer, or the reason for having none although a question was asked."""
        last = next((one for one in reversed(self._asked) if one.request is not None), None)
        if not self._carries or last is None:
            return None, ""
        if last.record_from is None:
            return None, f"the one before is missing: {last.loss}"
        return last.record_from, ""

    def about(self, question: Question | NoQuestion) -> None:
        """Ask the question, unless its answer is stored."""
        if isinstance(question, NoQuestion):
            nothing = Asked(question.label_t_s, None, None, None, question.reason, Loss.NO_QUESTION)
            self._asked.append(nothing)
            return
        _, no_previous = self._previous()
        key = self._keys.of(question.request)
        stored = self._store.find(key)
        if stored is not None:
            loss, why = loss_of(stored)
            asked = Asked(
                question.label_t_s, question.t_s, question.request, stored, why, loss, reused=True
            )
        else:
            asked = self._ask(question, key)
            while (
                asked.loss in PASSING
                and self._client is not None
                and asked.again < self._options.retry_errors
            ):
                time.sleep(min(self._options.retry_pause_s * 2**asked.again, _LONGEST_PAUSE_S))
                asked = replace(self._ask(question, key), again=asked.again + 1)
        self._asked.append(replace(asked, no_previous=no_previous))

    def _ask(self, question: Question, key: str) -> Asked:
        request = replace(question.request, request_id=new_request_id(key))
        asked = Asked(question.label_t_s, question.t_s, request, None)
        client = self._reached()
        if client is None:
            return replace(asked, missing=self._unreachable, loss=Loss.UNREACHABLE)
        # Other cells may be asked over the same client in between.
        before = replace(client.ignored)
        reply = client.ask(request)
        self._ignored = self._ignored.plus(client.ignored, before)
        if reply.response is None:
            return replace(asked, missing=reply.reason, loss=reply.loss)
        self._store.append(reply.response)
        loss, why = loss_of(reply.response)
        return replace(asked, response=reply.response, missing=why, loss=loss)

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

    def finish(self) -> tuple[list[Asked], IgnoredAnswers]:
        """Leave the stored answers and questions in order."""
        self._store.finish(self._asked)
        return self._asked, self._ignored


def _keep_frame(out: Path, frame: Frame) -> None:
    """Keep the newest frame of a request for the report, once for all models."""
    path = frame_path(out, frame.sha256)
    if not path.exists():
        write_bytes(path, frame.jpeg)


LLM_MISSING = "slots of the LLM are missing"
BY_READER, BY_LLM = "slots by the learned reader", "slots by the LLM"


def records_of(
    asked: Sequence[Asked], adapter: str, extractor: Extractor | None = None
) -> list[BehaviourRecord]:
    """Make one record per answer: adapter, then text extraction (METHOD 5.3 to 5.5).

    A label time without an answer leaves no record, which scoring counts as a missing output.

    Args:
        asked: the cell's questions with their answers.
        adapter: its name.
        extractor: of the slots; None: rules and reader.

    Raises:
        InputError: there is no such adapter.
    """
    return [
        record_of(one.t_s, one.record_from, adapter, one.request, one.no_previous, extractor)
        for one in asked
        if one.record_from is not None and one.t_s is not None
    ]


def record_of(
    t_s: float,
    response: Response,
    adapter: str,
    request: Request | None = None,
    no_previous: str = "",
    extractor: Extractor | None = None,
) -> BehaviourRecord:
    """Return the record of one raw answer; the same answer always gives the same record.

    Args:
        t_s: clip time of the newest frame that was sent.
        response: the raw answer.
        adapter: its name.
        request: that it answers; an adapter knows an echo of the prompt by it.
        no_previous: why the request held no previous answer though its interface carries one.
        extractor: of the slots; None: rules and reader.

    Raises:
        InputError: there is no such adapter.
    """
    adapted = adapt(adapter, response, request)
    # No file can hold half of a surrogate pair.
    text = adapted.text.encode("utf-8", "replace").decode()
    notes = list(adapted.info.notes)
    if no_previous:
        notes.append(f"asked without a previous answer: {no_previous}")
    found = (extractor or Extractor())(text)
    if found.language:
        notes.append(f"{NOT_READ}: {found.language}")
    notes += _sources(found)
    return BehaviourRecord(
        t_s=t_s,
        text=text,
        slots=found.slots,
        trajectory=adapted.trajectory,
        invalid=adapted.invalid,
        adapter={**asdict(adapted.info), "notes": notes},
    )


def _sources(found: Extracted) -> list[str]:
    """List the slots that the rules didn't fill, and the failures of the extraction's LLM."""
    notes = []
    if found.by_reader:
        notes.append(f"{BY_READER}: {', '.join(found.by_reader)}")
    if found.withdrawn:
        notes.append(f"slots the reader took back: {', '.join(found.withdrawn)}")
    if found.by_llm:
        notes.append(f"{BY_LLM}: {', '.join(found.by_llm)}")
    if found.trouble:
        notes.append(f"{LLM_MISSING}: {found.trouble}")
    return notes


def fail_cell(
    labelled: LabelledClip, model: ModelSpec, out: Path, options: CellOptions, reason: str
) -> CellResult:
    """Leave the folder of a cell whose worker died; answers that are stored there stay."""
    place = _place(labelled, model, out, options)
    for stale in (SCORE_FILE, RECORDS_FILE):
        (place.folder / stale).unlink(missing_ok=True)
    return write_cell(place, "failed", [reason])


def _folder(labelled: LabelledClip, model: ModelSpec, out: Path) -> Path:
    return out / CELLS / f"{labelled.name}__{model.shown}"


def _place(labelled: LabelledClip, model: ModelSpec, out: Path, options: CellOptions) -> CellPlace:
    folder = make_folder(_folder(labelled, model, out))
    _write_labels(folder, labelled.labels)
    options.extractor.counts.clear()
    adapter = model.read_by(options.adapter)
    return CellPlace(folder, labelled, model, adapter, options.extractor, options.thresholds)


def _write_labels(folder: Path, labels: Labels) -> None:
    """Leave the labels for a bridge that reads them, and no score that is of others.

    A run that is interrupted from here on would otherwise leave one beside them.
    """
    file = folder / LABELS_FILE
    before = sha256_file(file) if file.is_file() else None
    write_json(file, labels_to_json(labels))
    if before not in (None, sha256_file(file)):
        for stale in (CELL_FILE, SCORE_FILE, RECORDS_FILE):
            (folder / stale).unlink(missing_ok=True)


def evaluate_again(
    labelled: LabelledClip,
    models: Sequence[ModelSpec],
    clients: ModelClients,
    out: Path,
    options: CellOptions,
    on_record: Callable[[], None],
) -> list[CellResult]:
    """Evaluate cells, and repeat those whose bridge was missing: it may have come up late.

    Raises:
        InputError: as of evaluate_cells.
    """
    found = evaluate_cells(labelled, models, clients, out, options, on_record)
    late = [model for model, one in zip(models, found, strict=True) if one.failed_for_bridge]
    if not late:
        return found
    again = iter(evaluate_cells(labelled, late, clients, out, options, lambda: None))
    return [next(again) if one.failed_for_bridge else one for one in found]


def evaluate_cells(
    labelled: LabelledClip,
    models: Sequence[ModelSpec],
    clients: ModelClients,
    out: Path,
    options: CellOptions,
    on_record: Callable[[], None],
) -> list[CellResult]:
    """Evaluate one model under its conditions on one clip and leave the cells' folders.

    Args:
        labelled: the clip with its labels.
        models: of design.series_of; they take turns as design.stages_of says.
        clients: gives the way to the model; not touched when every answer is stored already.
        out: campaign folder, in which the cells' folders lie.
        options: of the cells.
        on_record: called after each label time of a cell.

    Returns:
        One result per model, in their order.

    Raises:
        InputError: the adapter or the model's options are wrong, or stored answers were changed.
    """
    for model in models:
        check_unchanged(_folder(labelled, model, out))
    places = {model.shown: _place(labelled, model, out, options) for model in models}
    refusal = labelled.refusal
    if refusal is not None:
        return [_refused(place, refusal, on_record) for place in places.values()]
    found: dict[str, CellResult] = {}
    labels = labelled.labels.labels
    for stage in stages_of(models, labelled.clip.provenance.bag_sha256, len(labels)):
        of_stage = [places[model.shown] for model in stage.models]
        answers = ask_all(of_stage, stage.rows, clients, out, options, on_record)
        for place, (asked, ignored) in zip(of_stage, answers, strict=True):
            found[place.model.shown] = _scored(place, asked, ignored, options)
    return [found[name] for name in places]


def _refused(place: CellPlace, refusal: str, on_record: Callable[[], None]) -> CellResult:
    for stale in (SCORE_FILE, RECORDS_FILE):
        (place.folder / stale).unlink(missing_ok=True)
    for _ in place.labelled.labels.labels:
        on_record()
    return write_cell(place, "refused", [refusal])


def _scored(
    place: CellPlace, asked: Sequence[Asked], ignored: IgnoredAnswers, options: CellOptions
) -> CellResult:
    """Interpret and score a cell's answers, and write its files."""
    folder = place.folder
    options.extractor.counts.clear()  # those of the cell before
    records = records_of(asked, place.adapter, options.extractor)
    write_text(folder / RECORDS_FILE, "".join(record_to_json(r) + "\n" for r in records))
    if not records:
        # Nothing came back at all: that says something about the bridge, not about the model.
        (folder / SCORE_FILE).unlink(missing_ok=True)
        reasons = list(dict.fromkeys(one.missing for one in asked if one.missing))
        return write_cell(place, "failed", reasons, asked, ignored)
    score = score_cell(place.labelled.labels, records, options.thresholds).to_json()
    write_json(folder / SCORE_FILE, score)
    return write_cell(place, "ok", [], asked, ignored, score)
