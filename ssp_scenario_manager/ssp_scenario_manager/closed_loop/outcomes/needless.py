"""Needless braking in the event-free twin of a start (METHOD 8.6).

METHOD bounds how a driver drives where no event comes. Within these bounds one that sees nothing
can dip its speed at the hand-over, and so pass behind what its twin hits. So a driver is needless,
too, if its way there would have avoided the event as well.
"""

from __future__ import annotations

from ssp_core.clock import ns_to_seconds
from ssp_core.run_file.driven import Driven
from ssp_core.run_file.model import RunSpec
from ssp_core.world.driver import DriveMode
from ssp_scenario_manager.closed_loop.contact import Contact, first_contact, until, with_vut
from ssp_scenario_manager.closed_loop.outcomes.outcome import DriverRun, Outcome
from ssp_scenario_manager.closed_loop.starts.start import path_of
from ssp_scenario_manager.closed_loop.values import EPSILON_S, LIMITS
from ssp_scenario_manager.run.in_process import Record

# Outcomes of the event-free twin in which the driver, or the session, didn't go on to T_end.
_ENDS = frozenset({"harness", "died", "left_road", "fence"})


def needless_of(
    event: DriverRun, free: DriverRun, built_in: Record, contact: Contact | None
) -> str:
    """Say why a driver is needless in the event-free twin of a run; empty: it isn't.

    Args:
        event: the run.
        free: the event-free one of the same driver, latency and repeat.
        built_in: of the event-free run under the built-in driver.
        contact: of the start's twin; None: it has none.
    """
    needless = needless_in(free.run, free.driven, free.record, built_in, free.outcome)
    if needless or contact is None or event.outcome.kind != "avoided":
        return needless
    return "driven as here, it has no contact in the event either" if _misses(event, free) else ""


def _misses(event: DriverRun, free: DriverRun) -> bool:
    """Tell whether the VUT of an event-free run has no contact with the objects of the event.

    Objects move alike for all drivers, so the two may be laid over each other. A VUT that had a
    contact in the event-free run has no way of its own up to T_end, and isn't judged.
    """
    if free.outcome.contact is not None:
        return False
    vut_id, driven = event.run.vut.id, event.driven
    states = {state.stamp_ns: state for state in free.record.truths(vut_id)}
    led = until(event.record.reports, driven.hand_over_s, driven.end_s)
    steps = (with_vut(one, states[one.now_ns]) for one in led if one.now_ns in states)
    return first_contact(steps, vut_id) is None


def needless_in(
    run: RunSpec, driven: Driven, record: Record, built_in: Record, outcome: Outcome
) -> str:
    """Say why a driver is needless by an event-free twin alone (METHOD 8.6); empty: it isn't.

    A run that a contact decided before T_end is judged up to there: the session brakes by itself
    afterwards. A driver that ends, or is ended, is needless: otherwise it could leave the twin, or
    brake for nothing, where it meets no event.

    Args:
        run: the event-free one, as it was driven.
        driven: its driver.
        record: of the run.
        built_in: of the same run under the built-in driver.
        outcome: of the run.
    """
    if outcome.kind in _ENDS:
        return f"ends by {outcome.kind} at {outcome.at_s:.2f} s"
    led = until(record.reports, driven.hand_over_s, min(driven.end_s, outcome.at_s))
    since_s: float | None = None
    for report in led:
        at_s = ns_to_seconds(report.now_ns)
        if report.drive is not None and report.drive.mode is DriveMode.FALLBACK:
            return f"falls back at {at_s:.2f} s"
        vut = next(s for s in report.truths if s.object_id == run.vut.id)
        if vut.acceleration_mps2 > -LIMITS.needless_mps2:
            since_s = None
            continue
        since_s = at_s if since_s is None else since_s
        if at_s - since_s >= LIMITS.needless_s - EPSILON_S:
            return f"brakes by {-vut.acceleration_mps2:.1f} m/s^2 at {at_s:.2f} s"
    end_s = ns_to_seconds(led[-1].now_ns) if led else driven.hand_over_s
    own_m, its_m = (progress_m(run, driven, one, end_s) for one in (record, built_in))
    if own_m < LIMITS.progress_share * its_m:
        return f"makes {own_m:.0f} m where the built-in driver makes {its_m:.0f} m"
    return ""


def progress_m(run: RunSpec, driven: Driven, record: Record, end_s: float) -> float:
    """Return the VUT's way along its path from the hand-over to a time."""
    led = until(record.reports, driven.hand_over_s, end_s)
    path = path_of(run)
    ends = [
        next(s for s in report.truths if s.object_id == run.vut.id)
        for report in (led[:1] + led[-1:])
    ]
    if not ends:
        return 0.0
    stations = [path.project_beyond(s.x_m, s.y_m)[0] for s in ends]
    return stations[-1] - stations[0]
