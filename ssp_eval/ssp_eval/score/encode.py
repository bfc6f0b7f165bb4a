"""Turning labels and records into the columns of ssp_eval.score.columns.

The objects are walked a block of cells at a time, so that what one pass has brought into the
processor's cache is still there for the next.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import accumulate, chain
from operator import attrgetter

import numpy as np

from ssp_core.vocab import LAT_ACTIONS, LON_ACTIONS
from ssp_eval.labels.model import Label, Labels
from ssp_eval.records import SLOT_NAMES, VOCABULARIES, BehaviourRecord, Slot
from ssp_eval.score.columns import (
    NOTHING,
    Columns,
    Flags,
    LabelColumns,
    RecordColumns,
    Whole,
)
from ssp_vla_bridge.core.trajectory import Trajectory

Cell = tuple[Labels, Sequence[BehaviourRecord]]

_BLOCK = 32
_NO_SLOT = Slot("", ())
_NO_TRAJECTORY = Trajectory((), (), ())
# Beyond any text; stands for a character position that doesn't fit into 64 bits.
_FAR = 1 << 62


class Codes(dict[object, int]):
    """Words of a closed vocabulary to their codes; what it doesn't know it asks for once."""

    def __init__(self, vocabulary: Sequence[str], bits: bool) -> None:
        super().__init__({None: NOTHING, "": NOTHING})
        self._vocabulary, self._bits = vocabulary, bits
        if not bits:
            self.update({word: code for code, word in enumerate(vocabulary)})

    def __missing__(self, value: object) -> int:
        if not self._bits or not isinstance(value, tuple) or not set(value) <= {*self._vocabulary}:
            raise ValueError(f"{value!r} isn't of the vocabulary {', '.join(self._vocabulary)}")
        self[value] = sum(1 << self._vocabulary.index(word) for word in set(value))
        return self[value]


_ANSWER_CODES = tuple(Codes(VOCABULARIES[name], name == "objects") for name in SLOT_NAMES)
_TRUTH_CODES = _ANSWER_CODES[:4]
_LON, _LAT = Codes(LON_ACTIONS, bits=True), Codes(LAT_ACTIONS, bits=True)
_label_fields = attrgetter(
    "t_s", "objects", "position", "motion", "conflict", "lon_actions", "lat_actions"
)
_slots = attrgetter(*SLOT_NAMES)


class _Grids(dict[tuple[float, ...], int]):
    """The different sequences of times, numbered as they come; the empty one is 0."""

    def __init__(self) -> None:
        super().__init__({(): 0})

    def __missing__(self, times: tuple[float, ...]) -> int:
        self[times] = len(self)
        return self[times]


def encode(cells: Sequence[Cell]) -> Columns:
    """The columns of cells, in their order.

    Args:
        cells: labels and records of each, both in time order.

    Raises:
        ValueError: a word is not of its vocabulary, or a cell has no label.
    """
    label_lists = [labels.labels for labels, _ in cells]
    if not all(label_lists):
        raise ValueError("a cell without labels has no scores")
    return Columns(
        label_start=_starts(map(len, label_lists)),
        record_start=_starts(len(records) for _, records in cells),
        risk_onset_s=np.array([labels.risk_onset_s for labels, _ in cells], dtype=np.float64),
        first_frame_dynamics=np.array(
            [labels.first_frame_dynamics for labels, _ in cells], dtype=np.bool_
        ),
        labels=_shared_labels(label_lists),
        records=_all_records([records for _, records in cells]),
    )


def _starts(lengths: Iterable[int]) -> Whole:
    return np.fromiter(accumulate(lengths, initial=0), np.int64)


def _shared_labels(label_lists: Sequence[tuple[Label, ...]]) -> LabelColumns:
    """The labels of all cells; those that several cells share are walked once."""
    numbers: dict[int, int] = {}
    which = [numbers.setdefault(id(labels), len(numbers)) for labels in label_lists]
    if len(numbers) == len(label_lists):
        return _labels(list(chain.from_iterable(label_lists)))
    distinct = list({id(labels): labels for labels in label_lists}.values())
    starts, lengths = _starts(map(len, distinct)), np.array([len(x) for x in distinct])
    count = lengths[which]
    first = np.repeat(starts[:-1][which] - (np.cumsum(count) - count), count)
    row = first + np.arange(count.sum())
    once = _labels(list(chain.from_iterable(distinct)))
    return LabelColumns(
        once.t_s[row], once.truth[row], once.lon_allowed[row], once.lat_allowed[row]
    )


