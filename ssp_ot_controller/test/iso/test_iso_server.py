"""``ssp iso object`` through real sockets with our own link as control centre; its options."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from ssp_core.cli import main
from ssp_core.errors import HostError, InputError
from ssp_core.geometry import Polyline
from ssp_core.motion.manoeuvre import drive_along
from ssp_core.vocabulary import ControlState
from ssp_ot_controller.bodies.iso22133.link import Link
from ssp_ot_controller.bodies.iso22133.messages import (
    CentreStatus,
    DecodedMessage,
    Grem,
    Heab,
    Monr,
    ObjectCommand,
    Ostm,
    Strt,
)
from ssp_ot_controller.bodies.iso22133.trajectories import read_trajectory
from ssp_ot_controller.bodies.iso22133.units import to_gps
from ssp_ot_controller.objects.own_states import OWN_STANDSTILL_MPS
from ssp_ot_controller.rehearsal.iso_object import IsoObject
from ssp_ot_controller.rehearsal.iso_server import IsoServer, serve
from ssp_ot_controller.rehearsal.played import StateLog
from tests.support.iso22133.centre import osem, rules_of, trajectory
from tests.support.processes.waiting import DEADLINE_S

TRAJ = trajectory(drive_along(Polyline([(0.0, 0.0), (60.0, 0.0)]), 0.0, 0.0, 8.0, 2.0, 2.0))


class Served:
    """An object that is served in a thread, and the link to it.

    Attributes:
        log: of its true states.
    """

    def __init__(self, folder: Path) -> None:
        # Whatever keeps a busy machine's threads waiting is no silence here.
        played = IsoObject(rules_of(heartbeat_s=10.0), time.time_ns())
        self.log = folder / "states.csv"
        self._states = StateLog(self.log)
        self.server = IsoServer(played, "127.0.0.1", 0)
        self._over = threading.Event()
        arguments = ([self.server], self._over.is_set, self._states)
        self._thread = threading.Thread(target=serve, args=arguments)
        self._thread.start()
        self.link = Link("127.0.0.1", self.server.port)
        self.status: CentreStatus | None = CentreStatus.INIT
        self.monr: Monr | None = None
        self.answers: list[int] = []

    def until(self, condition: Callable[[], bool], what: str) -> None:
        end_s = time.monotonic() + DEADLINE_S
        while not condition():
            assert time.monotonic() < end_s, f"{what} in vain; newest is {self.monr}"
            if self.status is not None:
                self.link.send(Heab(to_gps(time.time_ns())[1], self.status))
            for received in self.link.poll():
                assert isinstance(received.outcome, DecodedMessage), received
                if isinstance(received.outcome.message, Monr):
                    self.monr = received.outcome.message
                elif isinstance(received.outcome.message, Grem):
                    self.answers.append(received.outcome.message.response)
            time.sleep(0.005)

    def reports(self, state: ControlState) -> None:
        self.until(lambda: self.monr is not None and self.monr.state == state, state.name)

    def ask(self, message: Any) -> int:
        """The answer to a message."""
        self.answers.clear()
        self.link.send(message, acknowledge=True)
        self.until(lambda: bool(self.answers), "an answer")
        return self.answers[0]

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        self.link.close()
        self.server.close()
        self._states.close()


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    made = Served(tmp_path)
    yield made
    made.close()


def test_a_run_over_sockets_and_a_connection_that_breaks(served: Served) -> None:
    link = served.link
    link.connect()
    served.until(lambda: link.connected, "a connection")
    assert served.ask(osem(time.time_ns(), heab_timeout_s=10.0)) == 1
    served.reports(ControlState.DISARMED)
    assert served.ask(TRAJ) == 1
    served.status = CentreStatus.READY
    assert served.ask(Ostm(ObjectCommand.ARM)) == 1
    served.reports(ControlState.ARMED)
    with socket.create_connection(("127.0.0.1", served.server.port)) as second:
        second.settimeout(DEADLINE_S)
        assert second.recv(1) == b""
    assert served.ask(Strt(None, None)) == 1
    served.status = CentreStatus.RUNNING
    served.until(lambda: ((served.monr and served.monr.speed_mps) or 0.0) > 2.0, "motion")
    link.close()
    served.status = None
    played = served.server.played
    served.until(lambda: played.state is ControlState.INIT, "INIT")
    assert played.body.speed_mps <= OWN_STANDSTILL_MPS
    rows = served.log.read_text().splitlines()
    assert rows[0].startswith("time_ns,object,x_m")
    assert max(float(row.split(",")[5]) for row in rows[1:]) > 2.0
    served.status, served.monr = CentreStatus.INIT, None
    link.connect()
    served.until(lambda: link.connected, "a connection")
    assert served.ask(osem(time.time_ns())) == 1
    served.reports(ControlState.DISARMED)


def test_a_centre_that_connects_again_at_once_is_taken(served: Served) -> None:
    """The last messages and the end of the old connection are read before the new connection."""
    link = served.link
    for _ in range(20):
        link.connect()
        served.until(lambda: link.connected, "a connection")
        assert served.ask(osem(time.time_ns())) == 1
        link.send(TRAJ)
        link.close()


def test_a_port_that_is_taken_is_an_error(served: Served) -> None:
    with pytest.raises(HostError, match="can't listen at"):
        IsoServer(IsoObject(rules_of(), 0), "127.0.0.1", served.server.port)


# -- trajectory files and options -----------------------------------------------------------------


def test_a_trajectory_file_is_read(tmp_path: Path) -> None:
    file = tmp_path / "drive.csv"
    file.write_text("t_s,x_m,y_m,yaw_rad,speed_mps,curvature_1pm\n0,0,0,0,0,0\n1.5,3,1,0.5,4,0.1\n")
    traj = read_trajectory(file)
    assert (traj.name, len(traj.points)) == ("drive", 2)
    last = traj.points[1]
    assert (last.t_s, last.x_m, last.y_m, last.yaw_rad, last.speed_mps) == (1.5, 3.0, 1.0, 0.5, 4.0)
    assert (last.curvature_1pm, last.acceleration_mps2) == (0.1, None)


@pytest.mark.parametrize(
    ("text", "culprit"),
    [
        ("", "must have one t_s"),
        ("t_s,x_m,y_m,yaw_rad\n", "must have one speed_mps"),
        ("t_s,x_m,y_m,yaw_rad,speed_mps,mood\n", "'mood' isn't known"),
        ("t_s,x_m,y_m,yaw_rad,speed_mps\n0,0,0,0,0\n", "has 1 points"),
        ("t_s,x_m,y_m,yaw_rad,speed_mps\n0,0,0,0\n", "is no point"),
        ("t_s,x_m,y_m,yaw_rad,speed_mps\n0,0,0,0,fast\n", "is no point"),
        ("t_s,x_m,y_m,yaw_rad,speed_mps\n0,0,0,0,inf\n", "is no point"),
    ],
)
def test_a_file_that_is_no_trajectory_is_refused(tmp_path: Path, text: str, culprit: str) -> None:
    file = tmp_path / "drive.csv"
    file.write_text(text)
    with pytest.raises(InputError, match=culprit) as error:
        read_trajectory(file)
    assert str(file) in str(error.value)


@pytest.mark.parametrize(
    ("options", "status", "culprit"),
    [
        (["--run", "run.yaml", "--port", "1"], 2, "must have a port below it"),
        (["--run", "nowhere"], 1, "nowhere"),
        ([], 2, "Missing option '--run'"),
        (["--run", "run.yaml", "--fault", "moon"], 1, "--fault"),
        (["--run", "run.yaml", "--object", "Ö"], 1, "--object"),
        (["--run", "run.yaml", "--log", "nowhere/log.csv"], 1, "can't be written"),
    ],
)
def test_wrong_options_are_named(
    options: list[str],
    status: int,
    culprit: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    run_mapping: Callable[..., dict[str, Any]],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("run.yaml").write_text(yaml.safe_dump(run_mapping()))
    assert main(["iso", "object", *options]) == status
    assert culprit in " ".join(capsys.readouterr().err.split())
