"""The attachment ``import.json``: where a recording that others made comes from (METHOD 4.3, 4.4).

The importers write it; audit, labels and evaluation read it. ``ssp.import/1`` is what earlier
versions wrote of a video: it has no declaration, no states and no site.
"""

from __future__ import annotations

from datetime import date
from typing import Annotated, Literal

from pydantic import ConfigDict, Field, model_validator

from ssp_core.run_file.road import Road
from ssp_core.run_file.values import Finite, NonNegative, ObjectId, Strict
from ssp_core.vocabulary import DomainWord, ObjectWord

SCHEMA: Literal["ssp.import/2"] = "ssp.import/2"
IMPORT_ATTACHMENT = "import.json"
# A domain is a part of a cell's folder name, and so is a scenario.
SAFE_NAME = r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$"

Words = Annotated[str, Field(min_length=1, max_length=500, pattern=r"\S")]


class ImportedEgo(Strict):
    """How the VUT moved, and how that is known."""

    provenance: Literal["measured", "declared", "unknown"]
    speed_mps: NonNegative | None = Field(description="constant; null: measured or unknown")


class ImportedCamera(Strict):
    """Geometry of the camera, and how that is known."""

    provenance: Literal["measured", "declared", "assumed", "unknown"]
    hfov_deg: float | None
    height_m: float | None
    pitch_down_rad: float | None


class DomainDeclaration(Strict):
    """Who says of which domain a recording is, when and where it was made (METHOD 4.4)."""

    by: Words
    on: date = Field(description="when the recording was made")
    place: Words

    @property
    def text(self) -> str:
        return f"declared by {self.by}, {self.on.isoformat()}, {self.place}"


class LogDeclaration(Strict):
    """What a recording without our log can't show and a named person declares (METHOD 4.3)."""

    by: Words
    on: date
    safety_abort: bool = Field(description="true: there was one")
    identity_switch: bool = Field(description="true: there was one")
    site_changes: list[Words] = Field(description="what was changed on site; empty: nothing")


class ImportedStates(Strict):
    """Where the states on the objects' topics come from.

    The states themselves stand on ``<object>/state`` in the bag, frame map, on the recording's
    clock; everything that measures an event reads them there.
    """

    name: Words = Field(description="of the file, or of the bag")
    sha256: str = Field(pattern=r"^sha256:[0-9a-f]{64}$")
    vut: ObjectId
    objects: Annotated[dict[ObjectId, ObjectWord], Field(min_length=1, max_length=64)] = Field(
        description="class of every object target"
    )
    time_offset_s: Finite = Field(0.0, description="added to the source's times")
    notes: list[Words] = Field([], description="gaps, what was derived, frames and time bases")


class ImportedSite(Strict):
    """The road that is bound to a recording: topology comes from it (METHOD 4.3).

    The file itself is an attachment of the bag, whose bytes have this hash.
    """

    name: Words
    kind: Literal["site", "opendrive", "sumo"]
    attachment: Words
    sha256: str = Field(pattern=r"^sha256:[0-9a-f]{64}$")
    block: Words = Field(description="the stretch of road that the VUT drives on")
    road: Road
    road_type: Literal["urban", "rural", "motorway", "proving_ground", "unresolved"]
    left_boundary: Literal["kerb", "sidewalk", "shoulder", "verge", "unresolved"]
    right_boundary: Literal["kerb", "sidewalk", "shoulder", "verge", "unresolved"]


class ImportRecord(Strict):
    """``import.json``."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    schema_: Literal["ssp.import/1", "ssp.import/2"] = Field(SCHEMA, alias="schema")
    source: dict[str, object] = Field(description="name, sha256, kind; of a video its format")
    crop: dict[str, object] = Field(description="start_s and end_s on the source's clock")
    generator: str
    domain: DomainWord
    scenario: Annotated[str, Field(pattern=SAFE_NAME)] | None
    event_version: str | None
    ego: ImportedEgo
    camera: ImportedCamera
    declaration: DomainDeclaration | None = None
    log: LogDeclaration | None = None
    states: ImportedStates | None = None
    site: ImportedSite | None = None

    @model_validator(mode="after")
    def _objects_are_apart(self) -> ImportRecord:
        if self.states is not None and self.states.vut in self.states.objects:
            raise ValueError(f"states: {self.states.vut} is the VUT and an object target")
        return self

    @property
    def source_name(self) -> str:
        return str(self.source.get("name"))

    @property
    def source_sha256(self) -> str | None:
        """Hash of the file that was imported."""
        found = self.source.get("sha256")
        return found if isinstance(found, str) else None
