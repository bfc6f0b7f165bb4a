"""Phase-aligned label times: one plan for all recordings of a scenario (METHOD 5.2b).

The plan says how many labels each phase has and where they lie in it; each recording's label times
follow from its own phases. So every recording has as many labels in each phase, however fast its
event runs.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

from ssp_core.errors import InputError
from ssp_core.motion.event import TOLERANCE_S
from ssp_core.vocabulary import PHASES
from ssp_eval.data.labels import PhasePosition
from ssp_eval.recordings.event import Crop
from ssp_eval.score.thresholds import DEFAULT

# At most so much between labels from the trigger to the end of the conflict (METHOD 6.9).
STEP_S = DEFAULT.response_gap_s
# At least so much between neighbours, more than the tolerance of METHOD 6.1.
APART_S = 0.2
USUAL_LABELS = 9
_MOST_APPROACH = 3
_SPACING_S = 0.5
_AFTER_RESOLUTION_S = 0.25
# Nobody reviews more labels of one phase.
MOST_INSIDE = 300
# Label times are written to the nanosecond, as stamps are.
_DIGITS = 9
_HALF_NS = 0.5e-9


@dataclass(frozen=True)
class Timeline:
    """The phases of one recording and its frames; times on its clip clock, s.

    Args:
        crop: its clip; every label lies in it.
        frames_s: stamps of its frames, rising.
    """

    name: str
    trigger_s: float
    conflict_s: float
    resolution_s: float
    crop: Crop
    frames_s: Sequence[float]

    @property
    def durations(self) -> str:
        """Describe for people how long its phases are."""
        approach_s = self.trigger_s - self.crop.start_s
        rest_s = self.crop.end_s - self.resolution_s
        return (
            f"{self.name}: approach {approach_s:.3f} s, trigger {self.trigger_lasts_s:.3f} s, "
            f"conflict {self.conflict_lasts_s:.3f} s, resolution {rest_s:.3f} s"
        )

    @property
    def trigger_lasts_s(self) -> float:
        """T of METHOD 5.2b."""
        return self.conflict_s - self.trigger_s

    @property
    def conflict_lasts_s(self) -> float:
        """C of METHOD 5.2b."""
        return self.resolution_s - self.conflict_s

    def newest_frame_s(self, t_s: float) -> float | None:
        """Return the stamp of the newest frame at or before a time; None without one."""
        newest = bisect_right(self.frames_s, t_s + _HALF_NS) - 1
        return None if newest < 0 else self.frames_s[newest]

    def time_of(self, at: PhasePosition) -> float:
        """Clip time of a label of the plan."""
        if at.phase == "approach":
            t_s = self.trigger_s - at.value
        elif at.phase == "trigger":
            t_s = self.trigger_s + at.value * self.trigger_lasts_s
        elif at.phase == "conflict":
            t_s = self.conflict_s + at.value * self.conflict_lasts_s
        else:
            t_s = self.resolution_s + at.value
        return round(t_s, _DIGITS)

    def risk_s(self, plan: Plan) -> float:
        """Return the proposed risk_time_s: the trigger's start, or an earlier frame's stamp.

        The frame is the one shown at the first trigger label, so that this label is the first
        candidate of METHOD 6.9 in every domain.
        """
        first = next(at for at in plan.at if at.phase == "trigger")
        shown_s = self.newest_frame_s(self.time_of(first))
        return self.trigger_s if shown_s is None else min(self.trigger_s, shown_s)


@dataclass(frozen=True)
class Plan:
    """The places of a scenario's labels in its phases, in time order."""

    at: tuple[PhasePosition, ...]

    @property
    def counts(self) -> dict[str, int]:
        """Labels per phase."""
        return {phase: sum(at.phase == phase for at in self.at) for phase in PHASES}

    @property
    def remark(self) -> str:
        """Say why it has more labels than usual; empty where it hasn't."""
        if len(self.at) <= USUAL_LABELS:
            return ""
        return (
            f"{len(self.at)} labels rather than {USUAL_LABELS}: trigger and conflict need "
            f"{self.counts['trigger'] + self.counts['conflict']}, at most {STEP_S:g} s apart"
        )


class NoPlan(InputError):
    """There is no label plan for these recordings; their domains aren't comparable by labels."""


def plan_labels(timelines: Sequence[Timeline]) -> Plan:
    """Return the plan of a scenario (METHOD 5.2b).

    Args:
        timelines: of all its recordings, at least one.

    Raises:
        NoPlan: it names the phase and how long the phases are.
    """
    for timeline in timelines:
        for phase, lasts_s in (
            ("trigger", timeline.trigger_lasts_s),
            ("conflict", timeline.conflict_lasts_s),
        ):
            if lasts_s <= 0.0:
                raise _no_plan(timelines, f"the {phase} of {timeline.name} has no duration")
    counts = _counts(timelines)
    plan = Plan(tuple(_places(*counts)))
    for timeline in timelines:
        for at in plan.at:
            t_s = timeline.time_of(at)
            if not timeline.crop.holds(t_s):
                raise _no_plan(
                    timelines,
                    f"a label of the {at.phase} lies at {t_s:.3f} s, outside the clip of "
                    f"{timeline.name} ({timeline.crop.start_s:.3f} to {timeline.crop.end_s:.3f} s)",
                )
    return plan


