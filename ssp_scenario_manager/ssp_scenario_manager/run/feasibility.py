"""The check that a run's event happens, by running it twice in one process.

The VUT first holds its approach speed, then the SIL's driver drives it.
"""

from __future__ import annotations

from collections.abc import Sequence

from ssp_core.errors import InputError
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import Phase
from ssp_scenario_manager.run.in_process import InProcessResult, Record, run_in_process
from ssp_scenario_manager.run.result import late_conflict

# What a VUT that doesn't respond brings about after the conflict has begun.
_OF_NO_RESPONSE = frozenset(
    code.name.lower()
    for code in (SafetyCode.COLLISION, SafetyCode.SEPARATION, SafetyCode.EVENT_MISSING)
)


def why_not(run: RunSpec) -> list[str]:
    """Return reasons why a run's event wouldn't happen, each with the quantity that misses.

    It is run without a response of the VUT, then with the SIL's driver and the surroundings.

    Args:
        run: as it is compiled, with what K* wants of the passing; a VUT that somebody else drives
            is driven by the SIL's driver.

    Returns:
        None of them: it happens.
    """
    still = _without_response(run)
    reasons = _no_event(run, run_in_process(still)[0])
    if reasons:
        return [f"{reason}, while the VUT holds its approach speed" for reason in reasons]
    driver_reasons = _not_valid(_plain(run).model_copy(update={"traffic": run.traffic}))
    if driver_reasons and run.traffic and not _not_valid(_plain(run)):
        return [f"{reason}, with the surroundings" for reason in driver_reasons]
    return [f"{reason}, with the SIL's driver" for reason in driver_reasons]


def _not_valid(run: RunSpec) -> Sequence[str]:
    """Return reasons why a run isn't valid; none if it is."""
    try:
        result, _ = run_in_process(run)
    except InputError as error:
        return [str(error)]
    if not result.ok:
        return result.reasons or ["it doesn't begin"]
    return _late(result)


def _late(run_result: InProcessResult) -> list[str]:
    """List the conflict that comes too long after the trigger."""
    finding = late_conflict(run_result.phase_s(Phase.TRIGGER), run_result.phase_s(Phase.CONFLICT))
    return [finding] if finding else []


def driven(run: RunSpec) -> tuple[InProcessResult, Record]:
    """Do the second of the two runs: with the SIL's driver, without camera, traffic and faults."""
    return run_in_process(_plain(run))


def _plain(run: RunSpec) -> RunSpec:
    """Remove from a run what needs processes of its own and doesn't change the event."""
    driver = run.driver.model_copy(update={"external": False})
    return run.model_copy(
        update={"mode": "lockstep", "camera": None, "traffic": [], "faults": [], "driver": driver}
    )


def _without_response(run: RunSpec) -> RunSpec:
    plain = _plain(run)
    driver = plain.driver.model_copy(
        update={"reacts": False, "aeb_deceleration_mps2": None, "later": []}
    )
    # Most of the time gap comes of the response; the order is judged below.
    return plain.model_copy(update={"driver": driver, "passing": None})


def _no_event(run: RunSpec, run_result: InProcessResult) -> list[str]:
    """List what is missing of trigger, conflict and passing order."""
    who = run.initiator_id
    reasons = [reason for reason in run_result.reasons if _code(reason) not in _OF_NO_RESPONSE]
    if reasons:
        return reasons
    late = "; ".join(reason for reason in run_result.reasons if _code(reason) == "event_missing")
    if not run_result.triggers:
        return [f"the trigger of {who} doesn't fire ({late})"]
    has_conflict = run_result.phase_s(Phase.CONFLICT) is not None
    if run_result.passing.other_first is None and not has_conflict:
        return [f"no conflict comes of it ({late or _phases(run_result)})"]
    if run_result.passing.other_first is None:
        near = f"smallest distance {run_result.min_distance_m:.2f} m"
        return [f"{who} doesn't come into the VUT's corridor ({near})"]
    if (
        run.passing is not None
        and run_result.passing.other_first is not run.passing.initiator_first
    ):
        first = who if run_result.passing.other_first else run.vut.id
        return [f"{first} reaches the conflict point first, against K*'s passing order"]
    return _late(run_result)


def _code(reason: str) -> str:
    return reason.partition(":")[0]


def _phases(run_result: InProcessResult) -> str:
    names: Sequence[str] = [p.phase.name.lower() for p in run_result.phases]
    return f"phases: {', '.join(names)}"
