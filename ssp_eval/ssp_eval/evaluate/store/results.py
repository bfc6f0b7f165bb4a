"""Reads the cells of a campaign back, and scores them again for the details behind."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field

from ssp_core.errors import InputError
from ssp_core.files.folders import check_folder
from ssp_core.files.reading import parse_model, read_json_mapping, read_text
from ssp_core.run_file.values import Finite, Strict
from ssp_eval.data.audit import Audit, load_audit
from ssp_eval.data.labels import Labels, counts_text, load_labels, phase_counts
from ssp_eval.data.records import (
    MOST_BYTES,
    SLOT_NAMES,
    BehaviourRecord,
    load_records,
    parse_line,
)
from ssp_eval.evaluate.clients.models import BLIND, NEVER_MODELS, condition_of, is_control_name
from ssp_eval.evaluate.store.admission import (
    AUDITS,
    REFUSED,
    UNAUDITED,
    audit_files,
    audit_statuses,
)
from ssp_eval.evaluate.store.answer_records import BY_LLM, BY_READER, LLM_MISSING
from ssp_eval.evaluate.store.cell_file import (
    CELL_FILE,
    CELLS,
    LABELS_FILE,
    RECORDS_FILE,
    SCORE_FILE,
    changed_since,
    losses_text,
)
from ssp_eval.evaluate.store.requests import REQUESTS_FILE
from ssp_eval.extract.language import NOT_READ
from ssp_eval.score.aggregate import domain_order
from ssp_eval.score.cell import CellScore, score_in_detail
from ssp_eval.score.score_file import load_score
from ssp_eval.score.thresholds import DEFAULT, Thresholds, thresholds_of
from ssp_vla_bridge.backend import is_blind

Count = Annotated[int, Field(ge=0)]
# Of a cell that can't be read.
UNKNOWN = "unknown"


class _Part(Strict):
    """No value is made to fit: ``"false"`` is no boolean and 5 is no text."""

    model_config = ConfigDict(extra="ignore", frozen=True, strict=True)


class _Facts(_Part):
    """A part of cell.json, all of whose keys are known."""

    model_config = ConfigDict(extra="forbid")


class AdmissionFacts(_Facts):
    """The audit's judgement of the recording; cells of an earlier version have none."""

    status: Literal["admitted", "refused", "unpaired", "unaudited"] = "unaudited"
    audit_sha256: str | None = None
    reasons: list[str] = []
    crop: dict[str, Any] | None = None


class GeometryFacts(_Facts):
    """The forward camera: px, m and rad; height and pitch are null where they are unknown."""

    fx_px: Finite
    fy_px: Finite
    cx_px: Finite
    cy_px: Finite
    width_px: Annotated[int, Field(gt=0)]
    height_px: Annotated[int, Field(gt=0)]
    height_m: Finite | None = None
    pitch_down_rad: Finite | None = None


class ClipFacts(_Facts):
    """The recording that was shown; its path is from the campaign's folder."""

    origin: str
    # None where nobody knows of one; cells of an earlier version don't say.
    renderer: str | None = None
    # The bodies in CARLA that drew or moved participants; none where CARLA did nothing.
    carla: dict[str, str] = {}
    # Who says of which domain it is, when and where; empty where no person did.
    declared_by: str = ""
    # The driver that led the VUT; empty where none did.
    driven_by: str = ""
    # The rules by which it was imported; null for a session, and in cells of an earlier version.
    import_rules: int | None = None
    path: str | None = None
    start_ns: int | None = None
    verdict: str | None
    ego: str
    camera: str
    # Findings of the import that a person took as they are; none in cells of an earlier version.
    accepted: list[str] = []
    geometry: GeometryFacts | None
    mount_forward_m: Finite | None
    mount_left_m: Finite = 0.0
    mount_yaw_left_rad: Finite = 0.0
    mount_roll_right_rad: Finite = 0.0


class IgnoredFacts(_Facts):
    """Answers that came and weren't used."""

    late: Count
    duplicate: Count
    unknown: Count


class AnswerFacts(_Facts):
    """The questions and the answers."""

    sent: Count
    reused: Count
    asked_again: Count = 0
    missing: list[dict[str, Any]]
    # Cells of an earlier version don't tell the kinds apart.
    missing_by_kind: dict[str, Count] = {}
    ignored: IgnoredFacts


class PreprocessingFacts(_Facts):
    """The frames and the ego history in a request."""

    frames: Count
    frame_spacing_s: Finite
    frame_span_s: Finite = 1.0
    history_s: Finite = 2.0
    history_spacing_s: Finite = 0.1
    state_age_s: Finite = 0.3


class ModelFactsRead(_Facts):
    """The models file's facts about a model; none of them is scored."""

    total_b: Finite | None = None
    active_b: Finite | None = None
    architecture: str = ""


