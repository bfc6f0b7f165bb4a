"""``score.json``: a cell's score (METHOD 6.14), held against its form before it is compared."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import ConfigDict, Field

from ssp_core.errors import InputError
from ssp_core.files.reading import parse_model, read_json_mapping
from ssp_core.run_file.values import NonNegative, Strict

Count = Annotated[int, Field(ge=0, lt=2**63)]
Share = Annotated[float, Field(ge=0, le=1)]
_REMEDY = "give `ssp evaluate` the same command again, nothing that is stored is asked again"


class _Part(Strict):
    """No value is made to fit: ``"0.5"`` is no share."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class Denominators(_Part):
    """The counts that the ratios with few terms are divided by."""

    semantic: Count
    cia: Count


class ScoreFile(_Part):
    """The score output of METHOD 6.14; a metric is null where its denominator is 0."""

    n: Count
    matched: Count
    jovr: Share | None
    sem_cov: Share | None
    sem_acc_cond: Share | None
    sem_acc_eff: Share | None
    sem_acc_soft: Share | None
    cia_eff: Share | None
    act_acc_eff: Share | None
    stfr: Share | None
    tqsr: Share | None
    atc_eff: Share | None
    rsr: Annotated[int, Field(ge=0, le=1)]
    rl_s: NonNegative | None
    # A sum of rounded weights: above 1 by its last bit where each part is 1.
    ivcs: NonNegative | None
    denominators: Denominators


def load_score(file: Path) -> dict[str, Any]:
    """Read a score.json.

    Raises:
        InputError: it is no JSON or has a NaN, or a field is missing, unknown or wrong.
    """
    try:
        return check_score(read_json_mapping(file), file)
    except InputError as error:
        if error.remedy is not None or error.parts:
            raise
        raise InputError(
            error.problem, file=file, field=error.field, value=error.value, remedy=_REMEDY
        ) from error


def check_score(value: dict[str, Any], file: str | Path) -> dict[str, Any]:
    """Return the content of a score.json.

    Args:
        value: the content.
        file: that an error names.

    Raises:
        InputError: a field is missing, unknown or wrong.
    """
    parse_model(ScoreFile, value, file)
    return value
