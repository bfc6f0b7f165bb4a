"""Objects with bodies of hardware: readings in, steps on the session's clock, commands out."""

from __future__ import annotations

import select
from collections.abc import Callable, Iterable, Iterator, Mapping

from ssp_core.cdr.iso_frames import FrameBatch
from ssp_core.cdr.steps import WorldTick
from ssp_core.clock import ns_to_seconds
from ssp_core.errors import InputError
from ssp_core.leap_seconds import leap_seconds
from ssp_core.names import BODY_ADDRESSES, udp_body
from ssp_core.run_file.model import LinkDisturbance, RunSpec
from ssp_core.safety.body_status import BodyStatus
from ssp_ot_controller.bodies.body import Body, BodyCheck, BodyReading, MirrorBody, state_of
from ssp_ot_controller.bodies.dynamics import Command
from ssp_ot_controller.bodies.iso22133.gateway import IsoAddress, IsoBody
from ssp_ot_controller.bodies.protocol import UdpBody
from ssp_ot_controller.objects.pool import ObjectPool, PoolStep

_FIELD = "parameter bodies"
# A body that does what it is told, in this process: a dry run without hardware.
MIRROR = "mirror"
# Until a body is heard for the first time it is told to stand; it sends to whoever commands it.
_STAND = Command(0.0, 0.0, 0.0, emergency_stop=True)
# A test object's reports come more often than objects are stepped; each is stepped on the first
# one after this share of a step, and without one when none has come for so many steps: stepped
# shortly before its report, it would keep that waiting.
_STEP_SHARE = 0.75
_SILENT_STEPS = 1.25
# An object without a new reading for so long has none.
_QUIET_S = 0.5
# A clock that is as many seconds ahead as GPS time, to this, was not given the leap seconds.
_NEAR_S = 0.5
_REMEDY = f"write ID=ADDRESS, separated by commas, each {BODY_ADDRESSES}"


def parse_bodies(
    text: str, object_ids: Iterable[str]
) -> dict[str, tuple[str, int] | IsoAddress | None]:
    """Return the host and port of each object's body, None for a mirror.

    Args:
        text: ``ot1=udp://host:port,ot2=iso22133://host,ot3=mirror,...``.
        object_ids: of the process's objects.

    Raises:
        InputError: not of that form, or not exactly one for each object.
    """
    wanted = sorted(object_ids)
    found: dict[str, tuple[str, int] | IsoAddress | None] = {}
    for entry in filter(None, (part.strip() for part in text.split(","))):
        object_id, _, address = entry.partition("=")
        udp, iso = udp_body(address), IsoAddress.parse(address)
        if address != MIRROR and iso is None and udp is None:
            raise InputError("is no body", field=_FIELD, value=entry, remedy=_REMEDY)
        if object_id in found or object_id not in wanted:
            raise InputError(
                "has a body already" if object_id in found else "is no object of this process",
                field=_FIELD,
                value=object_id,
                remedy=f"give one body for each of {', '.join(wanted)}",
            )
        found[object_id] = iso or udp
    missing = [object_id for object_id in wanted if object_id not in found]
    if missing:
        raise InputError(
            f"{', '.join(missing)} has no body",
            field=_FIELD,
            value=text,
            remedy=f"a live run needs one for each object: {_REMEDY}",
        )
    return found


def check_undisturbed(run: RunSpec, object_ids: Iterable[str]) -> None:
    """Refuse noise and faults of real objects; they are for simulated ones.

    Raises:
        InputError: the run disturbs one of these objects on purpose.
    """
    for object_id in object_ids:
        disturbed = run.disturbance_of(object_id) != LinkDisturbance()
        if disturbed or any(fault.target == object_id for fault in run.faults):
            raise InputError(
                f"{object_id} has a disturbance or a fault, which moves a real object wrongly",
                field="disturbances, faults",
                remedy="leave them out of a live run, or use simulated objects",
            )


