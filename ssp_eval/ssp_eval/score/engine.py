"""The scoring engine: many cells at once, on arrays with a row per label (METHOD 6)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np

from ssp_core.vocabulary import CONFLICTS, LON_ACTIONS, OBJECTS
from ssp_eval.data.labels import Labels
from ssp_eval.data.records import VOCABULARIES, BehaviourRecord
from ssp_eval.score.columns import NOTHING, Cell, Columns, Flags, Numbers, Whole, encode
from ssp_eval.score.matching import match_columns
from ssp_eval.score.metrics import (
    LABELS,
    SUMMED,
    CellMetrics,
    exact_sum,
    exact_totals,
    ivcs_weights,
    ratios,
)
from ssp_eval.score.motion import driven
from ssp_eval.score.thresholds import DEFAULT, Thresholds

Value = str | tuple[str, ...]
SLOTS = ("objects", "position", "motion", "conflict")
DYNAMIC_SLOTS = ("motion", "conflict")
INTERACTION_SLOTS = ("objects", "position", "motion")
# Classes that a careful reader may take for each other (METHOD 6.3); the order doesn't matter.
ADJACENT = frozenset(
    frozenset(pair)
    for pair in (
        ("front", "front_left"),
        ("front", "front_right"),
        ("left", "front_left"),
        ("right", "front_right"),
        ("potential", "active"),
        ("no_conflict", "resolved"),
    )
)


def object_f1(answer: Iterable[str], truth: Iterable[str]) -> float:
    """Set F1 = 2|Ô∩O| / (|Ô|+|O|), and 1 when both are empty (METHOD 6.3)."""
    answer_ids, true = set(answer), set(truth)
    if not answer_ids and not true:
        return 1.0
    return 2 * len(answer_ids & true) / (len(answer_ids) + len(true))


def hard_score(answer: Value, truth: Value) -> float:
    """Return h of METHOD 6.3: set F1 for a set of objects, exact match for a word."""
    if isinstance(answer, str) or isinstance(truth, str):
        return float(answer == truth)
    return object_f1(answer, truth)


def soft_score(answer: Value, truth: Value, credit: float) -> float:
    """Return s of METHOD 6.3: as h, but ``credit`` for adjacent classes."""
    if isinstance(answer, str) and isinstance(truth, str) and {answer, truth} in ADJACENT:
        return credit
    return hard_score(answer, truth)


_DYNAMIC = [SLOTS.index(name) for name in DYNAMIC_SLOTS]
_INTERACTION = [SLOTS.index(name) for name in INTERACTION_SLOTS]


def _values(slot: str) -> list[Value]:
    """Return every value that a slot can have, in the order of its codes."""
    if slot != "objects":
        return list(VOCABULARIES[slot])
    return [
        tuple(word for bit, word in enumerate(OBJECTS) if mask >> bit & 1)
        for mask in range(1 << len(OBJECTS))
    ]


def score_tables(soft_credit: float) -> tuple[tuple[Numbers, Numbers], ...]:
    """Return h and s of METHOD 6.3 per slot of SLOTS, by the codes of answer and truth.

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
) -> dict[str, Any]:
    """Return the terms of METHOD 6.3 and 6.4 by their names in LabelTerms.

    Args:
        columns: of all cells.
        answer: (L, 6) codes of the matched records.
        earliest: (C,) the row of each cell's earliest label.
        thresholds: for the credit of adjacent classes.
    """
    truth = columns.labels.truth
    evaluable = truth != NOTHING
    masked = earliest[~columns.first_frame_dynamics]
    evaluable[masked[:, None], _DYNAMIC] = False
    has_answer = evaluable & (answer[:, : len(SLOTS)] != NOTHING)
    hard, soft = np.zeros(truth.shape), np.zeros(truth.shape)
    for slot, (hard_table, soft_table) in enumerate(_score_tables(thresholds.soft_credit)):
        index = (answer[:, slot], truth[:, slot])
        hard[:, slot] = np.where(evaluable[:, slot], hard_table[index], 0.0)
        soft[:, slot] = np.where(evaluable[:, slot], soft_table[index], 0.0)
    interaction = np.logical_and.reduce([evaluable[:, slot] for slot in _INTERACTION])
    correct = np.logical_and.reduce([hard[:, slot] == 1.0 for slot in _INTERACTION])
    return {
        "evaluable": evaluable,
        "given": has_answer,
        "hard": hard,
        "soft": soft,
        "interaction_evaluable": interaction,
        "interaction_correct": interaction & correct,
    }


