"""The firing of a trigger: nested conditions, edges and holding, over the states as they arrive.

**Truth.** At every judged state each single condition is true, false or unknown. Between two states
its truth changes at most once, at the instant that ``conditions`` gives; unknown lasts until the
next state. ``all`` is false if one of its parts is, else unknown if one of them is, else true;
``any`` is true if one of its parts is, else unknown if one of them is, else false. So the whole is
a function of time, with changes at the instants of its parts: where ``all`` becomes true, that is
the latest of its parts' instants, where ``any`` does, the earliest. Changes at the same nanosecond
are one.

**Firing.** Counted are states from ``not_before_s`` after the start of the run; what was before is
forgotten. A trigger fires at the first counted state at which its condition holds and has held
since at least ``held_for_s``, without a gap between states either. With edge ``rising`` it must
have been known to be false at some counted instant before; with ``falling`` everything is asked of
the opposite: it fails, has failed for ``held_for_s``, and was true before. Unknown interrupts the
holding, and is no edge.

**Phases.** A phase is confirmed some time after it began, and counts from when it began. What was
decided before isn't taken back; what is decided from then on goes by the corrected past.

**Order.** A state that isn't newer than the last judged one changes nothing, and a trigger fires
once.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.geometry import Polyline
from ssp_core.run_file.participants import AllOf, AnyOf, Condition, PhaseReached, TriggerSpec
from ssp_scenario_manager.triggers.conditions import (
    Quantity,
    Question,
    Reading,
    Sample,
    Snapshot,
    condition_text,
    leaves,
    question,
)


@dataclass(frozen=True, slots=True)
class Firing:
    """Decision record: what made a trigger fire, and when.

    Args:
        crossing_ns: from when the condition has held.
        fired_ns: stamp of the state at which it had held long enough.
        condition: for people; of nested ones with the values of all at ``fired_ns``, and from when
            each has been as it is.
        threshold: of the single condition that decided: whose change made the whole hold, the first
            of them in the file; of what held from the first, the first that holds.
        samples: of that condition, the two that bracket its change; one where it held from the
            first.
    """

    crossing_ns: int
    fired_ns: int
    condition: str
    threshold: float
    samples: tuple[Sample, ...]


@dataclass(frozen=True, slots=True)
class _Change:
    """The truth of a single condition from an instant on.

    ``order`` is twice the instant in ns, one more for a change right after a state at that instant.
    """

    order: int
    index: int
    holds: bool | None
    samples: tuple[Sample, ...]


def truth(condition: Condition, holds: Sequence[bool | None]) -> bool | None:
    """Return the truth of a condition from that of its single ones; None: unknown.

    Args:
        condition: any condition.
        holds: truth of each single condition, in the order of the file; None: unknown.
    """
    return _truth(condition, iter(holds))


def _truth(condition: Condition, holds: Iterator[bool | None]) -> bool | None:
    if not isinstance(condition, AllOf | AnyOf):
        return next(holds)
    parts = [_truth(part, holds) for part in condition.of]
    decides = isinstance(condition, AnyOf)
    if decides in parts:
        return decides
    return None if None in parts else not decides


class _Tracker:
    """Truth of the whole, followed through the changes of its single conditions.

    The first changes that it takes are those of all of them.
    """

    __slots__ = ("_condition", "_target_truth", "cause", "holds", "opposite_seen", "parts", "since")

    def __init__(self, condition: Condition, target_truth: bool) -> None:
        self._condition = condition
        self._target_truth = target_truth
        self.parts: dict[int, _Change] = {}
        self.holds: bool | None = None
        self.since = 0
        self.cause: _Change | None = None
        self.opposite_seen = False

    def take(self, changes: Sequence[_Change]) -> None:
        """Take changes of one instant, which isn't before any that was taken."""
        for change in changes:
            self.parts[change.index] = change
        holds = truth(self._condition, [part.holds for part in self.parts.values()])
        if holds is not self.holds:
            self.holds, self.since = holds, changes[0].order // 2
            self.cause = next((c for c in changes if c.holds is holds), None)
        self.opposite_seen |= holds is (not self._target_truth)


