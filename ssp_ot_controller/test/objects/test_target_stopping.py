"""Every fault, at every speed: from the fault to standstill it is no farther than the stated bound.

The objects of a process and their bodies in closed loop, in simulated time. The bound is that of
ssp_core.safety.stopping: v (timeout + reaction) + v^2 / 2a + margin.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from ssp_core.cdr.steps import Heartbeat, WorldTick
from ssp_core.geometry import Polyline
from ssp_core.motion.manoeuvre import drive_along
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.stopping import stopping_of
from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_ot_controller.bodies.dynamics import BodyState, step_body
from ssp_ot_controller.control.stopping import BRAKE_GRACE_S
from ssp_ot_controller.objects.pool import (
    PAUSE_S,
    WORLD_HANG_S,
    ObjectPool,
    PoolStep,
)
from ssp_ot_controller.objects.state_machine import ObjectEvent
from ssp_ot_controller.sil.disturbance import Actuator
from tests.support.runs import small_run
from tests.support.states import state_of_body

S = 1_000_000_000
STEP_S = 0.02
STEP_NS = 20_000_000
VERSION = "sha256:event"
START_X_M = 40.0
AGILITY = {"car": 3.0, "cyclist": 1.5, "pedestrian": 1.5}


def run_of(object_class: str, fault: dict[str, Any] | None = None, **limits: float) -> RunSpec:
    start = {"x_m": START_X_M, "y_m": 0.0, "yaw_rad": 0.0}
    brake = {"kind": "brake", "to_mps": 0.0, "deceleration_mps2": 2.0}
    trigger = {"id": "t", "condition": {"type": "elapsed_time", "after_s": 1.0}}
    return RunSpec.model_validate(
        small_run(
            event_version=VERSION,
            geofence=[(0.0, -30.0), (400.0, -30.0), (400.0, 30.0), (0.0, 30.0)],
            vut={"id": "vut", "object_class": "car", "start": {**start, "x_m": 5.0}},
            targets=[{"id": "ot1", "object_class": object_class, "start": start}],
            triggers=[{**trigger, "object_id": "ot1", "manoeuvre": brake}],
            limits={"speed_mps": 16.0, "acceleration_mps2": 5.0, **limits},
            faults=[] if fault is None else [{"target": "ot1", "at_s": FAULT_S, **fault}],
        )
    )


FAULT_S = 9.0
FAULT_NS = round(FAULT_S * S)


class Loop:
    """A pool of one and its body, stepped as the world does."""

    def __init__(self, run: RunSpec) -> None:
        self.run = run
        self.cls = run.targets[0].cls
        self.pool = ObjectPool(run)
        self.actuator = Actuator(run, "ot1")
        self.body = BodyState(START_X_M, 0.0, 0.0)
        self.step_index = 0
        self.session = SessionPhase.ARMED
        self.beats = 0
        self.sent = 0
        self.silent = False
        self.push_mps = 0.0
        self.events: list[tuple[int, SafetyCode]] = []
        self.last: PoolStep | None = None

    @property
    def now_ns(self) -> int:
        return self.step_index * STEP_NS

    def truth(self) -> ObjectState:
        state = state_of_body(self.body, self.now_ns, "ot1", self.cls)
        return replace(state, sequence=self.step_index + 1)

    def send(self, reference: Reference) -> None:
        self.sent += 1
        self.pool.take_reference(reference)

    def tick(self) -> WorldTick:
        running, truths = self.step_index > 0, (self.truth(),)
        return WorldTick(self.now_ns, self.step_index, running, True, self.beats, 0, truths)

    def step(self) -> PoolStep:
        if not self.silent:
            self.beats += 1
            stamp_ns = max(self.now_ns - STEP_NS, 0)
            beat = Heartbeat(stamp_ns, "m", self.beats, 0, self.session, {"ot1": self.sent})
            self.pool.take_heartbeat(beat, 0)
        self.pool.take_tick(self.tick(), 0)
        answer = self.pool.step(0)
        assert answer is not None
        self.events += [(self.now_ns, event.stop.code) for event in answer.events]
        command = self.actuator.actuate(dict(answer.commands)["ot1"], self.now_ns)
        assert command.is_finite
        self.body = step_body(self.cls, self.body, command, STEP_S)
        if self.push_mps:
            self.body = replace(self.body, y_m=self.body.y_m + self.push_mps * STEP_S)
        self.step_index += 1
        self.last = answer
        return answer

    def drive(self, cruise_mps: float, end_x_m: float = 380.0) -> None:
        """Armed, started, at cruise speed when the fault strikes."""
        self.step_index = 0
        self.step()
        self.step_index = 0
        assert self.pool.command("ot1", ObjectEvent.ARM, VERSION, 0).accepted
        self.step()
        assert self.pool.state_of("ot1") is ControlState.ARMED
        self.session = SessionPhase.RUNNING
        self.send(approach(self, cruise_mps, end_x_m))
        while self.now_ns < FAULT_NS:
            self.step()
        assert self.events == []
        assert self.body.speed_mps == pytest.approx(cruise_mps, rel=0.02)

    def stop(self) -> float:
        """Distance from now to standstill, which it must reach by itself."""
        x_m, y_m = self.body.x_m, self.body.y_m
        since_ns = self.now_ns
        while self.body.speed_mps > 0.0:
            self.step()
            assert self.now_ns - since_ns < 20 * S, "it never stands"
        assert self.pool.state_of("ot1") is ControlState.ABORTING
        for _ in range(50):
            self.step()
        assert self.body.speed_mps == 0.0
        return math.hypot(self.body.x_m - x_m, self.body.y_m - y_m)


def approach(loop: Loop, cruise_mps: float, end_x_m: float) -> Reference:
    agility = AGILITY[loop.run.targets[0].object_class]
    path = Polyline([(START_X_M, 0.0), (end_x_m, 0.0)])
    points = drive_along(path, 0.0, 0.0, cruise_mps, agility, agility)
    return Reference("a", "ot1", VERSION, "approach", 0, S // 2, S, points)


SPEEDS = [
    *(("pedestrian", v) for v in (0.5, 1.5, 3.0)),
    *(("cyclist", v) for v in (2.0, 5.0, 8.0)),
    *(("car", v) for v in (2.0, 8.0, 15.0)),
]


def silence(loop: Loop) -> None:
    loop.silent = True


def refused(loop: Loop) -> None:
    """A reference that has expired."""
    sent = approach(loop, 5.0, 380.0)
    loop.send(replace(sent, reference_id="b", execute_at_ns=0, expires_at_ns=loop.now_ns))


def out_of_fence(loop: Loop) -> None:
    """A reference that leads out: along the present one to its speed, then across the fence."""
    sent = approach(loop, loop.body.speed_mps, 401.0)
    loop.send(replace(sent, reference_id="b", execute_at_ns=loop.now_ns + S))


def by_fault(loop: Loop) -> None:
    """Do nothing: the fault of the run file strikes by itself."""


# Name: fault of the run file, what the test does, code of the event, timeout in s.
Fault = tuple[dict[str, Any] | None, Callable[[Loop], None], SafetyCode, float]
FAULTS: dict[str, Fault] = {
    "silence": (None, silence, SafetyCode.HEARTBEAT_LOST, 0.5),
    "link_cut": ({"kind": "link_cut"}, by_fault, SafetyCode.HEARTBEAT_LOST, 0.5),
    "nan": ({"kind": "state_nan"}, by_fault, SafetyCode.STATE_NOT_FINITE, 0.0),
    "frozen": ({"kind": "state_frozen"}, by_fault, SafetyCode.STATE_FROZEN, 0.3),
    "jump": ({"kind": "position_jump", "value": 2.0}, by_fault, SafetyCode.POSITION_JUMP, 0.0),
    "expired": (None, refused, SafetyCode.REFERENCE_REFUSED, 0.0),
    "out_of_fence": (None, out_of_fence, SafetyCode.REFERENCE_REFUSED, 0.0),
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize(("object_class", "speed_mps"), SPEEDS)
def test_the_stopping_distance_is_within_its_bound(
    fault: str, object_class: str, speed_mps: float
) -> None:
    spec, strike, code, timeout_s = FAULTS[fault]
    loop = Loop(run_of(object_class, spec))
    loop.drive(speed_mps)
    speed = loop.body.speed_mps
    strike(loop)
    distance_m = loop.stop()
    if fault == "frozen" and speed * timeout_s > loop.run.limits.error_longitudinal_m:
        # A fast object is too far behind its reference before its position has stood for long.
        code = SafetyCode.ERROR_LONGITUDINAL
    assert [c for _, c in loop.events] == [code]
    noticed_s = (loop.events[0][0] - FAULT_NS) / S
    assert noticed_s <= timeout_s + 2 * STEP_S
    bound = stopping_of(loop.cls, loop.run.limits, STEP_S)
    assert distance_m <= bound.distance_m(speed, timeout_s)
    # And it did brake because of the fault, no harder than the body can.
    assert distance_m > speed**2 / (2.0 * 8.5)
    assert abs(loop.body.y_m) < 0.2


@pytest.mark.parametrize("speed_mps", [2.0, 8.0, 15.0])
def test_lost_states_stop_it_on_the_path_that_it_was_on(speed_mps: float) -> None:
    """Localisation falls silent: the last state comes again and again, with its old stamp."""
    loop = Loop(run_of("car"))
    loop.drive(speed_mps)
    stale = loop.truth()
    loop.truth = lambda: stale  # type: ignore[method-assign]  # the receiver repeats itself
    distance_m = loop.stop()
    assert [c for _, c in loop.events] == [SafetyCode.STATE_STALE]
    bound = stopping_of(loop.cls, loop.run.limits, STEP_S)
    assert distance_m <= bound.distance_m(speed_mps, loop.run.limits.state_age_s)


@pytest.mark.parametrize("value", [0.0, 1.0])
@pytest.mark.parametrize(("object_class", "speed_mps"), [("car", 8.0), ("car", 13.0)])
def test_a_stuck_actuator_is_overruled_by_the_emergency_brake(
    object_class: str, speed_mps: float, value: float
) -> None:
    """It doesn't slow down at the end of its path: too far ahead, then the brakes fail as well."""
    fault = {"kind": "actuator_stuck", "value": value}
    loop = Loop(run_of(object_class, fault, speed_mps=20.0))
    end_x_m = {8.0: 130.0, 13.0: 180.0}[speed_mps]
    loop.drive(speed_mps, end_x_m)
    while not loop.events:
        loop.step()
        assert loop.now_ns < FAULT_NS + 20 * S
    assert loop.events[0][1] is SafetyCode.ERROR_LONGITUDINAL
    fastest = loop.body.speed_mps + BRAKE_GRACE_S * value
    distance_m = loop.stop()
    bound = stopping_of(loop.cls, loop.run.limits, STEP_S)
    assert distance_m <= bound.distance_m(fastest, BRAKE_GRACE_S)
    assert loop.last is not None
    assert dict(loop.last.commands)["ot1"].emergency_stop


