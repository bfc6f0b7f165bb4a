"""The effect of each cause on each part of an answer, beside its irrelevant control."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from statistics import fmean

import numpy as np

from ssp_eval.causes.answers import REASONING, Answer, Asked, Cause, cause_of
from ssp_eval.data.records import SLOT_NAMES
from ssp_eval.statistics.comparisons import step_down
from ssp_eval.statistics.paired import (
    Shares,
    Test,
    hodges_lehmann,
    mcnemar,
    paired_difference,
    rate_interval,
    signed_rank,
)
from ssp_eval.statistics.resampling import LEVEL, NO_INTERVAL, Interval
from ssp_vla_bridge.trajectory import Trajectory

TRAJECTORY = "trajectory"
OUTPUTS = (*SLOT_NAMES, TRAJECTORY)
ALPHA = 1.0 - LEVEL
# Trajectories are compared up to here, or to the end of the shortest.
HORIZON_S, STEP_S = 3.0, 0.25
# Per metre of a shorter trajectory any displacement is huge.
LEAST_LENGTH_M = 1.0
# Rounding of coordinates in text files, not a change of plan.
SAME_M = 1e-6
# Within so much of the control, by its interval, a cause is called without effect.
MARGIN_SHARE, MARGIN_M = 0.2, 0.1


class Verdict(Enum):
    """What is known of an effect."""

    MOVED = "moved"  # more than the control, by the test after Holm's correction
    LESS = "less than the control"  # the same, the other way
    SEEN = "differs, untested"  # more than the control, in too few recordings for any test
    UNCONTROLLED = "differs, no control"
    NONE = "no effect"  # never differs, or its interval lies within the margin
    OPEN = "not shown"
    NOT_GIVEN = "not given"  # the model doesn't say such a thing


@dataclass(frozen=True)
class Effect:
    """What one cause does to one part of a model's answers.

    Args:
        output: a slot, or TRAJECTORY.
        control: condition of the irrelevant change beside; empty: there is none.
        recordings: units; labels: label times in them at which all answers are there.
        given: share of the answers that have this part.
        changed: mean over recordings of the share of label times at which the answer differs from
            the factual one; of a trajectory its displacement, m.
        changed_by_control: the same of the control, None without one.
        size: the difference of both shares; of trajectories Hodges and Lehmann's estimate of the
            difference of displacements, m. Without a control it is the effect itself.
        per_metre: as size, over the factual trajectory's length, m/m.
        p_holm: over all tests of the model in which anything differs.
        decidable: with so many recordings and tests p_holm could be at most 5 %.
    """

    model: str
    cause: Cause
    output: str
    control: str
    recordings: int
    labels: int
    given: float
    changed: float | None
    changed_by_control: float | None
    size: float | None
    interval: Interval = NO_INTERVAL
    per_metre: float | None = None
    per_metre_interval: Interval = NO_INTERVAL
    test: Test | None = None
    p_holm: float | None = None
    decidable: bool = False

    @property
    def verdict(self) -> Verdict:
        """What is known of it."""
        if self.size is None or self.given == 0.0:
            return Verdict.NOT_GIVEN
        if not self.changed:
            return Verdict.NONE
        if self.test is None:
            return Verdict.UNCONTROLLED
        if self.p_holm is not None and self.p_holm <= ALPHA:
            return Verdict.MOVED if self.test.more > self.test.fewer else Verdict.LESS
        if self._is_small:
            return Verdict.NONE
        above = self.size > (MARGIN_M if self.output == TRAJECTORY else 0.0)
        is_seen = above and not self.decidable and self.test.more > 0 and self.test.fewer == 0
        return Verdict.SEEN if is_seen else Verdict.OPEN

    @property
    def _is_small(self) -> bool:
        margin = MARGIN_M if self.output == TRAJECTORY else MARGIN_SHARE
        low, high = self.interval.low, self.interval.high
        return low is not None and high is not None and -margin <= low and high <= margin


@dataclass(frozen=True)
class Triplet:
    """A label time: the factual answer, that to the cause, and that to the control.

    Args:
        control: None where there is no control.
    """

    factual: Answer
    cause: Answer
    control: Answer | None


def effects_of(cells: Iterable[Asked]) -> list[Effect]:
    """All effects, by model, cause and output; controls themselves are beside the causes.

    Label times at which one of the answers is missing are left out.
    """
    by_model: dict[str, list[Asked]] = {}
    for cell in cells:
        by_model.setdefault(cell.model, []).append(cell)
    return [one for model in sorted(by_model) for one in _of_model(model, by_model[model])]


def _of_model(model: str, cells: Sequence[Asked]) -> list[Effect]:
    found: list[Effect] = []
    causes = {cause for cell in cells if (cause := cause_of(cell.condition)) is not None}
    for cause in sorted(causes, key=lambda c: c.order):
        if not cause.is_control:
            control, units = triplets(cause, cells)
            # A text that was given back is no answer.
            outputs = (TRAJECTORY,) if cause.family == REASONING else OUTPUTS
            found += [_effect(model, cause, output, control, units) for output in outputs]
    return _corrected(found)


def triplets(cause: Cause, cells: Iterable[Asked]) -> tuple[str, list[list[Triplet]]]:
    """The triplets of each recording, and what the control is.

    A recording that was asked in several campaigns, or about several objects, is one unit. Where
    some recordings have a control, those without are left out.

    Args:
        cells: of one model.
    """
    listed = sorted(cells, key=lambda c: (*c.place, c.condition))
    factual = {cell.place: cell for cell in listed if not cell.condition}
    controls = {
        cell.place: cell
        for cell in listed
        if (found := cause_of(cell.condition)) and found.is_control and found.family == cause.family
    }
    with_control: dict[str, list[Triplet]] = {}
    without: dict[str, list[Triplet]] = {}
    name = ""
    for cell in listed:
        if cause_of(cell.condition) != cause or cell.place not in factual:
            continue
        before, control = factual[cell.place], controls.get(cell.place)
        kept = without if control is None else with_control
        name = name if control is None else control.condition
        for t_s, own in before.answers.items():
            other = cell.answers.get(t_s)
            beside = None if control is None else control.answers.get(t_s)
            if own is None or other is None or (control is not None and beside is None):
                continue
            kept.setdefault(before.recording, []).append(Triplet(own, other, beside))
    return (name, list(with_control.values())) if with_control else ("", list(without.values()))


def _effect(
    model: str, cause: Cause, output: str, control: str, units: Sequence[Sequence[Triplet]]
) -> Effect:
    if output == TRAJECTORY:
        return _of_trajectories(model, cause, control, units)
    place = SLOT_NAMES.index(output)
    said = [
        (t.factual.slots[place], t.cause.slots[place], t.control and t.control.slots[place])
        for unit in units for t in unit
    ]  # fmt: skip
    n, labels = len(units), len(said)
    given = fmean(any(v is not None for v in of) for of in said) if said else 0.0
    if not n:
        return Effect(model, cause, output, control, 0, 0, given, None, None, None)
    first = [_differing(unit, place, control=False) for unit in units]
    changed = fmean(float(one.mean()) for one in first)
    if not control:
        return Effect(
            model, cause, output, control, n, labels, given, changed, None, changed,
            rate_interval(changed, n),
        )  # fmt: skip
    second = [_differing(unit, place, control=True) for unit in units]
    each = [Shares.of(a, b) for a, b in zip(first, second, strict=True)]
    # A recording in which the cause changes more label times than the control does is one pair.
    more = sum(one.difference > SAME_M for one in each)
    fewer = sum(one.difference < -SAME_M for one in each)
    mean = Shares.mean(each)
    return Effect(
        model, cause, output, control, n, labels, given, changed, mean.both + mean.second,
        mean.difference, paired_difference(mean, n), test=mcnemar(more, fewer),
    )  # fmt: skip


def _differing(unit: Sequence[Triplet], place: int, control: bool) -> np.ndarray:
    """(L,) whether a slot differs from the factual answer's."""
    others = [t.control if control else t.cause for t in unit]
    return np.array(
        [
            other is not None and other.slots[place] != t.factual.slots[place]
            for t, other in zip(unit, others, strict=True)
        ]
    )


