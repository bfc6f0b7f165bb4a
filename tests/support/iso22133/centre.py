"""A control centre without sockets, for tests of objects that speak ISO 22133."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

from ssp_core.geodesy import Datum, Place
from ssp_core.motion.reference import Reference, ReferencePoint
from ssp_core.run_file.model import Limits
from ssp_core.run_file.participants import ParticipantSpec
from ssp_ot_controller.bodies.iso22133.framing import StreamDecoder
from ssp_ot_controller.bodies.iso22133.messages import (
    CentreStatus,
    DecodedMessage,
    Grem,
    Heab,
    Message,
    Monr,
    ObjectCommand,
    Osem,
    Ostm,
    Strt,
    Traj,
    decode,
    encode,
)
from ssp_ot_controller.bodies.iso22133.trajectories import trajectory_of
from ssp_ot_controller.bodies.iso22133.units import leap_seconds, to_gps
from ssp_ot_controller.objects.rules import ObjectRules
from ssp_ot_controller.rehearsal.iso_object import STEP_S, IsoObject

MS = 1_000_000
S = 1_000_000_000
T0 = 1_790_000_000 * S
HOST = "10.0.0.1"
PLACE = Place(57.7, 12.9, 100.0)
FENCE = ((-20.0, -20.0), (400.0, -20.0), (400.0, 20.0), (-20.0, 20.0))


def rules_of(object_class: str = "car", **limits: Any) -> ObjectRules:
    """Make the rules of an object that stands at the origin of frame map, heading along x."""
    start = {"x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0}
    spec = {"id": "ot1", "object_class": object_class, "start": start}
    return ObjectRules(
        ParticipantSpec.model_validate(spec),
        Limits(**{"speed_mps": 15.0, "acceleration_mps2": 5.0, **limits}),
        FENCE,
        STEP_S,
    )


def osem(now_ns: int = T0, place: Place = PLACE, **changes: Any) -> Osem:
    week, time_of_week_ns = to_gps(now_ns)
    made = Osem(
        device_id=7,
        sub_device_id=0,
        control_centre_id=3,
        latitude_deg=place.latitude_deg,
        longitude_deg=place.longitude_deg,
        altitude_m=place.altitude_m,
        rotation_rad=0.0,
        coordinate_system=3,
        date=20260924,
        week=week,
        time_of_week_ns=time_of_week_ns,
        leap_seconds=leap_seconds(now_ns),
        max_way_deviation_m=2.0,
        max_lateral_deviation_m=0.8,
        max_yaw_deviation_rad=0.35,
        max_position_error_m=0.5,
        heab_timeout_s=0.2,
        test_mode=1,
        monr_rate_hz=100,
        monr2_rate_hz=1,
        heab_rate_hz=100,
        max_message_bytes=None,
    )
    return replace(made, **changes)


def trajectory(
    points: Iterable[ReferencePoint], at_ns: int = 0, datum: Datum | None = None
) -> Traj:
    """A TRAJ of points whose time 0 is ``at_ns`` after the start."""
    reference = Reference("drive", "ot1", "", "traj", 0, at_ns, 0, tuple(points))
    return trajectory_of(reference, 0, datum or Datum(PLACE), 1)


class Centre:
    """Sends and hears by given times.

    Args:
        played: an ``IsoObject``, or what stands for one.

    Attributes:
        status: of its heartbeats; None: it sends none.
        monrs: those that came.
        answers: GREM and DRES that came.
        refused: frames that couldn't be read.
    """

    def __init__(self, played: Any, host: str = HOST) -> None:
        self.played = played
        self.now_ns = T0
        self.status: CentreStatus | None = CentreStatus.INIT
        self.address = (host, 50_000)
        self.monrs: list[Monr] = []
        self.answers: list[Message] = []
        self.refused: list[str] = []
        self._counter = 0
        self._tcp = StreamDecoder()

    @property
    def monr(self) -> Monr:
        return self.monrs[-1]

    def connect(self, osem_changes: dict[str, Any] | None = None) -> Grem:
        """TCP, OSEM and the first heartbeats; the answer to the OSEM."""
        assert self.played.connect(self.address[0], self.now_ns)
        answer = self.send(osem(self.now_ns, **(osem_changes or {})))
        self.run(0.05)
        return answer

    def send(self, message: Message, *, acknowledge: bool = True) -> Any:
        """Send a message by TCP, and return the answer that came at once."""
        self.answers.clear()
        self.played.on_tcp(self.frame(message, acknowledge=acknowledge), self.now_ns)
        self.hear()
        return self.answers[-1] if self.answers else None

    def command(self, command: ObjectCommand) -> int:
        """An OSTM; the response code."""
        return int(self.send(Ostm(command)).response)

    def start(self, in_s: float | None = None) -> int:
        """A STRT; the response code."""
        if in_s is None:
            return int(self.send(Strt(None, None)).response)
        week, time_of_week_ns = to_gps(self.now_ns + round(in_s * S))
        return int(self.send(Strt(time_of_week_ns, week)).response)

    def frame(self, message: Message, *, acknowledge: bool = False) -> bytes:
        self._counter = (self._counter + 1) % 256
        return encode(
            message,
            transmitter_id=3,
            receiver_id=7,
            counter=self._counter,
            acknowledge=acknowledge,
        )

    def beat(self, status: int) -> None:
        time_of_week_ns = to_gps(self.now_ns)[1]
        self.played.on_udp(self.frame(Heab(time_of_week_ns, status)), self.address, self.now_ns)

    def run(self, for_s: float, until: Callable[[], bool] = lambda: False) -> float:
        """Heartbeats at 100 Hz; the time that it took, s."""
        begin_ns = self.now_ns
        while self.now_ns - begin_ns < round(for_s * S) and not until():
            self.now_ns += 10 * MS
            if self.status is not None:
                self.beat(self.status)
            self.hear()
        return (self.now_ns - begin_ns) / S

    def hear(self) -> None:
        for sent in self.played.take_sent(self.now_ns):
            frames = StreamDecoder().feed(sent.data) if sent.udp else self._tcp.feed(sent.data)
            for frame in frames:
                found = decode(frame) if hasattr(frame, "header") else frame
                if not isinstance(found, DecodedMessage):
                    self.refused.append(found.text)
                elif isinstance(found.message, Monr):
                    self.monrs.append(found.message)
                else:
                    self.answers.append(found.message)
        if self.played.link.closes:
            self.played.disconnect(self.now_ns)

    def armed(self, traj: Traj | None) -> Centre:
        """Connect and go on to ARMED, with a trajectory."""
        self.connect()
        if traj is not None:
            assert self.send(traj).response == 1
        self.status = CentreStatus.READY
        self.run(0.05)
        assert self.command(ObjectCommand.ARM) == 1
        self.run(0.05)
        return self

    def driving(self, traj: Traj, for_s: float) -> Centre:
        """Go on to RUNNING, and run for so long."""
        self.armed(traj)
        assert self.start() == 1
        self.status = CentreStatus.RUNNING
        self.run(0.02)
        self.run(for_s)
        return self


def played_object(object_class: str = "car", **limits: Any) -> IsoObject:
    return IsoObject(rules_of(object_class, **limits), T0, Datum(PLACE))


def way_m(a: Any, b: Any) -> float:
    return math.dist((a.x_m, a.y_m), (b.x_m, b.y_m))