def test_who_is_pushed_off_its_path_stops_inside_the_fence() -> None:
    """Sideways by more than steering can make good, near the fence."""
    loop = Loop(run_of("car"))
    loop.drive(8.0)
    loop.push_mps = 8.0
    speed = loop.body.speed_mps
    while not loop.events:
        loop.step()
        assert loop.now_ns < FAULT_NS + 20 * S
    loop.push_mps = 0.0
    assert loop.events[0][1] in (SafetyCode.ERROR_LATERAL, SafetyCode.ERROR_YAW)
    distance_m = loop.stop()
    assert distance_m <= stopping_of(loop.cls, loop.run.limits, STEP_S).distance_m(speed, 0.0)


@pytest.mark.parametrize("speed_mps", [8.0, 15.0])
def test_it_stops_while_it_still_can_stop_inside(speed_mps: float) -> None:
    """An actuator that sticks heads for the fence: it stops before, whatever other limits say."""
    fault = {"kind": "actuator_stuck", "value": 1.5}
    wide = {"speed_mps": 30.0, "error_longitudinal_m": 500.0}
    loop = Loop(run_of("car", fault, **wide))
    loop.drive(speed_mps)
    loop.stop()
    assert [c for _, c in loop.events] == [SafetyCode.STOPPING_ROOM]
    assert loop.body.x_m + loop.truth().size.front_m <= 400.0


