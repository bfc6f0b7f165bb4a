"""Fixtures of the manager's tests: a run on a straight road, and states of its objects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.arming import Facts
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import ControlState
from ssp_scenario_manager.event_spec.load import load_event, seal_event, write_event
from ssp_scenario_manager.event_spec.model import CountField
from ssp_scenario_manager.session import outbox
from ssp_scenario_manager.session.limits import Violation
from ssp_scenario_manager.session.session import Session
from ssp_scenario_manager.session.state_machine import SessionEvent
from tests.support.runs import cut_in_run
from tests.support.states import object_state

S = 1_000_000_000

EventOnRoad = Callable[[str, int, int], str]


@pytest.fixture
def run_mapping() -> dict[str, Any]:
    """A valid run file of a cut-in, to be changed by the test."""
    return cut_in_run()


@pytest.fixture
def run(run_mapping: dict[str, Any]) -> RunSpec:
    """The run of run_mapping."""
    return RunSpec.model_validate(run_mapping)


StateMaker = Callable[..., ObjectState]


@pytest.fixture
def state() -> StateMaker:
    """Makes states: a car at the origin that stands, but for what is given."""
    return lambda object_id="vut", *of, **given: object_state(object_id, *of, **given)


class Driver:
    """A session with everything that it needs to hear, moved on by the test."""

    def __init__(self, run: RunSpec, state: StateMaker) -> None:
        self.run = run
        self.state = state
        self.session = Session()
        self.now_ns = 0
        self.vut = state("vut")
        self.targets = {
            t.id: state(
                t.id,
                t.cls,
                x_m=t.start.x_m,
                y_m=t.start.y_m,
                yaw_rad=t.start.yaw_rad,
                control_state=ControlState.DISARMED,
            )
            for t in run.targets
        }
        self.ready()

    def ready(self) -> None:
        """The node's facts: everything fresh."""
        self.session.facts = Facts.of_one_process(self.run)

    def hear(self, control_state: ControlState | None = None) -> None:
        """The present states arrive, stamped now."""
        self.vut = replace(self.vut, stamp_ns=self.now_ns)
        self.session.on_vut_state(self.vut)
        for object_id, known in self.targets.items():
            self.targets[object_id] = replace(
                known,
                stamp_ns=self.now_ns,
                control_state=known.control_state if control_state is None else control_state,
            )
            self.session.on_target_state(self.targets[object_id])

    def step(self, dt_ns: int = 20_000_000, control_state: ControlState | None = None) -> None:
        """Time goes on, states arrive, the session judges them."""
        self.now_ns += dt_ns
        self.hear(control_state)
        self.session.step(self.now_ns)

    def drive(self, steps: int, dt_ns: int = 20_000_000) -> None:
        """Steps, while everybody goes on as fast as its state says."""
        for _ in range(steps):
            later_ns = self.now_ns + dt_ns
            self.vut = self.vut.extrapolated(later_ns)
            self.targets = {i: s.extrapolated(later_ns) for i, s in self.targets.items()}
            self.step(dt_ns)

    def move(self, object_id: str, **changes: Any) -> None:
        """Changes the state that will be heard next."""
        if object_id == "vut":
            self.vut = replace(self.vut, **changes)
        else:
            self.targets[object_id] = replace(self.targets[object_id], **changes)

    def command(self, name: str) -> Any:
        return self.session.command(SessionEvent(name), self.now_ns, "test", "")

    def acknowledge(self) -> list[Any]:
        """Accepts every reference in the outbox, empties it and returns what was in it."""
        sent, self.session.outbox = self.session.outbox, []
        for fact in sent:
            if isinstance(fact, Reference):
                self.session.on_ack(fact.reference_id, True, 0, "", self.now_ns)
        return sent

    def until(self, phase: str) -> None:
        """Brings a fresh session to LOADED, CONNECTED, ARMED or RUNNING."""
        self.session.load(self.run, self.now_ns)
        for command in ("connect", "arm", "start"):
            if self.session.state.name == phase:
                return
            armed = command == "start"
            self.hear(ControlState.ARMED if armed else ControlState.DISARMED)
            answer = self.command(command)
            if not answer.accepted:
                raise AssertionError(answer)
        self.hear(ControlState.RUNNING)


@pytest.fixture
def driver(run: RunSpec, state: StateMaker) -> Driver:
    """A new session for the run."""
    return Driver(run, state)


@pytest.fixture
def make_driver(state: StateMaker) -> Callable[[RunSpec], Driver]:
    """Makes sessions for runs."""
    return lambda run: Driver(run, state)


def bring(driver: Driver, phase: str) -> None:
    """Any state of the machine, by the shortest way."""
    if phase in ("LOADED", "CONNECTED", "ARMED", "RUNNING"):
        driver.until(phase)
    elif phase in ("STOPPING", "FINISHED"):
        driver.until("RUNNING")
        driver.command("stop")
        if phase == "FINISHED":
            driver.step(control_state=ControlState.DISARMED)
    elif phase in ("ABORTING", "ABORTED"):
        driver.until("RUNNING")
        driver.command("abort")
        if phase == "ABORTED":
            driver.step(control_state=ControlState.ABORTING)
    assert driver.session.state.name == phase


def changes(facts: list[Any]) -> list[tuple[str, str, str]]:
    """The transitions among what a session sends: from, event, to."""
    return [
        (f.previous.name, f.event, f.state.name)
        for f in facts
        if isinstance(f, outbox.StateChanged)
    ]


def violations(facts: list[Any]) -> list[SafetyCode]:
    """The limits among what a session sends."""
    return [f.code for f in facts if isinstance(f, Violation)]


class SessionTools:
    """Tools with which several tests act on a session."""

    bring = staticmethod(bring)
    changes = staticmethod(changes)
    violations = staticmethod(violations)


@pytest.fixture
def tools() -> type[SessionTools]:
    """bring, changes and violations."""
    return SessionTools


@pytest.fixture
def event_on_road(tmp_path_factory: pytest.TempPathFactory) -> EventOnRoad:
    """Writes a shipped event as if its source showed so many lanes with and against the VUT."""

    def written(name: str, same: int, opposite: int) -> str:
        event, _ = load_event(name)
        lanes = {
            "lanes_same_direction": CountField(value=same, identity=True),
            "lanes_opposite": CountField(value=opposite, identity=True),
        }
        road = event.topology.model_copy(update=lanes)
        path = tmp_path_factory.mktemp("event") / f"{name}.event.yaml"
        write_event(path, seal_event(event.model_copy(update={"topology": road})))
        return str(path)

    return written
