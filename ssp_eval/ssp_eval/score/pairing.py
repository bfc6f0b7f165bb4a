"""Matching of many cells at once (METHOD 6.1)."""

from __future__ import annotations

import numpy as np

from ssp_eval.score.columns import NOTHING, Columns, Flags, Whole
from ssp_eval.score.matching import match
from ssp_eval.score.thresholds import Thresholds

# So many distances are held at a time.
_TABLE = 1 << 20


def match_columns(columns: Columns, thresholds: Thresholds) -> Whole:
    """For each label the row of its record, NOTHING without one (METHOD 6.1).

    Where no label's window holds two records and no record lies in two windows, every pair there
    is belongs to the one solution. Other cells go to the exact matcher.

    Args:
        columns: the cells.
        thresholds: window and tolerance.
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
    """Matches cells with as many labels and as many records each."""
    # Cells come last, where a sum over the others runs through memory in order.
    label = columns.label_start[cells] + np.arange(rows)[:, None]
    record = columns.record_start[cells] + np.arange(width)[:, None]
    label_s, record_s = columns.labels.t_s[label], columns.records.t_s[record]
    distance_s = np.abs(record_s[None, :, :] - label_s[:, None, :])
    near: Flags = thresholds.at_most(distance_s, thresholds.match_window_s)
    records_near, labels_near = near.sum(axis=1), near.sum(axis=0)
    plain = (records_near <= 1).all(axis=0) & (labels_near <= 1).all(axis=0)
    found = np.where(records_near > 0, near.argmax(axis=1) + record[0], NOTHING)
    result[label[:, plain]] = found[:, plain]
    for cell in np.flatnonzero(~plain):
        pairs = match(label_s[:, cell].tolist(), record_s[:, cell].tolist(), thresholds)
        result[label[:, cell]] = [NOTHING if i is None else record[i, cell] for i in pairs]
