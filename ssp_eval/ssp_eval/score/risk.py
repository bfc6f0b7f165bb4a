"""The response to the risk (METHOD 6.9)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from ssp_eval.labels.model import Label
from ssp_eval.score.thresholds import DEFAULT, Thresholds

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
