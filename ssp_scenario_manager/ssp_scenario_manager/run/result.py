"""The events of a run, as result.json has them of every run."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ssp_core import names
from ssp_core.bag.reading.reader import BagReader, object_states
from ssp_core.bag.seals.declaration import participation_of
from ssp_core.cdr.messages import stamp_ns
from ssp_core.cdr.steps import decode_tick
from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.errors import SspError
from ssp_core.geometry import Polyline, box_distance
from ssp_core.motion.corridor import Corridor
from ssp_core.motion.encounter import corridor_half_m
from ssp_core.motion.event import NO_CONFLICT_S, Instant, PhaseBegan, resolution_ns
from ssp_core.motion.intrusion import Intrusion, first_intrusions
from ssp_core.motion.passing import Passing, passing_since
from ssp_core.motion.state import ObjectState
from ssp_core.names import absolute
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participation import Participation, stands_in
from ssp_core.run_file.verdict import RESULT_SCHEMA
from ssp_core.vocabulary import Phase, SessionPhase
from ssp_core.world.plant import FaultFact
from ssp_scenario_manager.session.outbox import TriggerDecision
from ssp_scenario_manager.triggers.conditions import Sample

_OVER = (SessionPhase.FINISHED, SessionPhase.ABORTED)


@dataclass(frozen=True, slots=True)
class RunEvents:
    """The events of a run.

    Args:
        began_ns: session time at which it began; None: it didn't, and there is no such time.
        phases: those that were announced while it ran.
        resolution_ns: session time from which the whole recording shows neither TTC nor arrival gap
            under its threshold (METHOD 1); None: no conflict began, or it isn't over for good.
        triggers: those that fired.
        faults: injected ones that began or ended.
        passing: of VUT and initiator at the conflict zone.
        min_distance_m: smallest distance of the VUT and a target, inf: unknown.
        intrusions: conflicts with other targets before the initiator's.
    """

    began_ns: int | None
    phases: tuple[PhaseBegan, ...]
    resolution_ns: int | None
    triggers: tuple[TriggerDecision, ...]
    faults: tuple[FaultFact, ...]
    passing: Passing
    min_distance_m: float
    intrusions: tuple[Intrusion, ...] = ()

    @property
    def final_phases(self) -> tuple[PhaseBegan, ...]:
        """The phases as the whole recording has them: the announced resolution was provisional."""
        final = []
        for phase in self.phases:
            if not phase.phase.is_provisional:
                final.append(phase)
            elif self.resolution_ns is not None:
                final.append(replace(phase, stamp_ns=self.resolution_ns))
        return tuple(final)

    @property
    def is_measured(self) -> bool:
        """Tell whether all states are known, so that order, gap and distance could be measured."""
        return math.isfinite(self.min_distance_m)

    @classmethod
    def measure(
        cls,
        spec: RunSpec,
        began_ns: int | None,
        phases: Iterable[PhaseBegan],
        triggers: Iterable[TriggerDecision],
        faults: Iterable[FaultFact],
        truths: Mapping[str, Sequence[ObjectState]],
    ) -> RunEvents:
        """Measure a run on its states.

        Args:
            spec: the run.
            began_ns: session time of its start, None where it did not start.
            phases: in the order in which they began.
            triggers: that fired, in order.
            faults: that were injected, in any order.
            truths: by id of the VUT and of every target, at the same instants, in time order: the
                world's own, or in a live session those that every participant reported.
        """
        phases, triggers = tuple(phases), tuple(triggers)
        vut = truths[spec.vut.id]
        passed, resolved_ns = Passing(), None
        conflict_ns = next((p.stamp_ns for p in phases if p.phase is Phase.CONFLICT), None)
        # Without a conflict nothing passes: what brakes for an abort may still roll through.
        if conflict_ns is not None and spec.vut.approach is not None:
            pairs = instants(vut, truths[spec.initiator_id])
            path = Polyline(spec.vut.approach.path)
            resolved_ns = resolution_ns(pairs, path, spec.thresholds, conflict_ns)
            ours = {t.id for t in spec.triggers if t.object_id == spec.initiator_id}
            fired_ns = next((t.crossing_ns for t in triggers if t.trigger_id in ours), None)
            if fired_ns is not None and pairs:
                corridor = Corridor(path, corridor_half_m(vut[0].size.width_m))
                passed = passing_since(pairs, corridor, ns_to_seconds(fired_ns))
        return cls(
            began_ns,
            phases,
            resolved_ns,
            triggers,
            # Of one instant they come in any order over DDS.
            tuple(sorted(faults, key=lambda f: (f.stamp_ns, f.fault, f.target, f.active))),
            passed,
            min((_closest_m(vut, truths[t.id]) for t in spec.targets), default=math.inf),
            _intrusions(spec, truths, conflict_ns),
        )

    @classmethod
    def recorded(cls, bag: BagReader, spec: RunSpec) -> RunEvents:
        """Read the events from a session's bag; InputError or ValueError for a damaged one."""

        def decoded(topic: str) -> list[Any]:
            return [bag.decode(message) for message in bag.messages([absolute(topic)])]

        state_changes = [
            (stamp_ns(m.header.stamp), int(m.state)) for m in decoded(names.SESSION_STATE)
        ]
        starts = [at_ns for at_ns, state in state_changes if state == SessionPhase.RUNNING]
        # Simulated time stands at zero until the run begins; a live session's is the wall clock's.
        began_ns = starts[0] if starts else (None if spec.mode == "live" else 0)
        if spec.mode == "live":
            over = [at_ns for at_ns, state in state_changes if state in _OVER]
            truths = _reported_states(bag, spec, began_ns, over[0] if over else None)
        else:
            truths = _true_states(bag, spec)
        return cls.measure(
            spec,
            began_ns,
            [
                PhaseBegan(stamp_ns(p.header.stamp), Phase(p.phase), str(p.evidence))
                for p in decoded(names.PHASE_EVENT)
            ],
            [_fired(message) for message in decoded(names.TRIGGER_EVENT)],
            [
                FaultFact(
                    str(f.source),
                    str(f.fault),
                    str(f.target),
                    bool(f.active),
                    float(f.value),
                    str(f.unit),
                    stamp_ns(f.header.stamp),
                )
                for f in decoded(names.FAULT_EVENT)
            ],
            truths,
        )