def _labels(labels: Sequence[Label]) -> LabelColumns:
    times, *truths, lon, lat = zip(*map(_label_fields, labels), strict=True)
    return LabelColumns(
        t_s=np.array(times, dtype=np.float64),
        truth=np.column_stack(
            [_coded(codes, truth) for codes, truth in zip(_TRUTH_CODES, truths, strict=True)]
        ),
        lon_allowed=_coded(_LON, lon),
        lat_allowed=_coded(_LAT, lat),
    )


def _coded(codes: Codes, values: Sequence[object]) -> Whole:
    return np.fromiter(map(codes.__getitem__, values), np.int64, len(values))


def _all_records(record_lists: Sequence[Sequence[BehaviourRecord]]) -> RecordColumns:
    grids = _Grids()
    blocks = [
        _records(list(chain.from_iterable(record_lists[start : start + _BLOCK])), grids)
        for start in range(0, len(record_lists), _BLOCK)
    ]
    t_s, text_valid, answer, grid, x_m, y_m, x_count, y_count = (
        np.concatenate(parts) for parts in zip(*blocks, strict=True)
    )
    return RecordColumns(
        t_s,
        text_valid,
        answer,
        grid,
        tuple(grids),
        x_m,
        y_m,
        np.concatenate(([0], np.cumsum(x_count))),
        np.concatenate(([0], np.cumsum(y_count))),
    )


def _records(records: Sequence[BehaviourRecord], grids: _Grids) -> tuple[np.ndarray, ...]:
    """A block's columns in the order in which _all_records takes them."""
    n = len(records)
    times = [record.t_s for record in records]
    texts = [record.text for record in records]
    text_valid = np.fromiter(map(bool, map(str.strip, texts)), np.bool_, n)
    length = np.fromiter(map(len, texts), np.int64, n)
    slots = [_slots(record.slots) for record in records]
    answers = [
        _answers([row[slot] for row in slots], codes, text_valid, length)
        for slot, codes in enumerate(_ANSWER_CODES)
    ]
    paths = [record.trajectory or _NO_TRAJECTORY for record in records]
    xs, ys = [path.x_m for path in paths], [path.y_m for path in paths]
    return (
        np.array(times, dtype=np.float64),
        text_valid,
        np.column_stack(answers),
        np.fromiter((grids[path.t_s] for path in paths), np.int64, n),
        np.fromiter(chain.from_iterable(xs), np.float64),
        np.fromiter(chain.from_iterable(ys), np.float64),
        np.fromiter(map(len, xs), np.int64, n),
        np.fromiter(map(len, ys), np.int64, n),
    )


def _answers(
    column: Sequence[Slot | None], codes: Codes, text_valid: Flags, length: Whole
) -> Whole:
    """The codes of a slot's values where z = 1 (METHOD 5.3), else NOTHING."""
    slots = [_NO_SLOT if slot is None else slot for slot in column]
    answer = _coded(codes, [slot.value for slot in slots])
    evidence = [slot.evidence for slot in slots]
    spans = _spans(evidence)
    count = np.fromiter(map(len, evidence), np.int64, len(slots))
    start, end = spans[0::2], spans[1::2]
    inside = (start >= 0) & (start < end) & (end <= np.repeat(length, count))
    before = np.concatenate(([0], np.cumsum(inside)))
    last = np.cumsum(count)
    given = text_valid & (before[last] > before[last - count])
    return np.where(given, answer, NOTHING)


def _spans(evidence: Sequence[tuple[tuple[int, int], ...]]) -> Whole:
    def flat() -> Iterator[int]:
        return chain.from_iterable(chain.from_iterable(evidence))

    try:
        return np.fromiter(flat(), np.int64)
    except OverflowError:
        return np.fromiter((min(max(place, NOTHING), _FAR) for place in flat()), np.int64)
