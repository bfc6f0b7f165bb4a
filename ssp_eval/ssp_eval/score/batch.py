"""The scores of many cells at once (METHOD 6), and the terms that their means are taken of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from itertools import product

import numpy as np

from ssp_core.vocabulary import CONFLICTS, LON_ACTIONS, OBJECTS
from ssp_eval.data.records import VOCABULARIES
from ssp_eval.score.cell import CellMetrics, CellScore, ivcs_weights
from ssp_eval.score.columns import NOTHING, Cell, Columns, Flags, Numbers, Whole, encode
from ssp_eval.score.judge import (
    DEFENSIVE_ACTIONS,
    DYNAMIC_SLOTS,
    INTERACTION_SLOTS,
    RISKY_CONFLICTS,
    SLOTS,
    Value,
    hard_score,
    soft_score,
)
from ssp_eval.score.matching import match_columns
from ssp_eval.score.motion import driven
from ssp_eval.score.thresholds import DEFAULT, Thresholds


@dataclass(frozen=True, eq=False)
class RecordTerms:
    """The terms of a cell, one row per label in time order; a missing output is 0 everywhere.

    Args:
        matched: (N,) the label has a record (6.1).
        output_valid: (N,) v_txt v_trj (6.2).
        evaluable: (N, 4) e of each slot, in the order of SLOTS (6.3).
        given: (N, 4) e z.
        hard: (N, 4) e z h, 0..1.
        soft: (N, 4) e z s, 0..1.
        interaction_evaluable: (N,) E (6.4).
        interaction_correct: (N,) E C (6.4).
        action_correct: (N,) the term of ActAcc_eff (6.5).
        feasible: (N,) v_trj F, the term of STFR (6.7).
        trajectory_correct: (N,) v_trj F R_lon R_lat, the term of TQSR (6.7).
        consistent: (N,) the term of ATC_eff (6.8).
        candidate: (N,) the record is a candidate for the risk response (6.9).
        defensive: (N,) a valid trajectory slows down where that is right, candidate or not (6.9).
        record_t_s: (N,) clip time of the record, s; NaN without one.
        risk_onset_s: t_r (6.9), clip time, s.
    """

    matched: Flags
    output_valid: Flags
    evaluable: Flags
    given: Flags
    hard: Numbers
    soft: Numbers
    interaction_evaluable: Flags
    interaction_correct: Flags
    action_correct: Flags
    feasible: Flags
    trajectory_correct: Flags
    consistent: Flags
    candidate: Flags
    defensive: Flags
    record_t_s: Numbers
    risk_onset_s: float

    def __len__(self) -> int:
        """N, the number of labels."""
        return len(self.matched)


def record_terms(score: CellScore) -> RecordTerms:
    """The terms of a scored cell."""
    items = score.details.judgements
    slots = [[item.slots[name] for name in SLOTS] for item in items]

    def flags(values: list[bool]) -> Flags:
        return np.array(values, dtype=np.bool_)

    return RecordTerms(
        matched=flags([item.record is not None for item in items]),
        output_valid=flags([item.text_valid and item.trajectory_valid for item in items]),
        evaluable=np.array([[slot.evaluable for slot in row] for row in slots], dtype=np.bool_),
        given=np.array(
            [[slot.evaluable and slot.given for slot in row] for row in slots], dtype=np.bool_
        ),
        hard=np.array([[slot.h or 0.0 for slot in row] for row in slots]),
        soft=np.array([[slot.s or 0.0 for slot in row] for row in slots]),
        interaction_evaluable=flags([item.interaction_evaluable for item in items]),
        interaction_correct=flags(
            [item.interaction_evaluable and item.interaction_correct for item in items]
        ),
        action_correct=flags([item.action_correct for item in items]),
        feasible=flags([item.feasible_valid for item in items]),
        trajectory_correct=flags([item.trajectory_correct for item in items]),
        consistent=flags([item.consistent for item in items]),
        candidate=flags([item.candidate for item in items]),
        defensive=flags([item.defensive for item in items]),
        record_t_s=np.array(
            [np.nan if item.record_t_s is None else item.record_t_s for item in items]
        ),
        risk_onset_s=score.details.risk_onset_s,
    )


_DYNAMIC = [SLOTS.index(name) for name in DYNAMIC_SLOTS]
_INTERACTION = [SLOTS.index(name) for name in INTERACTION_SLOTS]
# By code; NOTHING, which is -1, picks the last item.
_RISKY = np.array([word in RISKY_CONFLICTS for word in (*CONFLICTS, None)])
_DEFENSIVE = np.array([word in DEFENSIVE_ACTIONS for word in (*LON_ACTIONS, None)])


@dataclass(frozen=True, eq=False)
class Semantics:
    """The slots of METHOD 6.3, one row per label, and the interaction of METHOD 6.4.

    Args:
        evaluable: (L, 4) e.
        given: (L, 4) e z.
        hard: (L, 4) e z h.
        soft: (L, 4) e z s.
        interaction_evaluable: (L,) E.
        interaction_correct: (L,) E C.
    """

    evaluable: Flags
    given: Flags
    hard: Numbers
    soft: Numbers
    interaction_evaluable: Flags
    interaction_correct: Flags


def _values(slot: str) -> list[Value]:
    """Every value that a slot can have, in the order of its codes."""
    if slot != "objects":
        return list(VOCABULARIES[slot])
    return [
        tuple(word for bit, word in enumerate(OBJECTS) if mask >> bit & 1)
        for mask in range(1 << len(OBJECTS))
    ]


def score_tables(soft_credit: float) -> tuple[tuple[Numbers, Numbers], ...]:
    """h and s of METHOD 6.3 per slot of SLOTS, by the codes of answer and truth.

    A last row of zeros stands for a missing answer, which NOTHING points at.
    """
    tables = []
    for slot in SLOTS:
        values = _values(slot)
        hard = np.zeros((len(values) + 1, len(values)))
        soft = np.zeros_like(hard)
        for (i, answer), (j, truth) in product(enumerate(values), enumerate(values)):
            hard[i, j] = hard_score(answer, truth)
            soft[i, j] = soft_score(answer, truth, soft_credit)
        tables.append((hard, soft))
    return tuple(tables)


_score_tables = lru_cache(maxsize=8)(score_tables)


def semantics(
    columns: Columns, answer: Whole, earliest: Whole, thresholds: Thresholds
) -> Semantics:
    """METHOD 6.3 and 6.4.

    Args:
        columns: the cells.
        answer: (L, 6) codes of the matched records.
        earliest: (C,) the row of each cell's earliest label.
        thresholds: the credit for adjacent classes.
    """
    truth = columns.labels.truth
    evaluable = truth != NOTHING
    masked = earliest[~columns.first_frame_dynamics]
    evaluable[masked[:, None], _DYNAMIC] = False
    given = evaluable & (answer[:, : len(SLOTS)] != NOTHING)
    hard, soft = np.zeros(truth.shape), np.zeros(truth.shape)
    for slot, (hard_table, soft_table) in enumerate(_score_tables(thresholds.soft_credit)):
        index = (answer[:, slot], truth[:, slot])
        hard[:, slot] = np.where(evaluable[:, slot], hard_table[index], 0.0)
        soft[:, slot] = np.where(evaluable[:, slot], soft_table[index], 0.0)
    interaction = np.logical_and.reduce([evaluable[:, slot] for slot in _INTERACTION])
    correct = np.logical_and.reduce([hard[:, slot] == 1.0 for slot in _INTERACTION])
    return Semantics(evaluable, given, hard, soft, interaction, interaction & correct)


def allowed(action: Whole, bits: Whole) -> Flags:
    """Whether an action's code is in the set whose bits a label allows; NOTHING never is."""
    result: Flags = (action != NOTHING) & ((bits >> np.maximum(action, 0)) & 1 == 1)
    return result


