"""States of a whole recording in arrays: an hour of two objects at 50 Hz takes 50 MB, not 500.

Rows are made of the arrays when they are asked for, and compare equal to what was put in.
"""

from __future__ import annotations

from array import array
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields
from operator import attrgetter, itemgetter
from typing import Any, Generic, TypeVar, cast, get_type_hints, overload

from ssp_core.motion.state import ObjectState

Row = TypeVar("Row")
_SMALL = range(-(2**63), 2**63)
States = Mapping[str, ObjectState]
Series = Sequence[tuple[float, States]]


class Packed(Sequence[Row], Generic[Row]):
    """Rows of a dataclass: its floats and whole numbers in arrays, and what else repeats once.

    Args:
        kind: a dataclass whose fields are floats, whole numbers, or hashable.
    """

    def __init__(self, kind: type[Row], rows: Iterable[Row] = ()) -> None:
        hints = get_type_hints(kind)
        names = [field.name for field in fields(cast(Any, kind))]
        floats = [name for name in names if hints[name] is float]
        wholes = [name for name in names if hints[name] is int]
        others = [name for name in names if hints[name] not in (float, int)]
        # Two constants beside the names make attrgetter give a tuple for one name or none, too.
        self._get = [
            attrgetter("__class__", "__class__", *group) for group in (floats, wholes, others)
        ]
        order = [*floats, *wholes, *others]
        self._arguments = itemgetter(*(order.index(name) for name in names))
        self._kind: Any = kind
        self._widths = len(floats), len(wholes)
        self._floats, self._wholes = array("d"), array("q")
        self._large: dict[int, int] = {}
        self._others = array("L")
        self._tables: list[tuple[Any, ...]] = []
        self._table_numbers: dict[tuple[Any, ...], int] = {}
        for row in rows:
            self.append(row)

    def append(self, row: Row) -> None:
        """Put a row behind the others."""
        floats, wholes, others = (get(row)[2:] for get in self._get)
        self._floats.extend(floats)
        for whole in wholes:
            if whole not in _SMALL:  # nothing that counts or is a time; a damaged file may hold it
                self._large[len(self._wholes)], whole = whole, 0
            self._wholes.append(whole)
        number = self._table_numbers.get(others)
        if number is None:
            number = self._table_numbers[others] = len(self._tables)
            self._tables.append(others)
        self._others.append(number)

    def __len__(self) -> int:
        return len(self._others)

    @overload
    def __getitem__(self, at: int) -> Row: ...
    @overload
    def __getitem__(self, at: slice) -> list[Row]: ...
    def __getitem__(self, at: int | slice) -> Row | list[Row]:
        rows = range(len(self))[at]
        return [self._row(i) for i in rows] if isinstance(rows, range) else self._row(rows)

    def _row(self, i: int) -> Row:
        a, b = self._widths
        wholes: Sequence[int] = self._wholes[i * b : i * b + b]
        if self._large:
            wholes = [self._large.get(i * b + k, whole) for k, whole in enumerate(wholes)]
        values = (
            *self._floats[i * a : i * a + a],
            *wholes,
            *self._tables[self._others[i]],
        )
        row: Row = self._kind(*self._arguments(values))
        return row

    def __iter__(self) -> Iterator[Row]:
        return map(self._row, range(len(self)))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and list(self) == list(other)

    __hash__ = None  # type: ignore[assignment]  # it grows


class StateSeries(Sequence[tuple[float, States]]):
    """The states of all objects by id at rising times, s.

    A slice without a step shares the arrays.
    """

    def __init__(self, rows: Iterable[tuple[float, Iterable[ObjectState]]] = ()) -> None:
        self._times_s, self._ends = array("d"), array("q", [0])
        self._states = Packed(ObjectState)
        self._span: range | None = None  # None: all
        for t_s, states in rows:
            self.append(t_s, states)

    def append(self, t_s: float, states: Iterable[ObjectState]) -> None:
        """Put the states of a time behind the others; of one id the last counts."""
        for state in {state.object_id: state for state in states}.values():
            self._states.append(state)
        self._times_s.append(t_s)
        self._ends.append(len(self._states))

    def copied(self) -> StateSeries:
        """Copy a slice, so that the rest of the arrays can be given back."""
        return StateSeries((t_s, states.values()) for t_s, states in self)

    @property
    def _rows(self) -> range:
        return range(len(self._times_s)) if self._span is None else self._span

    @property
    def times_s(self) -> Sequence[float]:
        """The times."""
        rows = self._rows
        return self._times_s[rows.start : rows.stop]

    def __len__(self) -> int:
        return len(self._rows)

    @overload
    def __getitem__(self, at: int) -> tuple[float, States]: ...
    @overload
    def __getitem__(self, at: slice) -> StateSeries: ...
    def __getitem__(self, at: int | slice) -> tuple[float, States] | StateSeries:
        rows = self._rows[at]
        if isinstance(rows, range):
            if rows.step != 1:
                raise ValueError("a series is cut without a step")
            part = StateSeries()
            part._times_s, part._ends, part._states = self._times_s, self._ends, self._states
            part._span = rows
            return part
        states = self._states[self._ends[rows] : self._ends[rows + 1]]
        return self._times_s[rows], {state.object_id: state for state in states}

    def __iter__(self) -> Iterator[tuple[float, States]]:
        return (self[i] for i in range(len(self)))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and list(self) == list(other)

    __hash__ = None  # type: ignore[assignment]  # it grows


def times_of(series: Series) -> Sequence[float]:
    """Return the times of a series, s."""
    return series.times_s if isinstance(series, StateSeries) else [t_s for t_s, _ in series]


def between(series: Series, first_s: float, last_s: float) -> Series:
    """Return the rows from one time to another, both included."""
    times_s = times_of(series)
    return series[bisect_left(times_s, first_s) : bisect_right(times_s, last_s)]


def copied(series: Series, first_s: float, last_s: float) -> Series:
    """Return the rows from one time to another, both included, sharing nothing with the rest."""
    part = between(series, first_s, last_s)
    if isinstance(part, StateSeries) and len(part) < len(series):
        return part.copied()
    return part


def states_of(series: Series, object_id: str) -> Packed[ObjectState]:
    """Return the states of one object where it is there, in arrays."""
    return Packed(ObjectState, (now[object_id] for _, now in series if object_id in now))
