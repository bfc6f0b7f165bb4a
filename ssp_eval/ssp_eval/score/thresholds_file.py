"""Thresholds of the scorer from a file, and in words where they aren't METHOD's.

METHOD 6.11 keeps them in one object whose hash is in every result. The weights of IVCS (METHOD
6.10) are none of them: what others would give is a table of ``ssp report --tables``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import click
from pydantic import Field, field_validator

from ssp_core.errors import InputError
from ssp_core.files import load_model
from ssp_core.run_file.values import NonNegative, Positive, Strict
from ssp_eval.score.thresholds import DEFAULT, Thresholds

WEIGHTS = "weight_"
OTHER_THRESHOLDS = "scored with other thresholds than METHOD's"

thresholds_option = click.option(
    "--thresholds",
    "thresholds_file",
    type=click.Path(path_type=Path),
    metavar="FILE.yaml",
    help="Thresholds, K and tolerance of the scorer (ssp.thresholds/1) in place of METHOD's.",
)


class ThresholdsFile(Strict):
    """``ssp.thresholds/1``: what isn't given stays as METHOD has it; see Thresholds for each."""

    schema_: Literal["ssp.thresholds/1"] = Field(alias="schema")
    tolerance: NonNegative | None = None
    match_window_s: NonNegative | None = None
    soft_credit: Annotated[NonNegative, Field(le=1)] | None = None
    support_end_s: Positive | None = None
    stop_speed_mps: NonNegative | None = None
    accel_mps2: Positive | None = None
    lateral_shift_m: Positive | None = None
    max_backward_m: NonNegative | None = None
    max_speed_mps: Positive | None = None
    max_lateral_speed_mps: Positive | None = None
    max_accel_mps2: Positive | None = None
    response_count: Annotated[int, Field(ge=1)] | None = None
    response_gap_s: Positive | None = None

    @field_validator("*", mode="before")
    @classmethod
    def _is_no_boolean(cls, value: object) -> object:
        if isinstance(value, bool):
            raise ValueError("is a boolean and no number")
        return value


KEYS = tuple(name for name in ThresholdsFile.model_fields if name != "schema_")


def load_thresholds(path: Path | None) -> Thresholds:
    """The thresholds of a YAML or JSON file; METHOD's where there is none.

    Raises:
        InputError: it can't be read, a key is unknown, or a value is no such number.
    """
    if path is None:
        return DEFAULT
    try:
        found = load_model(ThresholdsFile, path)
    except InputError as error:
        if error.field is None or error.field in ("schema", *KEYS):
            raise
        remedy = f"known are {', '.join(KEYS)}"
        if error.field.startswith(WEIGHTS):
            remedy = "the weights of IVCS are METHOD 6.10's; `ssp report --tables` tries others"
        raise InputError("is no threshold", file=path, field=error.field, remedy=remedy) from error
    given = found.model_dump(exclude_none=True, exclude={"schema_"})
    return replace(DEFAULT, **given)


def thresholds_of(values: Any, file: str | Path) -> Thresholds:
    """The thresholds that a result names, all of them.

    Raises:
        InputError: they aren't those that this version knows, or one is no number.
    """
    if not isinstance(values, Mapping) or any(type(v) not in (int, float) for v in values.values()):
        raise InputError("must be numbers by name", file=file, field="thresholds")
    if values.keys() != asdict(DEFAULT).keys():
        apart = sorted(values.keys() ^ asdict(DEFAULT).keys())
        raise InputError(
            "names other thresholds than this version has", file=file, field="thresholds",
            value=", ".join(apart), remedy="evaluate it again; stored answers aren't asked again",
        )  # fmt: skip
    return Thresholds(**values)


def changes(thresholds: Thresholds) -> str:
    """What isn't as METHOD has it: ``response_count 3 (METHOD: 2)``; empty where all is."""
    before, now = asdict(DEFAULT), asdict(thresholds)
    return ", ".join(
        f"{name} {now[name]:g} (METHOD: {before[name]:g})"
        for name in before
        if before[name] != now[name]
    )