def risky(conflict: Whole) -> Flags:
    """Whether a label's conflict admits a candidate of METHOD 6.9."""
    result: Flags = _RISKY[conflict]
    return result


def slows_down(lon: Whole) -> Flags:
    """Whether an inferred action is one of those that METHOD 6.9 calls defensive."""
    result: Flags = _DEFENSIVE[lon]
    return result


_CONFLICT = SLOTS.index("conflict")


@dataclass(frozen=True, eq=False)
class BatchTerms:
    """The terms of many cells.

    Args:
        rows: one row per label, cell after cell; it has no onset of its own (NaN).
        start: (C + 1,) where a cell's labels begin.
        risk_onset_s: (C,) t_r, clip time, s.
    """

    rows: RecordTerms
    start: Whole
    risk_onset_s: Numbers

    def cell(self, number: int) -> RecordTerms:
        """The terms of one cell."""
        part = slice(int(self.start[number]), int(self.start[number + 1]))
        names = [item.name for item in fields(RecordTerms) if item.name != "risk_onset_s"]
        views = {name: getattr(self.rows, name)[part] for name in names}
        return replace(self.rows, **views, risk_onset_s=float(self.risk_onset_s[number]))


def batch_terms(columns: Columns, thresholds: Thresholds = DEFAULT) -> BatchTerms:
    """The terms of METHOD 6.2 to 6.9 of every label of every cell."""
    labels, records, start = columns.labels, columns.records, columns.label_start
    pairing = match_columns(columns, thresholds)
    motion = driven(records, thresholds)

    def paired(column: np.ndarray, missing: float) -> np.ndarray:
        """A record's column beside the labels; NOTHING, which is -1, picks the item at its end."""
        end = np.full_like(column, missing, shape=(1, *column.shape[1:]))
        result: np.ndarray = np.concatenate((column, end))[pairing]
        return result

    answer = paired(records.answer, NOTHING)
    said_lon, said_lat = answer[:, len(SLOTS)], answer[:, len(SLOTS) + 1]
    valid = paired(motion.valid, False)
    lon, lat = paired(motion.lon, NOTHING), paired(motion.lat, NOTHING)
    feasible = paired(motion.feasible, False)
    record_t_s = paired(records.t_s, np.nan)
    onset_s = np.repeat(columns.risk_onset_s, np.diff(start))
    slots = semantics(columns, answer, start[:-1], thresholds)
    right_lon = allowed(lon, labels.lon_allowed)
    rows = RecordTerms(
        matched=pairing != NOTHING,
        output_valid=valid & paired(records.text_valid, False),
        evaluable=slots.evaluable,
        given=slots.given,
        hard=slots.hard,
        soft=slots.soft,
        interaction_evaluable=slots.interaction_evaluable,
        interaction_correct=slots.interaction_correct,
        action_correct=allowed(said_lon, labels.lon_allowed)
        & allowed(said_lat, labels.lat_allowed),
        feasible=feasible,
        trajectory_correct=feasible & right_lon & allowed(lat, labels.lat_allowed),
        consistent=valid & (said_lon == lon) & (said_lat == lat),
        candidate=thresholds.at_least(record_t_s, onset_s) & risky(labels.truth[:, _CONFLICT]),
        defensive=slows_down(lon) & right_lon,
        record_t_s=record_t_s,
        risk_onset_s=np.nan,
    )
    return BatchTerms(rows, start, columns.risk_onset_s)


