"""Every number that scoring compares with (METHOD 6.11), and the file that changes them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_type_hints, overload

import click
from pydantic import Field, create_model

from ssp_core.errors import InputError
from ssp_core.files.reading import load_model
from ssp_core.hashing import sha256_json
from ssp_core.run_file.values import NonNegative, Positive, Strict
from ssp_vla_bridge.trajectory import SUPPORT_END_S, TOLERANCE_S

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


Credit = Annotated[NonNegative, Field(le=1)]


@dataclass(frozen=True)
class Thresholds:
    """The thresholds and weights of METHOD 5.4 and 6.

    Args:
        tolerance: added to every inclusive comparison and to the equality of matching errors
            (6.11), in the unit of what is compared.
        match_window_s: largest distance of a matched record from its label (6.1).
        soft_credit: score of an adjacent class in the soft semantics (6.3).
        support_end_s: end of the interval that a trajectory must cover (5.4); it is sampled at
            its start, middle and end (6.6).
        stop_speed_mps: at or below it the trajectory stops (6.6).
        accel_mps2: size of an acceleration that counts as accelerate or decelerate (6.6).
        lateral_shift_m: size of a shift that counts as left or right (6.6).
        max_backward_m: how far a feasible step may go backwards (6.6).
        max_speed_mps: largest feasible speed of a step (6.6).
        max_lateral_speed_mps: largest feasible lateral speed (6.6).
        max_accel_mps2: largest feasible size of the acceleration (6.6).
        response_count: K of 6.9, how many consecutive defensive candidates make a response.
        response_gap_s: largest gap between two of them (6.9).
        weight_jovr, weight_sem_acc_eff, weight_cia_eff, weight_tqsr, weight_rsr: of IVCS (6.10).
    """

    tolerance: NonNegative = TOLERANCE_S
    match_window_s: NonNegative = 0.11
    soft_credit: Credit = 0.5
    support_end_s: Positive = SUPPORT_END_S
    stop_speed_mps: NonNegative = 0.5
    accel_mps2: Positive = 0.5
    lateral_shift_m: Positive = 0.3
    max_backward_m: NonNegative = 0.2
    max_speed_mps: Positive = 25.0
    max_lateral_speed_mps: Positive = 5.0
    max_accel_mps2: Positive = 8.0
    response_count: Annotated[int, Field(ge=1)] = 2
    response_gap_s: Positive = 0.6
    weight_jovr: float = 0.10
    weight_sem_acc_eff: float = 0.30
    weight_cia_eff: float = 0.20
    weight_tqsr: float = 0.30
    weight_rsr: float = 0.10

    @property
    def sha256(self) -> str:
        """``sha256:<hex>`` over all names and values; it is part of every result (METHOD 6.11)."""
        return _sha256(self)

    @overload
    def at_most(self, value: float, limit: float) -> bool: ...
    @overload
    def at_most(self, value: NDArray[np.float64], limit: float) -> NDArray[np.bool_]: ...
    def at_most(self, value: float | NDArray[np.float64], limit: float) -> bool | NDArray[np.bool_]:
        """Tell whether value ≤ limit with the tolerance of METHOD 6.11; False for NaN."""
        return value <= limit + self.tolerance

    @overload
    def at_least(self, value: float, limit: float) -> bool: ...
    @overload
    def at_least(
        self, value: NDArray[np.float64], limit: float | NDArray[np.float64]
    ) -> NDArray[np.bool_]: ...
    def at_least(
        self, value: float | NDArray[np.float64], limit: float | NDArray[np.float64]
    ) -> bool | NDArray[np.bool_]:
        """Tell whether value ≥ limit with the tolerance of METHOD 6.11; False for NaN."""
        return value >= limit - self.tolerance


@lru_cache(maxsize=64)
def _sha256(thresholds: Thresholds) -> str:
    return sha256_json(asdict(thresholds))


DEFAULT = Thresholds()
# METHOD's are below a hundred.
_LARGEST = 10_000


WEIGHTS = "weight_"
OTHER_THRESHOLDS = "scored with other thresholds than METHOD's"

thresholds_option = click.option(
    "--thresholds",
    "thresholds_file",
    type=click.Path(path_type=Path),
    metavar="FILE.yaml",
    help="Thresholds, K and tolerance of the scorer (ssp.thresholds/1) in place of METHOD's.",
)


class _File(Strict):
    schema_: Literal["ssp.thresholds/1"] = Field(alias="schema")


_GIVEN: dict[str, Any] = {
    name: (kind | None, None)
    for name, kind in get_type_hints(Thresholds, include_extras=True).items()
    if not name.startswith(WEIGHTS)
}
KEYS = tuple(_GIVEN)
# ``ssp.thresholds/1``: what isn't given stays as METHOD has it; see Thresholds for each.
ThresholdsFile = create_model("ThresholdsFile", __base__=_File, **_GIVEN)


def load_thresholds(path: Path | None) -> Thresholds:
    """Return the thresholds of a YAML or JSON file; METHOD's where there is none.

    Raises:
        InputError: it can't be read, a key is unknown, or a value is no such number.
    """
    if path is None:
        return DEFAULT
    try:
        thresholds = load_model(ThresholdsFile, path)
    except InputError as error:
        raise error.each(_of_thresholds) from error
    overrides = thresholds.model_dump(exclude_none=True, exclude={"schema_"})
    return replace(DEFAULT, **overrides)


def _of_thresholds(error: InputError) -> InputError:
    """Return the refusal of a thresholds file, of a key that is none in its own words."""
    if error.field is None or error.field in ("schema", *KEYS):
        return error
    remedy = error.remedy
    if error.field.startswith(WEIGHTS):
        remedy = "the weights of IVCS are METHOD 6.10's; `ssp report --tables` tries others"
    return InputError("is no threshold", file=error.file, field=error.field, remedy=remedy)


def thresholds_of(values: Any, file: str | Path) -> Thresholds:
    """Return the thresholds that a result names, all of them.

    Raises:
        InputError: they aren't those that this version knows, or one is no number.
    """
    if not isinstance(values, Mapping) or any(type(v) not in (int, float) for v in values.values()):
        raise InputError(
            "must be numbers by name",
            file=file,
            field="thresholds",
            remedy="put the file back, or evaluate the cell again",
        )
    if values.keys() != asdict(DEFAULT).keys():
        apart = sorted(values.keys() ^ asdict(DEFAULT).keys())
        raise InputError(
            "names other thresholds than this version has",
            file=file,
            field="thresholds",
            value=", ".join(apart),
            remedy="evaluate it again; stored answers aren't asked again",
        )
    for name, default in asdict(DEFAULT).items():
        number = values[name]
        is_whole = isinstance(number, int) or not isinstance(default, int)
        if not is_whole or not abs(number) <= _LARGEST:
            raise InputError(
                "is no such number",
                file=file,
                field=f"thresholds.{name}",
                value=number,
                remedy="put the file back, or evaluate the cell again",
            )
    return Thresholds(**values)


def changes(thresholds: Thresholds) -> str:
    """Describe the departures from METHOD: ``response_count 3 (METHOD: 2)``; empty without any."""
    before, now = asdict(DEFAULT), asdict(thresholds)
    return ", ".join(
        f"{name} {now[name]:g} (METHOD: {before[name]:g})"
        for name in before
        if before[name] != now[name]
    )
