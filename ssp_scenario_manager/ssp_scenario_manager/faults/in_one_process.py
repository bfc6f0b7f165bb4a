"""Cells without processes of their own: the same evidence from a run in this process."""

from __future__ import annotations

from ssp_core.clock import ns_to_seconds
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.codes import MEANINGS
from ssp_core.vocabulary import ControlState, Role, Verdict
from ssp_core.world.plant import ManagerUpdate, Plant, StepReport, make_plant
from ssp_scenario_manager.faults.evidence import Evidence, FaultNote, SafetyNote
from ssp_scenario_manager.faults.motion import Track
from ssp_scenario_manager.faults.read_evidence import track_of
from ssp_scenario_manager.in_process.command import for_one_process
from ssp_scenario_manager.in_process.loop import InProcessSession
from ssp_scenario_manager.in_process.outcome import Record, judged
from ssp_scenario_manager.runner.inject import RUNNER_KINDS

# Of the runner's faults, those that need no process.
_ALSO = ("operator_abort", "trigger_never")
MANAGER = "scenario_manager"


def possible(kind: str) -> bool:
    """Whether a kind of fault can be injected without processes."""
    return kind not in RUNNER_KINDS or kind in _ALSO


class _Watched:
    """A plant whose every report is kept, those of the armed session too."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self.reports: list[StepReport] = []

    def hold(self, word: ManagerUpdate) -> StepReport:
        return self._kept(self._plant.hold(word))

    def advance(self, word: ManagerUpdate) -> StepReport:
        return self._kept(self._plant.advance(word))

    def command(self, object_id: str, command: int, event_version: str) -> str:
        return self._plant.command(object_id, command, event_version)

    def close(self) -> None:
        self._plant.close()

    def _kept(self, report: StepReport) -> StepReport:
        self.reports.append(report)
        return report


def run_for_evidence(spec: RunSpec) -> Evidence:
    """Runs a session in this process.

    Args:
        spec: in lockstep, with faults that need no process.

    Raises:
        InputError: a fault needs processes of its own.
    """
    spec = for_one_process(spec)
    plant = _Watched(make_plant(spec))
    try:
        session = InProcessSession(spec, plant)
        session.run()
    finally:
        plant.close()
    account, reports = session.account, plant.reports
    outcome, _ = judged(spec, session, Record(reports))
    verdict = outcome.verdict
    if verdict is Verdict.NONE:
        verdict = Verdict.INVALID_HARNESS  # as the runner says of a session that never started
    safety = [
        SafetyNote(
            ns_to_seconds(limit.stamp_ns),
            MEANINGS[limit.code].limit_name,
            limit.source,
            limit.object_id,
        )
        for report in reports
        for limit in report.limits
    ]
    safety += [
        SafetyNote(
            ns_to_seconds(seen.stamp_ns), MEANINGS[seen.code].limit_name, MANAGER, seen.object_id
        )
        for seen in account.violations
    ]
    return Evidence(
        spec=spec,
        verdict=verdict.name.lower(),
        reasons=outcome.reasons,
        truth=_truth(reports),
        own_states=_own_states(reports),
        session=tuple((ns_to_seconds(c.stamp_ns), c.state) for c in account.changes),
        phases=tuple((ns_to_seconds(p.stamp_ns), p.phase) for p in account.phases),
        triggers=tuple(ns_to_seconds(t.dispatched_ns) for t in account.triggers),
        safety=tuple(sorted(safety, key=lambda note: note.t_s)),
        faults=_faults(spec, reports),
        has_wall=False,
    )


def _truth(reports: list[StepReport]) -> dict[str, Track]:
    rows: dict[str, list[tuple[float, ObjectState]]] = {}
    for report in reports:
        if report.running:
            for one in report.truths:
                if one.role in (Role.VUT, Role.OT):
                    rows.setdefault(one.object_id, []).append((ns_to_seconds(report.now_ns), one))
    return {object_id: track_of(kept) for object_id, kept in rows.items()}


def _own_states(reports: list[StepReport]) -> tuple[tuple[float, str, ControlState], ...]:
    last: dict[str, ControlState] = {}
    changes = []
    for report in reports:
        for state in report.target_states:
            if last.get(state.object_id) is not state.control_state:
                last[state.object_id] = state.control_state
                t_s = ns_to_seconds(state.stamp_ns)
                changes.append((t_s, state.object_id, state.control_state))
    return tuple(changes)


def _faults(spec: RunSpec, reports: list[StepReport]) -> tuple[FaultNote, ...]:
    notes = [
        FaultNote(ns_to_seconds(f.stamp_ns), int(f.fault.partition(" ")[0]), f.active)
        for report in reports
        for f in report.faults
    ]
    told = {note.index for note in notes}
    notes += [
        FaultNote(fault.at_s or 0.0, index, True)
        for index, fault in enumerate(spec.faults)
        if index not in told and fault.kind == "operator_abort"
    ]
    return tuple(sorted(notes, key=lambda note: (note.t_s, note.index)))
