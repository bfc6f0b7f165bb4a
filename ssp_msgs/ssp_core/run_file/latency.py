"""The latency of a driver: fixed, or measured with its bound (METHOD 8.3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import BeforeValidator, PlainSerializer

from ssp_core.decimals import decimal
from ssp_core.errors import InputError

MOST_LATENCY_S = 10.0
# The bound of a measured latency where none is declared.
BOUND_S = 2.0


@dataclass(frozen=True, slots=True)
class Latency:
    """The L of a driven run: from a frame's stamp until its answer is effective.

    Its text is the form that ``parse_latency`` reads. Measured ones come last in an order.

    Args:
        seconds: L; where it is measured, its declared bound.
        measured: from the complete request to the parsed trajectory.
    """

    seconds: float
    measured: bool = False

    def __str__(self) -> str:
        if self.measured:
            return f"measured:{self.seconds:.10g}"
        return f"fixed:{self.seconds:.10g}" if self.seconds else "zero"

    def __lt__(self, other: Latency) -> bool:
        return (self.measured, self.seconds) < (other.measured, other.seconds)

    @property
    def words(self) -> str:
        """The latency in a sentence."""
        return "measured L" if self.measured else f"L = {self.seconds:g} s"

    @property
    def cell_text(self) -> str:
        """The latency in a table whose column names the unit, s."""
        return "measured" if self.measured else f"{self.seconds:g}"


ZERO_LATENCY = Latency(0.0)


def parse_latency(text: str) -> Latency:
    """Read ``zero``, ``fixed:S``, ``measured``, or ``measured:S`` with its bound.

    Raises:
        InputError: it is none of these, or out of range.
    """
    wrong = InputError(
        f"is no latency from 0 to {MOST_LATENCY_S:g} s",
        field="latency",
        value=text,
        remedy="give zero, or fixed:S with S in seconds, such as fixed:0.2, or measured, or "
        f"measured:S with the largest L to leave time for, without S {BOUND_S:g} s",
    )
    if text == "zero":
        return ZERO_LATENCY
    kind, _, seconds = text.partition(":")
    if text == "measured":
        seconds = str(BOUND_S)
    try:
        value = round(decimal(seconds), 9)
    except ValueError:
        raise wrong from None
    if kind not in ("fixed", "measured") or not 0.0 <= value <= MOST_LATENCY_S:
        raise wrong
    return Latency(value, measured=kind == "measured")


def _of_file(value: Any) -> Latency:
    if isinstance(value, Latency):
        return value
    try:
        return parse_latency(str(value))
    except InputError as error:
        raise ValueError(f"{error.problem}; {error.remedy}") from error


# A field of a file: its text there, the value here.
LatencyField = Annotated[Latency, BeforeValidator(_of_file), PlainSerializer(str)]
