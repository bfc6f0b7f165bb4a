"""The limits of METHOD 8, in one object. They have no source but us."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ClosedLoopLimits:
    """Limits by which starts, outcomes and needless braking are judged.

    Args:
        steady_s: the VUT holds its approach speed so long before the hand-over.
        steady_mps: by which its speed may differ meanwhile.
        asked_mps: by which the speeds at the first frame asked about and at the hand-over may
            differ, where the run-up leaves the choice.
        before_trigger_s: from the hand-over to the first trigger at least.
        history_s: longest history of a driver.
        after_s: a run goes on for so long after the twin's contact or resolution.
        handed_mps: by which the VUT may be off its twin at the hand-over.
        handed_m: as handed_mps.
        standing_mps: a VUT that is struck drives no faster.
        opposite_m: depth in a lane of opposite direction.
        opposite_s: for how long.
        back_m: net motion backwards.
        fallback_s: of fallback and stale plans in all.
        evaded_share: of the twin's speed, by which the VUT is slower at T_obs.
        evaded_behind_m: behind the twin at T_obs.
        evaded_beside_m: beside the twin at T_obs.
        response_mps: difference from the twin that is a response.
        response_m: lateral difference from the twin that is a response.
        response_s: for how long.
        needless_mps2: deceleration in the event-free twin.
        needless_s: for how long.
        progress_share: of the built-in driver's way in the event-free twin.
        harness_share: of a driver's runs, above which it has no rates.
        contact_mps: by which `constant_velocity` may be off the twin's speed of contact.
    """

    steady_s: float = 1.0
    steady_mps: float = 0.03
    asked_mps: float = 0.003
    before_trigger_s: float = 0.5
    history_s: float = 1.7
    after_s: float = 5.0
    handed_mps: float = 0.5
    handed_m: float = 0.3
    standing_mps: float = 0.1
    opposite_m: float = 0.3
    opposite_s: float = 0.2
    back_m: float = 0.5
    fallback_s: float = 0.5
    evaded_share: float = 0.1
    evaded_behind_m: float = 3.0
    evaded_beside_m: float = 0.5
    response_mps: float = 0.5
    response_m: float = 0.3
    response_s: float = 0.3
    needless_mps2: float = 2.0
    needless_s: float = 0.2
    progress_share: float = 0.8
    harness_share: float = 0.02
    contact_mps: float = 0.05


LIMITS = ClosedLoopLimits()
EPSILON_S = 1e-9
