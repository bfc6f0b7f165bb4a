"""All that METHOD 6.2 to 6.9 ask about one label and its record, and the first failure (6.12)."""

from __future__ import annotations

from typing import NamedTuple

from ssp_eval.labels.model import Label
from ssp_eval.records import SLOT_NAMES, BehaviourRecord
from ssp_eval.score.motion import feasible, lat_action, lon_action, measure
from ssp_eval.score.risk import is_candidate, is_defensive
from ssp_eval.score.semantics import (
    SlotScore,
    interaction_correct,
    interaction_evaluable,
    score_slots,
)
from ssp_eval.score.thresholds import Thresholds
from ssp_eval.score.validity import Value, answers, readable_length

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