def responses(terms: BatchTerms, thresholds: Thresholds = DEFAULT) -> Numbers:
    """Per cell the clip time at which its response begins, s; NaN without one (METHOD 6.9)."""
    candidates = np.flatnonzero(terms.rows.candidate)
    cell = np.repeat(np.arange(len(terms.start) - 1), np.diff(terms.start))[candidates]
    t_s = terms.rows.record_t_s[candidates]
    defensive = terms.rows.defensive[candidates]
    gap_s = np.diff(t_s)
    linked = (np.diff(cell) == 0) & (gap_s > 0)
    linked &= thresholds.at_most(gap_s, thresholds.response_gap_s)
    begins = defensive.copy()
    for step in range(1, thresholds.response_count):
        begins[-step:] = False
        begins[:-step] &= linked[step - 1 :] & defensive[step:]
    begun, begun_s = cell[begins], t_s[begins]
    first = np.diff(begun, prepend=-1) > 0
    result = np.full(len(terms.start) - 1, np.nan)
    result[begun[first]] = begun_s[first]
    return result


@dataclass(frozen=True, eq=False)
class Scores:
    """The scores of many cells.

    Args:
        values: by the names of CellMetrics, in their order, an array with an item per cell;
            NaN where the score is null.
    """

    values: dict[str, np.ndarray]

    def cells(self) -> list[CellMetrics]:
        """The same cell by cell, null as None."""
        columns = map(_nullable, self.values.values())
        return [CellMetrics(*values) for values in zip(*columns, strict=True)]


