"""An object target and its body in closed loop, as the SIL world steps them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from ssp_core.geometry import Polyline
from ssp_core.motion.manoeuvre import drive_along
from ssp_core.motion.reference import Reference, ReferencePoint
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import ControlState, ObjectClass, SessionPhase
from ssp_ot_controller.bodies.dynamics import BodyState, step_body
from ssp_ot_controller.objects.references import Refusal
from ssp_ot_controller.objects.state_machine import ObjectEvent
from ssp_ot_controller.objects.target import Target, TargetStep
from tests.support.runs import small_run
from tests.support.states import make_reference, state_of_body

S = 1_000_000_000
STEP_NS = 20_000_000
VERSION = "sha256:event"


def run_of(object_class: str = "car") -> RunSpec:
    start = {"x_m": 40.0, "y_m": 3.5, "yaw_rad": 0.0}
    return RunSpec.model_validate(
        small_run(
            vut={"id": "vut", "object_class": "car", "start": {**start, "x_m": 10.0}},
            targets=[{"id": "ot1", "object_class": object_class, "start": start}],
        )
    )


def reference(
    name: str, execute_at_ns: int, points: list[ReferencePoint], dispatched_ns: int = 0
) -> Reference:
    return make_reference(
        points,
        reference_id=name,
        event_version=VERSION,
        dispatched_ns=dispatched_ns,
        execute_at_ns=execute_at_ns,
        expires_at_ns=execute_at_ns + S,
    )


def straight(cruise_mps: float = 8.0, end_x_m: float = 200.0) -> list[ReferencePoint]:
    path = Polyline([(40.0, 3.5), (end_x_m, 3.5)])
    return drive_along(path, 0.0, 0.0, cruise_mps, 2.0, 2.0)


class Rig:
    """A target and its body in closed loop, stepped as the SIL world does."""

    def __init__(self, object_class: ObjectClass = ObjectClass.CAR) -> None:
        self.run = run_of(object_class.word)
        self.target = Target("ot1", self.run)
        self.cls = object_class
        self.body = BodyState(40.0, 3.5, 0.0)
        self.now_ns = 0
        self.heartbeat_ns: int | None = 0
        self.session = SessionPhase.CONNECTED
        self.last: TargetStep | None = None

    @property
    def own(self) -> ObjectState:
        return state_of_body(self.body, self.now_ns, "ot1", self.cls)

    def step(self, **broken: Any) -> TargetStep:
        """Heartbeat, judgement, and the body's motion until the next step."""
        if self.heartbeat_ns is not None:
            self.heartbeat_ns = self.now_ns
            self.target.on_session_state(self.session)
        since_ns = self.heartbeat_ns if self.heartbeat_ns is not None else self.silent_ns
        own = replace(self.own, **broken)
        outcome = self.target.step(own, self.now_ns, (self.now_ns - since_ns) / S)
        command = outcome.command
        self.body = step_body(self.cls, self.body, command, STEP_NS / S)
        self.now_ns += STEP_NS
        self.last = outcome
        return outcome

    def silence(self) -> None:
        """The manager is heard for the last time in the step before."""
        self.silent_ns, self.heartbeat_ns = self.now_ns - STEP_NS, None

    def arm(self) -> None:
        self.target.power_on()
        self.step()
        assert self.target.command(ObjectEvent.ARM, VERSION, 0.0).accepted
        self.session = SessionPhase.ARMED
        self.step()
        assert self.target.state is ControlState.ARMED

    def start(self) -> None:
        """Armed and started; nothing is asked of it yet."""
        self.arm()
        self.session = SessionPhase.RUNNING
        self.step()

    def take(self, reference: Reference) -> Refusal | None:
        return self.target.on_reference(reference, self.now_ns)

    def drive(self, cruise_mps: float = 8.0, seconds: float = 8.0) -> None:
        """Armed, started, on its way at cruise speed."""
        self.start()
        assert self.take(reference("a", self.now_ns + S // 2, straight(cruise_mps))) is None
        while self.now_ns < seconds * S:
            self.step()
