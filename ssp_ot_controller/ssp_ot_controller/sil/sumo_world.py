"""The one place that talks to libsumo: traffic around objects that are moved from outside.

SUMO doesn't move the VUT and the object targets: it is given their poses every step, reacts to them
with its own traffic, and says what collides. SUMO puts a position at the front bumper and counts
angles clockwise from north in degrees; ``to_sumo`` and ``from_sumo`` are the only conversion.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType

import libsumo  # type: ignore[import-untyped] # has no types

from ssp_core.clock import seconds_to_ns
from ssp_core.errors import HostError, InputError
from ssp_core.geometry import Pose2, wrap_angle
from ssp_core.motion.state import DEFAULT_SIZES, ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import TrafficSpec
from ssp_core.value_class import value_class
from ssp_core.vocabulary import ObjectClass, Role
from ssp_core.world.sumo_network import SUMO_CLASSES, SUMO_SEEDS, Network, write_network

# moveToXY: 2 takes the pose as given, on a lane or not; 4 lets persons be on any lane.
_KEEP_VEHICLE = 2
_KEEP_PERSON = 6
# A person who never walks by itself waits longer than any run.
_WAIT_S = 1e6


@value_class(frozen=True, slots=True)
class SumoPose:
    """A pose as SUMO counts: front bumper in m, degrees clockwise from north in [0, 360)."""

    x_m: float
    y_m: float
    angle_deg: float


def to_sumo(pose: Pose2, front_m: float) -> SumoPose:
    """Return SUMO's pose of an object whose reference point is ``front_m`` behind its front."""
    x, y = pose.to_parent(front_m, 0.0)
    return SumoPose(x, y, (90.0 - math.degrees(pose.yaw_rad)) % 360.0)


def from_sumo(pose: SumoPose, front_m: float) -> Pose2:
    """Return the pose of the reference point, ``front_m`` behind SUMO's front bumper."""
    yaw = wrap_angle(math.radians(90.0 - pose.angle_deg))
    x, y = Pose2(pose.x_m, pose.y_m, yaw).to_parent(-front_m, 0.0)
    return Pose2(x, y, yaw)


