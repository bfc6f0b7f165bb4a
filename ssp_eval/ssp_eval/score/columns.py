"""Labels and records of many cells as columns of numbers, from objects or straight from files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate, chain, islice
from operator import attrgetter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ssp_core.files.reading import read_text
from ssp_core.vocabulary import LAT_ACTIONS, LON_ACTIONS
from ssp_eval.data.labels import Label, Labels, parse_labels_text
from ssp_eval.data.records import (
    SLOT_NAMES,
    VOCABULARIES,
    BehaviourRecord,
    Slot,
    load_records,
)
from ssp_vla_bridge.trajectory import Trajectory

Whole = NDArray[np.int64]
Flags = NDArray[np.bool_]
Numbers = NDArray[np.float64]

# The code of a null label and of an answer that is missing.
NOTHING = -1


@dataclass(frozen=True, eq=False)
class LabelColumns:
    """All labels of all cells, cell after cell (METHOD 5.2).

    Args:
        t_s: (L,) clip time, s.
        truth: (L, 4) per slot of METHOD 6.3 the code of its value, NOTHING for null.
        lon_allowed: (L,) bits of the allowed longitudinal actions.
        lat_allowed: (L,) bits of the allowed lateral actions.
    """

    t_s: Numbers
    truth: Whole
    lon_allowed: Whole
    lat_allowed: Whole


@dataclass(frozen=True, eq=False)
class RecordColumns:
    """All records of all cells, cell after cell (METHOD 5.3).

    Args:
        t_s: (R,) clip time, s.
        text_valid: (R,) v_txt.
        answer: (R, 6) per slot the code of its value where z = 1, else NOTHING.
        grid: (R,) which of grids the trajectory's times are.
        grids: the different sequences of times of trajectories; the first one is empty and that
            of records without a trajectory.
        x_m, y_m: all coordinates, record after record.
        x_start, y_start: (R + 1,) where a record's coordinates begin.
    """

    t_s: Numbers
    text_valid: Flags
    answer: Whole
    grid: Whole
    grids: tuple[tuple[float, ...], ...]
    x_m: Numbers
    y_m: Numbers
    x_start: Whole
    y_start: Whole


@dataclass(frozen=True, eq=False)
class Columns:
    """Many cells (METHOD 6).

    Args:
        label_start: (C + 1,) where a cell's labels begin.
        record_start: (C + 1,) where a cell's records begin.
        risk_onset_s: (C,) t_r, clip time, s.
        first_frame_dynamics: (C,) motion and conflict count at the earliest label too.
    """

    label_start: Whole
    record_start: Whole
    risk_onset_s: Numbers
    first_frame_dynamics: Flags
    labels: LabelColumns
    records: RecordColumns


Cell = tuple[Labels, Sequence[BehaviourRecord]]

# Cells.
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
_slots_of = attrgetter(*SLOT_NAMES)


class _Grids(dict[tuple[float, ...], int]):
    """The different sequences of times, numbered as they come; the empty one is 0."""

    def __init__(self) -> None:
        super().__init__({(): 0})

    def __missing__(self, times: tuple[float, ...]) -> int:
        self[times] = len(self)
        return self[times]


def encode(cells: Sequence[Cell]) -> Columns:
    """Return the columns of cells, in their order.

    Args:
        cells: labels and records of each, both in time order.

    Raises:
        ValueError: a word is not of its vocabulary, or a cell has no label.
    """
    blocks = RecordBlocks()
    for start in range(0, len(cells), _BLOCK):
        blocks.add(chain.from_iterable(records for _, records in cells[start : start + _BLOCK]))
    counts = [len(records) for _, records in cells]
    return columns_of([labels for labels, _ in cells], counts, blocks.columns())


def columns_of(labels: Sequence[Labels], counts: Sequence[int], records: RecordColumns) -> Columns:
    """Return the columns of cells whose records are in columns already.

    Args:
        labels: of each cell.
        counts: how many records each cell has.
        records: of all cells, in the order of labels.

    Raises:
        ValueError: see encode.
    """
    label_lists = [one.labels for one in labels]
    if not all(label_lists):
        raise ValueError("a cell without labels has no scores")
    return Columns(
        label_start=_starts(map(len, label_lists)),
        record_start=_starts(counts),
        risk_onset_s=np.array([one.risk_onset_s for one in labels], dtype=np.float64),
        first_frame_dynamics=np.array([one.first_frame_dynamics for one in labels], dtype=np.bool_),
        labels=_shared_labels(label_lists),
        records=records,
    )


def _starts(lengths: Iterable[int]) -> Whole:
    return np.fromiter(accumulate(lengths, initial=0), np.int64)


def _shared_labels(label_lists: Sequence[tuple[Label, ...]]) -> LabelColumns:
    """Return the labels of all cells; those that several cells share are walked once."""
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


class RecordBlocks:
    """Gathers records block by block; the columns of a block are made at once."""

    def __init__(self) -> None:
        self._grids = _Grids()
        self._blocks: list[tuple[np.ndarray, ...]] = []

    def add(self, records: Iterable[BehaviourRecord]) -> None:
        """Add a block of records."""
        rows = list(records)
        n = len(rows)
        slots = zip(*[_slots_of(record.slots) for record in rows], strict=True)
        # All records' first slots, then the second.
        flat_slots = [_NO_SLOT if slot is None else slot for slot in chain.from_iterable(slots)]
        paths = [record.trajectory or _NO_TRAJECTORY for record in rows]
        texts = [record.text for record in rows]
        text_valid = np.fromiter(map(bool, map(str.strip, texts)), np.bool_, n)
        length = np.where(text_valid, np.fromiter(map(len, texts), np.int64, n), 0)
        answer = np.empty((n, len(_ANSWER_CODES)), dtype=np.int64)
        values = [slot.value for slot in flat_slots]
        for slot, codes in enumerate(_ANSWER_CODES):
            answer[:, slot] = _coded(codes, values[slot * n : (slot + 1) * n])
        evidence = [slot.evidence for slot in flat_slots]
        has_support = _supported(evidence, np.tile(length, len(_ANSWER_CODES)))
        answer[~has_support.reshape(len(_ANSWER_CODES), n).T] = NOTHING
        self._blocks.append(
            (
                np.array([record.t_s for record in rows], dtype=np.float64),
                text_valid,
                answer,
                np.fromiter([self._grids[path.t_s] for path in paths], np.int64, n),
                np.fromiter(chain.from_iterable(path.x_m for path in paths), np.float64),
                np.fromiter(chain.from_iterable(path.y_m for path in paths), np.float64),
                np.fromiter([len(path.x_m) for path in paths], np.int64, n),
                np.fromiter([len(path.y_m) for path in paths], np.int64, n),
            )
        )

    def columns(self) -> RecordColumns:
        """Return all records so far, in the order in which they came."""
        t_s, text_valid, answer, grid, x_m, y_m, x_count, y_count = (
            np.concatenate(parts) for parts in zip(*self._blocks, strict=True)
        )
        return RecordColumns(
            t_s,
            text_valid,
            answer,
            grid,
            tuple(self._grids),
            x_m,
            y_m,
            np.concatenate(([0], np.cumsum(x_count))),
            np.concatenate(([0], np.cumsum(y_count))),
        )


def _supported(evidence: Sequence[Sequence[Sequence[int]]], length: Whole) -> Flags:
    """Tell whether a slot has a span inside the text (METHOD 5.3); length 0 is a blank text."""
    spans = _spans(evidence)
    count = np.fromiter(map(len, evidence), np.int64, len(evidence))
    start, end = spans[0::2], spans[1::2]
    inside = (start >= 0) & (start < end) & (end <= np.repeat(length, count))
    before = np.concatenate(([0], np.cumsum(inside)))
    last = np.cumsum(count)
    result: Flags = before[last] > before[last - count]
    return result


def _spans(evidence: Sequence[Sequence[Sequence[int]]]) -> Whole:
    def flat() -> Iterator[int]:
        return chain.from_iterable(chain.from_iterable(evidence))

    try:
        return np.fromiter(flat(), np.int64)
    except OverflowError:
        return np.fromiter((min(max(place, NOTHING), _FAR) for place in flat()), np.int64)


def load_columns(cells: Iterable[tuple[Path, Path]]) -> Columns:
    """Return the columns of cells, in their order.

    Raises:
        InputError: the first file that is wrong, see load_labels and load_records.
    """
    labels_by_text: dict[str, Labels] = {}
    labels: list[Labels] = []
    counts: list[int] = []
    blocks = RecordBlocks()
    rest = iter(cells)
    while block := list(islice(rest, _BLOCK)):
        block_records = []
        for labels_file, records_file in block:
            # The cells of a clip have a copy of its labels each; one object is encoded once.
            text = read_text(labels_file)
            if text not in labels_by_text:
                labels_by_text[text] = parse_labels_text(text, labels_file)
            labels.append(labels_by_text[text])
            block_records.append(load_records(records_file))
        counts += map(len, block_records)
        blocks.add(chain.from_iterable(block_records))
    return columns_of(labels, counts, blocks.columns())