RISKY_CONFLICTS = ("potential", "active")
DEFENSIVE_ACTIONS = ("decelerate", "stop")
# By code; NOTHING, which is -1, picks the last item.
_RISKY = np.array([word in RISKY_CONFLICTS for word in (*CONFLICTS, None)])
_DEFENSIVE = np.array([word in DEFENSIVE_ACTIONS for word in (*LON_ACTIONS, None)])


@dataclass(frozen=True, eq=False)
class LabelTerms:
    """The terms of a cell, one row per label in time order; a missing output is 0 everywhere.

    Args:
        record: (N,) row of the label's record (6.1), NOTHING without one.
        matched: (N,) the label has a record (6.1).
        text_valid: (N,) v_txt (5.3).
        trajectory_valid: (N,) v_trj (5.3, 5.4).
        answer: (N, 6) codes of the slots where z = 1, else NOTHING (5.3).
        lon, lat: (N,) codes of the inferred actions, NOTHING where v_trj = 0 (6.6).
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

    record: Whole
    matched: Flags
    text_valid: Flags
    trajectory_valid: Flags
    answer: Whole
    lon: Whole
    lat: Whole
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
        """Return N, the number of labels."""
        return len(self.matched)

    def term(self, name: str) -> np.ndarray:
        """Return each label's addend to a sum of METRICS, (N,), its slots together (6.11)."""
        if name == LABELS:
            return np.ones(len(self), dtype=np.int64)
        column: np.ndarray = getattr(self, name)
        return column if column.ndim == 1 else column.sum(axis=1)


def allowed(action: Whole, bits: Whole) -> Flags:
    """Tell whether an action's code is in the set whose bits a label allows; NOTHING never is."""
    result: Flags = (action != NOTHING) & ((bits >> np.maximum(action, 0)) & 1 == 1)
    return result


def risky(conflict: Whole) -> Flags:
    """Tell whether a label's conflict admits a candidate of METHOD 6.9."""
    result: Flags = _RISKY[conflict]
    return result


def slows_down(lon: Whole) -> Flags:
    """Tell whether an inferred action is one of those that METHOD 6.9 calls defensive."""
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

    rows: LabelTerms
    start: Whole
    risk_onset_s: Numbers

    def cell(self, number: int) -> LabelTerms:
        """Return the terms of one cell."""
        part = slice(int(self.start[number]), int(self.start[number + 1]))
        names = [item.name for item in fields(LabelTerms) if item.name != "risk_onset_s"]
        views = {name: getattr(self.rows, name)[part] for name in names}
        return replace(self.rows, **views, risk_onset_s=float(self.risk_onset_s[number]))


