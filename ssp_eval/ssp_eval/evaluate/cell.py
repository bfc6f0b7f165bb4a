"""One cell (scenario × domain × model): asks, stores, interprets, scores and writes its folder."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from ssp_core import __version__
from ssp_core.errors import PeerError
from ssp_core.files import write_bytes, write_json, write_text
from ssp_core.hashing import sha256_bytes, sha256_file, sha256_json
from ssp_eval.evaluate.admission import NO_AUDIT, Admission
from ssp_eval.evaluate.asker import Asker, Askers, Ignored, Loss, ModelSpec
from ssp_eval.evaluate.clip import Clip, NoQuestion, Question
from ssp_eval.evaluate.interpret import records_of
from ssp_eval.evaluate.store import (
    RAW_FILE,
    REQUESTS_FILE,
    Asked,
    RawStore,
    new_request_id,
    request_key,
)
from ssp_eval.extract import extractor_hash
from ssp_eval.labels.model import Labels, labels_to_json
from ssp_eval.records import record_to_json
from ssp_eval.score import DEFAULT, score_cell

CELL_SCHEMA = "ssp.cell/1"
CELLS = "cells"
FRAMES = "frames"
LABELS_FILE = "labels.json"
RECORDS_FILE = "records.jsonl"
SCORE_FILE = "score.json"
CELL_FILE = "cell.json"

Progress = Callable[[], None]


@dataclass(frozen=True)
class LabelledClip:
    """A clip with its labels, ready to be asked about.

    Args:
        clip: open.
        labels: of this clip.
        labels_source: where they come from, for people.
        proposed: made from privileged states and not reviewed since.
        admission: what the audit says of the recording.
    """

    clip: Clip
    labels: Labels
    labels_source: str
    proposed: bool
    admission: Admission = NO_AUDIT

    @property
    def name(self) -> str:
        """Scenario and domain as they stand in the cell's folder name."""
        return f"{self.labels.scenario}__{self.labels.domain}"

    @property
    def refusal(self) -> str | None:
        """Why this recording can't be scored against these labels; None when it can."""
        facts = self.clip.provenance
        if facts.refusal is not None:
            return facts.refusal
        if self.admission.refusal is not None:
            return self.admission.refusal
        if facts.event_version not in (None, self.labels.event_version):
            return (
                f"the labels are for event version {self.labels.event_version}, the recording "
                f"realises {facts.event_version}"
            )
        return None


@dataclass(frozen=True)
class CellResult:
    """What became of one cell.

    Args:
        folder: of the cell.
        scenario: of the labels.
        domain: of the labels.
        model: name.
        status: ok, refused or failed.
        reasons: of a refusal or failure, the primary one first.
        score: METHOD 6.14, None unless ok.
        asked: requests that were sent.
        reused: answers that an earlier run had stored.
        losses: label times without an answer, counted by kind (asker.Loss).
        admission: admitted, refused, unpaired or unaudited (admission.py).
        admission_reasons: of a refusal, or why an audit of the recording doesn't hold any more.
    """

    folder: Path
    scenario: str
    domain: str
    model: str
    status: str
    reasons: tuple[str, ...]
    score: dict[str, Any] | None
    asked: int
    reused: int
    losses: Mapping[str, int]
    admission: str
    admission_reasons: tuple[str, ...] = ()

    @property
    def missing(self) -> int:
        """Label times without an answer."""
        return sum(self.losses.values())


@dataclass(frozen=True)
class CellOptions:
    """What a cell depends on besides its inputs.

    Args:
        adapter: that reads the raw answers.
        fresh: ask again even where an answer is stored.
    """

    adapter: str = "waypoints"
    fresh: bool = False


