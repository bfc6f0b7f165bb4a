"""What the report reads of a cell's files; what else stands in them is let be."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from ssp_core.files import load_model
from ssp_core.run_file.values import Finite

Count = Annotated[int, Field(ge=0)]


class _Part(BaseModel):
    """No value is made to fit: ``"false"`` is no boolean and 5 is no text."""

    model_config = ConfigDict(extra="ignore", frozen=True, strict=True)


class AdmissionFacts(_Part):
    """What the audit said of the recording; cells of an earlier version say nothing."""

    status: Literal["admitted", "refused", "unpaired", "unaudited"] = "unaudited"
    audit_sha256: str | None = None


class GeometryFacts(_Part):
    """The forward camera: px, m and rad; height and pitch are null where nobody knows them."""

    fx_px: Finite
    fy_px: Finite
    cx_px: Finite
    cy_px: Finite
    width_px: Annotated[int, Field(gt=0)]
    height_px: Annotated[int, Field(gt=0)]
    height_m: Finite | None = None
    pitch_down_rad: Finite | None = None


class ClipFacts(_Part):
    """The recording that was shown; its path is from the campaign's folder."""

    origin: str
    # None where nobody knows of one; cells of an earlier version don't say.
    renderer: str | None = None
    path: str | None = None
    start_ns: int | None = None
    verdict: str | None
    ego: str
    camera: str
    geometry: GeometryFacts | None
    mount_forward_m: Finite | None
    mount_left_m: Finite = 0.0
    mount_yaw_left_rad: Finite = 0.0
    mount_roll_right_rad: Finite = 0.0


class IgnoredFacts(_Part):
    """Answers that came and weren't used."""

    late: Count
    duplicate: Count
    unknown: Count


class AnswerFacts(_Part):
    """What was asked, and what came back."""

    sent: Count
    reused: Count
    asked_again: Count = 0
    missing: list[dict[str, Any]]
    # Cells of an earlier version don't tell the kinds apart.
    missing_by_kind: dict[str, Count] = {}
    ignored: IgnoredFacts


class PreprocessingFacts(_Part):
    """Of the frames and the ego history in a request."""

    frames: Count
    frame_spacing_s: Finite
    history_s: Finite = 2.0
    history_spacing_s: Finite = 0.1


class ModelFactsRead(_Part):
    """What the models file says of a model; nothing of it is scored."""

    total_b: Finite | None = None
    active_b: Finite | None = None
    architecture: str = ""


class CellFacts(_Part):
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
    answers: AnswerFacts
    backend_options: dict[str, Any]
    decoding: list[dict[str, Any]]
    preprocessing: PreprocessingFacts
    # Empty in cells of an earlier version, and the backend of a bridge that was attached.
    backend: str = ""
    interface: str = ""
    # A blinded or disordered ask of a model, and a bridge that checks the harness.
    condition: str = ""
    control: bool = False
    task_version: str | None = None
    model_facts: ModelFactsRead = ModelFactsRead()
    adapter: str
    # Null where a recording has no such part: an imported video has no verdict.
    hashes: dict[str, str | None]
    # All of the scorer's; cells of an earlier version say only their hash.
    thresholds: dict[str, float | int] | None = None


class FrameFacts(_Part):
    """A frame that was sent."""

    sha256: str


class PlaceFacts(_Part):
    """Where the VUT was, in its own frame at the request, m."""

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
    """Reads a cell.json.

    Raises:
        InputError: it is no JSON, or a field is missing or wrong; with its path.
    """
    return load_model(CellFacts, file)
