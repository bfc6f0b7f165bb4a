"""Did the VUT respond alike in two recordings? A second verdict beside that on the event.

Everything here is of one signal, the VUT's longitudinal acceleration, and of a few figures beside
it (docs/audit.md, "The same response"). It qualifies no event and scores no model.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from ssp_core.files.reading import load_model
from ssp_core.geometry import FloatArray
from ssp_core.vocabulary import DOMAINS
from ssp_eval.data.response import (
    CauseEntry,
    Figure,
    FigureEntry,
    Grade,
    Limit,
    PairEntry,
    RatingEntry,
    ResponseEntry,
    ResponseLimits,
)
from ssp_eval.response.drive import (
    AFTER_S,
    BEFORE_S,
    DECELERATES_MPS2,
    DECELERATION_STEP_S,
    SHORTEST_S,
    STEP_S,
    Drive,
    braking,
    curve,
    figure,
    obstacle,
    sampled,
    start_before,
    strong,
)
from ssp_eval.response.iso18571 import Rating, rate

# Delays up to this are looked for, in a window that ends so long after the braking has built up.
DELAY_S = 1.5
_HELD_S = 0.2
_BUILT_UP = 0.9
# Smaller differences aren't pointed out; a delay's bound is the step of the recorded states.
_NOTABLE_GAIN = 0.03
_NOTABLE_SPEED_MPS = 0.3
_NOTABLE_GAP_M = 0.5
_GRADES: tuple[tuple[float, Grade], ...] = ((0.94, "excellent"), (0.80, "good"), (0.58, "fair"))
_EPS = 1e-9
DEFAULT_LIMITS = Path(__file__).with_name("limits.yaml")
# Reference and comparison, as indices of Synthetic, Simulation, Physical. ISO/TS 18571 compares a
# computation with a test.
_PAIRS = ((2, 1), (0, 1), (0, 2))


def load_limits(path: Path = DEFAULT_LIMITS) -> ResponseLimits:
    """Read limits of responses.

    Raises:
        InputError: the file can't be read or isn't valid.
    """
    return load_model(ResponseLimits, path)


def respond(drives: Sequence[Drive], limits: ResponseLimits) -> ResponseEntry:
    """Compare Simulation with Physical, and each with Synthetic where that has states.

    Args:
        drives: of Synthetic, Simulation, Physical.
        limits: differences up to which responses count as alike.
    """
    pairs = [
        compare((DOMAINS[a], DOMAINS[b]), drives[a], drives[b], limits)
        for a, b in _PAIRS
        if a != 0 or len(drives[0].t_s)
    ]
    brakings = [braking(drive, strong([drive])) for drive in drives]
    starts = dict(zip(DOMAINS, (b.start_s if b else None for b in brakings), strict=True))
    # The first pair in which a recording is rated says where its curve is drawn from.
    for pair in reversed(pairs):
        if pair.braking_s is not None:
            starts |= zip((pair.reference, pair.comparison), pair.braking_s, strict=True)
    curves = {
        domain: curve(drive, starts[domain]) for domain, drive in zip(DOMAINS, drives, strict=True)
    }
    return ResponseEntry.model_validate(
        {
            "limits": limits.model_dump(by_alias=True),
            "curves": {domain: entry for domain, entry in curves.items() if entry is not None},
            "pairs": pairs,
        }
    )


@dataclass(frozen=True, slots=True)
class Delay:
    """The delay of the comparison behind the reference on time since the trigger.

    Args:
        lag_s: that maximises the correlation, + where the comparison is later; None: there is no
            maximum within the delays that were looked for.
        gain: of the comparison over the reference at that lag, by least squares through 0.
    """

    lag_s: float | None
    gain: float | None


def braking_starts(reference: Drive, comparison: Drive) -> tuple[float | None, float | None]:
    """Clip times at which the brakings of two drives begin; None: it doesn't brake.

    One of the two brakes by the definition, the reference if it does. The other's braking is the
    one that follows it best (delay): its start is the crossing of the level that is as many times
    as deep as its gain. A level of its own would have it start elsewhere, or nowhere, for a braking
    that is a little weaker. Where nothing follows, the definition holds for both.
    """
    drives = reference, comparison
    brakings = [braking(drive, strong(drives)) for drive in drives]
    starts = [None if b is None else b.start_s for b in brakings]
    first = 0 if brakings[0] is not None else 1
    leads, leader, other = brakings[first], drives[first], drives[1 - first]
    # Where the other one begins to brake is found below.
    if leads is None or obstacle(leader, leads.start_s) or obstacle(other, None, brakes=False):
        return starts[0], starts[1]
    follows = delay(leader, other, leads.start_s)
    if follows.lag_s is None or follows.gain is None:
        return starts[0], starts[1]
    if follows.gain > 0.0 and other.acceleration_mps2.min() < leads.begins_mps2:
        since_s = leads.point_s - (leader.trigger_s or 0.0) + follows.lag_s
        level_mps2 = leads.begins_mps2 * follows.gain
        start_s = start_before(other, (other.trigger_s or 0.0) + since_s, level_mps2)
        starts[1 - first] = starts[1 - first] if start_s is None else start_s
    return starts[0], starts[1]


def delay(reference: Drive, comparison: Drive, start_s: float | None) -> Delay:
    """Return the comparison's delay, and the gain there, over the reference's braking.

    The window is from the trigger until the braking has built up, so that a weaker or longer
    braking isn't taken for a later one; correlation doesn't ask for gain.

    Args:
        reference: the drive that is followed.
        comparison: the drive that may follow later.
        start_s: clip time at which the reference's braking begins; None: it doesn't brake.
    """
    nothing = Delay(None, None)
    if start_s is None or reference.trigger_s is None or comparison.trigger_s is None:
        return nothing
    first_s = min(0.0, start_s - BEFORE_S - reference.trigger_s)
    t, a = reference.t_s, reference.acceleration_mps2
    braking = t >= start_s
    built = t[braking & (a <= _BUILT_UP * a[braking].min())][0] + _HELD_S
    last_s = min(float(built), float(t[-1])) - reference.trigger_s
    window = sampled(reference, reference.trigger_s, first_s, last_s)
    here_s = comparison.t_s - comparison.trigger_s
    low = max(-DELAY_S, float(here_s[0]) - first_s)
    high = min(DELAY_S, float(here_s[-1]) - last_s)
    lags = np.arange(math.ceil(low / STEP_S - 1e-6), math.floor(high / STEP_S + 1e-6) + 1)
    if len(lags) < 3:
        return nothing
    reach = sampled(comparison, comparison.trigger_s, first_s + low, last_s + high)
    shifted = np.lib.stride_tricks.sliding_window_view(reach, len(window))[: len(lags)]
    own = window - window.mean()
    others = shifted - shifted.mean(axis=1, keepdims=True)
    spread = np.sqrt((others**2).sum(axis=1) * (own**2).sum())
    correlations = np.divide(
        others @ own, spread, out=np.full(len(shifted), -1.0), where=spread > 1e-6
    )
    # On a straight line every lag follows as well; the least of them needs no explanation.
    as_good = np.flatnonzero(correlations >= correlations.max() - _EPS)
    best = int(as_good[np.argmin(np.abs(lags[as_good]))])
    if best in (0, len(correlations) - 1) or correlations[best] <= 0.0:
        return nothing
    gain = float(shifted[best] @ window / (window @ window))
    return Delay(float(lags[best] * STEP_S), gain)


def compare(
    names: tuple[str, str], reference: Drive, comparison: Drive, limits: ResponseLimits
) -> PairEntry:
    """Return the verdict on one pair.

    Args:
        names: domains of reference and comparison.
        reference: the drive that the other is compared with.
        comparison: the other drive.
        limits: differences up to which responses count as alike.
    """
    drives = reference, comparison
    head = {"reference": names[0], "comparison": names[1]}
    strong_mps2, starts = strong(drives), braking_starts(reference, comparison)
    brake = [braking(drive, strong_mps2) is not None for drive in drives]
    whole = list(zip(names, drives, starts, brake, strict=True))
    why = [f"{name} {text}" for name, d, start_s, b in whole if (text := obstacle(d, start_s, b))]
    brakes = [start_s is not None for start_s in starts]
    if not why and not any(brakes):
        bound = f"{-DECELERATES_MPS2:g} m/s² over two steps of {DECELERATION_STEP_S:g} s"
        why = [f"neither brakes: each decelerates by less than {bound}"]
    if why:
        return PairEntry.model_validate({**head, "verdict": "not assessable", "why": why})
    if starts[0] is None or starts[1] is None:
        does, doesnt = names if brakes[0] else names[::-1]
        text = f"{does} brakes, {doesnt} never falls below {strong_mps2:.2g} m/s²"
        return PairEntry.model_validate({**head, "verdict": "unlike", "why": [text]})
    begin = starts[0], starts[1]
    follows = delay(reference, comparison, begin[0])
    aligned, common = _aligned(drives, begin), _on_common_clock(drives, begin)
    rating = _rated(*aligned)
    figures = [_figure(name, drives, begin, getattr(limits, name)) for name in _FIGURES]
    if rating.overall < limits.rating.limit:
        why.append(f"the rating {rating.overall:.2f} is below {limits.rating.limit:g}")
    why += [_outside(entry, names) for entry in figures if entry.within is False]
    without = None
    if follows.gain is not None and follows.gain > 0.0:
        without = _rated(aligned[0], aligned[1] / follows.gain)
    clock = None if common is None else _rated(*common)
    return PairEntry.model_validate(
        {
            **head,
            "verdict": "unlike" if why else "alike",
            "why": why,
            "rating": rating,
            "braking_s": begin,
            "on_common_clock": clock,
            "without_gain": without,
            "figures": figures,
            "causes": _causes(names, drives, follows, rating, clock, without),
        }
    )


_FIGURES: tuple[Figure, ...] = ("ttc_at_braking", "remaining_distance", "impact_speed")


def _aligned(
    drives: tuple[Drive, Drive], starts: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    ends = [float(drive.t_s[-1]) - start for drive, start in zip(drives, starts, strict=True)]
    last_s = min(AFTER_S, *ends)
    first, second = (
        sampled(drive, start, -BEFORE_S, last_s)
        for drive, start in zip(drives, starts, strict=True)
    )
    return first, second


def _on_common_clock(
    drives: tuple[Drive, Drive], starts: tuple[float, float]
) -> tuple[FloatArray, FloatArray] | None:
    """Return both over time since the trigger, from 0.2 s before the earlier braking."""
    spans = []
    for drive, start_s in zip(drives, starts, strict=True):
        zero_s = drive.trigger_s
        if zero_s is None:
            return None
        spans.append((drive.t_s[0] - zero_s, start_s - zero_s, drive.t_s[-1] - zero_s, zero_s))
    first_s = min(span[1] for span in spans) - BEFORE_S
    last_s = min(first_s + BEFORE_S + AFTER_S, *(span[2] for span in spans))
    braked_s = max(span[1] for span in spans) + SHORTEST_S
    if max(span[0] for span in spans) > first_s + _EPS or last_s < braked_s:
        return None
    first, second = (
        sampled(drive, span[3], first_s, last_s) for drive, span in zip(drives, spans, strict=True)
    )
    return first, second


def _rated(reference: FloatArray, comparison: FloatArray) -> RatingEntry:
    rating: Rating = rate(reference, comparison, STEP_S)
    return RatingEntry(**asdict(rating), grade=grade(rating.overall))


def grade(overall: float) -> Grade:
    """Return the grade that ISO/TS 18571 has for a rating."""
    return next((word for above, word in _GRADES if overall > above), "poor")


def _figure(
    name: Figure, drives: tuple[Drive, Drive], starts: tuple[float, float], limit: Limit
) -> FigureEntry:
    values = figure(drives[0], name, starts[0]), figure(drives[1], name, starts[1])
    difference = None if None in values else values[1] - values[0]  # type: ignore[operator]
    within = None if values == (None, None) else False
    if difference is not None:
        within = abs(difference) <= limit.limit + _EPS
    return FigureEntry(
        name=name,
        unit=limit.unit,
        reference=values[0],
        comparison=values[1],
        difference=difference,
        limit=limit.limit,
        within=within,
    )


def _outside(entry: FigureEntry, names: tuple[str, str]) -> str:
    what = entry.name.replace("_", " ").replace("ttc", "TTC")
    if entry.difference is None:
        return f"only {names[0] if entry.comparison is None else names[1]} has a {what}"
    return f"the {what} differs by {entry.difference:+.2f} {entry.unit}, limit {entry.limit:g}"


def _causes(
    names: tuple[str, str],
    drives: tuple[Drive, Drive],
    follows: Delay,
    rating: RatingEntry,
    clock: RatingEntry | None,
    without: RatingEntry | None,
) -> list[CauseEntry]:
    """List the explanations of a difference, with their cost in the rating where it is known."""
    reference, comparison = drives
    who, other = names[1], names[0]
    causes = []
    lag_s = follows.lag_s
    text = f"no delay within {DELAY_S:g} s makes {who} follow {other}"
    if lag_s is not None:
        text = f"{who} responds {abs(lag_s):.2f} s {'later' if lag_s >= 0 else 'earlier'}"
        if clock is not None:
            text += f"; rated since the trigger {clock.overall:.2f}, aligned {rating.overall:.2f}"
    coarse_s = max(STEP_S, *(drive.step_s for drive in drives))
    causes.append(
        CauseEntry(
            name="delay",
            value=lag_s,
            unit="s",
            text=text,
            notable=lag_s is None or abs(lag_s) >= coarse_s - _EPS,
        )
    )
    if follows.gain is not None:
        text = f"{who} builds up {follows.gain:.2f} times the deceleration of {other}"
        if without is not None:
            text += f"; with that taken out the rating is {without.overall:.2f}"
        causes.append(
            CauseEntry(
                name="gain",
                value=follows.gain,
                unit="",
                text=text,
                notable=abs(follows.gain - 1.0) >= _NOTABLE_GAIN,
            )
        )
    if reference.trigger_s is not None and comparison.trigger_s is not None:
        speeds = [d.at(d.speed_mps, d.trigger_s or 0.0) for d in drives]
        if speeds[0] is not None and speeds[1] is not None:
            off = speeds[1] - speeds[0]
            causes.append(
                CauseEntry(
                    name="initial_speed",
                    value=off,
                    unit="m/s",
                    text=f"at the trigger {who} is {abs(off):.2f} m/s "
                    f"{'faster' if off >= 0 else 'slower'}",
                    notable=abs(off) >= _NOTABLE_SPEED_MPS,
                )
            )
    if reference.trigger_gap_m is not None and comparison.trigger_gap_m is not None:
        off = comparison.trigger_gap_m - reference.trigger_gap_m
        causes.append(
            CauseEntry(
                name="initial_gap",
                value=off,
                unit="m",
                text=f"at the trigger the gap of {who} is {abs(off):.2f} m "
                f"{'larger' if off >= 0 else 'smaller'}",
                notable=abs(off) >= _NOTABLE_GAP_M,
            )
        )
    return causes
