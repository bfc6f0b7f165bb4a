"""A cell's folder: its files and their size limits, and what cell.json says of clip and model."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from ssp_core import RULES_VERSION, __version__
from ssp_core.errors import InputError, not_written
from ssp_core.files.writing import write_json
from ssp_core.hashing import sha256_file, sha256_json
from ssp_eval.data.labels import Labels, phase_counts
from ssp_eval.evaluate.clients.model_replies import (
    MOST_REASON,
    OUTAGE,
    IgnoredAnswers,
    Loss,
    settings_of,
)
from ssp_eval.evaluate.clients.models import CONDITION_SEED, ModelSpec
from ssp_eval.evaluate.store.admission import NO_AUDIT, Admission
from ssp_eval.evaluate.store.requests import EARLIER_FILE, RAW_FILE, REQUESTS_FILE, Exchange
from ssp_eval.extract.combined.extractor import Extractor
from ssp_eval.recordings.clip import Clip
from ssp_eval.score.thresholds import DEFAULT, Thresholds
from ssp_vla_bridge.messages import Response

_MOST_REASONS = 20


def short(reason: str) -> str:
    """Return a reason of a length that people read."""
    return reason if len(reason) <= MOST_REASON else reason[: MOST_REASON - 1] + "…"


def short_list(reasons: Sequence[str]) -> list[str]:
    """Return the first reasons, and how many more there are."""
    more = len(reasons) - _MOST_REASONS
    texts = [short(reason) for reason in reasons[:_MOST_REASONS]]
    return [*texts, f"and {more} more"] if more > 0 else texts


def decodings(answers: Sequence[Response]) -> list[dict[str, Any]]:
    """Return the distinct decoding settings of the answers; those that vary by answer are raw."""
    settings_by_text = {}
    for answer in answers:
        settings = settings_of(answer)
        settings_by_text[json.dumps(settings, sort_keys=True)] = settings
    return [settings_by_text[key] for key in sorted(settings_by_text)]


@dataclass(frozen=True)
class TwinClip:
    """A twin of a recording (docs/twins.md), whose questions are put in the place of its own.

    Args:
        words: what differs, for people.
        sha256: content hash of its bag.
    """

    name: str
    words: str
    sha256: str
    clip: Clip


@dataclass(frozen=True)
class LabelledClip:
    """A clip with its labels, ready to be asked about.

    Args:
        labels_source: where they come from, for people.
        proposed: made from privileged states and not reviewed since.
        twins: by the condition under which a model is asked about them.
    """

    clip: Clip
    labels: Labels
    labels_source: str
    proposed: bool
    admission: Admission = NO_AUDIT
    twins: Mapping[str, TwinClip] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Scenario and domain as they stand in the cell's folder name."""
        return f"{self.labels.scenario}__{self.labels.domain}"

    @property
    def refusal(self) -> str | None:
        """Say why this recording can't be scored against these labels; None when it can."""
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
        crop = self.clip.crop
        outside = [x.t_s for x in self.labels.labels if crop is not None and not crop.holds(x.t_s)]
        if crop is not None and outside:
            return (
                f"the label at {outside[0]:g} s lies outside the clip that the audit compared, "
                f"{crop.start_s:.3f} to {crop.end_s:.3f} s; `ssp labels new` plans labels inside it"
            )
        return None

    def forget_twin(self, model: ModelSpec) -> None:
        """Free the memory of a twin's questions, which aren't asked again for a while."""
        twin = self.twins.get(model.condition)
        if twin is not None:
            twin.clip.forget_questions()


