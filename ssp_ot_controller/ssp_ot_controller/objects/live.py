"""Objects with bodies of hardware: readings in, steps on the session's clock, commands out.

``LiveObject`` owns what one body says; this file owns the number of the step.
"""

from __future__ import annotations

import select
from collections.abc import Callable, Iterable, Iterator, Mapping

from ssp_core.cdr.iso_frames import FrameBatch
from ssp_core.cdr.steps import WorldTick
from ssp_core.errors import InputError
from ssp_core.names import BODY_ADDRESSES, udp_body
from ssp_core.run_file.model import LinkDisturbance, RunSpec
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.safety.body_status import BodyStatus
from ssp_ot_controller.bodies.body import Body, MirrorBody
from ssp_ot_controller.bodies.iso22133.gateway import IsoAddress, IsoBody
from ssp_ot_controller.bodies.protocol import UdpBody
from ssp_ot_controller.objects.driving import room_of
from ssp_ot_controller.objects.live_object import LiveObject, ReadingLimits
from ssp_ot_controller.objects.pool import ObjectPool, PoolStep

_FIELD = "parameter bodies"
# A body that does what it is told, in this process: a dry run without hardware.
MIRROR = "mirror"
# A test object's reports come more often than objects are stepped; each is stepped on the first
# one after this share of a step, and without one when none has come for so many steps: stepped
# shortly before its report, it would keep that waiting.
_STEP_SHARE = 0.75
_SILENT_STEPS = 1.25
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
    required_ids = sorted(object_ids)
    bodies: dict[str, tuple[str, int] | IsoAddress | None] = {}
    for entry in filter(None, (part.strip() for part in text.split(","))):
        object_id, _, address = entry.partition("=")
        udp, iso = udp_body(address), IsoAddress.parse(address)
        if address != MIRROR and iso is None and udp is None:
            raise InputError("is no body", field=_FIELD, value=entry, remedy=_REMEDY)
        if object_id in bodies or object_id not in required_ids:
            raise InputError(
                "has a body already" if object_id in bodies else "is no object of this process",
                field=_FIELD,
                value=object_id,
                remedy=f"give one body for each of {', '.join(required_ids)}",
            )
        bodies[object_id] = iso or udp
    missing = [object_id for object_id in required_ids if object_id not in bodies]
    if missing:
        raise InputError(
            f"{', '.join(missing)} has no body",
            field=_FIELD,
            value=text,
            remedy=f"a live run needs one for each object: {_REMEDY}",
        )
    return bodies


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
        tell: called with what an operator needs to know of a test object.

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


def no_room(run: RunSpec, spec: ParticipantSpec, body: Body) -> tuple[str, ...]:
    """Say that a test object that brakes late can't stop inside the fence on its approach.

    Returns:
        One sentence; empty where it can, or drives no approach.
    """
    if not isinstance(body, IsoBody) or body.approach is None or not body.slows_s:
        return ()
    places = body.approach.places
    lack = room_of(spec, run, body.slows_s).lack(places)
    if lack is None:
        return ()
    _, x, y, _, speed, _, _ = places[:, lack.point]
    return (
        f"its probe report shows {body.slows_s:.3f} s from an abort to the first slowing: on its "
        f"approach {lack.how} from x {x:.2f} m, y {y:.2f} m ({speed:.1f} m/s) on leads "
        f"{lack.excess_m:.3f} m outside the geofence, limit is 0 m: it needs a larger fence, a "
        "slower approach, or brakes that answer sooner",
    )


class LiveObjects:
    """All bodies of one process, stepped on the session's clock. Reads no clock itself.

    Args:
        warn: called with readings that aren't taken, once for each object.
    """

    def __init__(
        self, run: RunSpec, bodies: Mapping[str, Body], warn: Callable[[str], None]
    ) -> None:
        specs = {t.id: t for t in run.targets}
        self._test_objects = {i: b for i, b in bodies.items() if isinstance(b, IsoBody)}
        limits = ReadingLimits(
            run.limits.clock_offset_s,
            run.limits.state_age_s,
            _STEP_SHARE * run.step_s if self._test_objects else 0.0,
            _SILENT_STEPS * run.step_s,
        )
        self._objects = {
            i: LiveObject(body, specs[i], limits, no_room(run, specs[i], body))
            for i, body in bodies.items()
        }
        self._warn = warn
        self._step = 0

    @property
    def simulated(self) -> tuple[str, ...]:
        """List the objects that are known to be models: mirrors, and what says so of itself."""
        return tuple(
            object_id
            for object_id, one in self._objects.items()
            if isinstance(one.body, MirrorBody)
            or (isinstance(one.body, IsoBody) and one.body.is_simulated)
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
        for object_id, one in self._objects.items():
            if refused := one.read(now_ns):
                self._warn(f"{object_id}: {refused}")
        states = [one.step(now_ns, only_new=only_new) for _, one in sorted(self._objects.items())]
        truths = tuple(state for state in states if state is not None)
        return WorldTick(now_ns, self._step, True, False, 0, 0, truths)

    def check(self, pool: ObjectPool, among: Iterable[str] | None = None) -> None:
        """Tell object targets what their test objects are found to be.

        Args:
            pool: the object targets.
            among: which of the objects; None: all.
        """
        for object_id in self._objects if among is None else among:
            if object_id in self._test_objects:
                pool.target_of(object_id).body = self._objects[object_id].check

    def follow(self, pool: ObjectPool, now_ns: int, among: Iterable[str] | None = None) -> None:
        """Tell test objects what their object targets decided; ``among`` as for ``check``."""
        for object_id in self._objects if among is None else among:
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
        return [one.status(now_ns) for one in self._objects.values()]

    def command(self, step: PoolStep | None, now_ns: int) -> None:
        """Send a step's commands; bodies that were never heard are commanded to stand."""
        commands = dict(step.commands) if step is not None else {}
        for object_id, one in self._objects.items():
            one.command(commands.get(object_id), now_ns)

    def close(self) -> None:
        """Leave the bodies to their own watchdogs."""
        for one in self._objects.values():
            one.body.close()
