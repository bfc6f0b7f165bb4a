"""The effect of each cause on each part of an answer, beside what changes it without a cause.

That is the noise: an irrelevant change (the control), and the factual question asked again after
all others (the repeat). A cause must do more than the larger of both.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from statistics import fmean

import numpy as np

from ssp_core.run_file.quantities import LENGTH
from ssp_eval.causes.answers import REASONING, Answer, Cause, CellAnswers, cause_of
from ssp_eval.data.records import SLOT_NAMES
from ssp_eval.evaluate.clients.models import REPEAT
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
    """The certainty of an effect."""

    MOVED = "moved"  # more than the noise, by the test after Holm's correction
    LESS = "less than the control"  # the same, the other way
    UNTESTED = "differs, untested"  # in too few recordings for any test, without any noise
    UNCONTROLLED = "differs, no control"
    UNREPEATED = "differs, not asked again"
    NONE = "no effect"  # never differs, or its interval lies within the margin
    OPEN = "not shown"
    NOT_GIVEN = "not given"  # the model doesn't say such a thing


@dataclass(frozen=True)
class Effect:
    """The effect of one cause on one part of a model's answers.

    Args:
        output: a slot, or TRAJECTORY.
        control: condition of the irrelevant change beside; empty: there is none.
        recordings: units; labels: label times in them at which all answers are there.
        coverage: share of the answers that have this part.
        changed: mean over recordings of the share of label times at which the answer differs from
            the factual one; of a trajectory its displacement, m.
        changed_by_control: the same of the control, None without one.
        changed_by_repeat: the same of the repeated question, None where it wasn't repeated.
        size: the difference from the larger of these two; of trajectories Hodges and Lehmann's
            estimate of the difference of displacements, m. Without a control it is the effect
            itself.
        per_metre: as size, over the factual trajectory's length, m/m.
        p_holm: over all tests of the model in which anything differs.
        decidable: with so many recordings and tests p_holm could be at most 5 %.
        quiet: control and repeat changed this part at no label time.
        alone: label times at which this cause changes this part.
        chances: of some cause and some part to differ as often as this one.
    """

    model: str
    cause: Cause
    output: str
    control: str
    recordings: int
    labels: int
    coverage: float
    changed: float | None
    changed_by_control: float | None
    size: float | None
    interval: Interval = NO_INTERVAL
    per_metre: float | None = None
    per_metre_interval: Interval = NO_INTERVAL
    test: Test | None = None
    p_holm: float | None = None
    decidable: bool = False
    changed_by_repeat: float | None = None
    quiet: bool = False
    alone: int = 0
    chances: int = 1

    @property
    def above_repeat(self) -> bool:
        """The repeated question does more than the control, and the cause is held against it."""
        return (self.changed_by_repeat or 0.0) > (self.changed_by_control or 0.0)

    @property
    def verdict(self) -> Verdict:
        """Return the certainty of the effect."""
        if self.size is None or self.coverage == 0.0:
            return Verdict.NOT_GIVEN
        if not self.changed:
            return Verdict.NONE
        if self.test is None:
            return Verdict.UNCONTROLLED
        if self.changed_by_repeat is None:
            return Verdict.UNREPEATED
        if self.p_holm is not None and self.p_holm <= ALPHA:
            if self.test.more > self.test.fewer:
                return Verdict.MOVED
            return Verdict.OPEN if self.above_repeat else Verdict.LESS
        if self._is_small:
            return Verdict.NONE
        above = self.size > (MARGIN_M if self.output == TRAJECTORY else 0.0)
        return Verdict.UNTESTED if above and not self.decidable and self._is_clear else Verdict.OPEN

    @property
    def _is_clear(self) -> bool:
        """Tell whether there is an effect without noise, at more label times than by chance.

        Of an answer that comes from nothing that was shown, the one that differs is the factual
        one, the control's or the cause's with the same chance, since they take turns: m times in a
        row it is the cause's with the chance 3^−m.
        """
        return self.quiet and self.chances * 3.0**-self.alone <= ALPHA

    @property
    def _is_small(self) -> bool:
        margin = MARGIN_M if self.output == TRAJECTORY else MARGIN_SHARE
        low, high = self.interval.low, self.interval.high
        return low is not None and high is not None and -margin <= low and high <= margin


@dataclass(frozen=True)
class AnswerComparison:
    """A label time: the factual answer, and those to the cause, the control and the repeat.

    Args:
        control: None where there is no control.
        repeat: None where the factual question wasn't asked again.
    """

    factual: Answer
    cause: Answer
    control: Answer | None
    repeat: Answer | None = None

    @property
    def noise(self) -> list[Answer]:
        """The answers that nothing should have changed."""
        return [one for one in (self.control, self.repeat) if one is not None]


def effects_of(cells: Iterable[CellAnswers]) -> list[Effect]:
    """Return all effects, by model, cause and output; controls themselves are beside the causes.

    Label times at which one of the answers is missing are left out.
    """
    by_model: dict[str, list[CellAnswers]] = {}
    for cell in cells:
        by_model.setdefault(cell.model, []).append(cell)
    return [one for model in sorted(by_model) for one in _of_model(model, by_model[model])]


def _of_model(model: str, cells: Sequence[CellAnswers]) -> list[Effect]:
    effects: list[Effect] = []
    causes = {cause for cell in cells if (cause := cause_of(cell.condition)) is not None}
    non_controls = sorted((c for c in causes if not c.is_control), key=lambda c: c.order)
    compared = [(cause, *compared_answers(cause, cells)) for cause in non_controls]
    controlled = sum(bool(control) for _, control, _ in compared)
    for cause, control, units in compared:
        # A text that was given back is no answer.
        outputs = (TRAJECTORY,) if cause.family == REASONING else OUTPUTS
        labels = [label for unit in units for label in unit]
        quiet = {output: all(_is_quiet(one, output) for one in labels) for output in outputs}
        # Where nothing at all was noise, a part that differs was no choice among them.
        chances = controlled * (1 if all(quiet.values()) else len(outputs))
        for output in outputs:
            effect = _effect(model, cause, output, control, units)
            effects.append(replace(effect, quiet=quiet[output], chances=chances))
    return _corrected(effects)


def compared_answers(
    cause: Cause, cells: Iterable[CellAnswers]
) -> tuple[str, list[list[AnswerComparison]]]:
    """Choose the answers to compare for each recording, and the control.

    A recording that was asked in several campaigns, or about several objects, is one unit. Where
    some recordings have a control, those without are left out; of those left, the same with the
    repeated question.

    Args:
        cause: whose answers are compared with the factual ones.
        cells: of one model.
    """
    listed = sorted(cells, key=lambda c: (*c.place, c.condition))
    factual = {cell.place: cell for cell in listed if not cell.condition}
    repeats = {cell.place: cell for cell in listed if cell.condition == REPEAT}
    controls = {
        cell.place: cell
        for cell in listed
        if (own_cause := cause_of(cell.condition))
        and own_cause.is_control
        and own_cause.family == cause.family
    }
    groups: dict[tuple[bool, bool], dict[str, list[AnswerComparison]]] = {}
    name = ""
    for cell in listed:
        if cause_of(cell.condition) != cause or cell.place not in factual:
            continue
        before = factual[cell.place]
        noise = [controls.get(cell.place), repeats.get(cell.place)]
        name = name if noise[0] is None else noise[0].condition
        group = groups.setdefault((noise[0] is not None, noise[1] is not None), {})
        for t_s, own in before.answers.items():
            other = cell.answers.get(t_s)
            beside = [None if one is None else one.answers.get(t_s) for one in noise]
            lacks = any(n is not None and b is None for n, b in zip(noise, beside, strict=True))
            if own is None or other is None or lacks:
                continue
            group.setdefault(before.recording, []).append(AnswerComparison(own, other, *beside))
    has = max((key for key, units in groups.items() if units), default=(False, False))
    return (name if has[0] else ""), [*groups.get(has, {}).values()]


def _is_quiet(label: AnswerComparison, output: str) -> bool:
    """Control and repeat are there, and this part of them is that of the factual answer."""
    if label.control is None or label.repeat is None:
        return False
    own = label.factual
    if output == TRAJECTORY:
        return all(_is_same_path(own.trajectory, one.trajectory) for one in label.noise)
    place = SLOT_NAMES.index(output)
    return all(one.slots[place] == own.slots[place] for one in label.noise)


def _is_same_path(own: Trajectory | None, other: Trajectory | None) -> bool:
    if own is None or other is None:
        return own is other
    return _distances_m([own, other])[0] <= MARGIN_M


def _effect(
    model: str, cause: Cause, output: str, control: str, units: Sequence[Sequence[AnswerComparison]]
) -> Effect:
    if output == TRAJECTORY:
        return _of_trajectories(model, cause, control, units)
    place = SLOT_NAMES.index(output)
    slot_values = [
        [one.slots[place] for one in (label.factual, label.cause, *label.noise)]
        for unit in units
        for label in unit
    ]
    n, labels = len(units), len(slot_values)
    answer_share = (
        fmean(any(v is not None for v in of) for of in slot_values) if slot_values else 0.0
    )
    if not n:
        return Effect(model, cause, output, control, 0, 0, answer_share, None, None, None)

    def differing(others: Callable[[AnswerComparison], Answer | None]) -> list[np.ndarray]:
        """Tell by recording (L,) whether the slot differs from the factual answer's."""
        return [
            np.array(
                [
                    (o := others(x)) is not None and o.slots[place] != x.factual.slots[place]
                    for x in unit
                ]
            )
            for unit in units
        ]

    first = differing(lambda label: label.cause)
    noise = [differing(lambda label: label.control), differing(lambda label: label.repeat)]
    changed, by_control, by_repeat = (
        fmean(float(one.mean()) for one in of) for of in (first, *noise)
    )
    repeated = by_repeat if units[0][0].repeat is not None else None
    alone = sum(int(one.sum()) for one in first)
    if not control:
        return Effect(
            model,
            cause,
            output,
            control,
            n,
            labels,
            answer_share,
            changed,
            None,
            changed,
            rate_interval(changed, n),
            changed_by_repeat=repeated,
            alone=alone,
        )
    second = noise[by_repeat > by_control]
    each = [Shares.of(a, b) for a, b in zip(first, second, strict=True)]
    # A recording in which the cause changes more label times than the noise does is one pair.
    more = sum(one.difference > SAME_M for one in each)
    fewer = sum(one.difference < -SAME_M for one in each)
    mean = Shares.mean(each)
    return Effect(
        model,
        cause,
        output,
        control,
        n,
        labels,
        answer_share,
        changed,
        by_control,
        mean.difference,
        paired_difference(mean, n),
        test=mcnemar(more, fewer),
        changed_by_repeat=repeated,
        alone=alone,
    )


