"""One cell (scenario × domain × model): asks, stores, interprets, scores and writes its folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from ssp_core.files import make_folder, write_json, write_text
from ssp_core.hashing import sha256_file
from ssp_eval.data.labels import Labels, labels_to_json
from ssp_eval.data.records import BehaviourRecord, record_to_json
from ssp_eval.evaluate.asking import Repeats, ask_all
from ssp_eval.evaluate.cell_file import (
    CELL_FILE,
    CELLS,
    LABELS_FILE,
    RECORDS_FILE,
    SCORE_FILE,
    CellPlace,
    CellResult,
    LabelledClip,
    write_cell,
)
from ssp_eval.evaluate.model_client import ModelClients
from ssp_eval.evaluate.models import ModelSpec
from ssp_eval.evaluate.raw_store import check_unchanged
from ssp_eval.evaluate.requests import Asked
from ssp_eval.extract.language import NOT_READ
from ssp_eval.extract.llm import Extracted, Extractor, make_extractor
from ssp_eval.score.cell import score_cell
from ssp_eval.score.thresholds import DEFAULT, Thresholds
from ssp_vla_bridge.adapters.registry import adapt
from ssp_vla_bridge.messages import Request, Response

LLM_MISSING = "slots of the LLM are missing"


def records_of(
    asked: Sequence[Asked], adapter: str, extractor: Extractor | None = None
) -> list[BehaviourRecord]:
    """One record per answer: adapter, then text extraction (METHOD 5.3 to 5.5).

    A label time without an answer leaves no record, which scoring counts as a missing output.

    Args:
        asked: in label order.
        extractor: of the slots; None: the rules alone.

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
    """The record of one raw answer; the same answer always gives the same record.

    Args:
        t_s: clip time of the newest frame that was sent.
        adapter: name of the adapter, with its mode.
        request: that it answers; an adapter knows an echo of the prompt by it.
        no_previous: why the request held no previous answer though its interface carries one.
        extractor: of the slots; None: the rules alone.

    Raises:
        InputError: there is no such adapter.
    """
    adapted = adapt(adapter, response, request)
    # No file can hold half of a surrogate pair.
    text = adapted.text.encode("utf-8", "replace").decode()
    notes = list(adapted.info.notes)
    if no_previous:
        notes.append(f"asked without a previous answer: {no_previous}")
    found = (extractor or make_extractor())(text)
    if found.language:
        notes.append(f"{NOT_READ}: {found.language}")
    notes += _llm_notes(found)
    return BehaviourRecord(
        t_s=t_s,
        text=text,
        slots=found.slots,
        trajectory=adapted.trajectory,
        invalid=adapted.invalid,
        adapter={**asdict(adapted.info), "notes": notes},
    )


def _llm_notes(found: Extracted) -> list[str]:
    """What the LLM of the extraction did or couldn't do; nothing where there is none."""
    notes = []
    if found.by_llm:
        notes.append(f"slots by the LLM: {', '.join(found.by_llm)}")
    if found.trouble:
        notes.append(f"{LLM_MISSING}: {found.trouble}")
    return notes


@dataclass(frozen=True)
class CellOptions:
    """What a cell depends on besides its inputs.

    Args:
        adapter: that reads the raw answers; empty: each model's own.
        fresh: ask again even where an answer is stored.
        retry_errors: ask again at most this often after an error that may pass.
        retry_pause_s: before the first of these, s.
    """

    adapter: str = ""
    fresh: bool = False
    retry_errors: int = 0
    retry_pause_s: float = 1.0
    extractor: Extractor = field(default_factory=make_extractor)
    thresholds: Thresholds = DEFAULT

    @property
    def repeats(self) -> Repeats:
        """What is asked again."""
        return Repeats(self.fresh, self.retry_errors, self.retry_pause_s)


def fail_cell(
    labelled: LabelledClip, model: ModelSpec, out: Path, options: CellOptions, reason: str
) -> CellResult:
    """Leaves the folder of a cell whose worker died; answers that are stored there stay.

    Args:
        reason: how it died.
    """
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
    """Leaves the labels for a bridge that reads them, and no score that is of others.

    A run that is interrupted from here on would otherwise leave one beside them.
    """
    file = folder / LABELS_FILE
    before = sha256_file(file) if file.is_file() else None
    write_json(file, labels_to_json(labels))
    if before not in (None, sha256_file(file)):
        for stale in (CELL_FILE, SCORE_FILE, RECORDS_FILE):
            (folder / stale).unlink(missing_ok=True)


def evaluate_cell(
    labelled: LabelledClip,
    model: ModelSpec,
    clients: ModelClients,
    out: Path,
    options: CellOptions,
    on_record: Callable[[], None],
) -> CellResult:
    """Evaluates one model on one clip and leaves the cell's folder.

    Args:
        model: who is asked.
        clients: gives the way to the model; not touched when every answer is stored already.
        options: adapter, reuse and repetition.
        on_record: called once per label time.

    Raises:
        InputError: the adapter or the model's options are wrong, or stored answers were changed.
    """
    check_unchanged(_folder(labelled, model, out))
    place = _place(labelled, model, out, options)
    folder = place.folder
    refusal = labelled.refusal
    if refusal is not None:
        for stale in (SCORE_FILE, RECORDS_FILE):
            (folder / stale).unlink(missing_ok=True)
        for _ in labelled.labels.labels:
            on_record()
        return write_cell(place, "refused", [refusal])
    asked, ignored = ask_all(place, clients, out, options.repeats, on_record)
    records = records_of(asked, place.adapter, options.extractor)
    write_text(folder / RECORDS_FILE, "".join(record_to_json(r) + "\n" for r in records))
    if not records:
        # Nothing came back at all: that says something about the bridge, not about the model.
        (folder / SCORE_FILE).unlink(missing_ok=True)
        reasons = list(dict.fromkeys(one.missing for one in asked if one.missing))
        return write_cell(place, "failed", reasons, asked, ignored)
    score = score_cell(labelled.labels, records, options.thresholds).to_json()
    write_json(folder / SCORE_FILE, score)
    return write_cell(place, "ok", [], asked, ignored, score)
