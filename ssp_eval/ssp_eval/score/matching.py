"""Pairing labels with records (METHOD 6.1): an exact optimum, for one cell or for many at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ssp_eval.score.columns import NOTHING, Columns, Flags, Whole
from ssp_eval.score.thresholds import DEFAULT, Thresholds

# The records [first, end) that a label may be paired with.
Window = tuple[int, int]


class _Best(NamedTuple):
    """The best that the rest of the labels can reach with the rest of the records."""

    pairs: int
    error_s: float

    def better(self, other: _Best) -> _Best:
        """Return the one with more pairs, or of two with as many the one with the smaller error."""
        return min(self, other, key=lambda best: (-best.pairs, best.error_s))


class _Optima:
    """The optimum over labels j.. and records i.., for every (j, i) that a matching can reach.

    Only the records in a label's window can make a difference to it, so row j holds just those
    columns: the table is as large as all windows together, however long the recording.
    """

    def __init__(
        self, labels_s: Sequence[float], records_s: Sequence[float], windows: Sequence[Window]
    ) -> None:
        self._labels_s = labels_s
        self._records_s = records_s
        self.windows = windows
        self._rows: list[list[_Best]] = [[] for _ in labels_s]
        for j in reversed(range(len(labels_s))):
            first, end = self.windows[j]
            best = self.of(j + 1, end)
            row = [best]
            for i in reversed(range(first, end)):
                best = self.with_pair(j, i).better(best).better(self.of(j + 1, i))
                row.append(best)
            row.reverse()
            self._rows[j] = row

    def error_s(self, j: int, i: int) -> float:
        """Return |t_i − τ_j|."""
        return abs(self._records_s[i] - self._labels_s[j])

    def of(self, j: int, i: int) -> _Best:
        """Return the optimum of labels j.. with records i..; i ≤ the end of label j's window."""
        if j == len(self._labels_s):
            return _Best(0, 0.0)
        first = self.windows[j][0]
        return self._rows[j][max(i - first, 0)]

    def with_pair(self, j: int, i: int) -> _Best:
        """Return the optimum of labels j.. with records i.. that pairs label j with record i."""
        rest = self.of(j + 1, i + 1)
        return _Best(rest.pairs + 1, rest.error_s + self.error_s(j, i))


def _windows(labels_s: Sequence[float], records_s: Sequence[float], limit_s: float) -> list[Window]:
    """Find for each label the records (first, end) that are no further than limit_s from it."""
    count, first, end = len(records_s), 0, 0
    windows = []
    for label_s in labels_s:
        while first < count and records_s[first] - label_s < -limit_s:
            first += 1
        end = max(end, first)
        while end < count and records_s[end] - label_s <= limit_s:
            end += 1
        windows.append((first, end))
    return windows


def match(
    labels_s: Sequence[float], records_s: Sequence[float], thresholds: Thresholds = DEFAULT
) -> tuple[int | None, ...]:
    """Find for each label the index of its record, or None (METHOD 6.1).

    One to one, without crossings, |t_i − τ_j| ≤ 0.11 s; the most pairs, then the least total
    error; of equal solutions, label by label in time order the earliest record that still allows
    an equal one. Totals are equal when they exceed the least one by no more than the tolerance
    of METHOD 6.11.

    Args:
        labels_s: clip times, s, rising strictly.
        records_s: clip times, s, rising strictly.
        thresholds: for the window and the tolerance.
    """
    windows = _windows(labels_s, records_s, thresholds.match_window_s + thresholds.tolerance)
    optima = _Optima(labels_s, records_s, windows)
    result: list[int | None] = []
    start, spare_s = 0, thresholds.tolerance
    for j, (first, end) in enumerate(optima.windows):
        # Each choice is held against the best that is left, which one of them reaches exactly: a
        # sum from the start could round past the tolerance, and then no choice would be allowed.
        rest = optima.of(j, start)
        choice = None
        for i in range(max(start, first), end):
            with_pair = optima.with_pair(j, i)
            if with_pair.pairs == rest.pairs and with_pair.error_s - rest.error_s <= spare_s:
                spare_s -= with_pair.error_s - rest.error_s
                choice, start = i, i + 1
                break
        result.append(choice)
    return tuple(result)


# So many distances are held at a time.
_TABLE = 1 << 20


def match_columns(columns: Columns, thresholds: Thresholds) -> Whole:
    """Find for each label the row of its record, NOTHING without one (METHOD 6.1).

    Where no label's window holds two records and no record lies in two windows, every pair there
    is belongs to the one solution. Other cells go to the exact matcher.
    """
    result = np.full(len(columns.labels.t_s), NOTHING)
    labels, records = np.diff(columns.label_start), np.diff(columns.record_start)
    base = int(records.max()) + 1
    shapes = labels * base + records
    for shape in np.unique(shapes).tolist():
        rows, width = divmod(shape, base)
        if width == 0:
            continue
        cells = np.flatnonzero(shapes == shape)
        size = max(1, _TABLE // (rows * width))
        for start in range(0, len(cells), size):
            _match_alike(columns, cells[start : start + size], rows, width, thresholds, result)
    return result


def _match_alike(
    columns: Columns, cells: Whole, rows: int, width: int, thresholds: Thresholds, result: Whole
) -> None:
    """Match cells with as many labels and as many records each."""
    # Cells come last, where a sum over the others runs through memory in order.
    label = columns.label_start[cells] + np.arange(rows)[:, None]
    record = columns.record_start[cells] + np.arange(width)[:, None]
    label_s, record_s = columns.labels.t_s[label], columns.records.t_s[record]
    distance_s = np.abs(record_s[None, :, :] - label_s[:, None, :])
    near: Flags = thresholds.at_most(distance_s, thresholds.match_window_s)
    records_near, labels_near = near.sum(axis=1), near.sum(axis=0)
    plain = (records_near <= 1).all(axis=0) & (labels_near <= 1).all(axis=0)
    nearest = np.where(records_near > 0, near.argmax(axis=1) + record[0], NOTHING)
    result[label[:, plain]] = nearest[:, plain]
    for cell in np.flatnonzero(~plain):
        pairs = match(label_s[:, cell].tolist(), record_s[:, cell].tolist(), thresholds)
        result[label[:, cell]] = [NOTHING if i is None else record[i, cell] for i in pairs]