CELL_SCHEMA = "ssp.cell/1"
CELLS = "cells"
FRAMES = "frames"
LABELS_FILE = "labels.json"
RECORDS_FILE = "records.jsonl"
SCORE_FILE = "score.json"
CELL_FILE = "cell.json"
# The files beside it whose hashes it names, and the name of its own hash.
HASHED = (LABELS_FILE, RAW_FILE, REQUESTS_FILE, RECORDS_FILE, SCORE_FILE)
SEAL = "cell"
# Why a model under a condition may have no answer without anything being wrong.
_BY_CONDITION = frozenset({Loss.NO_QUESTION, Loss.ERROR, Loss.DECLINED})
# Why a cell has no answer that the model could have given.
_NO_BRIDGE = frozenset({Loss.DIED, Loss.UNREACHABLE})


@dataclass(frozen=True)
class CellResult:
    """The outcome of one cell.

    Args:
        reasons: of a refusal or failure, the primary one first.
        score: METHOD 6.14, None unless ok.
        losses: label times without an answer, counted by kind (model_replies.Loss).
        admission: admitted, refused, unpaired or unaudited (admission.py).
        admission_reasons: of a refusal, or why an audit of the recording doesn't hold any more.
        condition: under which the model was asked; empty: none.
        driven_by: driver that led the VUT of the recording; empty: none did.
        first_missing: why the first answer is missing; empty where none is.
    """

    folder: Path
    scenario: str
    domain: str
    model: str
    status: str
    reasons: tuple[str, ...]
    score: dict[str, Any] | None
    sent: int
    reused: int
    losses: Mapping[str, int]
    admission: str
    admission_reasons: tuple[str, ...] = ()
    again: int = 0
    control: bool = False
    condition: str = ""
    driven_by: str = ""
    first_missing: str = ""
    labels_per_phase: Mapping[str, int] = field(default_factory=dict)

    @property
    def missing(self) -> int:
        """Label times without an answer."""
        return sum(self.losses.values())

    @property
    def failed_for_bridge(self) -> bool:
        """True where the bridge wasn't there for any question, which says nothing of its model."""
        return self.status == "failed" and bool(self.losses) and _NO_BRIDGE.issuperset(self.losses)

    @property
    def is_failure(self) -> bool:
        """True where the cell has no score and should have one, or where answers failed to come.

        A model that is shown spoilt frames may refuse to answer, and a clip of one label time has
        no other frame to show: that is what such a control found out, and nothing failed.
        """
        if self.status == "ok" and not outages(self.losses):
            return False
        return not (self.condition and self.losses and _BY_CONDITION.issuperset(self.losses))


def outages(losses: Mapping[str, int]) -> dict[str, int]:
    """Return the losses caused by bridge, server or network, and not by the model."""
    return {kind: count for kind, count in losses.items() if kind in OUTAGE}


def losses_text(losses: Mapping[str, int]) -> str:
    """Return a text such as ``2 answers missing: bridge died``; empty where none is missing."""
    parts = [
        f"{count} answer{'s' if count > 1 else ''} missing: {kind}"
        for kind, count in losses.items()
    ]
    return ", ".join(parts)


def holds_answers(out: Path) -> bool:
    """Return True where a campaign's folder has raw answers, whatever became of its cells.

    Args:
        out: campaign folder; it need not be there.
    """
    return any(path.stat().st_size for path in out.glob(f"{CELLS}/*/{RAW_FILE}"))


def frame_path(out: Path, sha256: str) -> Path:
    """Return the path at which the campaign keeps a frame."""
    return out / FRAMES / f"{sha256.removeprefix('sha256:')[:32]}.jpg"


def remove_file(path: Path) -> None:
    """Remove a file of a cell, if it is there.

    Raises:
        InputError: a folder is in its place.
        HostError: the system doesn't let it.
    """
    try:
        path.unlink(missing_ok=True)
    except IsADirectoryError as error:
        raise InputError(
            "is a folder", file=path, remedy="remove it, or name a new --out"
        ) from error
    except OSError as error:
        raise not_written(path, error) from error


def _file_hashes(folder: Path) -> dict[str, str]:
    """Hash the files beside cell.json, so that a score can be traced back to its origin."""
    there = (folder / name for name in (*HASHED, EARLIER_FILE) if (folder / name).is_file())
    return {path.stem: sha256_file(path) for path in there}