def score_columns(columns: Columns, thresholds: Thresholds = DEFAULT) -> Scores:
    """The scores of the cells of columns, in their order (METHOD 6.2 to 6.11).

    Args:
        columns: of at least one cell.
        thresholds: all limits and weights.
    """
    terms = batch_terms(columns, thresholds)
    rows, begin = terms.rows, terms.start[:-1]
    n = np.diff(terms.start)

    def total(column: Flags) -> Whole:
        summed = np.add.reduceat(column, begin, axis=0, dtype=np.int64)
        return summed if summed.ndim == 1 else summed.sum(axis=1)

    evaluable, given = total(rows.evaluable), total(rows.given)
    hard, soft = exact_totals(rows.hard, terms.start), exact_totals(rows.soft, terms.start)
    interactions = total(rows.interaction_evaluable)
    response_s = responses(terms, thresholds)
    values = {
        "n": n,
        "matched": total(rows.matched),
        "jovr": total(rows.output_valid) / n,
        "sem_cov": _ratio(given, evaluable),
        "sem_acc_cond": _ratio(hard, given),
        "sem_acc_eff": _ratio(hard, evaluable),
        "sem_acc_soft": _ratio(soft, evaluable),
        "cia_eff": _ratio(total(rows.interaction_correct), interactions),
        "act_acc_eff": total(rows.action_correct) / n,
        "stfr": total(rows.feasible) / n,
        "tqsr": total(rows.trajectory_correct) / n,
        "atc_eff": total(rows.consistent) / n,
        "rsr": np.isfinite(response_s).astype(np.int64),
        "rl_s": np.maximum(response_s - terms.risk_onset_s, 0.0),
    }
    values["ivcs"] = exact_sum(
        [weight * np.nan_to_num(values[name]) for name, weight in ivcs_weights(thresholds).items()]
    )
    return Scores(values | {"semantic_denominator": evaluable, "cia_denominator": interactions})


def exact_sum(columns: Sequence[Numbers]) -> Numbers:
    """The sum of arrays, item by item, rounded once as math.fsum does it.

    What an addition loses is itself a number, which is summed beside. Scores lie in 0..1 and are
    no multiples of tiny numbers, so that a sum of losses loses nothing.
    """
    total, lost = columns[0], np.zeros_like(columns[0])
    for column in columns[1:]:
        after = total + column
        added = after - total
        lost += (total - (after - added)) + (column - added)
        total = after
    result: Numbers = total + lost
    return result


def exact_totals(column: Numbers, start: Whole) -> Numbers:
    """The sum of each cell's terms, see exact_sum.

    Args:
        column: (L, 4), one row per label.
        start: (C + 1,) where a cell's labels begin.
    """
    length = np.diff(start)
    result = np.empty(len(length))
    for count in np.unique(length).tolist():
        cells = np.flatnonzero(length == count)
        rows = column[start[cells] + np.arange(count)[:, None]]
        result[cells] = exact_sum([*np.moveaxis(rows, 2, 1).reshape(-1, len(cells))])
    return result


def _ratio(sums: np.ndarray, denominators: np.ndarray) -> Numbers:
    """Σ / denominator, NaN where the denominator is 0 (METHOD 6.11)."""
    result = np.full(len(sums), np.nan)
    np.divide(sums, denominators, out=result, where=denominators > 0)
    return result


def _nullable(column: np.ndarray) -> list[float | None]:
    """An array as plain numbers, NaN as None."""
    values: list[float | None] = column.tolist()
    if column.dtype == np.float64:
        for place in np.flatnonzero(np.isnan(column)).tolist():
            values[place] = None
    return values


def score_cells(cells: Sequence[Cell], thresholds: Thresholds = DEFAULT) -> list[CellMetrics]:
    """Scores many cells at once: what score_cell gives for each, without the details.

    Args:
        cells: labels and records of each cell, see score_cell.
        thresholds: all limits and weights.

    Raises:
        ValueError: a cell has no label, or a word is of no vocabulary.
    """
    return score_columns(encode(cells), thresholds).cells() if cells else []
