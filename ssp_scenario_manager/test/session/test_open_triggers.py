"""The open triggers of one run: each is judged from its first instant until it has fired."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ssp_core.geometry import Polyline
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import TriggerSpec
from ssp_scenario_manager.session.open_triggers import OpenTriggers
from ssp_scenario_manager.triggers.conditions import Snapshot

MS = 1_000_000
S = 1_000_000_000
PATH = Polyline([(0.0, 0.0), (250.0, 0.0)])
START_NS = 10 * S
StateMaker = Callable[..., ObjectState]


def trigger(name: str, condition: dict[str, Any], **changes: Any) -> TriggerSpec:
    hold = {"id": name, "object_id": "ot1", "manoeuvre": {"kind": "hold"}}
    return TriggerSpec.model_validate({**hold, "condition": condition, **changes})


def after(seconds: float) -> dict[str, Any]:
    return {"type": "elapsed_time", "after_s": seconds}


def watch(run: RunSpec, *triggers: TriggerSpec) -> OpenTriggers:
    """The triggers of a run that began at START_NS."""
    open_triggers = OpenTriggers(run.model_copy(update={"triggers": list(triggers)}))
    open_triggers.start(PATH, START_NS)
    return open_triggers


def names(open_triggers: OpenTriggers, vut: ObjectState) -> list[str]:
    """The triggers that fire at a state of the VUT."""
    snapshot = Snapshot(vut, {}, PATH, 300 * MS, {})
    return [spec.id for spec, _ in open_triggers.firings(snapshot)]


def test_a_trigger_is_judged_from_its_first_instant_on(run: RunSpec, state: StateMaker) -> None:
    open_triggers = watch(
        run, trigger("at_once", after(0.0)), trigger("later", after(0.0), not_before_s=1.0)
    )
    assert names(open_triggers, state(stamp_ns=START_NS - 1)) == []
    assert names(open_triggers, state(stamp_ns=START_NS)) == ["at_once"]
    assert names(open_triggers, state(stamp_ns=START_NS + S - 1)) == []
    assert names(open_triggers, state(stamp_ns=START_NS + S)) == ["later"]
    assert names(open_triggers, state(stamp_ns=START_NS + 2 * S)) == []


def test_a_trigger_that_has_fired_or_has_not_begun_holds_up_none_after_it(
    run: RunSpec, state: StateMaker
) -> None:
    open_triggers = watch(
        run,
        trigger("not_yet", after(0.0), not_before_s=9.0),
        trigger("first", after(0.1)),
        trigger("second", after(0.2)),
    )
    for at_ms, fires in ((50, []), (100, ["first"]), (200, ["second"]), (9000, ["not_yet"])):
        assert names(open_triggers, state(stamp_ns=START_NS + at_ms * MS)) == fires


def test_a_time_to_arrival_counts_along_the_path_of_the_vut(
    run: RunSpec, state: StateMaker
) -> None:
    """The VUT's front is 3.6 m before its reference point."""
    arrival = {"type": "time_to_arrival", "anchor": (53.6, 0.0), "below_s": 2.0}
    open_triggers = watch(run, trigger("arrival", arrival))
    for at_ms, x_m, fires in ((20, 29.0, []), (40, 30.0, []), (60, 30.1, ["arrival"])):
        vut = state(stamp_ns=START_NS + at_ms * MS, x_m=x_m, speed_mps=10.0)
        assert names(open_triggers, vut) == fires


def test_every_state_that_comes_too_late_is_counted(run: RunSpec, state: StateMaker) -> None:
    """States may be two steps of 20 ms old, where the site says nothing."""
    open_triggers = watch(run)
    for stamp_ms, age_ms, in_time in ((0, 40, True), (20, 41, False), (40, 60, False)):
        stamp_ns = START_NS + stamp_ms * MS
        vut = state(stamp_ns=stamp_ns)
        assert open_triggers.is_in_time(vut, stamp_ns + age_ms * MS) is in_time
        assert open_triggers.has_evaluated(vut)
    assert open_triggers.late_states == 2