def sealed(facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return cell.json's content, with the hash of all of it under ``hashes.cell``."""
    hashes = {key: sha256 for key, sha256 in facts["hashes"].items() if key != SEAL}
    digest = sha256_json({**facts, "hashes": hashes})
    return {**facts, "hashes": {**hashes, SEAL: digest}}


def changed_since(folder: Path, facts: Mapping[str, Any]) -> str:
    """Name the file of a cell that isn't as the evaluation left it; empty where all are."""
    hashes = facts["hashes"]
    if SEAL not in hashes:
        return (
            f"{CELL_FILE} names no hash of itself, as those of earlier versions; give "
            "`ssp evaluate` the same command again, nothing that is stored is asked again"
        )
    if sealed(facts)["hashes"][SEAL] != hashes[SEAL]:
        return f"{CELL_FILE} was changed since it was written"
    current_hashes = _file_hashes(folder)
    for name in HASHED:
        key = Path(name).stem
        if current_hashes.get(key) != hashes.get(key):
            what = "was changed" if key in current_hashes and key in hashes else "came or went"
            return f"{name} {what} since the cell was evaluated"
    return ""


@dataclass(frozen=True)
class CellPlace:
    """The identity of a cell, and its folder.

    Args:
        extractor: of the slots; its counts are of this cell.
    """

    folder: Path
    labelled: LabelledClip
    model: ModelSpec
    adapter: str
    extractor: Extractor = field(default_factory=Extractor)
    thresholds: Thresholds = DEFAULT


def write_cell(
    place: CellPlace,
    status: str,
    reasons: Sequence[str],
    exchanges: Sequence[Exchange] = (),
    ignored: IgnoredAnswers | None = None,
    score: dict[str, Any] | None = None,
) -> CellResult:
    """Write cell.json, the last of a cell's files.

    Args:
        place: the cell's folder, recording and model.
        status: ok, refused or failed.
        reasons: of a refusal or failure, the primary one first.
        exchanges: questions with their answers.
        ignored: answers that came late, twice or to no question; None: not counted.
        score: METHOD 6.14, None unless ok.
    """
    facts = _facts(place, status, reasons, exchanges, ignored)
    write_json(place.folder / CELL_FILE, sealed(facts))
    labelled, model = place.labelled, place.model
    return CellResult(
        folder=place.folder,
        scenario=labelled.labels.scenario,
        domain=labelled.labels.domain,
        model=model.result_name,
        status=status,
        reasons=tuple(short_list(reasons)),
        score=score,
        sent=len(_sent(exchanges)),
        reused=sum(one.reused for one in exchanges),
        losses=_losses(exchanges),
        admission=labelled.admission.status,
        admission_reasons=labelled.admission.reasons,
        again=sum(one.again for one in exchanges),
        control=model.control,
        condition=model.condition,
        driven_by=labelled.clip.provenance.driven_by,
        first_missing=next((short(one.missing) for one in exchanges if one.missing), ""),
        labels_per_phase=phase_counts(labelled.labels),
    )


def _sent(exchanges: Sequence[Exchange]) -> list[Exchange]:
    return [one for one in exchanges if one.request is not None and not one.reused]


def _losses(exchanges: Sequence[Exchange]) -> dict[str, int]:
    return dict(sorted(Counter(str(one.loss) for one in exchanges if one.missing).items()))


def _facts(
    place: CellPlace,
    status: str,
    reasons: Sequence[str],
    exchanges: Sequence[Exchange],
    ignored: IgnoredAnswers | None,
) -> dict[str, Any]:
    """Collect the content of cell.json; see write_cell."""
    labelled, model = place.labelled, place.model
    facts = labelled.clip.provenance
    answers = [one.response for one in exchanges if one.response is not None]
    settings = decodings(answers)
    return {
        "schema": CELL_SCHEMA,
        "scenario": labelled.labels.scenario,
        "domain": labelled.labels.domain,
        "model": model.result_name,
        "condition": model.condition,
        "condition_seed": CONDITION_SEED if model.condition else None,
        "control": model.control,
        "twin": _twin_facts(labelled.twins.get(model.condition), place.folder.parent.parent),
        "model_ids": sorted({answer.model_id for answer in answers if answer.model_id}),
        "model_facts": asdict(model.facts),
        "status": status,
        "reasons": short_list(reasons),
        "stand_in": facts.stand_in,
        "admission": labelled.admission.to_json(),
        "event_version": labelled.labels.event_version,
        "clip": _clip_facts(labelled, place.folder.parent.parent),
        "labels_source": labelled.labels_source,
        "labels_proposed": labelled.proposed,
        "labels_plan": labelled.labels.plan,
        "labels_per_phase": phase_counts(labelled.labels),
        "answers": {
            "sent": len(_sent(exchanges)),
            "reused": sum(one.reused for one in exchanges),
            "asked_again": sum(one.again for one in exchanges),
            "missing": [
                {"label_t_s": one.label_t_s, "kind": one.loss, "reason": short(one.missing)}
                for one in exchanges
                if one.missing
            ],
            "missing_by_kind": _losses(exchanges),
            "ignored": (ignored or IgnoredAnswers()).to_json(),
        },
        "backend": "" if model.attached else model.backend_name,
        "backend_options": dict(model.options),
        "decoding": settings,
        "interface": model.model_interface.name,
        "preprocessing": asdict(model.rules),
        "adapter": place.adapter,
        "extraction": place.extractor.describe(),
        "task_version": None if facts.run is None else facts.run.task_version,
        "hashes": {
            **_file_hashes(place.folder),
            "bag": facts.bag_sha256,
            **({"twin": twin.sha256} if (twin := labelled.twins.get(model.condition)) else {}),
            "verdict": facts.verdict_sha256,
            "question": sha256_json(asdict(labelled.clip.task)),
            "preprocessing": model.rules.sha256,
            "decoding": sha256_json(settings),
            "extractor": place.extractor.sha256,
            "thresholds": place.thresholds.sha256,
        },
        "thresholds": asdict(place.thresholds),
        "software": f"ssp {__version__}",
        "rules_version": RULES_VERSION,
    }


def _twin_facts(twin: TwinClip | None, out: Path) -> dict[str, Any] | None:
    if twin is None:
        return None
    path = os.path.relpath(twin.clip.path.resolve(), out.resolve())
    return {"name": twin.name, "words": twin.words, "path": path}


def _clip_facts(labelled: LabelledClip, out: Path) -> dict[str, Any]:
    facts, camera, mount = labelled.clip.provenance, labelled.clip.camera, labelled.clip.mount
    return {
        "origin": facts.origin,
        "renderer": facts.renderer,
        **({"carla": facts.carla_texts} if facts.carla_texts else {}),
        "declared_by": facts.declared_by,
        **({"driven_by": facts.driven_by} if facts.driven_by else {}),
        "import_rules": None if facts.imported is None else facts.imported.rules_version,
        # From the campaign's folder, so that both can be moved together.
        "path": os.path.relpath(labelled.clip.path.resolve(), out.resolve()),
        "start_ns": labelled.clip.start_ns,
        "verdict": facts.verdict,
        "ego": facts.ego,
        "camera": facts.camera,
        "accepted": [] if facts.imported is None else facts.imported.accepted_names,
        "geometry": None if camera is None else asdict(camera),
        "mount_forward_m": None if mount is None else mount.forward_m,
        "mount_left_m": 0.0 if mount is None else mount.left_m,
        "mount_yaw_left_rad": 0.0 if mount is None else mount.yaw_left_rad,
        "mount_roll_right_rad": 0.0 if mount is None else mount.roll_right_rad,
    }
