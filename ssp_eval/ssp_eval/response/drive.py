"""The VUT's drive in one recording: its braking, its key figures and the curve that is rated."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ssp_core.geometry import FloatArray, box_distance
from ssp_core.motion.corridor import Corridor
from ssp_core.motion.encounter import encounter
from ssp_core.motion.event import instants_of
from ssp_core.motion.state_series import Series
from ssp_eval.data.response import CurveEntry, Figure

# Both curves are sampled anew at this step, linearly between their states; no filter is applied.
STEP_S = 0.01
# The VUT decelerates where METHOD 6.6 says so: the change between the mean speeds of two steps.
DECELERATES_MPS2, DECELERATION_STEP_S = -0.5, 0.5
# It brakes where its acceleration falls below a share of the strongest one of a pair. Its braking
# is the first point below a share of its own strongest one, from there back to the crossing of a
# smaller share. Stronger braking doesn't deepen any of the three, but where the VUT is below the
# last of them from the beginning on, as with the engine's drag.
_STRONG_SHARE, _STRONG_MPS2 = 0.5, -3.0
_BRAKES_SHARE, _BRAKES_MPS2 = 0.9, -3.0
_BEGINS_SHARE, _BEGINS_MPS2 = 0.5, -1.0
# A comparison begins so long before the braking and ends at most so long after it.
BEFORE_S = 0.2
AFTER_S = 20.0
# No vehicle has more, even in an impact.
POSSIBLE_MPS2 = 1000.0
# A shorter common stretch after the braking says nothing.
SHORTEST_S = 0.5
_EPS = 1e-9


@dataclass(frozen=True)
class Drive:
    """The VUT's drive in one recording, at its states within the clip.

    Args:
        t_s: clip times, rising, shape (n,).
        acceleration_mps2: longitudinal, shape (n,).
        speed_mps: shape (n,).
        gap_m: bumper gap along the VUT's path to the OT of the event, NaN where it isn't there,
            isn't ahead, or isn't in the VUT's corridor, shape (n,); 0 where they touch.
        ttc_s: to it, +inf while not closing, NaN where it isn't there, shape (n,).
        touching: the outlines of the two overlap, shape (n,).
        trigger_s: clip time of the trigger; None: there is none.
        trigger_gap_m: bumper gap at the trigger, wherever the OT is; None: unknown.
    """

    t_s: FloatArray
    acceleration_mps2: FloatArray
    speed_mps: FloatArray
    gap_m: FloatArray
    ttc_s: FloatArray
    touching: FloatArray
    trigger_s: float | None
    trigger_gap_m: float | None = None

    @property
    def step_s(self) -> float:
        """The usual time between states."""
        return float(np.median(np.diff(self.t_s))) if len(self.t_s) > 1 else math.inf

    def at(self, values: FloatArray, t_s: float) -> float | None:
        """Return a value at a time; None where it isn't finite."""
        sample = float(np.interp(t_s, self.t_s, values))
        return sample if math.isfinite(sample) else None


@dataclass(frozen=True, slots=True)
class Braking:
    """The braking in one recording.

    Args:
        point_s: clip time of its first strong point.
        begins_mps2: the level at whose last crossing before that point it begins.
        start_s: clip time of that crossing; None: the recording begins below the level.
    """

    point_s: float
    begins_mps2: float
    start_s: float | None


def strong(drives: Sequence[Drive]) -> float | None:
    """Return the acceleration below which a drive brakes, m/s²; None if none decelerates.

    It follows the strongest of them, so that a gentle braking counts and noise beside it doesn't.
    """
    if not any(_decelerates(drive) for drive in drives):
        return None
    return max(_STRONG_MPS2, _STRONG_SHARE * min(map(_strongest, drives)))


def braking(drive: Drive, strong_mps2: float | None) -> Braking | None:
    """Find the braking of a drive; None: the VUT doesn't brake.

    The levels follow the drive's own strongest deceleration, so that they stay at the same instants
    when the whole braking is made weaker or stronger.

    Args:
        drive: of one recording.
        strong_mps2: acceleration that a braking falls below (strong).
    """
    own_mps2 = _strongest(drive)
    if strong_mps2 is None or own_mps2 >= strong_mps2:
        return None
    level_mps2 = max(_BRAKES_MPS2, _BRAKES_SHARE * own_mps2)
    i = int(np.flatnonzero(drive.acceleration_mps2 < level_mps2)[0])
    share_mps2 = _BEGINS_SHARE * own_mps2
    begins_mps2 = max(_BEGINS_MPS2, share_mps2)
    start_s = _crossing(drive, i, begins_mps2)
    if start_s is None and share_mps2 < begins_mps2:
        begins_mps2, start_s = share_mps2, _crossing(drive, i, share_mps2)
    return Braking(float(drive.t_s[i]), begins_mps2, start_s)


def _strongest(drive: Drive) -> float:
    return float(drive.acceleration_mps2.min(initial=0.0))


def _decelerates(drive: Drive) -> bool:
    """Tell whether the mean speeds of two successive steps fall by enough (METHOD 6.6)."""
    if len(drive.t_s) < 2:
        return False
    values = sampled(drive, drive.t_s[0], 0.0, float(drive.t_s[-1] - drive.t_s[0]))
    n = round(DECELERATION_STEP_S / STEP_S)
    # The second difference of places is the acceleration under a triangle of two steps.
    weights = np.concatenate([np.arange(1, n + 1), np.arange(n - 1, 0, -1)]) / n**2
    return bool(np.convolve(values, weights).min() <= DECELERATES_MPS2)