def _of_trajectories(
    model: str, cause: Cause, control: str, units: Sequence[Sequence[AnswerComparison]]
) -> Effect:
    recordings: list[list[tuple[float, float, float, float]]] = []
    for unit in units:
        displacements = [one for label in unit if (one := _displacements(label)) is not None]
        if displacements:
            recordings.append(displacements)
    labels, total = sum(map(len, recordings)), sum(map(len, units))
    n, answer_share = len(recordings), labels / total if total else 0.0
    if not n:
        return Effect(model, cause, TRAJECTORY, control, 0, 0, answer_share, None, None, None)
    means = [[fmean(f[k] for f in of_unit) for of_unit in recordings] for k in range(3)]
    by_control, by_repeat = fmean(means[1]), fmean(means[2])
    # Without a control nothing is tested, and the effect stands by itself.
    at = 1 if not control or by_repeat <= by_control else 2
    differences = [_whole(b - c) for b, c in zip(means[0], means[at], strict=True)]
    per_metre = [
        fmean(relative)
        for of_unit in recordings
        if (relative := [(f[0] - f[at]) / f[3] for f in of_unit if f[3] >= LEAST_LENGTH_M])
    ]
    size, interval = hodges_lehmann(differences)
    share, share_interval = hodges_lehmann(per_metre)
    return Effect(
        model,
        cause,
        TRAJECTORY,
        control,
        n,
        labels,
        answer_share,
        _whole(fmean(means[0])),
        by_control if control else None,
        size,
        interval,
        share,
        share_interval,
        signed_rank(differences) if control else None,
        changed_by_repeat=by_repeat if units[0][0].repeat is not None else None,
        alone=sum(f[0] > MARGIN_M for of_unit in recordings for f in of_unit),
    )


