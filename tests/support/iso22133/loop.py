"""A gateway and an object of ours in one process, on one clock that is stepped, without sockets.

The manager is played: its heartbeats, commands and references. What goes over the link may be
disturbed on its way, in both directions.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from ssp_core.cdr.references import Acknowledgement
from ssp_core.cdr.steps import Heartbeat
from ssp_core.clock import NS_PER_S, ns_to_seconds, seconds_to_ns
from ssp_core.motion.approach import approach_points
from ssp_core.motion.reference import Points, Reference
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.limits import LimitViolation
from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_ot_controller.bodies.iso22133.framing import (
    Header,
    RejectedBytes,
    StreamDecoder,
    frames_of,
)
from ssp_ot_controller.bodies.iso22133.gateway import IsoAddress, IsoBody
from ssp_ot_controller.bodies.iso22133.link import Link, ReceivedMessage, Tap
from ssp_ot_controller.bodies.iso22133.messages import Heab, Message, decode, encode
from ssp_ot_controller.objects.live import LiveObjects
from ssp_ot_controller.objects.pool import ObjectPool, PoolStep
from ssp_ot_controller.objects.rules import ObjectRules
from ssp_ot_controller.objects.state_machine import CommandResponse, ObjectEvent
from ssp_ot_controller.rehearsal.iso_object import STEP_S, IsoObject
from tests.support.runs import cut_in_run

T0 = 1_800_000_000 * NS_PER_S
MS = 1_000_000
HOST = "10.0.0.1"
# What goes on its way: to the object or from it, by UDP or by TCP, and its bytes. None is lost.
Way = Callable[[bool, bool, bytes], bytes | None]


class LoopLink(Link):
    """The link's interface between two objects of one process."""

    def __init__(self, loop: Loop, tap: Tap) -> None:
        super().__init__("127.0.0.1", 2, tap)
        self._loop = loop
        self._stands = False
        self._came: deque[tuple[bool, bytes]] = deque()
        self._decoder = StreamDecoder()

    @property
    def connected(self) -> bool:
        return self._stands

    def connect(self) -> None:
        if self._loop.may_connect:
            self._stands = self._loop.object.connect(HOST, self._loop.now_ns)

    def poll(self) -> list[ReceivedMessage]:
        found = []
        while self._came:
            udp, data = self._came.popleft()
            frames = frames_of(data) if udp else self._decoder.feed(data)
            for frame in frames:
                outcome = frame if isinstance(frame, RejectedBytes) else decode(frame)
                found.append(ReceivedMessage(udp, self._loop.now_ns, outcome, data))
        return found

    def send(self, message: Message, *, acknowledge: bool = False) -> Header:
        data = encode(message, acknowledge=acknowledge)
        udp = isinstance(message, Heab)
        arrives = self._loop.way(True, udp, data)
        if arrives is not None and self._stands:
            target, now_ns = self._loop.object, self._loop.now_ns
            if udp:
                target.on_udp(arrives, (HOST, 4000), now_ns)
            else:
                target.on_tcp(arrives, now_ns)
        return Header(0)

    def take(self, udp: bool, data: bytes) -> None:
        arrives = self._loop.way(False, udp, data)
        if arrives is not None:
            self._came.append((udp, arrives))

    def lose(self) -> None:
        """The control connection breaks, and both ends see it."""
        self._stands = False
        self.problem = "broken"
        self._loop.object.disconnect(self._loop.now_ns)