class TwinFacts(_Facts):
    """The twin that a model was asked about in the recording's place."""

    name: str
    words: str
    # From the campaign's folder.
    path: str | None = None


class CellFacts(_Facts):
    """cell.json (``ssp.cell/1``): scenario × domain × model."""

    schema_: Literal["ssp.cell/1"] = Field(alias="schema")
    scenario: str
    domain: str
    model: str
    model_ids: list[str]
    status: Literal["ok", "refused", "failed"]
    reasons: list[str]
    stand_in: bool
    admission: AdmissionFacts = AdmissionFacts()
    event_version: str
    clip: ClipFacts
    labels_source: str
    labels_proposed: bool
    labels_plan: str = ""
    labels_per_phase: dict[str, Count] = {}
    answers: AnswerFacts
    backend_options: dict[str, Any]
    decoding: list[dict[str, Any]]
    preprocessing: PreprocessingFacts
    # Empty in cells of an earlier version, and the backend of a bridge that was attached.
    backend: str = ""
    interface: str = ""
    # A blinded or disordered ask of a model, and a bridge that checks the harness.
    condition: str = ""
    condition_seed: int | None = None
    control: bool = False
    twin: TwinFacts | None = None
    task_version: str | None = None
    model_facts: ModelFactsRead = ModelFactsRead()
    adapter: str
    extraction: dict[str, Any] = {}
    software: str = ""
    # Null where a recording has no such part: an imported video has no verdict.
    hashes: dict[str, str | None]
    # All of the scorer's; cells of an earlier version say only their hash.
    thresholds: dict[str, float | int] | None = None
    # Cells of an earlier version don't say.
    rules_version: int = 1


class FrameFacts(_Part):
    """A frame that was sent."""

    sha256: str


class PlaceFacts(_Part):
    """The VUT's places, in its own frame at the request, m."""

    x_m: Finite
    y_m: Finite


class RequestFacts(_Part):
    """One line of requests.jsonl: a label time, and what was asked then, if anything was."""

    label_t_s: Finite
    missing: str = ""
    kind: str | None = None
    frames: list[FrameFacts] = []
    history: list[PlaceFacts] = []


def load_facts(file: Path) -> CellFacts:
    """Read a cell.json.

    Raises:
        InputError: it is no JSON, or a field is missing or wrong; with its path.
    """
    return parse_model(CellFacts, read_json_mapping(file), file)


@dataclass(frozen=True)
class CellData:
    """One cell as it lies in its folder.

    Args:
        records: empty unless the cell has answers.
        request_lines: the lines of requests.jsonl, checked; see requests.
        score: scored again from records and labels, None unless the cell is ok.
        changed: what of it isn't as `ssp evaluate` left it, for which it is refused; or empty.
    """

    folder: Path
    facts: CellFacts
    labels: Labels
    records: tuple[BehaviourRecord, ...]
    request_lines: tuple[bytes, ...]
    score: CellScore | None
    notes: tuple[str, ...]
    thresholds: Thresholds = DEFAULT
    changed: str = ""

    @property
    def requests(self) -> tuple[dict[str, Any], ...]:
        """Read the questions, one per label time, anew at each access.

        As values they would take most of the memory of a large campaign's cells.
        """
        return tuple(json.loads(line) for line in self.request_lines)

    def requests_by_label(self) -> dict[float, dict[str, Any]]:
        """Return the question at each label's clip time, s."""
        return {float(request["label_t_s"]): request for request in reversed(self.requests)}

    @property
    def scenario(self) -> str:
        """Name of the scenario."""
        return self.facts.scenario

    @property
    def domain(self) -> str:
        """Name of the domain."""
        return self.facts.domain

    @property
    def model(self) -> str:
        """Name of the model, with its condition."""
        name = self.facts.model
        # A bridge that was attached, or a recording, tells in its answers that it was shown none.
        has_no_pictures = any(map(is_blind, self.facts.decoding))
        return f"{name}+{BLIND}" if has_no_pictures and not condition_of(name)[1] else name

    @property
    def is_blind(self) -> bool:
        """True where the model was shown no picture."""
        return condition_of(self.model)[1] == BLIND

    @property
    def admission(self) -> str:
        """admitted, refused, unpaired or unaudited; cells of an earlier version are unaudited."""
        return self.facts.admission.status

    @property
    def audit_sha256(self) -> str | None:
        """Hash of the audit that the recording was looked up in."""
        return self.facts.admission.audit_sha256

    @property
    def labels_per_phase(self) -> str:
        """Count the labels of approach, trigger, conflict and resolution, as ``3/1/4/1``."""
        return counts_text(phase_counts(self.labels))

    @property
    def is_control(self) -> bool:
        """True for a bridge that checks the harness."""
        facts = self.facts
        has_control_name = is_control_name(self.model) or facts.backend in NEVER_MODELS
        return has_control_name or facts.control or bool(facts.condition)

    @property
    def id(self) -> str:
        """Anchor in the page."""
        return self.folder.name


