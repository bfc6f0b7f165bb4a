"""Cells (scenario × domain × model): each becomes a folder in six steps.

1. clip: refused here if the audit refused its recording, or the labels don't fit it.
2. questions: one for each label time, as the model's interface asks them (conversation.py).
3. answers: taken from the folder, or asked for and stored there as they come (conversation.py).
4. records: the adapter reads each answer, the extractor fills its slots (answer_records.py).
5. score: the scoring core compares records with labels.
6. folder: holds all of it, and says in one file what became of the cell (cell_file.py).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from ssp_core.files.folders import make_folder
from ssp_core.files.writing import write_json, write_text
from ssp_core.hashing import sha256_file
from ssp_eval.data.labels import Labels, labels_to_json
from ssp_eval.data.records import record_to_json
from ssp_eval.evaluate.clients.model_client import ModelClients
from ssp_eval.evaluate.clients.model_replies import IgnoredAnswers
from ssp_eval.evaluate.clients.models import ModelSpec
from ssp_eval.evaluate.conditions.design import stages_of
from ssp_eval.evaluate.conversation import CellOptions, ask_all
from ssp_eval.evaluate.store.answer_records import records_of
from ssp_eval.evaluate.store.cell_file import (
    CELL_FILE,
    CELLS,
    LABELS_FILE,
    RECORDS_FILE,
    SCORE_FILE,
    CellPlace,
    CellResult,
    LabelledClip,
    remove_file,
    write_cell,
)
from ssp_eval.evaluate.store.raw_store import check_unchanged
from ssp_eval.evaluate.store.requests import Exchange
from ssp_eval.score.cell import score_cell


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
    results = evaluate_cells(labelled, models, clients, out, options, on_record)
    late = [model for model, one in zip(models, results, strict=True) if one.failed_for_bridge]
    if not late:
        return results
    again = iter(evaluate_cells(labelled, late, clients, out, options, lambda: None))
    return [next(again) if one.failed_for_bridge else one for one in results]


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
    places = {model.result_name: _place(labelled, model, out, options) for model in models}
    labels = labelled.labels.labels
    if labelled.refusal is not None:
        for _ in range(len(places) * len(labels)):
            on_record()
        return [_unasked(place, "refused", labelled.refusal) for place in places.values()]
    results: dict[str, CellResult] = {}
    for stage in stages_of(models, labelled.clip.provenance.bag_sha256, len(labels)):
        of_stage = [places[model.result_name] for model in stage.models]
        answers = ask_all(of_stage, stage.rows, clients, out, options, on_record)
        for place, (exchanges, ignored) in zip(of_stage, answers, strict=True):
            results[place.model.result_name] = _scored(place, exchanges, ignored, options)
    return [results[name] for name in places]


def _scored(
    place: CellPlace, exchanges: Sequence[Exchange], ignored: IgnoredAnswers, options: CellOptions
) -> CellResult:
    """Interpret and score a cell's answers, and write its files."""
    folder = place.folder
    options.extractor.counts.clear()  # those of the cell before
    records = records_of(exchanges, place.adapter, options.extractor)
    write_text(folder / RECORDS_FILE, "".join(record_to_json(r) + "\n" for r in records))
    if not records:
        # No usable answer: there is nothing to score.
        _remove(folder, SCORE_FILE)
        reasons = list(dict.fromkeys(one.missing for one in exchanges if one.missing))
        return write_cell(place, "failed", reasons, exchanges, ignored)
    score = score_cell(place.labelled.labels, records, options.thresholds).to_json()
    write_json(folder / SCORE_FILE, score)
    return write_cell(place, "ok", [], exchanges, ignored, score)


def _unasked(place: CellPlace, status: str, reason: str) -> CellResult:
    """Write the file of a cell without a score; answers that are stored in its folder stay."""
    _remove(place.folder, SCORE_FILE, RECORDS_FILE)
    return write_cell(place, status, [reason])


def fail_cell(
    labelled: LabelledClip, model: ModelSpec, out: Path, options: CellOptions, reason: str
) -> CellResult:
    """Leave the folder of a cell whose worker died; answers that are stored there stay."""
    return _unasked(_place(labelled, model, out, options), "failed", reason)


def _folder(labelled: LabelledClip, model: ModelSpec, out: Path) -> Path:
    return out / CELLS / f"{labelled.name}__{model.result_name}"


def _place(labelled: LabelledClip, model: ModelSpec, out: Path, options: CellOptions) -> CellPlace:
    folder = make_folder(_folder(labelled, model, out))
    _write_labels(folder, labelled.labels)
    options.extractor.counts.clear()
    adapter = model.read_by(options.adapter)
    return CellPlace(folder, labelled, model, adapter, options.extractor, options.thresholds)


def _write_labels(folder: Path, labels: Labels) -> None:
    """Write the labels; if they changed, delete the score of the old ones.

    A run that is interrupted from here on would otherwise leave it beside them.
    """
    file = folder / LABELS_FILE
    before = sha256_file(file) if file.is_file() else None
    write_json(file, labels_to_json(labels))
    if before not in (None, sha256_file(file)):
        _remove(folder, CELL_FILE, SCORE_FILE, RECORDS_FILE)


def _remove(folder: Path, *files: str) -> None:
    for file in files:
        remove_file(folder / file)
