"""``ssp.shortlist/1``: which events go on to the track, and why; made by `ssp shortlist`.

It stands here because the compiler reads what the evaluation writes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from ssp_core.errors import InputError
from ssp_core.files.reading import load_model
from ssp_core.run_file.values import Finite, Strict

SHORTLIST_SCHEMA: Literal["ssp.shortlist/1"] = "ssp.shortlist/1"
SHORTLIST_FILE = "shortlist.json"

Share = Annotated[Finite, Field(ge=0, le=1)]
Hash = Annotated[str, Field(pattern=r"^sha256:[0-9a-f]{64}$")]


class Limits(Strict):
    """The limits from which a finding makes an event a candidate, each a share of 1."""

    no_response: Share
    turned: Share
    width: Share
    most: Annotated[int, Field(ge=1)]


class ListedEvent(Strict):
    """One event that both stages evaluated."""

    scenario: str
    event_version: str
    rank: Annotated[int, Field(ge=1)] | None = Field(description="null: it is no candidate")
    priority: Share = Field(description="mean of the three shares")
    no_response: Share = Field(description="of the cells, those with RSR = 0 (METHOD 6.9)")
    turned: Share = Field(description="of the pairs of models, those whose order by IVCS turns")
    width: Share = Field(description="mean width of the cells' 95 % intervals of IVCS over labels")
    ranks: dict[str, tuple[int, int]] = Field(description="by model, synthetic then simulation")
    first_failures: dict[str, tuple[int, int]] = Field(
        description="by stage of METHOD 6.12, label times in synthetic and in simulation"
    )
    reasons: list[str]
    cells: list[Hash] = Field(description="of each cell.json that this rests on")


class LeftOut(Strict):
    """A scenario that can't be compared between the two stages."""

    scenario: str
    why: str


class Shortlist(Strict):
    """The file."""

    schema_: Literal["ssp.shortlist/1"] = Field(SHORTLIST_SCHEMA, alias="schema")
    software: str
    limits: Limits
    models: list[str]
    events: list[ListedEvent]
    left_out: list[LeftOut]
    notes: list[str]

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)


def load_candidate(path: Path, name: str, version: str) -> ListedEvent:
    """Return the entry of an event that a shortlist holds as a candidate.

    Args:
        path: of the shortlist.
        name: of the scenario, for the error.
        version: content hash of its K*.

    Raises:
        InputError: the file is none, or the event in this version is no candidate of it.
    """
    shortlist = load_model(Shortlist, path)
    entry = next((one for one in shortlist.events if one.event_version == version), None)
    if entry is not None and entry.rank is not None:
        return entry
    candidates = [one.scenario for one in shortlist.events if one.rank is not None]
    others = [one.event_version for one in shortlist.events if one.scenario == name]
    why = "is not on the shortlist"
    if entry is not None:
        why = "is on the shortlist and no candidate"
    elif others:
        why = f"is on the shortlist in another version, {', '.join(others)}"
    raise InputError(
        why,
        file=path,
        field="events",
        value=f"{name} {version}",
        remedy=f"candidates are {', '.join(candidates) or 'none'}; evaluate this version in both "
        "stages and make the list anew, or compile without --shortlist",
    )