def evaluate_cell(
    labelled: LabelledClip,
    model: ModelSpec,
    askers: Askers,
    out: Path,
    options: CellOptions,
    on_record: Progress,
) -> CellResult:
    """Evaluates one model on one clip and leaves the cell's folder.

    Args:
        labelled: clip and labels.
        model: who is asked.
        askers: gives the way to the model; not touched when every answer is stored already.
        out: campaign folder.
        options: adapter and reuse.
        on_record: called once per label time.

    Raises:
        InputError: the adapter or the model's options are wrong.
    """
    folder = out / CELLS / f"{labelled.name}__{model.name}"
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / LABELS_FILE, labels_to_json(labelled.labels))
    refusal = labelled.refusal
    if refusal is not None:
        for stale in (SCORE_FILE, RECORDS_FILE):
            (folder / stale).unlink(missing_ok=True)
        for _ in labelled.labels.labels:
            on_record()
        return _finish(folder, labelled, model, options, [], Ignored(), None, "refused", [refusal])
    asked, ignored = _ask_all(folder, labelled, model, askers, out, options, on_record)
    records = records_of(asked, options.adapter)
    write_text(folder / RECORDS_FILE, "".join(record_to_json(r) + "\n" for r in records))
    if not records:
        # Nothing came back at all: that says something about the bridge, not about the model.
        (folder / SCORE_FILE).unlink(missing_ok=True)
        reasons = list(dict.fromkeys(one.missing for one in asked if one.missing))
        return _finish(folder, labelled, model, options, asked, ignored, None, "failed", reasons)
    score = score_cell(labelled.labels, records).to_json()
    write_json(folder / SCORE_FILE, score)
    return _finish(folder, labelled, model, options, asked, ignored, score, "ok", [])


def _ask_all(
    folder: Path,
    labelled: LabelledClip,
    model: ModelSpec,
    askers: Askers,
    out: Path,
    options: CellOptions,
    on_record: Progress,
) -> tuple[list[Asked], Ignored]:
    store = RawStore(folder)
    if options.fresh:
        store.forget()
    key_options = model.key_options(sha256_json(labels_to_json(labelled.labels)))
    asker: Asker | None = None
    unreachable = ""
    asked: list[Asked] = []
    for label in labelled.labels.labels:
        question = labelled.clip.question(label.t_s)
        if isinstance(question, Question) and any(one.t_s == question.t_s for one in asked):
            reason = f"the newest frame, at {question.t_s:.3f} s, was asked about before"
            question = NoQuestion(label.t_s, reason)
        if isinstance(question, NoQuestion):
            asked.append(Asked(label.t_s, None, None, None, question.reason, Loss.NO_QUESTION))
            on_record()
            continue
        request = question.request
        _keep_frame(out, request.frames[-1].jpeg)
        key = request_key(request, model.name, key_options)
        stored = store.find(key)
        if stored is not None:
            asked.append(Asked(label.t_s, question.t_s, request, stored, reused=True))
            on_record()
            continue
        if asker is None and not unreachable:
            try:
                asker = askers.asker(
                    model,
                    model.options_for(str(folder / LABELS_FILE), labelled.clip.start_ns),
                )
            except PeerError as error:
                unreachable = str(error)
        asked.append(_ask(question, key, asker, unreachable, store))
        on_record()
    store.finish(asked)
    return asked, asker.ignored if asker is not None else Ignored()


def _ask(
    question: Question, key: str, asker: Asker | None, unreachable: str, store: RawStore
) -> Asked:
    request = replace(question.request, request_id=new_request_id(key))
    if asker is None:
        return Asked(question.label_t_s, question.t_s, request, None, unreachable, Loss.UNREACHABLE)
    reply = asker.ask(request)
    if reply.response is None:
        return Asked(question.label_t_s, question.t_s, request, None, reply.reason, reply.loss)
    store.append(reply.response)
    error, loss = "", None
    if reply.response.error_code:
        error = f"the bridge answered error {reply.response.error_code}: {reply.response.error_msg}"
        loss = Loss.ERROR
    return Asked(question.label_t_s, question.t_s, request, reply.response, error, loss)


def _keep_frame(out: Path, jpeg: bytes) -> None:
    """Keeps the newest frame of a request for the report, once for all models."""
    path = frame_path(out, sha256_bytes(jpeg))
    if not path.exists():
        write_bytes(path, jpeg)


def losses_text(losses: Mapping[str, int]) -> str:
    """``2 answers missing: bridge died``; empty where none is missing."""
    parts = [
        f"{count} answer{'s' if count > 1 else ''} missing: {kind}"
        for kind, count in losses.items()
    ]
    return ", ".join(parts)


