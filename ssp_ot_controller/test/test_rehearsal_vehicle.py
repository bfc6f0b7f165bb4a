"""The played VUT: it drives while it hears that the session runs, and brakes else."""

from __future__ import annotations

from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import SessionPhase
from ssp_ot_controller.rehearsal.played import PlayedVehicle
from support.runs import small_run

S = 1_000_000_000
EPOCH = 1_700_000_000 * S
PERIOD = S // 100


def played() -> PlayedVehicle:
    run = small_run(
        domain="physical",
        mode="live",
        stand_in=True,
        vut={
            "id": "vut",
            "object_class": "car",
            "start": {"x_m": 10.0, "y_m": 0.0, "yaw_rad": 0.0},
            "approach": {"path": [(10.0, 0.0), (390.0, 0.0)], "cruise_mps": 10.0},
        },
        targets=[
            {
                "id": "ot1",
                "object_class": "car",
                "start": {"x_m": 200.0, "y_m": 0.0, "yaw_rad": 0.0},
            }
        ],
    )
    return PlayedVehicle(RunSpec.model_validate(run), EPOCH)


def advance(vehicle: PlayedVehicle, seconds: float, phase: SessionPhase | None) -> None:
    for _ in range(round(seconds * 100)):
        now_ns = vehicle.now_ns + PERIOD
        if phase is not None:
            vehicle.hear(phase, now_ns)
        vehicle.advance((), now_ns)
        assert vehicle.now_ns == now_ns


def test_drives_while_the_session_runs() -> None:
    vehicle = played()
    advance(vehicle, 1.0, SessionPhase.ARMED)
    assert vehicle.body.speed_mps == 0.0
    advance(vehicle, 2.0, SessionPhase.RUNNING)
    assert vehicle.body.speed_mps > 2.0
    advance(vehicle, 6.0, SessionPhase.ABORTING)
    assert vehicle.body.speed_mps == 0.0


def test_brakes_when_nobody_says_anything_any_more() -> None:
    vehicle = played()
    advance(vehicle, 2.0, SessionPhase.RUNNING)
    advance(vehicle, 6.0, None)
    assert vehicle.body.speed_mps == 0.0


def test_a_late_call_moves_it_as_many_would() -> None:
    one, other = played(), played()
    for vehicle in (one, other):
        vehicle.hear(SessionPhase.RUNNING, EPOCH)
    for step in range(1, 31):
        one.advance((), EPOCH + step * PERIOD)
    other.advance((), EPOCH + 30 * PERIOD)
    assert one.body == other.body
    assert one.body.speed_mps > 0.0
