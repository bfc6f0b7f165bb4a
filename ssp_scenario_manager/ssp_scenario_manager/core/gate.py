"""What keeps a command from being accepted that the state machine would allow."""

from __future__ import annotations

from collections.abc import Mapping, Set

from ssp_core.motion.state import ObjectState
from ssp_scenario_manager.core import readiness, standstill
from ssp_scenario_manager.core.run import Run
from ssp_scenario_manager.core.session_machine import SessionEvent


def missing(
    event: SessionEvent,
    run: Run,
    facts: readiness.Facts,
    vut: ObjectState | None,
    targets: Mapping[str, ObjectState],
    now_ns: int,
    heard: Set[str],
) -> list[str]:
    """Everything that a command lacks, each with object, measured value and limit.

    Args:
        event: the command.
        run: that is loaded.
        facts: of the node.
        vut: newest state of the VUT.
        targets: newest states by id.
        now_ns: session time.
        heard: ids of those who have sent a state since the last abort.
    """
    if event is SessionEvent.CONNECT:
        return readiness.missing_to_connect(run.spec, facts, vut, targets)
    if event is SessionEvent.ARM:
        return readiness.missing_to_arm(run.spec, facts, vut, targets, now_ns)
    if event is SessionEvent.START:
        return readiness.missing_to_start(run.spec, facts, vut, targets, now_ns)
    if event is SessionEvent.ALL_CLEAR:
        return _not_clear(run, vut, targets, now_ns, heard)
    return []


def _not_clear(
    run: Run,
    vut: ObjectState | None,
    targets: Mapping[str, ObjectState],
    now_ns: int,
    heard: Set[str],
) -> list[str]:
    """Who moves, or has said nothing since the abort: what was heard before is no proof."""
    unknown = set(standstill.moving(run.spec, vut, targets, now_ns, armed=run.armed))
    known = set(targets) | ({run.spec.vut.id} if vut is not None else set())
    return [f"it is not known of {i} that it stands" for i in sorted(unknown | (known - heard))]