def _intrusions(
    spec: RunSpec, truths: Mapping[str, Sequence[ObjectState]], conflict_ns: int | None
) -> tuple[Intrusion, ...]:
    """Return the conflicts with other targets than the initiator that come before its own."""
    others = [target.id for target in spec.targets if target.id != spec.initiator_id]
    if spec.vut.approach is None or spec.passing is None:
        return ()
    return tuple(
        first_intrusions(
            (instants(truths[spec.vut.id], truths[name]) for name in others),
            Polyline(spec.vut.approach.path),
            spec.thresholds,
            None if conflict_ns is None else ns_to_seconds(conflict_ns),
        )
    )


def misses(spec: RunSpec, happened: RunEvents) -> list[str]:
    """List how a run's event departs from K* (METHOD 4.4), each with quantity, value and range.

    Empty for a run that was made by hand, of which no K* says anything.
    """
    if spec.passing is None:
        return []
    passing = happened.passing
    departures = spec.passing.misses(
        spec.initiator_id,
        passing.other_first,
        passing.time_gap_s,
        vut_arrived=passing.own_arrival_s is not None,
    )
    departures += [
        f"initiator: {one.text(spec.thresholds)}, K* wants the conflict with {spec.initiator_id}"
        for one in happened.intrusions
    ]
    announced = any(p.phase is Phase.RESOLUTION for p in happened.phases)
    if announced and happened.resolution_ns is None:
        departures.append(
            "resolution: the conflict began again and lasts to the end of the recording, K* wants "
            "it resolved"
        )
    return departures


def late_conflict(trigger_s: float | None, conflict_s: float | None) -> str:
    """Return the finding of a conflict that comes too long after its trigger; empty: it doesn't.

    Args:
        trigger_s: start of the phase trigger; None: it has none. So for the conflict.
        conflict_s: start of the phase conflict.
    """
    if trigger_s is None or conflict_s is None or conflict_s - trigger_s <= NO_CONFLICT_S:
        return ""
    return (
        f"the conflict begins {conflict_s - trigger_s:.1f} s after the trigger; a trigger that "
        f"none follows within {NO_CONFLICT_S:g} s leads to none (a smaller constraints.trigger."
        "below, or a faster manoeuvre, would do)"
    )


