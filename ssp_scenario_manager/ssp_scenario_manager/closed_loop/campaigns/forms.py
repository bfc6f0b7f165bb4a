"""The forms of a campaign's sealed files, held before a hash of them is asked."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field

from ssp_core.errors import InputError
from ssp_core.files.reading import parse_model, read_json_mapping
from ssp_core.run_file.latency import LatencyField
from ssp_core.run_file.values import Finite, NonNegative, Positive, Strict
from ssp_scenario_manager.closed_loop.outcomes.rates import KINDS

# A thousand starts of each of a few events.
_MOST_BYTES = 1 << 30
_REMEDY = "name a folder that `ssp loop` wrote"
Count = Annotated[int, Field(ge=0, lt=2**63)]
Text = Annotated[str, Field(max_length=500)]


class SealedDraw(Strict):
    """The counts of an event's seeds by what they gave."""

    event: str
    first_seed: Count
    critical: Count
    harmless: Count
    unavoidable: Count
    off_spec: Count
    short_run_up: Count
    left_out: list[str]


class StartTimes(Strict):
    """The times of a start, and its speed at the contact of its twin."""

    hand_over_s: NonNegative
    first_request_s: NonNegative
    observable_s: NonNegative
    end_s: Positive
    frame_period_s: Positive
    triggers_s: list[Finite]
    contact_s: NonNegative | None
    v_r_mps: Finite | None


class SealedStart(StartTimes):
    """A start; its run and its camera are read as such where the start is driven."""

    event: str
    kind: Literal[KINDS]  # type: ignore[valid-type]  # words of a tuple
    seed: Count
    hash: str
    values: dict[str, Finite]
    left_out: list[str]
    run: dict[str, Any]
    camera: dict[str, Any] | None


class SealedStarts(Strict):
    """The sealed part of ``starts.json``."""

    starts: list[SealedStart]
    drawn: list[SealedDraw]


class _CardPart(Strict):
    """The part of a card that is read; the card's hash holds all of it."""

    model_config = ConfigDict(extra="ignore", frozen=True)


class CardLatency(_CardPart):
    """A latency that a driver is driven under."""

    given: LatencyField
    p50_s: NonNegative | None
    p99_s: NonNegative | None
    contains: Text


class Hardware(Strict):
    """The machine of a campaign, which its cards' hashes hold only where a latency is measured."""

    machine: Text = ""
    processor: Text = ""
    system: Text = ""
    cores: Count | None = None


class Card(_CardPart):
    """A driver with the conditions that it drove under."""

    driver: Text
    kind: Text
    hash: Text
    privileged: bool
    options: dict[str, Any]
    latencies: Annotated[list[CardLatency], Field(min_length=1)]
    history_s: NonNegative | None
    route_m: NonNegative | None
    step_s: Positive
    frame_period_s: Positive
    d_max_mps2: Positive
    starts: Count
    repeats: Count
    seed: Count
    versions: dict[Text, Text]
    # Neither is under the card's hash; cards of an earlier version have no compiled core.
    hardware: Hardware
    compiled_core: Annotated[str, Field(pattern="^[0-9a-f]{64}$")] | None = None


class SealedCards(_CardPart):
    """``ssp.loop_cards/1``."""

    schema_: Literal["ssp.loop_cards/1"] = Field(alias="schema")
    cards: list[Card]


def read_sealed(path: Path) -> dict[str, Any]:
    """Return the content of a JSON file of a campaign.

    Raises:
        InputError: it can't be read, is no JSON or has a NaN, or holds no object.
    """
    try:
        return read_json_mapping(path, _MOST_BYTES)
    except InputError as error:
        raise InputError(error.problem, file=path, value=error.value, remedy=_REMEDY) from error


def check_form(form: type[Strict], value: Any, file: Path) -> None:
    """Hold a content against its form.

    Raises:
        InputError: it isn't of this form; all that is wrong.
    """
    parse_model(form, value, file)