@pytest.mark.parametrize("object_class", ["pedestrian", "cyclist", "car"])
@pytest.mark.parametrize("begun_mps", [0.4, 1.0])
def test_one_that_speeds_up_while_it_is_blind_keeps_the_bound_of_what_it_may_reach(
    object_class: str, begun_mps: float
) -> None:
    loop = Loop(run_of(object_class))
    loop.step()
    loop.step_index = 0
    assert loop.pool.command("ot1", ObjectEvent.ARM, VERSION, 0).accepted
    loop.step()
    loop.session = SessionPhase.RUNNING
    loop.send(approach(loop, 3.0, 380.0))
    while loop.body.speed_mps < begun_mps:
        loop.step()
    speed, limits = loop.body.speed_mps, loop.run.limits
    loop.silent = True
    distance_m = loop.stop()
    bound = stopping_of(loop.cls, limits, STEP_S)
    gain_mps2 = limits.acceleration_mps2
    assert bound.distance_m(speed, limits.heartbeat_s) < distance_m
    assert distance_m <= bound.distance_m(speed, limits.heartbeat_s, gain_mps2)


def test_a_world_that_falls_silent_stops_what_drives_but_not_after_a_pause_of_the_own_process() -> (
    None
):
    """Ticks that came during the pause may still be unread at the first look."""
    loop = Loop(run_of("car"))
    loop.drive(8.0)
    silent_ns = round((WORLD_HANG_S + PAUSE_S) * S)
    assert loop.pool.watch(silent_ns) is None
    loop.pool.take_tick(loop.tick(), silent_ns)
    assert loop.pool.watch(silent_ns + STEP_NS) is None
    for at_ns in range(silent_ns + STEP_NS, 2 * silent_ns, STEP_NS):
        stopped = loop.pool.watch(at_ns)
        if stopped is not None:
            break
    assert stopped is not None
    assert at_ns - silent_ns == pytest.approx(WORLD_HANG_S * S, abs=2 * STEP_NS)
    assert [event.stop.code for event in stopped.events] == [SafetyCode.STATE_STALE]
    assert loop.pool.state_of("ot1") is ControlState.ABORTING