def open_bodies(
    run: RunSpec, object_ids: Iterable[str], text: str, now_ns: int, tell: Callable[[str], None]
) -> dict[str, Body]:
    """Return the bodies of a live run's objects.

    Args:
        run: a live one.
        object_ids: of the process's objects.
        text: see ``parse_bodies``.
        now_ns: by this host's clock.
        tell: is told what an operator needs to know of a test object.

    Raises:
        InputError: the parameter or the run doesn't fit.
        HostError: there is no way to a body.
    """
    ids = list(object_ids)
    check_undisturbed(run, ids)
    specs = {t.id: t for t in run.targets}
    bodies: dict[str, Body] = {}
    numbers = {target.id: number for number, target in enumerate(run.targets, start=1)}
    for object_id, address in parse_bodies(text, ids).items():
        spec = specs[object_id]
        if address is None:
            bodies[object_id] = MirrorBody(spec.cls, spec.start.pose, now_ns)
        elif isinstance(address, IsoAddress):
            bodies[object_id] = IsoBody(run, spec, address, numbers[object_id], tell)
        else:
            bodies[object_id] = UdpBody(object_id, *address, now_ns)
    return bodies


def _leap_hint(off_s: float, now_ns: int, hint: str) -> str:
    """Return a word on leap seconds, where a clock is off by as many."""
    return f" ({hint})" if abs(off_s - leap_seconds(now_ns)) < _NEAR_S else ""


