"""The world over an in-memory scene: bodies, their timeout, the VUT, and exact repetition."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pytest

from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import ObjectClass, Role
from ssp_ot_controller.bodies.dynamics import Command
from ssp_ot_controller.sil.world import BODY_TIMEOUT_S, World
from tests.support.runs import small_run
from tests.support.states import object_state

GO = Command(2.0, 0.0, 0.0)


class MemoryScene:
    """One truck that drives on; keeps the poses that it is given."""

    def __init__(self) -> None:
        self.poses: list[list[ObjectState]] = []
        truck = object_state("zz_truck", ObjectClass.TRUCK, 300.0, 7.0, 3.14159, 10.0)
        self.truck = replace(truck, role=Role.TRAFFIC)

    def step(self, poses: list[ObjectState]) -> list[ObjectState]:
        self.poses.append(poses)
        self.truck = replace(
            self.truck, x_m=self.truck.x_m - 0.2, stamp_ns=self.truck.stamp_ns + 20_000_000
        )
        return [self.truck]

    def traffic(self) -> list[ObjectState]:
        return [self.truck]


@pytest.fixture
def run() -> RunSpec:
    start = {"x_m": 10.0, "y_m": 0.0, "yaw_rad": 0.0}
    return RunSpec.model_validate(
        small_run(
            vut={
                "id": "vut",
                "object_class": "car",
                "start": start,
                "approach": {"path": [(10.0, 0.0), (390.0, 0.0)], "cruise_mps": 10.0},
            },
            targets=[
                {"id": "ot1", "object_class": "car", "start": {**start, "x_m": 60.0, "y_m": 3.5}},
                {
                    "id": "ot2",
                    "object_class": "pedestrian",
                    "start": {"x_m": 90.0, "y_m": -6.0, "yaw_rad": 1.57},
                },
            ],
        )
    )


def body(world: World, object_id: str) -> ObjectState:
    return next(s for s in world.objects() if s.object_id == object_id)


def fresh(world: World, command: Command = GO) -> dict[str, tuple[int, Command]]:
    return dict.fromkeys(("ot1", "ot2"), (world.step_index, command))


def test_the_start(run: RunSpec) -> None:
    world = World(run, MemoryScene())
    assert [s.object_id for s in world.objects()] == ["ot1", "ot2", "vut", "zz_truck"]
    assert (world.step_index, world.now_ns) == (0, 0)
    assert world.all_stand()  # the truck doesn't count
    vut = world.vut()
    assert (vut.x_m, vut.role, vut.sequence, vut.stamp_ns) == (10.0, Role.VUT, 1, 0)
    assert body(world, "ot2").role is Role.OT


def test_a_step_moves_everybody_and_tells_the_scene(run: RunSpec) -> None:
    scene = MemoryScene()
    world = World(run, scene)
    for k in range(1, 101):
        states = world.advance(fresh(world), drive_vut=True)
        assert states == world.objects()
        assert {s.stamp_ns for s in states} == {k * 20_000_000}
        assert {s.sequence for s in states if s.object_id != "zz_truck"} == {k + 1}
        assert scene.poses[-1] == [s for i in ("vut", "ot1", "ot2") for s in [body(world, i)]]
    assert body(world, "ot1").speed_mps == pytest.approx(4.0, abs=0.5)
    assert world.vut().speed_mps == pytest.approx(4.0, abs=0.5)
    assert not world.all_stand()


def test_without_drive_the_vut_stops_comfortably(run: RunSpec) -> None:
    world = World(run, MemoryScene())
    for _ in range(300):
        world.advance(fresh(world), drive_vut=True)
    hardest = 0.0
    for _ in range(300):
        world.advance({}, drive_vut=False)
        hardest = min(hardest, world.vut().acceleration_mps2)
    assert hardest == pytest.approx(-2.5, abs=0.1)
    assert world.vut().speed_mps == 0.0
    assert world.all_stand()


def test_a_stopping_vut_does_not_run_into_what_stops_harder(run: RunSpec) -> None:
    """The OT brakes with 4 m/s^2 at the end of a run, the VUT on its own with 2.5 m/s^2.

    From 8 m/s that is 8 m against 12.8 m, more than the gap between them.
    """
    at = run.vut.start.model_copy(update={"x_m": 28.0})
    close = run.model_copy(
        update={
            "targets": [run.targets[0].model_copy(update={"start": at})],
            "driver": run.driver.model_copy(update={"headway_s": 0.3, "standstill_gap_m": 1.0}),
        }
    )
    world = World(close, MemoryScene())

    def gap_m() -> float:
        return body(world, "ot1").x_m - 0.9 - world.vut().x_m - 3.6

    for _ in range(1400):
        command = Command(2.0 * (8.0 - body(world, "ot1").speed_mps), 0.0, 0.0)
        world.advance({"ot1": (world.step_index, command)}, drive_vut=True)
    assert world.vut().speed_mps == pytest.approx(8.0, abs=1.0)
    assert gap_m() < 4.8
    closest = gap_m()
    while not world.all_stand():
        world.advance({"ot1": (world.step_index, Command(-4.0, 0.0, 0.0))}, drive_vut=False)
        closest = min(closest, gap_m())
        assert world.now_ns < 60_000_000_000
    assert closest > 0.2


@pytest.mark.parametrize("object_id", ["ot1", "ot2"])
def test_a_body_that_hears_nothing_brakes_hard(run: RunSpec, object_id: str) -> None:
    world = World(run, MemoryScene())
    for _ in range(60):
        world.advance(fresh(world), drive_vut=False)
    speed, heard = body(world, object_id).speed_mps, world.step_index
    assert speed > 1.0
    commands = {object_id: (heard, GO)}
    # Up to the timeout the last command holds …
    for _ in range(round(BODY_TIMEOUT_S / run.step_s) + 1):
        world.advance(commands, drive_vut=False)
        assert body(world, object_id).acceleration_mps2 > 1.9
    # … and then it brakes to a standstill, although the same old command still lies there.
    world.advance(commands, drive_vut=False)
    assert body(world, object_id).acceleration_mps2 < 1.9
    for _ in range(100):
        world.advance(commands, drive_vut=False)
    assert body(world, object_id).speed_mps == 0.0


def test_a_body_that_hears_nothing_in_a_bend_stays_on_its_arc(run: RunSpec) -> None:
    """A real body stays there too: the room for a blind stop was judged along that arc."""
    world = World(run, MemoryScene())
    for _ in range(60):
        world.advance({"ot1": (world.step_index, Command(2.0, 0.05, 0.0))}, drive_vut=False)
    led = body(world, "ot1")
    curvature_1pm = led.yaw_rate_radps / led.speed_mps
    assert curvature_1pm == pytest.approx(0.05, rel=0.01)
    while body(world, "ot1").speed_mps > 0.0:
        before = body(world, "ot1")
        world.advance({}, drive_vut=False)
        now = body(world, "ot1")
        if now.speed_mps > 0.0:
            assert now.yaw_rate_radps / now.speed_mps == pytest.approx(curvature_1pm, rel=0.01)
        assert now.yaw_rad >= before.yaw_rad


@pytest.mark.parametrize(
    "commands",
    [
        {},
        {"ot1": (0, Command(float("nan"), 0.0, 0.0))},
        {"ot1": (0, Command(2.0, float("inf"), 0.0))},
        {"somebody": (0, GO)},
    ],
)
def test_no_or_no_good_command_is_no_motion(run: RunSpec, commands: Mapping[str, Any]) -> None:
    world = World(run, MemoryScene())
    for _ in range(20):
        world.advance(commands, drive_vut=False)
    assert world.all_stand()


def history(run: RunSpec) -> list[list[ObjectState]]:
    world = World(run, MemoryScene())
    states = []
    for k in range(400):
        command = Command(2.0 - 0.01 * k, 0.02 * (k % 7 - 3), 0.001 * k)
        states.append(world.advance(fresh(world, command), drive_vut=k < 300))
    return states


def test_two_worlds_are_bitwise_equal(run: RunSpec) -> None:
    assert history(run) == history(run)
    # repr() tells 0.0 from -0.0 and shows every bit.
    assert repr(history(run)) == repr(history(run))


def test_sluggish_actuators_are_for_targets_only(run: RunSpec) -> None:
    run = run.model_copy(update={"driver": run.driver.model_copy(update={"reacts": False})})
    slow = run.model_copy(
        update={"disturbance": run.disturbance.model_copy(update={"actuator_lag_scale": 3.0})}
    )
    a, b = World(run, MemoryScene()), World(slow, MemoryScene())
    for world in (a, b):
        for _ in range(10):
            world.advance(fresh(world), drive_vut=True)
    assert b.vut() == a.vut()
    assert body(b, "ot1").speed_mps < body(a, "ot1").speed_mps