def _whole(value_m: float) -> float:
    """Remove rounding errors, so that equal displacements are equal."""
    return round(value_m / SAME_M) * SAME_M


def _displacements(label: AnswerComparison) -> tuple[float, float, float, float] | None:
    """Return the mean distances of three trajectories from the factual one, and its length, m.

    The three are those of the cause, the control and the repeat. None where one is missing, or
    where one isn't comparable: a distance is beyond any two places on the Earth. What wasn't asked
    has the distance 0.
    """
    answers = (label.factual, label.cause, *label.noise)
    paths = [answer.trajectory for answer in answers if answer.trajectory is not None]
    if len(paths) < len(answers):
        return None
    distances_m = _distances_m(paths)
    if not all(distance_m <= LENGTH.most for distance_m in distances_m):
        return None
    by_cause, *others, length_m = distances_m
    by_control = others.pop(0) if label.control is not None else 0.0
    return by_cause, by_control, others[0] if others else 0.0, length_m


def _distances_m(paths: Sequence[Trajectory]) -> list[float]:
    """Return mean distances from the first trajectory, as long as all last, and its length, m.

    Infinite or NaN where coordinates are too large to be subtracted.
    """
    end_s = min(HORIZON_S, *(path.t_s[-1] for path in paths))
    times_s = np.arange(0.0, end_s + 1e-9, STEP_S)
    with np.errstate(over="ignore", invalid="ignore"):
        own, *others = (_at(path, times_s) for path in paths)
        # At t = 0 all of them are where the vehicle is.
        moved = [float(np.hypot(*(other - own)[:, 1:]).mean()) for other in others]
        return [*moved, float(np.hypot(*np.diff(own, axis=1)).sum())]


def _at(path: Trajectory, times_s: np.ndarray) -> np.ndarray:
    """Return x and y in m, shape (2, T)."""
    return np.array(
        [np.interp(times_s, path.t_s, path.x_m), np.interp(times_s, path.t_s, path.y_m)]
    )


def _corrected(effects: Sequence[Effect]) -> list[Effect]:
    """Apply Holm's correction over a model's tests.

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
    """Return the clearest of some effects: the least p_holm, then the largest size."""
    return min(
        effects,
        key=lambda e: (1.0 if e.p_holm is None else e.p_holm, -(e.size or -math.inf), e.output),
        default=None,
    )
