"""Noise of recorded states: how far their places lie from where speeds put them.

States of a model of motion have none: each place follows from the one before it and the speeds of
both. Places that were measured and then smoothed keep some (docs/audit.md has figures).
"""

from __future__ import annotations

from collections.abc import Iterable
from statistics import median

import numpy as np

from ssp_eval.recordings.states import Sighting
from ssp_eval.recordings.tracks import MOVING_MPS

# Below it, states have no noise of measurement.
NONE_M = 1e-5
_LONGEST_STEP_S = 0.25
_FEWEST_STEPS = 40


def step_noises_m(sightings: Iterable[Sighting], ids: Iterable[str]) -> dict[str, float]:
    """Return the noise of the states that participants reported themselves, by id.

    It is the median over steps of ``|distance of the two places - mean of the two speeds * time|``,
    while the participant moves. One with fewer than 40 such steps is left out.
    """
    object_ids = frozenset(ids)
    rows: dict[str, dict[float, Sighting]] = {who: {} for who in sorted(object_ids)}
    for one in sightings:
        if one.source == one.object_id and one.object_id in object_ids:
            rows[one.object_id][one.t_s] = one
    noises_m = {}
    for who, by_time in rows.items():
        steps = _steps_m([by_time[t_s] for t_s in sorted(by_time)])
        if len(steps) >= _FEWEST_STEPS:
            noises_m[who] = median(steps)
    return noises_m


def _steps_m(states: list[Sighting]) -> list[float]:
    times_s, x_m, y_m, speeds_mps = (
        np.array([(one.t_s, one.x_m, one.y_m, abs(one.speed_mps)) for one in states])
        .reshape(-1, 4)
        .T
    )
    apart_s = np.diff(times_s)
    mean_mps = (speeds_mps[1:] + speeds_mps[:-1]) / 2.0
    wrong_m = np.abs(np.hypot(np.diff(x_m), np.diff(y_m)) - mean_mps * apart_s)
    mask = (apart_s <= _LONGEST_STEP_S) & (mean_mps > MOVING_MPS)
    return [float(value) for value in wrong_m[mask]]


def noise_text(noises_m: dict[str, float]) -> str:
    """Describe noises for people; empty: none is known."""
    return ", ".join(
        f"{who} none, as of a model" if noise_m < NONE_M else f"{who} {1000.0 * noise_m:.2g} mm"
        for who, noise_m in noises_m.items()
    )