def frame_path(out: Path, sha256: str) -> Path:
    """Where the campaign keeps a frame."""
    return out / FRAMES / f"{sha256.removeprefix('sha256:')[:32]}.jpg"


def _file_hashes(folder: Path) -> dict[str, str]:
    """Of the files beside cell.json, so that a score can be walked back to what gave it."""
    names = (LABELS_FILE, RAW_FILE, REQUESTS_FILE, RECORDS_FILE, SCORE_FILE)
    there = (folder / name for name in names if (folder / name).is_file())
    return {path.stem: sha256_file(path) for path in there}


def _finish(
    folder: Path,
    labelled: LabelledClip,
    model: ModelSpec,
    options: CellOptions,
    asked: Sequence[Asked],
    ignored: Ignored,
    score: dict[str, Any] | None,
    status: str,
    reasons: Sequence[str],
) -> CellResult:
    facts = labelled.clip.provenance
    camera, mount = labelled.clip.camera, labelled.clip.mount
    answers = [one.response for one in asked if one.response is not None]
    missing = [
        {"label_t_s": one.label_t_s, "kind": one.loss, "reason": one.missing}
        for one in asked
        if one.missing
    ]
    losses = dict(sorted(Counter(str(one.loss) for one in asked if one.missing).items()))
    preprocessing = labelled.clip.preprocessing
    sent = [one for one in asked if one.request is not None and not one.reused]
    reused = sum(one.reused for one in asked)
    decodings = {json.dumps(dict(a.decoding), sort_keys=True): dict(a.decoding) for a in answers}
    value = {
        "schema": CELL_SCHEMA,
        "scenario": labelled.labels.scenario,
        "domain": labelled.labels.domain,
        "model": model.name,
        "model_ids": sorted({answer.model_id for answer in answers if answer.model_id}),
        "status": status,
        "reasons": list(reasons),
        "stand_in": facts.stand_in,
        "admission": labelled.admission.to_json(),
        "event_version": labelled.labels.event_version,
        "clip": {
            "origin": facts.origin,
            "start_ns": labelled.clip.start_ns,
            "verdict": facts.verdict,
            "ego": facts.ego,
            "camera": facts.camera,
            "geometry": None if camera is None else asdict(camera),
            "mount_forward_m": None if mount is None else mount.forward_m,
            "mount_left_m": 0.0 if mount is None else mount.left_m,
            "mount_yaw_left_rad": 0.0 if mount is None else mount.yaw_left_rad,
            "mount_roll_right_rad": 0.0 if mount is None else mount.roll_right_rad,
        },
        "labels_source": labelled.labels_source,
        "labels_proposed": labelled.proposed,
        "answers": {
            "sent": len(sent),
            "reused": reused,
            "missing": missing,
            "missing_by_kind": losses,
            "ignored": ignored.to_json(),
        },
        "backend_options": dict(model.options),
        "decoding": [decodings[key] for key in sorted(decodings)],
        "preprocessing": asdict(preprocessing),
        "adapter": options.adapter,
        "task_version": None if facts.run is None else facts.run.task_version,
        "hashes": {
            **_file_hashes(folder),
            "bag": facts.bag_sha256,
            "verdict": facts.verdict_sha256,
            "question": sha256_json(asdict(labelled.clip.task)),
            "preprocessing": preprocessing.sha256,
            "decoding": sha256_json([decodings[key] for key in sorted(decodings)]),
            "extractor": extractor_hash(),
            "thresholds": DEFAULT.sha256,
        },
        "software": f"ssp {__version__}",
    }
    write_json(folder / CELL_FILE, value)
    return CellResult(
        folder=folder,
        scenario=labelled.labels.scenario,
        domain=labelled.labels.domain,
        model=model.name,
        status=status,
        reasons=tuple(reasons),
        score=score,
        asked=len(sent),
        reused=reused,
        losses=losses,
        admission=labelled.admission.status,
        admission_reasons=labelled.admission.reasons,
    )
