"""Manoeuvres planned ahead are those that would be planned on firing, or aren't used."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import pytest

from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_scenario_manager.dispatch.references import (
    Address,
    approach_reference,
    manoeuvre_reference,
)
from ssp_scenario_manager.session.run import PreparedManoeuvres
from ssp_scenario_manager.triggers.conditions import Quantity

S = 1_000_000_000
STEP_NS = S // 50
LEAD_NS = S // 10


@dataclass
class Watch:
    """As much of a trigger's watch as is looked at."""

    spec: Any
    fired: bool = False
    value: float = 20.0
    quantity: Quantity = field(default_factory=lambda: Quantity("gap", "<", 12.0, "m"))

    @property
    def values(self) -> list[tuple[Quantity, float]]:
        return [(self.quantity, self.value)]


class Rig:
    """A run's trigger whose value comes down by 0.1 a step."""

    def __init__(self, run: RunSpec) -> None:
        motion = run.targets[0].approach
        assert motion is not None
        self.run = run
        self.trigger = run.triggers[0]
        self.approach = approach_reference(self.address("a", 0), motion)
        self.motion = motion
        self.watch = Watch(self.trigger)
        self.ready = PreparedManoeuvres(run)
        self.now_ns = 10 * S

    def address(self, name: str, now_ns: int) -> Address:
        return Address(name, "ot1", self.run.event_version, "manoeuvre", now_ns, now_ns + LEAD_NS)

    def judge(self, value: float) -> None:
        self.now_ns += STEP_NS
        self.watch.value = value
        watches = [] if self.watch.fired else [self.watch]
        self.ready.plan(watches, {"ot1": self.approach}, self.now_ns)

    def take(self, at_ns: int, current: Reference | None = None) -> Reference | None:
        address = self.address("ot1-2", at_ns)
        return self.ready.take(self.trigger, address, current or self.approach)


@pytest.fixture
def rig(run: RunSpec) -> Rig:
    return Rig(run)


def test_what_was_planned_ahead_is_what_would_be_planned_then(rig: Rig, state: Any) -> None:
    rig.judge(12.3)
    rig.judge(12.2)
    fires_ns = rig.now_ns + STEP_NS
    address = rig.address("ot1-2", fires_ns)
    heard: ObjectState = state("ot1")
    then = manoeuvre_reference(address, rig.trigger.manoeuvre, heard, rig.approach, rig.motion)
    assert rig.take(fires_ns) == then


def test_it_is_used_once(rig: Rig) -> None:
    rig.judge(12.3)
    rig.judge(12.2)
    assert rig.take(rig.now_ns + STEP_NS) is not None
    assert rig.take(rig.now_ns + STEP_NS) is None


@pytest.mark.parametrize(("off_ns", "used"), [(0, True), (S // 100, True), (S // 100 + 1, False)])
def test_it_is_used_within_half_a_step(rig: Rig, off_ns: int, used: bool) -> None:
    rig.judge(12.3)
    rig.judge(12.2)
    assert (rig.take(rig.now_ns + STEP_NS + off_ns) is not None) == used


def test_another_reference_since_makes_it_useless(rig: Rig) -> None:
    rig.judge(12.3)
    rig.judge(12.2)
    assert rig.take(rig.now_ns + STEP_NS, replace(rig.approach, reference_id="b")) is None


@pytest.mark.parametrize(
    ("values", "near"),
    [
        ((20.0, 19.9), False),
        ((12.5, 12.4), False),
        ((12.4, 12.28), True),
        ((11.0, 11.0), True),  # holds, and may wait for how long it has held
        ((float("inf"), 12.1), False),
        ((12.1, float("nan")), False),
    ],
)
def test_it_is_planned_when_the_condition_is_about_to_change(
    rig: Rig, values: tuple[float, float], near: bool
) -> None:
    for value in values:
        rig.judge(value)
    assert (rig.take(rig.now_ns + STEP_NS) is not None) == near


def test_nothing_is_planned_for_what_has_fired_or_stands(rig: Rig) -> None:
    rig.watch.fired = True
    rig.judge(12.3)
    rig.judge(12.2)
    assert rig.take(rig.now_ns + STEP_NS) is None


def test_rising_values_are_near_from_below(rig: Rig) -> None:
    rig.watch.quantity = Quantity("speed", ">", 12.0, "m/s")
    rig.judge(11.7)
    rig.judge(11.8)
    assert rig.take(rig.now_ns + STEP_NS) is not None