def batch_terms(columns: Columns, thresholds: Thresholds = DEFAULT) -> BatchTerms:
    """Return the terms of METHOD 6.2 to 6.9 of every label of every cell."""
    labels, records, start = columns.labels, columns.records, columns.label_start
    pairing = match_columns(columns, thresholds)
    motion = driven(records, thresholds)

    def paired(column: np.ndarray, missing: float) -> np.ndarray:
        """Return a record's column beside the labels; NOTHING, which is -1, takes its last item."""
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
    right_lon = allowed(lon, labels.lon_allowed)
    text_valid = paired(records.text_valid, False)
    rows = LabelTerms(
        record=pairing,
        matched=pairing != NOTHING,
        text_valid=text_valid,
        trajectory_valid=valid,
        answer=answer,
        lon=lon,
        lat=lat,
        output_valid=valid & text_valid,
        **semantics(columns, answer, start[:-1], thresholds),
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


def response_begins(
    terms: LabelTerms, thresholds: Thresholds = DEFAULT, start: Whole | None = None
) -> Flags:
    """Tell which labels begin a risk response in the recording (METHOD 6.9).

    That is where K consecutive candidates, the first of them this label's record, are defensive
    and each gap between them is > 0 and ≤ the limit. Labels that yield no candidate don't break
    a run.

    Args:
        terms: of the labels.
        thresholds: for K and the largest gap.
        start: (C + 1,) where a cell's labels begin; None: all are one cell's.

    Returns:
        (N,).
    """
    candidates = np.flatnonzero(terms.candidate)
    t_s, defensive = terms.record_t_s[candidates], terms.defensive[candidates]
    gap_s = np.diff(t_s)
    linked = (gap_s > 0) & thresholds.at_most(gap_s, thresholds.response_gap_s)
    if start is not None:
        cell = np.searchsorted(start, candidates, side="right")
        linked &= np.diff(cell) == 0
    begins = defensive.copy()
    for step in range(1, thresholds.response_count):
        begins[-step:] = False
        begins[:-step] &= linked[step - 1 :] & defensive[step:]
    result = np.zeros(len(terms), dtype=np.bool_)
    result[candidates] = begins
    return result


def cell_terms(
    labels: Labels, records: Sequence[BehaviourRecord], thresholds: Thresholds = DEFAULT
) -> LabelTerms:
    """Return the terms of one cell, see batch_terms."""
    return batch_terms(encode([(labels, records)]), thresholds).cell(0)


def responses(terms: BatchTerms, thresholds: Thresholds = DEFAULT) -> Whole:
    """Find per cell the label whose record begins its response.

    NOTHING without one (METHOD 6.9).
    """
    rows = np.flatnonzero(response_begins(terms.rows, thresholds, terms.start))
    cell = np.searchsorted(terms.start, rows, side="right") - 1
    result = np.full(len(terms.start) - 1, NOTHING)
    # The earliest label of a cell is written last.
    result[cell[::-1]] = rows[::-1]
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
        """Return the scores cell by cell, null as None."""
        columns = map(_nullable, self.values.values())
        return [CellMetrics(*values) for values in zip(*columns, strict=True)]


def score_columns(columns: Columns, thresholds: Thresholds = DEFAULT) -> Scores:
    """Return the scores of the cells of columns, in their order (METHOD 6.2 to 6.11)."""
    return score_terms(batch_terms(columns, thresholds), thresholds)


def score_terms(terms: BatchTerms, thresholds: Thresholds = DEFAULT) -> Scores:
    """Return the scores of cells whose terms are known, see score_columns."""
    rows, begin = terms.rows, terms.start[:-1]

    def total(name: str) -> np.ndarray:
        if name in ("hard", "soft"):
            return exact_totals(getattr(rows, name), terms.start)
        summed: np.ndarray = np.add.reduceat(rows.term(name), begin, dtype=np.int64)
        return summed

    sums = {name: total(name) for name in SUMMED}
    row = responses(terms, thresholds)
    responded = row != NOTHING
    latency_s = np.where(responded, rows.record_t_s[row] - terms.risk_onset_s, np.nan)
    metrics = ratios(sums)
    metrics |= {"rsr": responded.astype(np.int64), "rl_s": np.maximum(latency_s, 0.0)}
    metrics["ivcs"] = exact_sum(
        [weight * np.nan_to_num(metrics[name]) for name, weight in ivcs_weights(thresholds).items()]
    )
    matched = np.add.reduceat(rows.matched, begin, dtype=np.int64)
    return Scores(
        {
            "n": sums[LABELS],
            "matched": matched,
            **metrics,
            "semantic_denominator": sums["evaluable"],
            "cia_denominator": sums["interaction_evaluable"],
        }
    )


def _nullable(column: np.ndarray) -> list[float | None]:
    """Return an array as plain numbers, NaN as None."""
    values: list[float | None] = column.tolist()
    if column.dtype == np.float64:
        for place in np.flatnonzero(np.isnan(column)).tolist():
            values[place] = None
    return values


def score_cells(cells: Sequence[Cell], thresholds: Thresholds = DEFAULT) -> list[CellMetrics]:
    """Score many cells at once: what score_cell gives for each, without the details.

    Raises:
        ValueError: a cell has no label, or a word is of no vocabulary.
    """
    return score_columns(encode(cells), thresholds).cells() if cells else []
