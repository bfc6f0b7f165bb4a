"""CARLA's vehicle physics as the plant of a run in lockstep (docs/carla.md).

Vehicles are driven by throttle, brake and steering wheel; pedestrians have no such physics there
and are moved by our own body, and placed. This alone ticks the server, one frame a step.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from typing import Any

from ssp_core.carla.address import CarlaAddress
from ssp_core.carla.blueprints import ChosenBody
from ssp_core.carla.client import CarlaServer
from ssp_core.carla.frame import Ground, feet_pose, vehicle_pose
from ssp_core.carla.offer import Offer
from ssp_core.carla.orders import CarlaMotion, PedalOrder, Placement
from ssp_core.carla.record import PLANT_SCHEMA, body_record
from ssp_core.errors import InputError, PeerError
from ssp_core.geometry import Pose2, wrap_angle
from ssp_core.motion.state import Size
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.vocabulary import ObjectClass
from ssp_ot_controller.bodies.dynamics import BodyState, Command, step_body
from ssp_ot_controller.control.pedals import Pedals, Response, first_order, response_problems
from ssp_ot_controller.sil.plant import lag_scale

# Below this a braked vehicle stands: a simulator's never comes to rest exactly.
_STILL_MPS = 0.03
_LIFT_M, _SETTLE_S = 0.2, 0.6
# A vehicle that was put on its start and settled may stand this far from it.
_START_M, _START_RAD = 0.1, 0.02
# Farther from the road than this, or tilted more against it, a vehicle fell or turned over.
_OFF_ROAD_M, _TILT_DEG = 1.5, 30.0
# The measurement of a response: full throttle up to a speed, a tenth of the wheel, full brake.
_THROTTLE_S, _FASTEST_MPS = 2.5, 8.0
_WHEEL, _WHEEL_S, _TURNS_FROM_MPS = 0.1, 0.8, 0.5
_BRAKE_S, _BRAKES_DOWN_TO_MPS = 6.0, 0.5


class CarlaBodies:
    """The bodies of a run in a CARLA world of the run's map that is otherwise empty.

    Args:
        map_sha256: of the OpenDRIVE that the run was compiled for.
        on_record: takes the record (``CarlaPlantRecord``) once all stand at their starts.

    Raises:
        InputError: a run that isn't in lockstep.
        HostError: CARLA's client isn't installed.
        PeerError: there is no server, or it is refused, or a vehicle can't be led within the
            site's limits.
    """

    def __init__(
        self,
        run: RunSpec,
        address: CarlaAddress,
        map_sha256: str,
        on_record: Callable[[Mapping[str, Any]], None],
    ) -> None:
        if run.mode != "lockstep":
            raise InputError(
                "CARLA moves bodies in lockstep only, and never beside real ones",
                field="mode",
                value=run.mode,
                remedy="run it in lockstep, or without --plant",
            )
        self._run, self._step_s = run, run.step_s
        self._specs: dict[str, ParticipantSpec] = {p.id: p for p in (run.vut, *run.targets)}
        self._actors: dict[str, int] = {}
        self._bodies: dict[str, ChosenBody] = {}
        self._pedals: dict[str, Pedals] = {}
        responses: dict[str, Response] = {}
        self._server = CarlaServer(address)
        try:
            facts = self._server.accept(map_sha256)
            self._ground: Ground = self._server.ground()
            self._server.take_over(run.step_s)
            self._server.turn_lights_green()
            offer = Offer(self._server)
            for name, spec in self._specs.items():
                actor, body = offer.spawn(name, spec.cls, spec.size)
                self._actors[name], self._bodies[name] = actor, body
            for name in self._vehicles:
                responses[name] = self._measured(name)
                scale = lag_scale(run, name)
                cls = self._specs[name].cls
                self._pedals[name] = Pedals(cls, responses[name], run.step_s, scale)
            self._begin()
            on_record(
                {
                    "schema": PLANT_SCHEMA,
                    "address": str(address),
                    "version": facts.version,
                    "client_version": facts.client_version,
                    "map_name": facts.map_name,
                    "map_sha256": facts.map_sha256,
                    "synchronous": True,
                    "step_s": run.step_s,
                    "first_frame": self._server.tick(),
                    "seed": run.seed,
                    "settings": self._server.settings(),
                    "bodies": {n: body_record(b, self._size(n)) for n, b in self._bodies.items()},
                    "responses": {
                        n: {key: round(v, 4) for key, v in asdict(r).items()}
                        for n, r in responses.items()
                    },
                    "counterpart": self._server.is_counterpart(),
                }
            )
        except BaseException:
            self._server.close()
            raise

    @property
    def _vehicles(self) -> list[str]:
        walks = ObjectClass.PEDESTRIAN
        return [name for name, spec in self._specs.items() if spec.cls is not walks]

    def _size(self, name: str) -> Size:
        return self._specs[name].size

    # -- before the run ---------------------------------------------------------------------------

    def _measured(self, name: str) -> Response:
        """Drive a vehicle off from its start, with no other vehicle on the ground, and measure.

        Raises:
            PeerError: it can't be led within the site's limits.
        """
        actor, dt_s = self._actors[name], self._step_s
        high = self._server.pose_of(actor)
        self._put(name)
        body = self._settled(name)
        pushed: list[float] = []
        while len(pushed) * dt_s < _THROTTLE_S and body.speed_mps < _FASTEST_MPS:
            body = self._pressed(name, body, 1.0, 0.0, 0.0)
            pushed.append(body.acceleration_mps2)
        turned: list[float] = []
        while len(turned) * dt_s < _WHEEL_S and body.speed_mps > _TURNS_FROM_MPS:
            body = self._pressed(name, body, 0.0, 0.0, -_WHEEL)
            turned.append(body.yaw_rate_radps / max(body.speed_mps, _TURNS_FROM_MPS) / _WHEEL)
        braked: list[float] = []
        while len(braked) * dt_s < _BRAKE_S and body.speed_mps > _BRAKES_DOWN_TO_MPS:
            body = self._pressed(name, body, 0.0, 1.0, 0.0)
            braked.append(-body.acceleration_mps2)
        self._server.set_physics(actor, False)
        self._server.step([Placement(actor, high)])
        response = Response(
            *first_order(pushed, dt_s), *first_order(braked, dt_s), *first_order(turned, dt_s)
        )
        limits = self._run.limits
        problems = response_problems(
            response, limits.stop_deceleration_mps2, limits.stop_reaction_s
        )
        if problems:
            raise PeerError(
                f"CARLA's {self._bodies[name].blueprint} can't be led as {name} within the limits "
                f"of {self._run.site}: {'; '.join(problems)}"
            )
        return response

    def _begin(self) -> None:
        """Put everybody on the start, and wait until all stand there."""
        for name in self._actors:
            self._put(name)
        self._start = {
            name: self._settled(name)
            if name in self._pedals
            else BodyState.at_rest(spec.start.pose)
            for name, spec in self._specs.items()
        }
        for name in self._pedals:
            start_pose, state = self._specs[name].start.pose, self._start[name]
            off_m = math.hypot(state.x_m - start_pose.x_m, state.y_m - start_pose.y_m)
            turned = abs(wrap_angle(state.yaw_rad - start_pose.yaw_rad))
            if off_m > _START_M or turned > _START_RAD:
                raise PeerError(
                    f"CARLA's {self._bodies[name].blueprint} doesn't stay at the start of {name}: "
                    f"it settled {off_m:.2f} m and {math.degrees(turned):.1f} degrees from it"
                )

    def _put(self, name: str) -> None:
        spec, actor = self._specs[name], self._actors[name]
        if spec.cls is ObjectClass.PEDESTRIAN:
            self._server.step([Placement(actor, feet_pose(spec.start.pose, self._ground), 0.0)])
            return
        box = self._bodies[name].box
        pose = vehicle_pose(spec.start.pose, spec.size, box, self._ground)
        self._server.step([Placement(actor, replace(pose, z_m=pose.z_m + _LIFT_M))])
        self._server.set_physics(actor, True)

    def _settled(self, name: str) -> BodyState:
        body = BodyState.at_rest(self._specs[name].start.pose)
        for _ in range(math.ceil(_SETTLE_S / self._step_s)):
            body = self._pressed(name, body, 0.0, 1.0, 0.0)
        return replace(body, speed_mps=0.0, acceleration_mps2=0.0, yaw_rate_radps=0.0)

    def _pressed(
        self, name: str, before: BodyState, throttle: float, brake: float, steer: float
    ) -> BodyState:
        """Run one frame in which one vehicle is driven."""
        order = PedalOrder(self._actors[name], throttle, brake, steer)
        self._server.step([], [order])
        return self._read(name, before, brake, 0.0)

    # -- the run ----------------------------------------------------------------------------------

    def start(self) -> dict[str, BodyState]:
        return dict(self._start)

    def step(
        self, bodies: Mapping[str, BodyState], commands: Mapping[str, Command]
    ) -> dict[str, BodyState]:
        placements, orders = [], []
        states: dict[str, BodyState] = {}
        for name, actor in self._actors.items():
            pedals = self._pedals.get(name)
            if pedals is not None:
                orders.append(PedalOrder(actor, *pedals.press(bodies[name], commands[name])))
                continue
            scale = lag_scale(self._run, name)
            cls = self._specs[name].cls
            walked = step_body(cls, bodies[name], commands[name], self._step_s, lag_scale=scale)
            states[name] = walked
            pose = feet_pose(Pose2(walked.x_m, walked.y_m, walked.yaw_rad), self._ground)
            placements.append(Placement(actor, pose, max(0.0, walked.speed_mps)))
        self._server.step(placements, orders)
        for (name, pedals), order in zip(self._pedals.items(), orders, strict=True):
            states[name] = self._read(name, bodies[name], order.brake, pedals.curvature_1pm)
        return {name: states[name] for name in bodies}

    def _read(self, name: str, before: BodyState, brake: float, curvature_1pm: float) -> BodyState:
        """Read a vehicle in the newest frame.

        Raises:
            PeerError: it is gone, or fell off the road, or over.
        """
        motion = self._server.motion_of(self._actors[name])
        self._check_upright(name, motion)
        spec, box = self._specs[name], self._bodies[name].box
        pose, (vx, vy, _) = motion.pose, motion.velocity
        yaw = wrap_angle(-math.radians(pose.yaw_deg))
        ahead_m = 0.5 * (spec.size.front_m - spec.size.rear_m) - box.forward_m
        x, y = Pose2(pose.x_m, -pose.y_m, yaw).to_parent(-ahead_m, -box.right_m)
        speed = vx * math.cos(yaw) - vy * math.sin(yaw)
        if brake > 0.0 and abs(speed) < _STILL_MPS:
            return BodyState(x, y, yaw, curvature_1pm=curvature_1pm)
        return BodyState(
            x,
            y,
            yaw,
            speed_mps=speed,
            acceleration_mps2=(speed - before.speed_mps) / self._step_s,
            curvature_1pm=curvature_1pm,
            yaw_rate_radps=wrap_angle(yaw - before.yaw_rad) / self._step_s,
        )

    def _check_upright(self, name: str, motion: CarlaMotion) -> None:
        pose = motion.pose
        off_m = pose.z_m - self._ground(pose.x_m, -pose.y_m)
        tilt_deg = max(abs(pose.pitch_deg), abs(pose.roll_deg))
        if abs(off_m) > _OFF_ROAD_M or tilt_deg > _TILT_DEG:
            raise PeerError(
                f"CARLA's body of {name} is {off_m:+.2f} m from the road's height and tilted by "
                f"{tilt_deg:.0f} degrees: it fell, or turned over"
            )

    def close(self) -> list[str]:
        return self._server.close()
