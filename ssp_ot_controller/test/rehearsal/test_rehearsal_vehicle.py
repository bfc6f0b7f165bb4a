"""The played hardware: it drives while a session runs, and goes back to its start afterwards."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from ssp_core.geometry import Pose2
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import SessionPhase
from ssp_ot_controller.bodies.dynamics import Command
from ssp_ot_controller.bodies.protocol import CommandDatagram, Envelope, encode_command
from ssp_ot_controller.bodies.simulated import BodyServer
from ssp_ot_controller.rehearsal import played as rehearsal
from ssp_ot_controller.rehearsal.played import PUT_BACK_S, PlayedBodies, PlayedVehicle
from tests.support.processes.waiting import DEADLINE_S
from tests.support.runs import small_run

S = 1_000_000_000
EPOCH = 1_700_000_000 * S
PERIOD = S // 100


def run_of_two() -> RunSpec:
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
    return RunSpec.model_validate(run)


def played() -> PlayedVehicle:
    return PlayedVehicle(run_of_two(), EPOCH)


def advance(
    vehicle: PlayedVehicle, seconds: float, phase: SessionPhase | None, token: str = "first"
) -> None:
    for _ in range(round(seconds * 100)):
        now_ns = vehicle.now_ns + PERIOD
        if phase is not None:
            vehicle.hear(phase, token, now_ns)
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
        vehicle.hear(SessionPhase.RUNNING, "first", EPOCH)
    for step in range(1, 31):
        one.advance((), EPOCH + step * PERIOD)
    other.advance((), EPOCH + 30 * PERIOD)
    assert one.body == other.body
    assert one.body.speed_mps > 0.0


def test_stays_where_the_run_ended_while_the_session_is_there() -> None:
    vehicle = played()
    advance(vehicle, 2.0, SessionPhase.RUNNING)
    advance(vehicle, 3.0 * PUT_BACK_S, SessionPhase.ABORTED)
    assert vehicle.body.x_m > 12.0


def test_goes_back_to_its_start_when_the_session_has_gone_and_drives_again() -> None:
    """It stayed where the run ended, and the next run refused to arm."""
    vehicle = played()
    for _ in range(2):
        advance(vehicle, 2.0, SessionPhase.RUNNING)
        advance(vehicle, PUT_BACK_S - 0.1, None)
        assert vehicle.body.x_m > 12.0
        assert vehicle.body.speed_mps == 0.0
        advance(vehicle, 0.2, None)
        assert (vehicle.body.x_m, vehicle.body.y_m, vehicle.body.speed_mps) == (10.0, 0.0, 0.0)
        advance(vehicle, 1.0, SessionPhase.ARMED)
        assert vehicle.body.x_m == 10.0


@pytest.mark.parametrize("phase", [SessionPhase.IDLE, SessionPhase.LOADED, SessionPhase.CONNECTED])
def test_goes_back_to_its_start_when_the_next_session_is_there(phase: SessionPhase) -> None:
    """A run that was started within these 10 s could never be armed."""
    vehicle = played()
    advance(vehicle, 2.0, SessionPhase.RUNNING)
    advance(vehicle, 0.1, phase, "second")
    assert vehicle.body.x_m > 12.0, "it went back before it stood"
    assert vehicle.body.speed_mps > 0.0
    advance(vehicle, 4.0, phase, "second")
    assert (vehicle.body.x_m, vehicle.body.speed_mps) == (10.0, 0.0)
    advance(vehicle, 2.0, SessionPhase.RUNNING, "second")
    advance(vehicle, 4.0, SessionPhase.ABORTED, "second")
    assert vehicle.body.x_m > 12.0


@pytest.mark.parametrize(
    ("phase", "token"),
    [
        (SessionPhase.IDLE, "first"),
        (SessionPhase.CONNECTED, "first"),
        (SessionPhase.CONNECTED, ""),
        (SessionPhase.ARMED, "second"),
        (SessionPhase.ABORTED, "second"),
    ],
)
def test_stays_where_the_run_ended_without_a_session_that_has_yet_to_arm(
    phase: SessionPhase, token: str
) -> None:
    vehicle = played()
    advance(vehicle, 2.0, SessionPhase.RUNNING)
    advance(vehicle, 6.0, phase, token)
    assert vehicle.body.x_m > 12.0
    assert vehicle.body.speed_mps == 0.0


def test_a_body_goes_back_to_its_start_when_another_process_commands_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    speeds_mps, place = list[float](), BodyServer.place

    def noted(server: BodyServer, pose: Pose2) -> None:
        speeds_mps.append(server.body.speed_mps)
        place(server, pose)

    monkeypatch.setattr(BodyServer, "place", noted)
    log = tmp_path / "log.csv"
    with PlayedBodies(run_of_two(), "127.0.0.1", 0, log) as bodies:
        host, _, port = bodies.addresses["ot1"].removeprefix("udp://").partition(":")
        over = threading.Event()
        thread = threading.Thread(target=bodies.serve, args=(over.is_set,))
        thread.start()

        def drive(acceleration_mps2: float, until: Callable[[list[str]], bool]) -> None:
            deadline = time.monotonic() + DEADLINE_S
            boot_ns = time.time_ns()
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
                number = 0
                while not until(log.read_text().splitlines()[-1].split(",")):
                    assert time.monotonic() < deadline, log.read_text()[-500:]
                    number += 1
                    envelope = Envelope("ot1", boot_ns, number, time.time_ns())
                    command = Command(acceleration_mps2, 0.0, 0.0)
                    datagram = encode_command(CommandDatagram(envelope, command, 200))
                    sock.sendto(datagram, (host, int(port)))
                    time.sleep(0.01)

        drive(3.0, lambda row: row[1] == "ot1" and float(row[2]) > 200.5)
        # Another socket is heard when the body stands, having heard nothing.
        began_s = time.monotonic()
        drive(0.0, lambda row: float(row[2]) == 200.0)
        assert time.monotonic() - began_s < PUT_BACK_S
        over.set()
        thread.join()
    assert speeds_mps == [0.0], "it went back before it stood"


def test_a_body_that_nobody_commands_goes_back_to_its_start(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(rehearsal, "PUT_BACK_S", 3.0)
    log = tmp_path / "log.csv"
    with (
        PlayedBodies(run_of_two(), "127.0.0.1", 0, log) as bodies,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock,
    ):
        host, _, port = bodies.addresses["ot1"].removeprefix("udp://").partition(":")
        over = threading.Event()
        thread = threading.Thread(target=bodies.serve, args=(over.is_set,))
        thread.start()
        for number in range(1, 60):
            now_ns = time.time_ns()
            envelope = Envelope("ot1", 1, number, now_ns)
            command = CommandDatagram(envelope, Command(3.0, 0.0, 0.0), 200)
            sock.sendto(encode_command(command), (host, int(port)))
            time.sleep(0.01)
        # What it said in a gap of the commands is no answer to their end.
        capsys.readouterr()
        deadline = time.monotonic() + DEADLINE_S
        while "ot1: back at its start" not in capsys.readouterr().out:
            assert time.monotonic() < deadline, log.read_text()[-500:]
            time.sleep(0.02)
        over.set()
        thread.join()
    rows = [line.split(",") for line in log.read_text().splitlines()[1:]]
    assert max(float(row[2]) for row in rows) > 200.1
    assert float(rows[-1][2]) == 200.0