def happened_by(bag: Path, spec: RunSpec) -> RunEvents | None:
    """Read the events from a session's bag; None where the bag is missing or damaged.

    Why it can't be read stands with the latencies (``report.measured``).
    """
    try:
        with BagReader(bag) as reader:
            return RunEvents.recorded(reader, spec)
    except (SspError, ValueError):
        return None


def participation_by(bag: Path, spec: RunSpec) -> Participation | None:
    """Read the declarations of a session's participants, and a person's word beside its bag.

    None where the bag is missing or damaged.
    """
    if spec.mode != "live":
        return Participation(spec.mode, {})
    try:
        with BagReader(bag) as reader:
            return participation_of(reader, spec, bag, "")
    except (SspError, ValueError):
        return None


def result_keys(
    spec: RunSpec, happened: RunEvents | None, took_part: Participation | None = None
) -> dict[str, Any]:
    """Return the keys of result.json that every run has besides its verdict and reasons.

    Args:
        spec: the run.
        happened: None where nothing is known of it; all of it is null then.
        took_part: who took part; None: it isn't known.

    Returns:
        Times in s since the start of the run.
    """
    event_keys: dict[str, Any] = dict.fromkeys(
        ("phases", "triggers", "faults", "initiator_first", "time_gap_s", "min_distance_m")
    )
    if happened is not None:
        event_keys = {
            "phases": [_phase(happened, p) for p in happened.final_phases],
            "triggers": [_trigger(happened, t) for t in happened.triggers],
            "faults": [_fault(happened, f) for f in happened.faults],
            "initiator_first": happened.passing.other_first,
            "time_gap_s": rounded(happened.passing.time_gap_s),
            "min_distance_m": rounded(happened.min_distance_m),
        }
    return {
        "schema": RESULT_SCHEMA,
        "run_id": spec.run_id,
        "scenario": spec.scenario,
        "site": spec.site,
        "seed": spec.seed,
        "mode": spec.mode,
        "participants": None if took_part is None else took_part.text,
        "stand_in": None if took_part is None else stands_in(spec, took_part),
        "wanted": None if spec.passing is None else spec.passing.model_dump(),
        **event_keys,
    }


def time_gap_text(gap_s: float | None) -> str:
    """Write a time gap for people."""
    return "no time gap" if gap_s is None else f"time gap {gap_s:.3f} s"


def rounded(value: float | None) -> float | None:
    """Round to a tenth of a millimetre or millisecond; None for what isn't a number."""
    return None if value is None or not math.isfinite(value) else round(value, 4)


def _s(happened: RunEvents, time_ns: int) -> float | None:
    return None if happened.began_ns is None else ns_to_seconds(time_ns - happened.began_ns)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _phase(happened: RunEvents, phase: PhaseBegan) -> dict[str, Any]:
    announced = next((p.stamp_ns for p in happened.phases if p.phase is phase.phase), None)
    return {
        "phase": phase.phase.name.lower(),
        "at_s": _s(happened, phase.stamp_ns),
        "announced_s": None if announced is None else _s(happened, announced),
        "evidence": phase.evidence,
    }


def _trigger(happened: RunEvents, fired: TriggerDecision) -> dict[str, Any]:
    return {
        "trigger_id": fired.trigger_id,
        "condition": fired.condition,
        "threshold": _finite(fired.threshold),
        "crossing_s": _s(happened, fired.crossing_ns),
        "dispatched_s": _s(happened, fired.dispatched_ns),
        "samples": [[_s(happened, s.stamp_ns), _finite(s.value)] for s in fired.samples],
        "reference_ids": list(fired.reference_ids),
    }


def _fault(happened: RunEvents, fault: FaultFact) -> dict[str, Any]:
    number, _, kind = fault.fault.partition(" ")
    return {
        "number": int(number) if number.isdecimal() else None,
        "kind": kind,
        "target": fault.target,
        "active": fault.active,
        "value": _finite(fault.value),
        "unit": fault.unit,
        "at_s": _s(happened, fault.stamp_ns),
    }