def _of_trajectories(
    model: str, cause: Cause, control: str, units: Sequence[Sequence[Triplet]]
) -> Effect:
    moved_m: list[tuple[float, float]] = []
    per_metre: list[float] = []
    labels, total = 0, sum(map(len, units))
    for unit in units:
        found = [one for triplet in unit if (one := _displacements(triplet)) is not None]
        if not found:
            continue
        labels += len(found)
        moved_m.append((fmean(f[0] for f in found), fmean(f[1] for f in found)))
        relative = [(b - c) / length for b, c, length in found if length >= LEAST_LENGTH_M]
        if relative:
            per_metre.append(fmean(relative))
    n, given = len(moved_m), labels / total if total else 0.0
    if not n:
        return Effect(model, cause, TRAJECTORY, control, 0, 0, given, None, None, None)
    differences = [_whole(b - c) for b, c in moved_m]
    size, interval = hodges_lehmann(differences)
    share, share_interval = hodges_lehmann(per_metre)
    return Effect(
        model, cause, TRAJECTORY, control, n, labels, given, _whole(fmean(b for b, _ in moved_m)),
        fmean(c for _, c in moved_m) if control else None, size, interval, share, share_interval,
        signed_rank(differences) if control else None,
    )  # fmt: skip


def _whole(value_m: float) -> float:
    """Without rounding errors, so that equal displacements are equal."""
    return round(value_m / SAME_M) * SAME_M