def load_cells(out: Path, on_cell: Callable[[], None] = lambda: None) -> list[CellData]:
    """Return all cells of a campaign, by scenario, domain and model.

    Raises:
        InputError: it is no campaign folder, or a file in it is damaged.
    """
    cells = []
    audits = AuditCache(out)
    for cell in read_cells(cell_files(out), audits):
        cells.append(cell)
        on_cell()
    return in_order(cells)


def cell_files(out: Path) -> list[Path]:
    """Return the cell.json of each cell of a campaign.

    Raises:
        InputError: it is no campaign folder.
    """
    if out.is_file():
        raise InputError(
            "is no campaign's folder but a file",
            file=out,
            remedy="component scores go with --from-cells FILE.csv; of a campaign give the --out "
            "folder of `ssp evaluate`",
        )
    remedy = "give the --out folder of `ssp evaluate`"
    check_folder(out, remedy)
    files = sorted((out / CELLS).glob(f"*/{CELL_FILE}"))
    if not files:
        raise InputError(
            f"holds no evaluated cells ({CELLS}/*/{CELL_FILE})", file=out, remedy=remedy
        )
    return files


def in_order(cells: Iterable[CellData]) -> list[CellData]:
    """Sort by scenario, domain and model, controls last."""
    return sorted(cells, key=lambda c: (c.scenario, domain_order(c.domain), c.is_control, c.model))


class AuditCache:
    """The audits in a campaign's folder, each read once."""

    def __init__(self, out: Path) -> None:
        self._files = audit_files(out)
        self._read: dict[str, Audit] = {}

    def against(self, facts: CellFacts) -> str:
        """Say how a cell's admission departs from its audit; empty where it doesn't."""
        status, digest = facts.admission.status, facts.admission.audit_sha256
        if facts.status != "ok" or status == UNAUDITED:
            return ""
        if status == REFUSED:
            return "it is scored though the audit refused its recording"
        if digest is None:
            return f"it says {status} and names no audit"
        if digest not in self._files:
            return (
                f"it says {status}, and the audit that it names ({digest}) isn't in {AUDITS}/; "
                "give `ssp evaluate` the same command with that audit again"
            )
        try:
            if digest not in self._read:
                self._read[digest] = load_audit(self._files[digest])
        except InputError as error:
            return str(error)
        audit = self._read[digest]
        statuses = audit_statuses(audit, facts.hashes.get("bag"), facts.hashes.get("verdict"))
        if statuses != {status} or audit.event_version != facts.event_version:
            words = ", ".join(sorted(statuses)) or "not known"
            return (
                f"it says {status} of event version {facts.event_version}, and by "
                f"{self._files[digest]} it is {words} of {audit.event_version}"
            )
        return ""


# Cells that are scored at a time: the engine takes many in little more time than one.
_BLOCK = 32


def read_cells(files: Sequence[Path], audits: AuditCache) -> Iterator[CellData]:
    """Yield cells in the order of their files, scored again; see load_cells.

    Raises:
        InputError: a file of a cell is damaged.
    """
    for start in range(0, len(files), _BLOCK):
        cells = [_read_cell(file, audits) for file in files[start : start + _BLOCK]]
        scores: dict[int, CellScore] = {}
        for thresholds in dict.fromkeys(cell.thresholds for cell in cells):
            numbers = [
                number
                for number, cell in enumerate(cells)
                if cell.facts.status == "ok" and cell.thresholds == thresholds
            ]
            those = [(cells[number].labels, cells[number].records) for number in numbers]
            scores |= zip(numbers, score_in_detail(those, thresholds), strict=True)
        for number, cell in enumerate(cells):
            yield _scored(cell, scores[number]) if number in scores else cell


def _read_cell(file: Path, audits: AuditCache) -> CellData:
    """Return one cell without its score; refused where it isn't as `ssp evaluate` left it."""
    folder = file.parent
    try:
        value = read_json_mapping(file)
        facts = parse_model(CellFacts, value, file)
    except InputError as error:
        return _refused(folder, _unreadable(folder), f"{CELL_FILE} can't be read: {error}")
    name = "__".join((facts.scenario, facts.domain, facts.model))
    changed = changed_since(folder, value) or audits.against(facts)
    if name != folder.name:
        changed = f"it is the cell {name}, and lies in another one's folder"
    if changed:
        return _refused(folder, facts, changed)
    labels = load_labels(folder / LABELS_FILE)
    if facts.status != "ok":
        return CellData(folder, facts, labels, (), (), None, ())
    records = load_records(folder / RECORDS_FILE)
    thresholds = DEFAULT if facts.thresholds is None else thresholds_of(facts.thresholds, file)
    requests = request_lines(folder / REQUESTS_FILE)
    return CellData(folder, facts, labels, records, requests, None, (), thresholds)