class SumoWorld:
    """A SUMO simulation of one run, as a context manager; at most one per process.

    On entering, everything stands where the run file says, at time 0. Every ``step`` is given the
    next poses of the VUT and all targets, and returns the traffic at the same instant.

    Args:
        work_dir: folder for the network and SUMO's log; is made when it isn't there.
    """

    def __init__(self, run: RunSpec, work_dir: Path) -> None:
        self._run = run
        self._work_dir = work_dir
        self._external = {p.id: p for p in (run.vut, *run.targets)}
        self._traffic = {t.id: t for t in run.traffic}
        # Asked for in every step, and looked up by word each time.
        self._kinds = {t.id: ObjectClass.from_word(t.object_class) for t in run.traffic}
        ours = sorted(self._external.values(), key=lambda p: p.id)
        self._fronts = [(p.id, p.cls is ObjectClass.PEDESTRIAN, p.size.front_m) for p in ours]
        self._step = 0
        self._yaw: dict[str, float] = {}
        self._states: list[ObjectState] = []
        ids = [p.id for p in (run.vut, *run.targets)] + [t.id for t in run.traffic]
        for i in sorted(set(ids)):
            if ids.count(i) > 1:
                raise InputError(
                    "two objects have the same id",
                    field="traffic",
                    value=i,
                    remedy="give each object an id of its own",
                )

    def __enter__(self) -> SumoWorld:
        if libsumo.isLoaded():
            raise RuntimeError("a process can hold one SUMO simulation only, and it holds one")
        network = write_network(self._run.road, self._work_dir)
        try:
            libsumo.start(self._command(network))
        except (libsumo.FatalTraCIError, libsumo.TraCIException) as error:
            raise HostError(f"SUMO doesn't start: {error}") from error
        try:
            self._populate(network)
            self._place({p.id: (p.start.pose, 0.0) for p in self._external.values()})
            # SUMO inserts traffic at the end of a step: after this one all of it is at its start.
            self._advance()
            missing = sorted(set(self._traffic) - {s.object_id for s in self._states})
            if missing:
                raise InputError(
                    "there is no room for this traffic at its start",
                    field="traffic",
                    value=missing,
                    remedy="give it more distance to what is ahead of it, or less speed",
                )
        except BaseException:
            libsumo.close()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        libsumo.close()

    def _command(self, network: Network) -> list[str]:
        return [
            "sumo",
            f"--net-file={network.path}",
            f"--step-length={self._run.step_s}",
            f"--seed={self._run.seed % SUMO_SEEDS}",
            "--collision.action=warn",
            "--collision.mingap-factor=0",
            "--collision.check-junctions=true",
            "--time-to-teleport=-1",
            "--no-step-log=true",
            "--duration-log.disable=true",
            "--no-warnings=true",
            f"--error-log={self._work_dir / 'sumo.log'}",
        ]

    def _populate(self, network: Network) -> None:
        for edge in sorted({place.edge for place in network.lanes}):
            libsumo.route.add(edge, [edge])
        for object_class in sorted({p.cls for p in self._external.values()} | self._classes()):
            self._add_type(object_class)
        some_edge = network.lanes[0].edge
        for p in self._external.values():
            if p.cls is ObjectClass.PEDESTRIAN:
                libsumo.person.add(p.id, some_edge, 0.0, typeID=p.object_class)
                libsumo.person.appendWaitingStage(p.id, _WAIT_S)
            else:
                libsumo.vehicle.add(p.id, some_edge, typeID=p.object_class)
        for t in self._traffic.values():
            self._add_traffic(t, network)

    def _classes(self) -> set[ObjectClass]:
        return {ObjectClass.from_word(t.object_class) for t in self._traffic.values()}

    @staticmethod
    def _add_type(object_class: ObjectClass) -> None:
        size, word = DEFAULT_SIZES[object_class], object_class.word
        parent = "DEFAULT_PEDTYPE" if object_class is ObjectClass.PEDESTRIAN else "DEFAULT_VEHTYPE"
        libsumo.vehicletype.copy(parent, word)
        libsumo.vehicletype.setVehicleClass(word, SUMO_CLASSES[object_class])
        libsumo.vehicletype.setLength(word, size.length_m)
        libsumo.vehicletype.setWidth(word, size.width_m)
        libsumo.vehicletype.setHeight(word, size.height_m)
        libsumo.vehicletype.setSpeedDeviation(word, 0.0)
        libsumo.vehicletype.setSpeedFactor(word, 1.0)
        # SUMO's imperfection is noise on acceleration in every step, which no driver shows.
        libsumo.vehicletype.setImperfection(word, 0.0)

    def _add_traffic(self, traffic: TrafficSpec, network: Network) -> None:
        if traffic.object_class == "pedestrian":
            raise InputError(
                "a pedestrian can't be traffic",
                field=f"traffic.{traffic.id}.object_class",
                remedy="make it a target, or choose a vehicle",
            )
        if traffic.lane >= len(network.lanes):
            raise InputError(
                f"the road has {len(network.lanes)} lane(s)",
                field=f"traffic.{traffic.id}.lane",
                value=traffic.lane,
                remedy="give an index into road.lanes, from 0",
            )
        place = network.lanes[traffic.lane]
        libsumo.vehicle.add(
            traffic.id,
            place.edge,
            typeID=traffic.object_class,
            departLane=str(place.index),
            departPos=f"{place.position_m(traffic.x_m):.6f}",
            departSpeed=f"{traffic.speed_mps:.6f}",
        )
        # It wants to keep the speed that it starts with, and to stay in its lane.
        libsumo.vehicle.setLaneChangeMode(traffic.id, 0)
        if traffic.speed_mps > 0.0:
            libsumo.vehicle.setMaxSpeed(traffic.id, traffic.speed_mps)
        else:
            libsumo.vehicle.setSpeed(traffic.id, 0.0)

    @property
    def now_ns(self) -> int:
        """Simulated time of the present states, ns; 0 on entering."""
        return seconds_to_ns(self._step * self._run.step_s)

    def traffic(self) -> list[ObjectState]:
        """Return the states of the traffic, sorted by id; a vehicle that left the road is gone."""
        return list(self._states)

    def step(self, poses: Sequence[ObjectState]) -> list[ObjectState]:
        """Advance by one step to where the VUT and all targets have the given states.

        Args:
            poses: one state per participant of the run, in any order; stamps are ignored.

        Returns:
            States of the traffic at that instant, as ``traffic()``.

        Raises:
            ValueError: a state isn't finite, is missing, given twice or of an unknown object.
                SUMO is as it was.
        """
        ids = sorted(s.object_id for s in poses)
        if ids != [name for name, _, _ in self._fronts]:
            raise ValueError(f"need one state of each of {sorted(self._external)}, got {ids}")
        for s in poses:
            if not s.is_finite:
                raise ValueError(f"state of {s.object_id!r} isn't finite: {s}")
        self._place({s.object_id: (s.pose, s.speed_mps) for s in poses})
        self._step += 1
        self._advance()
        return self.traffic()

    def _place(self, places: Mapping[str, tuple[Pose2, float]]) -> None:
        """Put our objects where they are, in the order of their ids."""
        for name, walks, front_m in self._fronts:
            pose, speed_mps = places[name]
            at = to_sumo(pose, front_m)
            if walks:
                libsumo.person.moveToXY(
                    name, "", at.x_m, at.y_m, at.angle_deg, keepRoute=_KEEP_PERSON
                )
                continue
            libsumo.vehicle.moveToXY(
                name, "", -1, at.x_m, at.y_m, at.angle_deg, keepRoute=_KEEP_VEHICLE
            )
            speed = max(speed_mps, 0.0)
            libsumo.vehicle.setPreviousSpeed(name, speed)
            libsumo.vehicle.setSpeed(name, speed)

    def _advance(self) -> None:
        libsumo.simulationStep()
        present = sorted(set(libsumo.vehicle.getIDList()) & self._traffic.keys())
        self._states = [self._state(name) for name in present]
        self._yaw = {s.object_id: s.yaw_rad for s in self._states}

    def _state(self, name: str) -> ObjectState:
        cls = self._kinds[name]
        size = DEFAULT_SIZES[cls]
        x, y = libsumo.vehicle.getPosition(name)
        pose = from_sumo(SumoPose(x, y, libsumo.vehicle.getAngle(name)), size.front_m)
        turn = wrap_angle(pose.yaw_rad - self._yaw.get(name, pose.yaw_rad))
        return ObjectState(
            object_id=name,
            object_class=cls,
            role=Role.TRAFFIC,
            stamp_ns=self.now_ns,
            x_m=pose.x_m,
            y_m=pose.y_m,
            yaw_rad=pose.yaw_rad,
            speed_mps=libsumo.vehicle.getSpeed(name),
            acceleration_mps2=libsumo.vehicle.getAcceleration(name),
            yaw_rate_radps=turn / self._run.step_s,
            size=size,
            sequence=self._step + 1,
        )