class Loop:
    """The control loop of one target that approaches along x from (40, 3.5) at up to 7 m/s.

    Args:
        waive: person who lets the object be armed without a probe report; empty: none.
        report: file of a probe report.

    Attributes:
        way: what happens to bytes on their way.
        gateway_alive: its process runs.
        manager_alive: it sends heartbeats.
        stops: limits that the object target stopped by.
        live: the object target's bodies.
    """

    def __init__(self, waive: str = "Ada", report: Path | None = None, **limits: float) -> None:
        made = cut_in_run()
        made["limits"] = {"speed_mps": 15.0, "acceleration_mps2": 5.0, **limits}
        made |= {"mode": "live", "datum": {"latitude_deg": 57.0, "longitude_deg": 12.0}}
        self.run = RunSpec.model_validate(made)
        spec = self.run.targets[0]
        self.now_ns = T0
        self.way: Way = lambda to_object, udp, data: data
        self.may_connect = self.gateway_alive = self.manager_alive = True
        self.told: list[str] = []
        self.stops: list[LimitViolation] = []
        self.acks: list[Acknowledgement] = []
        fence = tuple(self.run.geofence)
        rules = ObjectRules(spec, self.run.limits, fence, STEP_S, self.run.event_version)
        assert self.run.datum is not None
        self.object = IsoObject(rules, T0, self.run.datum.datum)
        self.links: list[LoopLink] = []

        def make_link(host: str, port: int, tap: Tap) -> Link:
            self.links.append(LoopLink(self, tap))
            return self.links[-1]

        address = IsoAddress("10.0.0.9", waive=waive, report=report)
        self.body = IsoBody(self.run, spec, address, 1, self.told.append, make_link)
        self.live = LiveObjects(self.run, {spec.id: self.body}, self.told.append)
        self.pool = ObjectPool(self.run)
        self.session = SessionPhase.LOADED
        self.driven: Reference | None = None
        self._beats = 0

    @property
    def link(self) -> LoopLink:
        return self.links[0]

    @property
    def state(self) -> ControlState:
        return self.pool.state_of("ot1")

    @property
    def steady_ns(self) -> int:
        return self.now_ns - T0

    def forward(self, seconds: float) -> None:
        end_ns = self.now_ns + seconds_to_ns(seconds)
        while self.now_ns < end_ns:
            self._step()

    def until(self, condition: Callable[[], bool], within_s: float) -> float:
        """Steps until it holds; s from now. Fails where that takes too long."""
        began_ns = self.now_ns
        while not condition():
            assert ns_to_seconds(self.now_ns - began_ns) <= within_s, (self.state, self.told)
            self._step()
        return ns_to_seconds(self.now_ns - began_ns)

    def command(self, event: ObjectEvent) -> CommandResponse:
        return self.pool.command("ot1", event, self.run.event_version, self.steady_ns)

    def drive(self, speed_mps: float) -> None:
        """Connects, arms and starts the object, and waits until it drives that fast."""
        self.arm()
        self.session = SessionPhase.RUNNING
        self.forward(0.06)
        self.driven = self.approach()
        self.send(self.driven)
        self.until(lambda: self.object.body.speed_mps >= speed_mps, 20.0)

    def arm(self) -> None:
        self.session = SessionPhase.CONNECTED
        self.forward(1.0)
        response = self.command(ObjectEvent.ARM)
        assert response.accepted, response
        self.until(lambda: self.state is ControlState.ARMED, 2.0)
        self.session = SessionPhase.ARMED
        self.forward(0.1)

    def approach(self) -> Reference:
        motion = self.run.targets[0].approach
        assert motion is not None
        return self.reference("approach", approach_points(motion), 0.5)

    def reference(self, purpose: str, points: Points, lead_s: float) -> Reference:
        execute_ns = self.now_ns + seconds_to_ns(lead_s)
        version, ends_ns = self.run.event_version, execute_ns + NS_PER_S
        return Reference(purpose, "ot1", version, purpose, self.now_ns, execute_ns, ends_ns, points)

    def send(self, reference: Reference) -> None:
        self.pool.take_reference(reference)

    def later(self, way: Way, seconds: float) -> None:
        """Another way of the bytes from a time on."""
        self.forward(seconds)
        self.way = way

    # -- inside --------------------------------------------------------------------------------

    def _step(self) -> None:
        self.now_ns += 5 * MS
        elapsed_ms = self.steady_ns // MS
        if self.manager_alive and elapsed_ms % 50 == 0:
            self._beats += 1
            beat = Heartbeat(self.now_ns, "manager", self._beats, self.now_ns, self.session, {})
            self.pool.take_heartbeat(beat, self.steady_ns)
        if self.gateway_alive:
            if elapsed_ms % 10 == 0:
                self.live.beat(self.now_ns)
            self._serve(only_new=elapsed_ms % 20 != 0)
        for sent in self.object.take_sent(self.now_ns):
            self.link.take(sent.udp, sent.data)
        if self.object.link.closes:
            self.link.lose()

    def _serve(self, *, only_new: bool) -> None:
        # Instead of ``listen``: there is no socket.
        if only_new and not self.body.poll(self.now_ns):
            return
        tick = self.live.tick(self.now_ns, only_new=only_new)
        if only_new and not tick.objects:
            return
        among = [state.object_id for state in tick.objects] if only_new else None
        self.live.check(self.pool, among)
        self.pool.take_tick(replace(tick), self.steady_ns)
        self._take(self.pool.step(self.steady_ns), among)

    def _take(self, step: PoolStep | None, among: list[str] | None) -> None:
        self.live.command(step, self.now_ns)
        self.live.follow(self.pool, self.now_ns, among)
        if step is not None:
            self.stops += [event.stop for event in step.events]
            self.acks += step.acks