def _places(triggers: int, conflicts: int) -> Iterator[PhasePosition]:
    """Yield all labels of a plan with so many in trigger and conflict."""
    approaches = max(1, min(_MOST_APPROACH, USUAL_LABELS - 1 - triggers - conflicts))
    resolutions = max(1, USUAL_LABELS - triggers - conflicts - approaches)
    for k in range(approaches, 0, -1):
        yield PhasePosition("approach", k * _SPACING_S)
    yield from _inside("trigger", triggers)
    yield from _inside("conflict", conflicts)
    for k in range(resolutions):
        yield PhasePosition("resolution", _AFTER_RESOLUTION_S + k * _SPACING_S)


def _inside(phase: str, count: int) -> list[PhasePosition]:
    return [PhasePosition(phase, (i + 0.5) / count) for i in range(count)]


def _counts(timelines: Sequence[Timeline]) -> tuple[int, int]:
    """Return m and n: the fewest by the durations; n, then m, is raised until all gaps are right.

    Raises:
        NoPlan: no numbers do.
    """
    possible_m = _possible(timelines, "trigger", [t.trigger_lasts_s for t in timelines])
    possible_n = _possible(timelines, "conflict", [t.conflict_lasts_s for t in timelines])
    inside_n: dict[int, str] = {}
    problems: list[str] = []
    for m in possible_m:
        triggers = _inside("trigger", m)
        if problem := _gap_problem(timelines, triggers):
            problems.append(problem)
            continue
        for n in possible_n:
            conflicts = _inside("conflict", n)
            if n not in inside_n:
                inside_n[n] = _gap_problem(timelines, conflicts)
            if problem := inside_n[n] or _gap_problem(timelines, [triggers[-1], conflicts[0]]):
                problems.append(problem)
                continue
            return m, n
    raise _no_plan(timelines, problems[0])


def _possible(timelines: Sequence[Timeline], phase: str, lasts_s: Sequence[float]) -> range:
    """Return numbers of labels that a phase may have by its durations.

    Raises:
        NoPlan: there is none.
    """
    fewest = max(1, math.ceil(max(lasts_s) / STEP_S - TOLERANCE_S))
    # More than that would be too near each other where the phase is shortest.
    most = max(1, math.floor(min(lasts_s) / (APART_S - 2.0 * TOLERANCE_S)))
    if fewest > most:
        raise _no_plan(
            timelines,
            f"the {phase} needs {fewest} labels where it is longest, and where it is shortest they "
            f"would be less than {APART_S:g} s apart",
        )
    if fewest > MOST_INSIDE:
        raise _no_plan(timelines, f"the {phase} would need {fewest} labels, over {MOST_INSIDE}")
    return range(fewest, min(most, MOST_INSIDE) + 1)


def _gap_problem(timelines: Sequence[Timeline], places: Sequence[PhasePosition]) -> str:
    """Say what is wrong with the gaps between neighbours from trigger to conflict.

    Empty: nothing.
    """
    for timeline in timelines:
        times_s = [timeline.time_of(at) for at in places]
        shown_s = [timeline.newest_frame_s(t_s) for t_s in times_s]
        missing = [t_s for t_s, stamp_s in zip(times_s, shown_s, strict=True) if stamp_s is None]
        if missing:
            return f"{timeline.name} has no frame at or before {missing[0]:.3f} s"
        for (before_s, after_s), (old_s, new_s) in zip(
            pairwise(times_s), pairwise(s for s in shown_s if s is not None), strict=True
        ):
            if after_s - before_s < APART_S - 2.0 * TOLERANCE_S:
                return (
                    f"labels of {timeline.name} would be {after_s - before_s:.3f} s apart, less "
                    f"than {APART_S:g} s"
                )
            if not (new_s > old_s and DEFAULT.at_most(new_s - old_s, STEP_S)):
                return (
                    f"the frames of {timeline.name} shown at {before_s:.3f} and {after_s:.3f} s "
                    f"are {new_s - old_s:.3f} s apart, not more than 0 and at most {STEP_S:g} s"
                )
    return ""


def _no_plan(timelines: Sequence[Timeline], problem: str) -> NoPlan:
    """Return the refusal to plan, with every recording's durations."""
    return NoPlan(
        f"no label plan (METHOD 5.2b): {problem}",
        remedy=f"the phases are: {'; '.join(t.durations for t in timelines)}",
    )
