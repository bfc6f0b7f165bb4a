"""Whether labels let a model have a risk response."""

from __future__ import annotations

from itertools import pairwise

from ssp_eval.labels.model import Labels
from ssp_eval.recordings.crop import TOLERANCE_S
from ssp_eval.score import DEFAULT


def response_problems(labels: Labels) -> list[str]:
    """Why no model could get a risk response (METHOD 6.9) under these labels; empty if one can.

    It takes two labels, at or after risk onset, adjacent among those whose conflict is potential
    or active, that admit a defensive action and lie at most 0.6 s apart.
    """
    onset_s = labels.risk_onset_s
    defensive = {"decelerate", "stop"}
    candidates = [
        label
        for label in labels.labels
        if label.t_s >= onset_s - TOLERANCE_S and label.conflict in ("potential", "active")
    ]
    if len(candidates) < 2:
        return [
            f"only {len(candidates)} label(s) at or after the risk onset ({onset_s:g} s) have "
            "conflict potential or active; a risk response needs two"
        ]
    gaps_s = []
    for before, after in pairwise(candidates):
        if defensive.intersection(before.lon_actions) and defensive.intersection(after.lon_actions):
            gaps_s.append(after.t_s - before.t_s)
    if not gaps_s:
        return ["no two adjacent labels in the conflict admit decelerate or stop"]
    if not DEFAULT.at_most(min(gaps_s), DEFAULT.response_gap_s):
        return [
            f"labels in the conflict are {min(gaps_s):g} s apart; a risk response needs two at "
            f"most {DEFAULT.response_gap_s} s apart"
        ]
    return []