def _refused(folder: Path, facts: CellFacts, why: str) -> CellData:
    """Return a cell of which only the name is used."""
    facts = facts.model_copy(update={"status": "refused", "reasons": [why]})
    unknown = Labels(facts.scenario, facts.domain, facts.event_version, None, False, ())
    return CellData(folder, facts, unknown, (), (), None, (), changed=why)


def _unreadable(folder: Path) -> CellFacts:
    """Read a cell's facts from the name of its folder, where its cell.json can't be read."""
    scenario, domain, model = (*folder.name.split("__", 2), UNKNOWN, UNKNOWN)[:3]
    return CellFacts(
        schema="ssp.cell/1",
        scenario=scenario,
        domain=domain,
        model=model,
        model_ids=[],
        status="refused",
        reasons=[],
        stand_in=False,
        event_version=UNKNOWN,
        clip=ClipFacts(
            origin=UNKNOWN,
            verdict=None,
            ego=UNKNOWN,
            camera=UNKNOWN,
            geometry=None,
            mount_forward_m=None,
        ),
        labels_source=UNKNOWN,
        labels_proposed=False,
        answers=AnswerFacts(
            sent=0, reused=0, missing=[], ignored=IgnoredFacts(late=0, duplicate=0, unknown=0)
        ),
        backend_options={},
        decoding=[],
        preprocessing=PreprocessingFacts(frames=0, frame_spacing_s=0.0),
        adapter=UNKNOWN,
        hashes={},
    )


def _scored(cell: CellData, score: CellScore) -> CellData:
    """Return a cell with its score and what a reader must know of it."""
    facts, records, folder = cell.facts, cell.records, cell.folder
    notes = []
    try:
        stored = load_score(folder / SCORE_FILE)
    except InputError as error:
        return _refused(folder, facts, f"{SCORE_FILE} can't be read: {error}")
    if stored != score.to_json():
        notes.append(
            "The stored score differs from what its records and labels give now; this page shows "
            "the latter."
        )
    if facts.hashes.get("thresholds") != score.details.thresholds_sha256:
        notes.append("It doesn't say the thresholds that it was evaluated with; these are others.")
    if losses := losses_text(facts.answers.missing_by_kind):
        notes.append(f"{losses}. They count as missing outputs.")
    if foreign := _languages(records):
        languages = ", ".join(f"{name} {count}" for name, count in sorted(foreign.items()))
        notes.append(
            f"{foreign.total()} of {len(records)} texts are {NOT_READ} ({languages}): what they "
            "say of the scene and the plan counts as missing."
        )
    notes += _shares(records)
    if lacking := sum(_has_note(record, LLM_MISSING) for record in records):
        notes.append(
            f"{lacking} of {len(records)} records lack what the LLM of the extraction would have "
            "filled; their notes say why."
        )
    return replace(cell, score=score, notes=tuple(notes))


def _notes(record: BehaviourRecord) -> list[str]:
    return [] if record.adapter is None else record.adapter["notes"]


def _has_note(record: BehaviourRecord, beginning: str) -> bool:
    return any(note.startswith(beginning) for note in _notes(record))


def _shares(records: Sequence[BehaviourRecord]) -> Iterator[str]:
    """Describe how many of the slots the rules didn't fill."""
    slot_count = sum(getattr(one.slots, name) is not None for one in records for name in SLOT_NAMES)
    for source, name in ((BY_READER, "learned reader"), (BY_LLM, "LLM of the extraction")):
        filled = sum(
            note.count(",") + 1
            for record in records
            for note in _notes(record)
            if note.startswith(f"{source}: ")
        )
        if filled:
            yield f"The {name} filled {filled} of {slot_count} slots ({filled / slot_count:.2f})."


def _languages(records: Iterable[BehaviourRecord]) -> Counter[str]:
    """Count the texts in each language that the rules don't read."""
    return Counter(
        note.removeprefix(NOT_READ).lstrip(": ")
        for record in records
        for note in _notes(record)
        if note.startswith(NOT_READ)
    )


def request_lines(file: Path) -> tuple[bytes, ...]:
    """Read the questions, one line of JSON per label time.

    Raises:
        InputError: a line is damaged; with its number.
    """
    lines = []
    for number, line in enumerate(read_text(file, MOST_BYTES).splitlines(), start=1):
        parse_line(RequestFacts, line, file, number)
        lines.append(line.encode())
    return tuple(lines)
