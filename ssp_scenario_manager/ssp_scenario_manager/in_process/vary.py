"""What a sweep varies: ``FIELD=VALUES``, fields of the run file by dotted path."""

from __future__ import annotations

import difflib
import itertools
import re
import zlib
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from ssp_core.errors import InputError
from ssp_core.files import parse_model
from ssp_core.run_file.model import RunSpec

OPTION = "--vary"
# A run has one of each; what a sweep is of must stay the same over its rows.
_FIXED = ("schema", "run_id", "seed", "mode", "camera", "look")
_WORDS = {"true": True, "false": False, "null": None}


@dataclass(frozen=True, slots=True)
class Choice:
    """These values in turn."""

    field: str
    values: tuple[Any, ...]

    def __str__(self) -> str:
        return f"{self.field}={','.join(map(_word, self.values))}"


@dataclass(frozen=True, slots=True)
class Span:
    """A number between two bounds, drawn evenly for each run."""

    field: str
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.field}={self.low}:{self.high}"

    @property
    def ends(self) -> tuple[float, float]:
        return self.low, self.high

    def draw(self, seed: int, run: int) -> float:
        """The value of one run: a function of seed, field and run alone."""
        random = np.random.default_rng([seed, zlib.crc32(self.field.encode()), run])
        return self.low + (self.high - self.low) * float(random.random())


Variation = Choice | Span


def parse_variation(text: str) -> Variation:
    """``driver.cruise_mps=11:15`` (evenly between), or ``disturbance.reorder=0,0.1`` (in turn).

    Raises:
        InputError: no such form, or bounds that are no rising numbers.
    """
    field, equals, values = text.partition("=")
    field = field.strip()
    if not (equals and field and values.strip()):
        raise InputError(
            "is no FIELD=VALUES",
            field=OPTION,
            value=text,
            remedy="give one such as driver.cruise_mps=11:15 or disturbance.reorder=0,0.1",
        )
    if ":" in values:
        low, high = (_scalar(part, text) for part in _bounds(values, text))
        if not (_is_number(low) and _is_number(high) and low < high):
            raise InputError(
                "needs a lower and an upper bound", field=OPTION, value=text, remedy="such as 11:15"
            )
        return Span(field, float(low), float(high))
    return Choice(field, tuple(_scalar(part, text) for part in values.split(",")))


def _bounds(values: str, text: str) -> list[str]:
    parts = values.split(":")
    if len(parts) != 2:
        raise InputError(
            "has more than two bounds", field=OPTION, value=text, remedy="such as 11:15"
        )
    return parts


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _scalar(part: str, text: str) -> Any:
    """A number, true, false, null, or a word."""
    word = part.strip()
    if word in _WORDS:
        return _WORDS[word]
    for kind in (int, float):
        with suppress(ValueError):
            return kind(word)
    if not re.fullmatch(r"[\w.+/-]+", word):
        raise InputError(
            f"{word!r} is no number or word", field=OPTION, value=text, remedy="such as 0.05"
        )
    return word


def _word(value: Any) -> str:
    """As ``_scalar`` reads it."""
    return next((word for word, known in _WORDS.items() if known is value), str(value))


def grid(variations: Sequence[Variation]) -> list[dict[str, Any]]:
    """Every combination of the values that are taken in turn; the last one changes fastest."""
    choices = [v for v in variations if isinstance(v, Choice)]
    return [
        {choice.field: value for choice, value in zip(choices, values, strict=True)}
        for values in itertools.product(*(choice.values for choice in choices))
    ]


def values_of(variations: Sequence[Variation], seed: int, run: int) -> dict[str, Any]:
    """What one run has for each varied field, in the order in which they were given.

    Args:
        variations: of the sweep.
        seed: of the sweep.
        run: number of the run, from 0.
    """
    cells = grid(variations)
    cell = cells[run % len(cells)]
    return {
        v.field: v.draw(seed, run) if isinstance(v, Span) else cell[v.field] for v in variations
    }


class Variable:
    """A run of which single fields can be given other values.

    Args:
        spec: the run.
    """

    def __init__(self, spec: RunSpec) -> None:
        self._spec = spec
        self._data = spec.model_dump(mode="json", by_alias=True)

    def with_values(self, values: dict[str, Any], seed: int) -> RunSpec:
        """The run with these values.

        Args:
            values: by dotted path, such as ``driver.cruise_mps`` or ``triggers.0.lead_time_s``.
            seed: of the run.

        Raises:
            InputError: no such field, naming those that are near; or no valid value of it.
        """
        data: dict[str, Any] = {**self._data, "seed": seed}
        for field, value in values.items():
            data = _replaced(data, field.split("."), value, lambda f=field: self._unknown(f))
        shown = ", ".join(f"{field}={value}" for field, value in values.items())
        return parse_model(RunSpec, data, f"the run with {shown}" if shown else "the run")

    def check(self, variations: Sequence[Variation]) -> None:
        """Refuses what can't be varied, before the first run of a sweep.

        Raises:
            InputError: as ``with_values``, or a field that is given twice or belongs to the sweep.
        """
        seen: set[str] = set()
        for variation in variations:
            field = variation.field
            if field in seen:
                raise InputError(
                    "is varied twice", field=OPTION, value=field, remedy="merge the two"
                )
            if field.split(".")[0] in _FIXED:
                raise InputError(
                    "can't be varied: it is the same over a sweep, or the sweep's own",
                    field=OPTION,
                    value=field,
                )
            seen.add(field)
            ends: tuple[Any, ...]
            ends = variation.values if isinstance(variation, Choice) else variation.ends
            for value in ends:
                self.with_values({field: value}, self._spec.seed)

    def _unknown(self, field: str) -> InputError:
        known = list(_leaves(self._data))
        last = field.split(".")[-1]
        near = [f for f in known if f.split(".")[-1] == last]
        near += [f for f in difflib.get_close_matches(field, known, 4, 0.6) if f not in near]
        remedy = f"did you mean {', '.join(near[:4])}?" if near else "see run.yaml of any run"
        return InputError("is no single field of a run", field=OPTION, value=field, remedy=remedy)


def _leaves(value: Any, path: str = "") -> Iterator[str]:
    """Dotted paths of all single values."""
    if isinstance(value, dict):
        items: Iterator[tuple[Any, Any]] = iter(value.items())
    elif isinstance(value, list):
        items = enumerate(value)
    else:
        yield path
        return
    for key, inner in items:
        yield from _leaves(inner, f"{path}.{key}" if path else str(key))


def _replaced(value: Any, path: Sequence[str], new: Any, unknown: Any) -> Any:
    """The value with a single one in it replaced; everything on the way is copied."""
    if not path:
        if isinstance(value, dict | list):
            raise unknown()
        return new
    key = path[0]
    if isinstance(value, dict) and key in value:
        return {**value, key: _replaced(value[key], path[1:], new, unknown)}
    if isinstance(value, list) and key.isdecimal() and int(key) < len(value):
        copy = list(value)
        copy[int(key)] = _replaced(value[int(key)], path[1:], new, unknown)
        return copy
    raise unknown()