class LiveObjects:
    """All bodies of one process, stepped on the session's clock. Reads no clock itself.

    Args:
        warn: is told of readings that aren't taken, once for each object.
    """

    def __init__(
        self, run: RunSpec, bodies: Mapping[str, Body], warn: Callable[[str], None]
    ) -> None:
        self._bodies = dict(bodies)
        self._specs = {t.id: t for t in run.targets if t.id in bodies}
        self._test_objects = {i: b for i, b in bodies.items() if isinstance(b, IsoBody)}
        self._ahead_s = run.limits.clock_offset_s
        self._oldest_s = run.limits.state_age_s
        self._late_s: dict[str, float] = {}
        self._apart_s = _STEP_SHARE * run.step_s if self._test_objects else 0.0
        self._silent_s = _SILENT_STEPS * run.step_s
        self._stepped_ns: dict[str, int] = {}
        self._newest: dict[str, BodyReading] = {}
        # When they were taken.
        self._taken_ns: dict[str, int] = {}
        self._states: dict[str, int] = {}
        self._warn = warn
        self._warned: set[str] = set()
        # Of those whose newest reading came from the future: by how much.
        self._ahead: dict[str, str] = {}
        self._step = 0

    @property
    def simulated(self) -> tuple[str, ...]:
        """List the objects that are known to be models: mirrors, and what says so of itself."""
        return tuple(
            object_id
            for object_id, body in self._bodies.items()
            if isinstance(body, MirrorBody) or (isinstance(body, IsoBody) and body.is_simulated)
        )

    @property
    def test_object_ids(self) -> tuple[str, ...]:
        """List the objects whose bodies speak ISO 22133."""
        return tuple(self._test_objects)

    def listen(self, now_ns: int) -> bool:
        """Read the test objects that have said something; True where there is a new reading."""
        owners = {one: body for body in self._test_objects.values() for one in body.sockets}
        readable = {id(owners[one]): owners[one] for one in select.select(owners, (), (), 0)[0]}
        new = [body.poll(now_ns) for body in readable.values()]
        return any(new)

    def tick(self, now_ns: int, *, only_new: bool = False) -> WorldTick:
        """Read all bodies; one that says nothing new is where it was, with its old stamp.

        Args:
            now_ns: by this host's clock.
            only_new: after ``listen``; those that say nothing new, or were in a tick just now, are
                left out.
        """
        self._step += 1
        if not only_new:
            for test_object in self._test_objects.values():
                test_object.poll(now_ns)
        for object_id, body in self._bodies.items():
            reading = body.read()
            if reading is not None and self._is_believable(object_id, reading, now_ns):
                self._newest[object_id] = reading
                self._taken_ns[object_id] = now_ns
                self._late_s[object_id] = ns_to_seconds(now_ns - reading.stamp_ns)
        truths = []
        for object_id, reading in sorted(self._newest.items()):
            if not self._is_due(object_id, now_ns, only_new):
                continue
            self._stepped_ns[object_id] = now_ns
            number = self._states[object_id] = self._states.get(object_id, 0) + 1
            truths.append(state_of(reading, self._specs[object_id], number))
        return WorldTick(now_ns, self._step, True, False, 0, 0, tuple(truths))

    def _is_due(self, object_id: str, now_ns: int, only_new: bool) -> bool:
        """Tell whether an object is stepped now."""
        stepped_ns, taken_ns = self._stepped_ns.get(object_id, 0), self._taken_ns[object_id]
        if ns_to_seconds(now_ns - stepped_ns) < self._apart_s:
            return False
        if taken_ns > stepped_ns:
            return True
        reports = object_id in self._test_objects
        is_silent = not reports or ns_to_seconds(now_ns - taken_ns) > self._silent_s
        return is_silent and not only_new

    def check(self, pool: ObjectPool, among: Iterable[str] | None = None) -> None:
        """Tell object targets what their test objects are found to be.

        Args:
            pool: the object targets.
            among: which of the objects; None: all.
        """
        for object_id in self._bodies if among is None else among:
            if object_id in self._test_objects:
                pool.target_of(object_id).body = self._test_objects[object_id].check

    def follow(self, pool: ObjectPool, now_ns: int, among: Iterable[str] | None = None) -> None:
        """Tell test objects what their object targets decided; ``among`` as for ``check``."""
        for object_id in self._bodies if among is None else among:
            if object_id in self._test_objects:
                self._test_objects[object_id].follow(pool.target_of(object_id).decided, now_ns)

    def beat(self, now_ns: int) -> None:
        """Send a heartbeat to each test object."""
        for body in self._test_objects.values():
            body.beat(now_ns)

    def frames(self) -> Iterator[FrameBatch]:
        """Yield the raw frames of each test object since the last call."""
        for object_id, body in self._test_objects.items():
            frames = body.frames()
            if frames:
                yield FrameBatch(frames[-1].stamp_ns, object_id, tuple(frames))

    def statuses(self, now_ns: int) -> list[BodyStatus]:
        """List what keeps each object from being seen and armed."""
        found = []
        for object_id, body in self._bodies.items():
            taken_ns = self._taken_ns.get(object_id)
            silent = taken_ns is None or ns_to_seconds(now_ns - taken_ns) > _QUIET_S
            ahead = self._ahead.get(object_id)
            problems = (ahead,) if ahead else body.problems()
            of_object = self._test_objects.get(object_id)
            check = BodyCheck() if of_object is None else of_object.check
            late = () if silent else self._late(object_id, now_ns)
            deaf = () if silent or of_object is not None else self._deaf(object_id)
            no_state = problems if silent else ()
            keeps = (*check.cannot_arm, *late, *deaf)
            found.append(BodyStatus(object_id, no_state, keeps, check.lasting))
        return found

    def _deaf(self, object_id: str) -> tuple[str, ...]:
        """Say that a body hears no command, where it says so; empty otherwise.

        One of ISO 22133 says it by its state.
        """
        if not self._newest[object_id].brakes_by_itself:
            return ()
        return (
            "its body hears no command and brakes by itself: is the way to it open, and does no "
            "other program command it?",
        )

    def _late(self, object_id: str, now_ns: int) -> tuple[str, ...]:
        """Say why the newest reading was too old when it came."""
        late_s = self._late_s[object_id]
        if late_s <= self._oldest_s:
            return ()
        text = (
            f"what its body says is {late_s:.3f} s old when it comes, limit {self._oldest_s:g} s: "
            "its clock is behind, or its link is slow"
        )
        return (text + _leap_hint(late_s, now_ns, "UTC is so far behind GPS time"),)

    def _is_believable(self, object_id: str, reading: BodyReading, now_ns: int) -> bool:
        ahead_s = ns_to_seconds(reading.stamp_ns - now_ns)
        if ahead_s <= self._ahead_s:
            self._ahead.pop(object_id, None)
            return True
        text = (
            f"its body's clock is {ahead_s:.3f} s ahead, limit {self._ahead_s:g} s: its readings "
            "aren't taken"
        )
        text += _leap_hint(ahead_s, now_ns, "GPS time is so far ahead of UTC")
        if object_id not in self._warned:
            self._warned.add(object_id)
            self._warn(f"{object_id}: {text}")
        self._ahead[object_id] = text
        return False

    def command(self, step: PoolStep | None, now_ns: int) -> None:
        """Send a step's commands; bodies that were never heard are told to stand."""
        commands = dict(step.commands) if step is not None else {}
        for object_id, body in self._bodies.items():
            command = commands.get(object_id)
            if command is None and object_id not in self._newest:
                command = _STAND
            if command is not None:
                body.command(command if command.is_finite else _STAND, now_ns)

    def close(self) -> None:
        """Leave the bodies to their own watchdogs."""
        for body in self._bodies.values():
            body.close()