class TriggerWatch:
    """One trigger of a run, fed with a snapshot per state of the VUT.

    Args:
        path: the VUT's planned path, frame map.
        started_ns: session time at which the run started.
    """

    def __init__(self, spec: TriggerSpec, path: Polyline, started_ns: int) -> None:
        self.spec = spec
        self.fired = False
        conditions = leaves(spec.condition)
        self.waits_for_phase = any(isinstance(leaf, PhaseReached) for leaf in conditions)
        self._questions: list[Question] = [question(leaf, path, started_ns) for leaf in conditions]
        self._text = condition_text(spec.condition)
        self._started_ns = started_ns
        self.begin_ns = started_ns + seconds_to_ns(spec.not_before_s)
        self._held_ns = seconds_to_ns(spec.held_for_s)
        self._target_truth = spec.edge != "falling"
        self._course = self._new_course()
        self._readings: list[Reading] = []
        self._first_ns = 0
        # Kept where a phase is asked about: only a phase begins before what was judged already.
        self._log: list[_Change] = []

    def _new_course(self) -> _Tracker:
        return _Tracker(self.spec.condition, self._target_truth)

    @property
    def values(self) -> list[tuple[Quantity, float]]:
        """Return each single condition's comparison, and its value at the last judged state."""
        return [
            (leaf_question.quantity, reading.sample.value)
            for leaf_question, reading in zip(self._questions, self._readings, strict=False)
        ]

    def observe(self, snapshot: Snapshot) -> Firing | None:
        """Judge the states of one instant; return None if it doesn't fire there."""
        stamp_ns = snapshot.stamp_ns
        if self.fired or stamp_ns < self.begin_ns:
            return None
        before = self._readings
        if before and stamp_ns <= before[0].sample.stamp_ns:
            return None
        self._readings = [one.read(snapshot) for one in self._questions]
        self._follow(self._changes(before))
        course = self._course
        if course.holds is not self._target_truth or stamp_ns - course.since < self._held_ns:
            return None
        if self.spec.edge != "none" and not course.opposite_seen:
            return None
        self.fired = True
        return self._firing(stamp_ns)

    def _changes(self, before: list[Reading]) -> list[_Change]:
        """List the changes since the last readings; of the first ones, everything."""
        if not before:
            self._first_ns = self._readings[0].sample.stamp_ns
            return [
                _Change(2 * now.sample.stamp_ns, i, now.holds, (now.sample,))
                for i, now in enumerate(self._readings)
            ]
        last_ns = before[0].sample.stamp_ns
        changes = []
        for i, (old, now) in enumerate(zip(before, self._readings, strict=True)):
            if now.holds is old.holds:
                continue
            instant_ns = self._questions[i].changed_ns(old, now)
            if now.since_ns is None:
                order = 2 * instant_ns + (instant_ns == last_ns)
            else:
                order = 2 * max(instant_ns, self._first_ns)
            changes.append(_Change(order, i, now.holds, (old.sample, now.sample)))
        return sorted(changes, key=_order)

    def _follow(self, changes: list[_Change]) -> None:
        if not changes:
            return
        if self.waits_for_phase:
            last_order = self._log[-1].order if self._log else None
            self._log = sorted([*self._log, *changes], key=_order)
            if last_order is not None and changes[0].order <= last_order:
                self._course = self._new_course()
                changes = self._log
        for _, group in itertools.groupby(changes, key=_order):
            self._course.take(list(group))

    def _firing(self, fired_ns: int) -> Firing:
        course = self._course
        cause = course.cause
        if cause is None:
            raise ValueError(f"trigger {self.spec.id} fired without a cause")
        return Firing(
            crossing_ns=course.since,
            fired_ns=fired_ns,
            condition=self._explained(),
            threshold=self._questions[cause.index].quantity.threshold,
            samples=cause.samples,
        )

    def _explained(self) -> str:
        """Describe the condition; a nested one with every value and when each became what it is."""
        spec = self.spec
        text = self._text
        if isinstance(spec.condition, AllOf | AnyOf):
            parts = [self._part(i) for i in range(len(self._questions))]
            text = _condition_report(spec.condition, iter(parts))
        if spec.edge != "none":
            text += f", {spec.edge}"
        if self._held_ns:
            text += f", held for {spec.held_for_s:g} s"
        return text

    def _part(self, index: int) -> str:
        leaf_question, reading = self._questions[index], self._readings[index]
        since_ns = self._course.parts[index].order // 2
        word = {True: "holds", False: "fails", None: "unknown"}[reading.holds]
        return (
            f"{leaf_question.quantity.text} ({reading.sample.value:.3f} "
            f"{leaf_question.quantity.unit}, {word} "
            f"since {ns_to_seconds(since_ns - self._started_ns):.3f} s)"
        )


def _condition_report(condition: Condition, parts: Iterator[str]) -> str:
    if not isinstance(condition, AllOf | AnyOf):
        return next(parts)
    inner = "; ".join(_condition_report(part, parts) for part in condition.of)
    return f"{condition.type} of ({inner})"


def _order(change: _Change) -> int:
    return change.order
