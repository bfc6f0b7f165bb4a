"""All that METHOD 6.2 to 6.9 ask about one label and its record, and the first failure (6.12)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from operator import attrgetter, itemgetter
from typing import NamedTuple

from ssp_eval.data.labels import Label
from ssp_eval.data.records import SLOT_NAMES, BehaviourRecord, Slot
from ssp_eval.score.motion import feasible, lat_action, lon_action, measure
from ssp_eval.score.thresholds import DEFAULT, Thresholds

Value = str | tuple[str, ...]

_slots = attrgetter(*SLOT_NAMES)
_NOTHING = (None,) * len(SLOT_NAMES)


def readable_length(record: BehaviourRecord | None) -> int:
    """How many characters can support a slot (METHOD 5.3); 0 says that v_txt = 0.

    That of a blank text is 0, whatever spaces it holds.
    """
    if record is None or not record.text.strip():
        return 0
    return len(record.text)


def answers(record: BehaviourRecord | None, length: int) -> tuple[Value | None, ...]:
    """The values of a record's six slots, None where z = 0 (METHOD 5.3): missing or unsupported.

    Args:
        record: an output, None for a missing one.
        length: see readable_length.
    """
    return _NOTHING if record is None else tuple([_answer(x, length) for x in _slots(record.slots)])


def _answer(slot: Slot | None, length: int) -> Value | None:
    if slot is not None:
        for start, end in slot.evidence:
            if 0 <= start < end <= length:
                return slot.value
    return None


def ratio(total: float, denominator: int) -> float | None:
    """total / denominator, and None (shown as ``–``) when the denominator is 0 (METHOD 6.11).

    A total of fractions is one of math.fsum, so that the order of its terms doesn't matter.
    """
    return total / denominator if denominator else None


SLOTS = ("objects", "position", "motion", "conflict")
DYNAMIC_SLOTS = ("motion", "conflict")
INTERACTION_SLOTS = ("objects", "position", "motion")
_truths = attrgetter(*SLOTS)
_interaction: Callable[[Mapping[str, SlotScore]], tuple[SlotScore, SlotScore, SlotScore]] = (
    itemgetter(*INTERACTION_SLOTS)
)

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


@dataclass(frozen=True)
class SlotScore:
    """One slot at one label.

    Args:
        evaluable: e of METHOD 6.3.
        given: z, the record gives a value with evidence.
        h: 0..1, 0 where nothing is given, None where the slot isn't evaluable.
        s: as h, with credit for adjacent classes.
        answer: the value that the record gives with evidence.
        truth: the label's value.
    """

    evaluable: bool
    given: bool
    h: float | None
    s: float | None
    answer: Value | None
    truth: Value | None


def object_f1(answer: Iterable[str], truth: Iterable[str]) -> float:
    """Set F1 = 2|Ô∩O| / (|Ô|+|O|), and 1 when both are empty (METHOD 6.3)."""
    given, true = set(answer), set(truth)
    if not given and not true:
        return 1.0
    return 2 * len(given & true) / (len(given) + len(true))


def hard_score(answer: Value, truth: Value) -> float:
    """h of METHOD 6.3: set F1 for a set of objects, exact match for a word."""
    if isinstance(answer, str) or isinstance(truth, str):
        return float(answer == truth)
    return object_f1(answer, truth)


def soft_score(answer: Value, truth: Value, credit: float) -> float:
    """s of METHOD 6.3: as h, but ``credit`` for adjacent classes."""
    if isinstance(answer, str) and isinstance(truth, str) and {answer, truth} in ADJACENT:
        return credit
    return hard_score(answer, truth)


@lru_cache(maxsize=1 << 14)
def score_slot(
    answer: Value | None, truth: Value | None, masked: bool, soft_credit: float
) -> SlotScore:
    """One slot (METHOD 6.3). Vocabularies are closed, so that few different ones ever come up.

    Args:
        answer: what the record gives with evidence, None where z = 0.
        truth: the label's value, None for null.
        masked: the slot isn't evaluable here, whatever the label says.
        soft_credit: s of adjacent classes.
    """
    given = answer is not None
    if truth is None or masked:
        return SlotScore(False, given, None, None, answer, truth)
    if answer is None:
        return SlotScore(True, False, 0.0, 0.0, None, truth)
    soft = soft_score(answer, truth, soft_credit)
    return SlotScore(True, True, hard_score(answer, truth), soft, answer, truth)


def score_slots(
    label: Label, answers: Sequence[Value | None], dynamics_masked: bool, soft_credit: float
) -> dict[str, SlotScore]:
    """The four slots of METHOD 6.3 at one label, by name.

    Args:
        label: what is true.
        answers: of the matched output in the order of SLOTS, None where z = 0; more are ignored.
        dynamics_masked: motion and conflict aren't evaluable here (the earliest label).
        soft_credit: s of adjacent classes.
    """
    return {
        name: score_slot(answer, truth, dynamics_masked and name in DYNAMIC_SLOTS, soft_credit)
        for name, answer, truth in zip(SLOTS, answers, _truths(label), strict=False)
    }


@dataclass(frozen=True)
class SemanticRatios:
    """The four ratios of METHOD 6.3 and their common denominator Σe."""

    coverage: float | None
    accuracy_conditional: float | None
    accuracy_effective: float | None
    accuracy_soft: float | None
    evaluable: int


def semantic_ratios(scores: Sequence[SlotScore]) -> SemanticRatios:
    """SemCov, SemAcc_cond, SemAcc_eff and SemAcc_soft over all slots of all labels (6.3)."""
    given = [score for score in scores if score.evaluable and score.given]
    hard = [score.h for score in given if score.h is not None]
    soft = [score.s for score in given if score.s is not None]
    e = sum([score.evaluable for score in scores])
    ez, ezh, ezs = len(given), math.fsum(hard), math.fsum(soft)
    return SemanticRatios(ratio(ez, e), ratio(ezh, ez), ratio(ezh, e), ratio(ezs, e), e)


def interaction_evaluable(slots: Mapping[str, SlotScore]) -> bool:
    """E of METHOD 6.4: objects, position and motion are all evaluable."""
    objects, position, motion = _interaction(slots)
    return objects.evaluable and position.evaluable and motion.evaluable


def interaction_correct(slots: Mapping[str, SlotScore]) -> bool:
    """C of METHOD 6.4: objects, position and motion are all given and exactly right."""
    objects, position, motion = _interaction(slots)
    return objects.h == position.h == motion.h == 1.0


RISKY_CONFLICTS = ("potential", "active")
DEFENSIVE_ACTIONS = ("decelerate", "stop")


@dataclass(frozen=True)
class Candidate:
    """A matched record that could be part of a response.

    Args:
        record: its index among the records.
        t_s: its clip time, s.
        defensive: whether it slows down where slowing down is right.
    """

    record: int
    t_s: float
    defensive: bool


@dataclass(frozen=True)
class Response:
    """The response of a cell.

    Args:
        record: index of the record that begins it, None if there is none.
        latency_s: RL = max(0, t_resp − t_r), s; None if there is none.
    """

    record: int | None
    latency_s: float | None

    @property
    def success(self) -> int:
        """RSR of one cell: 1 or 0."""
        return int(self.record is not None)


def is_candidate(
    label: Label, record_t_s: float, risk_onset_s: float, thresholds: Thresholds = DEFAULT
) -> bool:
    """Whether a matched record is a candidate: not before t_r, and the conflict is on (6.9)."""
    return thresholds.at_least(record_t_s, risk_onset_s) and label.conflict in RISKY_CONFLICTS


def is_defensive(label: Label, trajectory_lon: str | None) -> bool:
    """Whether an output is defensive: a valid trajectory slows down, rightly (6.9).

    Args:
        label: the matched label.
        trajectory_lon: inferred longitudinal action; None without a valid trajectory.
    """
    return trajectory_lon in DEFENSIVE_ACTIONS and trajectory_lon in label.lon_actions


def find_response(
    candidates: Sequence[Candidate], risk_onset_s: float, thresholds: Thresholds = DEFAULT
) -> Response:
    """The first candidate that begins K consecutive defensive ones, no gap too wide (6.9).

    Consecutive means adjacent in the list: labels that yield no candidate don't break a run.

    Args:
        candidates: in time order.
        risk_onset_s: t_r, clip time, s.
        thresholds: K and the widest gap.
    """
    for start in range(len(candidates) - thresholds.response_count + 1):
        run = candidates[start : start + thresholds.response_count]
        gaps_s = [after.t_s - before.t_s for before, after in pairwise(run)]
        if all(candidate.defensive for candidate in run) and all(
            gap_s > 0 and thresholds.at_most(gap_s, thresholds.response_gap_s) for gap_s in gaps_s
        ):
            return Response(run[0].record, max(0.0, run[0].t_s - risk_onset_s))
    return Response(None, None)


# The chain of METHOD 6.12, in its order.
STAGES = (
    "output_validity",
    "semantics",
    "critical_interaction",
    "action_commitment",
    "trajectory_quality",
    "consistency",
    "risk_response",
)


_LON, _LAT = SLOT_NAMES.index("lon_action"), SLOT_NAMES.index("lat_action")

# What h of a slot is that isn't missing or wrong: right, or not asked.
_RIGHT = {1.0, None}


class Judgement(NamedTuple):
    """One label with the output that was matched to it; a missing output fails everything.

    Args:
        label_t_s: clip time of the label, s.
        record: index of the matched record, None if there is none.
        record_t_s: its clip time, s.
        text_valid: v_txt (5.3).
        trajectory_valid: v_trj (5.3).
        slots: e, z, h, s and the values of the four semantic slots (6.3).
        interaction_evaluable: E (6.4).
        interaction_correct: C (6.4), False where E = 0.
        text_lon, text_lat: the actions that the text commits to with evidence, or None (6.5).
        trajectory_lon, trajectory_lat: the inferred actions, None if v_trj = 0 (6.6).
        feasible: F (6.6), None if v_trj = 0.
        action_correct: the term of ActAcc_eff (6.5).
        feasible_valid: the term of STFR (6.7).
        trajectory_correct: the term of TQSR (6.7).
        consistent: the term of ATC_eff (6.8).
        candidate: a candidate for the risk response (6.9).
        defensive: slows down where that is right (6.9), candidate or not.
        first_failure: the first stage of 6.12 that fails, None if none does.
    """

    label_t_s: float
    record: int | None
    record_t_s: float | None
    text_valid: bool
    trajectory_valid: bool
    slots: dict[str, SlotScore]
    interaction_evaluable: bool
    interaction_correct: bool
    text_lon: str | None
    text_lat: str | None
    trajectory_lon: str | None
    trajectory_lat: str | None
    feasible: bool | None
    action_correct: bool
    feasible_valid: bool
    trajectory_correct: bool
    consistent: bool
    candidate: bool
    defensive: bool
    first_failure: str | None


def judge(
    label: Label,
    record: BehaviourRecord | None,
    record_index: int | None,
    *,
    dynamics_masked: bool,
    risk_onset_s: float,
    thresholds: Thresholds,
) -> Judgement:
    """Judges one label (METHOD 6.2 to 6.9, 6.12).

    Args:
        label: what is true.
        record: the matched output, None for a missing one.
        record_index: its index among the records.
        dynamics_masked: motion and conflict aren't evaluable at this label (6.3).
        risk_onset_s: t_r, clip time, s.
        thresholds: all limits.
    """
    length = readable_length(record)
    motion = measure(record.trajectory, thresholds) if record is not None else None
    lon = lon_action(motion, thresholds) if motion is not None else None
    lat = lat_action(motion, thresholds) if motion is not None else None
    drivable = feasible(motion, thresholds) if motion is not None else None

    said = answers(record, length)
    slots = score_slots(label, said, dynamics_masked, thresholds.soft_credit)
    e_interaction = interaction_evaluable(slots)
    c_interaction = interaction_correct(slots)

    text_lon, text_lat = _action(said[_LON]), _action(said[_LAT])
    action_correct = text_lon in label.lon_actions and text_lat in label.lat_actions
    trajectory_correct = bool(drivable) and lon in label.lon_actions and lat in label.lat_actions
    consistent = (
        motion is not None
        and text_lon is not None
        and text_lat is not None
        and (text_lon, text_lat) == (lon, lat)
    )
    candidate = record is not None and is_candidate(label, record.t_s, risk_onset_s, thresholds)
    defensive = is_defensive(label, lon)

    # In the order of STAGES, whether each stage holds.
    held = (
        length > 0 and motion is not None,
        {slot.h for slot in slots.values()} <= _RIGHT,
        c_interaction or not e_interaction,
        action_correct,
        trajectory_correct,
        consistent,
        defensive or not candidate,
    )
    # By position, in the order of Judgement: names would cost as much as a whole trajectory.
    return Judgement(
        label.t_s,
        record_index,
        record.t_s if record is not None else None,
        length > 0,
        motion is not None,
        slots,
        e_interaction,
        c_interaction,
        text_lon,
        text_lat,
        lon,
        lat,
        drivable,
        action_correct,
        bool(drivable),
        trajectory_correct,
        consistent,
        candidate,
        defensive,
        None if all(held) else STAGES[held.index(False)],
    )


def _action(said: Value | None) -> str | None:
    """The word that a text commits to; a set of objects is none."""
    return said if isinstance(said, str) else None
