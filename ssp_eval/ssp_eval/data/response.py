"""The block ``response`` of ``ssp.audit/2``: did the VUT respond alike? (docs/audit.md)."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from ssp_core.run_file.quantities import of_unit
from ssp_core.run_file.values import Finite, NonNegative, Positive, Strict
from ssp_core.vocabulary import DomainWord

Share = Annotated[float, Field(ge=0, le=1)]
Figure = Literal["ttc_at_braking", "remaining_distance", "impact_speed"]
Grade = Literal["excellent", "good", "fair", "poor"]
ResponseVerdict = Literal["alike", "unlike", "not assessable"]


class Limit(Strict):
    """The largest difference of two responses in one respect.

    It has its origin, and the person who checked it against its source.
    """

    limit: NonNegative
    unit: str
    source: Annotated[str, Field(min_length=1)]
    checked_by: Annotated[str, Field(min_length=1)] | None = Field(
        description="who read the source, and when; null: not checked"
    )

    @model_validator(mode="after")
    def _is_within_its_unit(self) -> Limit:
        of_unit(self.unit).within(self.limit)
        return self


class ResponseLimits(Strict):
    """The limits within which two responses are alike.

    The rating is a lower limit, the others upper limits of an absolute difference.
    """

    schema_: Literal["ssp.response_limits/1"] = Field(alias="schema")
    rating: Limit
    ttc_at_braking: Limit
    remaining_distance: Limit
    impact_speed: Limit

    @field_validator("rating")
    @classmethod
    def _is_a_share(cls, rating: Limit) -> Limit:
        if rating.limit > 1.0:
            raise ValueError("a rating is from 0 to 1")
        return rating


class RatingEntry(Strict):
    """A rating by ISO/TS 18571 with its four parts and its grade on the TS's scale."""

    overall: Share
    corridor: Share
    phase: Share
    magnitude: Share
    slope: Share
    grade: Grade


class FigureEntry(Strict):
    """A key figure of both recordings; null where it doesn't exist, as a TTC while not closing."""

    name: Figure
    unit: str
    reference: Finite | None
    comparison: Finite | None
    difference: Finite | None = Field(description="comparison minus reference")
    limit: NonNegative
    within: bool | None = Field(description="null: neither recording has it")


class CauseEntry(Strict):
    """A possible explanation of a difference, in the comparison against the reference."""

    name: Literal["delay", "gain", "initial_speed", "initial_gap"]
    value: Finite | None
    unit: str
    notable: bool
    text: str


class PairEntry(Strict):
    """One pair of recordings, with its verdict.

    ``rating`` is aligned at the braking, ``on_common_clock`` at the trigger, and ``without_gain``
    is aligned with the comparison divided by its gain.
    """

    reference: DomainWord
    comparison: DomainWord
    verdict: ResponseVerdict
    why: list[str]
    rating: RatingEntry | None = None
    braking_s: tuple[Finite, Finite] | None = Field(
        None, description="clip times at which the two were aligned; null in audits of before"
    )
    on_common_clock: RatingEntry | None = None
    without_gain: RatingEntry | None = None
    figures: list[FigureEntry] = []
    causes: list[CauseEntry] = []


class CurveEntry(Strict):
    """The VUT's longitudinal acceleration from 0.2 s before its braking on, as it was rated."""

    trigger_s: Finite = Field(description="clip time")
    braking_s: Finite = Field(description="clip time at which the braking begins")
    from_s: Finite = Field(description="of the first sample, from the braking on")
    step_s: Positive
    acceleration_mps2: list[Finite]


class ResponseEntry(Strict):
    """Second verdict of an audit: it qualifies no event and scores no model."""

    limits: ResponseLimits
    curves: dict[DomainWord, CurveEntry]
    pairs: list[PairEntry]
