"""Objects that stop by themselves: each has its own time to say why, and is named."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from ssp_core.motion.state import ObjectState
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import ControlState
from ssp_scenario_manager.session.limits import Violation
from ssp_scenario_manager.session.local_stops import LocalStops

MS = 1_000_000
S = 1_000_000_000
NOW_NS = 50 * S
StateMaker = Callable[..., ObjectState]


def test_each_object_has_its_own_time_to_say_why_it_stopped(state: StateMaker) -> None:
    stops = LocalStops()

    def stop_of(who: str, after_ms: int) -> Violation | None:
        now_ns = NOW_NS + after_ms * MS
        stop = state(who, stamp_ns=now_ns - 5 * MS, control_state=ControlState.ABORTING)
        return stops.own_abort(stop, now_ns, started=True)

    assert stop_of("ot1", 0) is None
    assert stop_of("ot2", 90) is None
    assert stop_of("ot1", 100) == Violation(
        SafetyCode.OBJECT_ABORTED, "ot1", 1.0, 0.0, NOW_NS + 95 * MS, "local stop"
    )
    assert stop_of("ot2", 189) is None
    violation = stop_of("ot2", 190)
    assert violation is not None
    assert violation.object_id == "ot2"


@pytest.mark.parametrize(("after_ms", "counts"), [(0, False), (99, False), (100, True)])
def test_a_refusal_counts_once_its_object_had_the_time_to_explain_it(
    state: StateMaker, after_ms: int, counts: bool
) -> None:
    stops = LocalStops()
    refusal = Violation(SafetyCode.REFERENCE_REFUSED, "ot1", 1.0, 0.0, NOW_NS, "not running")
    stops.take_refusal(refusal)
    now_ns = NOW_NS + after_ms * MS
    running = state("ot1", stamp_ns=now_ns, control_state=ControlState.RUNNING)
    assert stops.unexplained(running, now_ns) == (refusal if counts else None)
    other = state("ot2", stamp_ns=now_ns, control_state=ControlState.RUNNING)
    assert stops.unexplained(other, now_ns) is None
