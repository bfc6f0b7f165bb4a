"""The check that every object is known to stand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ssp_core.clock import ns_to_seconds
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.safety import limits as judge
from ssp_core.safety.consistency import ConsistencyWatch
from ssp_core.vocabulary import ControlState

FRESH_S = 1.0
# Who is PRE_RUNNING has heard the start, and drives off next.
_MOVING = (ControlState.PRE_RUNNING, ControlState.RUNNING, ControlState.REMOTE_CONTROLLED)
# Whoever is armed hasn't heard of the abort yet, and would drive off if it were told to.
_NOT_ABORTED = (
    *_MOVING,
    ControlState.PRE_ARMING,
    ControlState.ARMED,
)


def stands(
    state: ObjectState,
    watch: ConsistencyWatch,
    now_ns: int,
    *,
    aborting: bool = False,
    least_s: float = 0.0,
) -> bool:
    """Tell whether an object stands by its fresh state and its places, and isn't on the move.

    A stamp far ahead of the session's time is no fresh one either.

    Args:
        state: the object's newest.
        watch: knows the object's places.
        now_ns: session time.
        aborting: the session aborts, and the object must have heard it.
        least_s: time that its places must cover.
    """
    return (
        judge.is_standing(state, watch)
        and watch.net_way_m(judge.STOOD_S)[1] >= least_s
        and abs(ns_to_seconds(now_ns - state.stamp_ns)) <= FRESH_S
        and state.control_state not in (_NOT_ABORTED if aborting else _MOVING)
    )


def moving(
    spec: RunSpec,
    vut: ObjectState | None,
    targets: Mapping[str, ObjectState],
    motion: Mapping[str, ConsistencyWatch],
    now_ns: int,
    *,
    armed: bool,
    aborting: bool = False,
    without: Sequence[str] = (),
) -> list[str]:
    """List the objects that aren't known to stand, by id.

    Args:
        spec: the run.
        vut: newest state of the VUT; None: it was never heard.
        targets: newest states, by id.
        motion: the places of each, by id.
        now_ns: session time.
        armed: the session has armed its objects. Before that, what was never heard need not prove
            that it stands.
        aborting: the session aborts; every object must have heard it.
        without: objects that are not looked at, because they can't be heard.
    """
    # The time of a simulated world stands still while it holds: nothing moves, and places that
    # cover a second may never come.
    least_s = judge.STOOD_S if spec.mode == "live" else 0.0

    def is_still(state: ObjectState, watch: ConsistencyWatch) -> bool:
        return stands(state, watch, now_ns, aborting=aborting, least_s=least_s)

    states = {spec.vut.id: vut}
    states |= {t.id: targets.get(t.id) for t in spec.targets if t.id not in without}
    return [
        object_id
        for object_id, state in states.items()
        if (armed if state is None else not is_still(state, motion[object_id]))
    ]