def _displacements(triplet: Triplet) -> tuple[float, float, float] | None:
    """Mean distances of the cause's and the control's trajectory from the factual one, and its
    length, m; None where one is missing. Without a control its distance is 0.
    """
    paths = [triplet.factual.trajectory, triplet.cause.trajectory]
    if triplet.control is not None:
        paths.append(triplet.control.trajectory)
    known = [path for path in paths if path is not None]
    if len(known) < len(paths):
        return None
    end_s = min(HORIZON_S, *(path.t_s[-1] for path in known))
    times_s = np.arange(0.0, end_s + 1e-9, STEP_S)
    own, *others = (_at(path, times_s) for path in known)
    # At t = 0 all of them are where the vehicle is.
    moved = [float(np.hypot(*(other - own)[:, 1:]).mean()) for other in others]
    length_m = float(np.hypot(*np.diff(own, axis=1)).sum())
    return moved[0], moved[1] if len(moved) > 1 else 0.0, length_m


def _at(path: Trajectory, times_s: np.ndarray) -> np.ndarray:
    """(2, T) x and y, m."""
    return np.array(
        [np.interp(times_s, path.t_s, path.x_m), np.interp(times_s, path.t_s, path.y_m)]
    )


def _corrected(effects: Sequence[Effect]) -> list[Effect]:
    """With Holm's correction over a model's tests.

    A test in which no recording differs can't reject whatever the others say, and isn't counted
    (Tarone, Biometrics 46:515, 1990).
    """
    tested = [e.test if e.test is not None and e.test.p_least < 1.0 else None for e in effects]
    family = sum(test is not None for test in tested)
    corrected = step_down([None if test is None else test.p for test in tested])

    def can_decide(recordings: int) -> bool:
        return max(1, family) * 2.0 ** (1 - recordings) <= ALPHA

    return [
        replace(effect, p_holm=p, decidable=can_decide(effect.recordings))
        for effect, p in zip(effects, corrected, strict=True)
    ]


def largest(effects: Iterable[Effect]) -> Effect | None:
    """The clearest of some effects: the least p_holm, then the largest size."""
    return min(
        effects,
        key=lambda e: (1.0 if e.p_holm is None else e.p_holm, -(e.size or -math.inf), e.output),
        default=None,
    )