def _fired(message: Any) -> TriggerDecision:
    pairs = zip(message.sample_stamps, message.sample_values, strict=True)
    return TriggerDecision(
        stamp_ns=stamp_ns(message.header.stamp),
        trigger_id=str(message.trigger_id),
        condition=str(message.condition),
        threshold=float(message.threshold),
        samples=tuple(Sample(stamp_ns(stamp), float(value)) for stamp, value in pairs),
        crossing_ns=stamp_ns(message.crossing_time),
        dispatched_ns=stamp_ns(message.dispatch_time),
        object_ids=tuple(map(str, message.object_ids)),
        reference_ids=tuple(map(str, message.reference_ids)),
    )


def _reported_states(
    bag: BagReader, spec: RunSpec, began_ns: int | None, ended_ns: int | None
) -> dict[str, list[ObjectState]]:
    """Read the states that all participants reported, by id, at the stamps of the VUT's states.

    The others are extrapolated to them, by no more than ``limits.state_age_s``; an instant at which
    somebody is unknown is left out.
    """
    everybody = (spec.vut.id, *_ids(spec))
    states_by_id: dict[str, list[ObjectState]] = {i: [] for i in everybody}
    if began_ns is None:
        return states_by_id
    ordered = {
        name: sorted((s for s in states if s.is_finite), key=lambda state: state.stamp_ns)
        for name, states in object_states(bag, everybody).items()
    }
    stamps = {name: [s.stamp_ns for s in states] for name, states in ordered.items()}
    age_ns, last_ns = seconds_to_ns(spec.limits.state_age_s), began_ns - 1
    for vut in ordered[spec.vut.id]:
        now_ns = vut.stamp_ns
        if now_ns <= last_ns or (ended_ns is not None and now_ns > ended_ns):
            continue
        last_ns = now_ns
        newest = {i: bisect_right(stamps[i], now_ns) - 1 for i in everybody}
        if all(k >= 0 and now_ns - stamps[i][k] <= age_ns for i, k in newest.items()):
            for name, k in newest.items():
                states_by_id[name].append(ordered[name][k].extrapolated(now_ns))
    return states_by_id


def _true_states(bag: BagReader, spec: RunSpec) -> dict[str, list[ObjectState]]:
    """Read the true states of each step of the simulated world once, by id."""
    states_by_id: dict[str, list[ObjectState]] = {i: [] for i in (spec.vut.id, *_ids(spec))}
    steps: dict[int, Sequence[ObjectState]] = {}
    for message in bag.messages([absolute(names.WORLD_TICK)]):
        tick = decode_tick(message.data)
        if tick.step:
            # A world that holds says its step again.
            steps.setdefault(tick.step, tick.objects)
    for _, objects in sorted(steps.items()):
        by_id = {state.object_id: state for state in objects}
        if states_by_id.keys() <= by_id.keys():
            for name, states in states_by_id.items():
                states.append(by_id[name])
    return states_by_id


def _ids(spec: RunSpec) -> list[str]:
    return [target.id for target in spec.targets]


def instants(vut: Sequence[ObjectState], other: Sequence[ObjectState]) -> list[Instant]:
    """Pair two objects' states at the same stamps."""
    return [Instant(ns_to_seconds(a.stamp_ns), a, b) for a, b in zip(vut, other, strict=True)]


def _closest_m(vut: Sequence[ObjectState], other: Sequence[ObjectState]) -> float:
    """Return the smallest distance of two boxes over a run, without looking at far ones."""
    best = math.inf
    # The nearest come first, so that few boxes are looked at.
    pairs = zip(vut, other, strict=True)
    for a, b in sorted(pairs, key=lambda pair: _away_m(*pair)):
        if _away_m(a, b) - a.size.reach_m - b.size.reach_m < best:
            best = min(best, box_distance(a.box, b.box))
    return best


def _away_m(a: ObjectState, b: ObjectState) -> float:
    return math.hypot(a.x_m - b.x_m, a.y_m - b.y_m)
