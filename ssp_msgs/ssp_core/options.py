"""The additions to click for command-line options."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager

import click

from ssp_core.decimals import decimal, whole_number
from ssp_core.errors import InputError
from ssp_core.vocabulary import DOMAINS_READ, DomainWord, read_domain


@contextmanager
def usage_errors() -> Iterator[None]:
    """Make wrong usage, exit status 2, of values that have no sense whatever they are for."""
    try:
        yield
    except InputError as error:
        raise click.UsageError(str(error)) from error


class Number(click.ParamType[float]):
    """A finite number within limits; click's own range lets nan through."""

    name = "number"

    def __init__(
        self, low: float = -math.inf, high: float = math.inf, low_open: bool = False
    ) -> None:
        self._low, self._high, self._low_open = low, high, low_open

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        try:
            number = decimal(str(value))
        except ValueError:
            number = math.nan
        too_low = number <= self._low if self._low_open else number < self._low
        if not math.isfinite(number) or too_low or number > self._high:
            limits = f"{'above' if self._low_open else 'from'} {self._low:g}"
            limits += f" up to {self._high:g}" if math.isfinite(self._high) else ""
            self.fail(f"{value!r} is no number {limits}", param, ctx)
        return number


class WholeNumber(click.IntRange):
    """A whole number within limits, in digits; click's own range takes `1_000`."""

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> int:
        if isinstance(value, str):
            try:
                value = whole_number(value)
            except ValueError as error:
                self.fail(str(error), param, ctx)
        return super().convert(value, param, ctx)  # type: ignore[arg-type]  # it takes all


class Domain(click.ParamType[DomainWord]):
    """A domain of METHOD 5.2 by its word, or by Syn, Sim or Phy, in any case."""

    name = "domain"

    def convert(
        self, value: str, param: click.Parameter | None, ctx: click.Context | None
    ) -> DomainWord:
        word = read_domain(value)
        if word is None:
            self.fail(f"{value!r} is no domain; known: {DOMAINS_READ}", param, ctx)
        return word