def start_before(drive: Drive, point_s: float, level_mps2: float) -> float | None:
    """Clip time at which a braking begins: the crossing of a level before a point of the braking.

    Returns:
        None where the VUT doesn't decelerate by as much there, or did so from its beginning on.
    """
    i = int(np.argmin(np.abs(drive.t_s - point_s)))
    return _crossing(drive, i, level_mps2) if drive.acceleration_mps2[i] < level_mps2 else None


def _crossing(drive: Drive, before: int, level_mps2: float) -> float | None:
    """Clip time of the last falling crossing of a level before a state."""
    a = drive.acceleration_mps2
    # A plateau at the level itself lies above it, whatever a factor leaves of its last digit.
    above = np.flatnonzero(a[:before] >= level_mps2 - _EPS)
    if not len(above):
        return None
    i = int(above[-1])
    share = (a[i] - level_mps2) / (a[i] - a[i + 1])
    return float(drive.t_s[i] + share * (drive.t_s[i + 1] - drive.t_s[i]))


def obstacle(drive: Drive, start_s: float | None, brakes: bool = True) -> str | None:
    """Return why a response can't be assessed; None where it can, or without any braking.

    Args:
        drive: of one recording.
        start_s: clip time at which its braking begins; None: there is no such time.
        brakes: whether it brakes.
    """
    if len(drive.t_s) < 2:
        return "has no states of the VUT"
    if drive.trigger_s is None:
        return "has no trigger"
    if (np.abs(drive.acceleration_mps2) > POSSIBLE_MPS2).any():
        return f"has states with more than {POSSIBLE_MPS2:g} m/s²"
    if start_s is None:
        return "brakes from its beginning on" if brakes else None
    if start_s - BEFORE_S < drive.t_s[0] - _EPS:
        return f"begins less than {BEFORE_S} s before its braking"
    if start_s + SHORTEST_S > drive.t_s[-1] + _EPS:
        return f"ends less than {SHORTEST_S} s after its braking began"
    return None


def sampled(drive: Drive, zero_s: float, first_s: float, last_s: float) -> FloatArray:
    """Return the acceleration at the common step, ``first_s`` to ``last_s`` from a clip time."""
    steps = np.arange(math.ceil(first_s / STEP_S - 1e-6), math.floor(last_s / STEP_S + 1e-6) + 1)
    values: FloatArray = np.interp(zero_s + STEP_S * steps, drive.t_s, drive.acceleration_mps2)
    return values


def curve(drive: Drive, start_s: float | None) -> CurveEntry | None:
    """Return the curve that is rated; None where it can't be assessed.

    Args:
        drive: of one recording.
        start_s: clip time at which the braking begins.
    """
    if start_s is None or drive.trigger_s is None or obstacle(drive, start_s) is not None:
        return None
    values = sampled(drive, start_s, -BEFORE_S, min(AFTER_S, float(drive.t_s[-1]) - start_s))
    return CurveEntry(
        trigger_s=drive.trigger_s,
        braking_s=start_s,
        from_s=-BEFORE_S,
        step_s=STEP_S,
        acceleration_mps2=[float(value) for value in values],
    )


def figure(drive: Drive, name: Figure, start_s: float | None) -> float | None:
    """Return a key figure of a recording whose braking begins at a clip time; None: undefined.

    ``ttc_at_braking`` at the braking's start; ``remaining_distance`` the smallest bumper gap from
    there on while the OT is ahead in the VUT's corridor; ``impact_speed`` the VUT's speed at the
    first state in which the outlines touch, 0 where they never do.
    """
    if start_s is None:
        return None
    if name == "ttc_at_braking":
        return drive.at(drive.ttc_s, start_s)
    later = drive.t_s >= start_s
    if name == "impact_speed":
        hits = np.flatnonzero(later & (drive.touching > 0.0))
        return float(drive.speed_mps[hits[0]]) if len(hits) else 0.0
    gaps = drive.gap_m[later & np.isfinite(drive.gap_m)]
    return float(gaps.min()) if len(gaps) else None


def drive_of(series: Series, vut: str, other: str | None, trigger_s: float | None) -> Drive:
    """Compute the drive of a recording's VUT, against the OT of its event.

    Args:
        series: states within the clip.
        vut: id of the VUT.
        other: the OT of the event; None: there is none.
        trigger_s: clip time of the trigger; None: there is none.
    """
    rows = [(t_s, states) for t_s, states in series if vut in states]
    states = [states[vut] for _, states in rows]
    gap_m, ttc_s = np.full(len(rows), math.nan), np.full(len(rows), math.nan)
    touching = np.zeros(len(rows))
    trigger_gap_m = None
    if other is not None and rows:
        corridor = Corridor.of(states)
        index = {t_s: i for i, (t_s, _) in enumerate(rows)}
        for instant in instants_of(rows, vut, other):
            i = index[instant.t_s]
            meeting = encounter(instant.vut, instant.other, corridor.path)
            ttc_s[i] = meeting.ttc_s
            if box_distance(instant.vut.box, instant.other.box) == 0.0:
                touching[i], gap_m[i] = 1.0, 0.0
            elif meeting.in_corridor and meeting.gap_m >= 0.0:
                gap_m[i] = meeting.gap_m
            if trigger_gap_m is None and trigger_s is not None and instant.t_s >= trigger_s:
                trigger_gap_m = meeting.gap_m
    return Drive(
        t_s=np.array([t_s for t_s, _ in rows]),
        acceleration_mps2=np.array([state.acceleration_mps2 for state in states]),
        speed_mps=np.array([state.speed_mps for state in states]),
        gap_m=gap_m,
        ttc_s=ttc_s,
        touching=touching,
        trigger_s=trigger_s,
        trigger_gap_m=trigger_gap_m,
    )


def no_drive() -> Drive:
    """Return the drive of a recording without states."""
    nothing = np.empty(0)
    return Drive(nothing, nothing, nothing, nothing, nothing, nothing, None)
