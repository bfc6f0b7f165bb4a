"""The log L: who changed or decided what, when and why; one JSON object a line, only appended."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, ConfigDict, Field

from ssp_core.run_file.values import Strict

LOG_FILE = "log.jsonl"

Kind = Literal[
    "source",  # hash, generator, original version and crop of the source clip
    "gate",  # a source clip that was refused, with one of the gate's reasons
    "extraction",  # a candidate was made: model, prompts, answers
    "edit",  # a field of the event was changed
    "accept",  # a field was accepted as it is
    "choice",  # a person chose between tied blocks
    "tuning",  # the compiler chose or changed a value within part C
    "shortlist",  # the event was a candidate for the track, in a list of the two virtual stages
    "validation",  # a simulation run validated the anchors
    "site_change",  # something was changed on site
    "disclosure",  # a difference between domains that is allowed and must be known
    "observation",  # a person looked at a recording, and what he saw was sealed
    "label_review",  # a person confirmed or edited proposed labels
]


def _utc(text: str) -> str:
    try:
        when = datetime.fromisoformat(text)
    except ValueError:
        when = None
    if when is None or when.utcoffset() != timedelta(0):
        raise ValueError("must be a time in ISO 8601 and UTC, such as 2025-03-01T09:30:00Z")
    return text


Text = Annotated[str, Field(min_length=1)]


class Record(Strict):
    """One entry of L.

    ``field``, ``old`` and ``new`` are null where nothing was changed. ``when`` is ISO 8601 UTC.
    """

    schema_: Literal["ssp.log/1"] = Field("ssp.log/1", alias="schema")
    kind: Kind
    when: Annotated[str, AfterValidator(_utc)]
    who: Text
    subject: Text = Field(description="what it is about: event, task, site or recording, by name")
    version: str | None = Field(None, description="content hash of the subject before the entry")
    field: str | None = None
    old: Any = None
    new: Any = None
    reason: Text
    details: dict[str, Any] = Field(default_factory=dict)

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)
