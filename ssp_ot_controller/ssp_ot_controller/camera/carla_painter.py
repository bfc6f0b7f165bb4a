"""CARLA as a renderer of the front camera.

Its server receives where everything is, runs one frame, and sends what its camera saw in that
frame.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ssp_core.carla.address import CarlaAddress
from ssp_core.carla.blueprints import ChosenBody
from ssp_core.carla.client import CarlaServer
from ssp_core.carla.frame import camera_pose, feet_pose, vehicle_pose
from ssp_core.carla.offer import Offer
from ssp_core.carla.orders import Placement
from ssp_core.carla.record import SCENE_SCHEMA, body_record
from ssp_core.carla.sensor import camera_attributes, weather_of
from ssp_core.errors import PeerError
from ssp_core.geometry import Pose2
from ssp_core.motion.state import ObjectState, Size
from ssp_core.run_file.model import Camera, Look, RunSpec
from ssp_core.vocabulary import ObjectClass
from ssp_ot_controller.camera.frames import steps_per_frame
from ssp_ot_controller.camera.kernels.jit import Array
from ssp_ot_controller.camera.renderer.bodies import BRAKE_MPS2
from ssp_ot_controller.camera.renderer.scene import Indicator, Scene, is_lit

# Three calls make a picture, and the world gives the camera 10 s for it.
_FRAME_TIMEOUT_S = 3.0
# CARLA's exposure follows the light for this long after the camera appeared.
_EXPOSURE_S = 2.0
_CAMERA_M, _CAMERA_DEG = 0.01, 0.05
# Bits of carla.VehicleLightState.
_LOW_BEAM, _BRAKE, _RIGHT, _LEFT = 2, 8, 16, 32
_WITH_LIGHTS = frozenset(
    {ObjectClass.CAR, ObjectClass.TRUCK, ObjectClass.BUS, ObjectClass.MOTORCYCLE}
)


@dataclass(frozen=True)
class Shooting:
    """The world before CARLA's camera.

    Args:
        frame_s: from one picture to the next.
        objects: class and size of those that are known beforehand, by id.
        vut_size: of the VUT, which carries the camera.
        start: of the VUT at the first picture, for the camera's exposure.
        triggers: for the record.
    """

    camera: Camera
    frame_s: float
    look: Look
    objects: Mapping[str, tuple[ObjectClass, Size]]
    vut_size: Size
    start: Pose2
    seed: int = 0
    triggers: Sequence[Mapping[str, Any]] = ()

    @classmethod
    def of_run(cls, run: RunSpec, camera: Camera, start: Pose2 | None = None) -> Shooting:
        """Describe the world before a run's camera.

        Args:
            run: gives the road, the look and the objects.
            camera: of the run.
            start: where the first picture isn't the run's first.
        """
        return cls(
            camera=camera,
            frame_s=steps_per_frame(camera.rate_hz, run.step_s) * run.step_s,
            look=run.look,
            objects={target.id: (target.cls, target.size) for target in run.targets},
            vut_size=run.vut.size,
            start=start or run.vut.start.pose,
            seed=run.seed,
            triggers=[one.model_dump(mode="json") for one in run.triggers],
        )


class CarlaPainter:
    """CARLA's camera in an empty world of the run's map, which this alone ticks.

    The VUT has no body in it: the camera is attached to nothing, and is put where the VUT carries
    it. The other objects are bodies of the nearest size, without physics.

    Args:
        map_sha256: of the OpenDRIVE that the run was compiled for.
        on_record: takes ``record`` whenever it changes.

    Raises:
        HostError: CARLA's client isn't installed.
        PeerError: there is no server, or it is refused, or can't do what the run needs.
    """

    def __init__(
        self,
        shooting: Shooting,
        address: CarlaAddress,
        map_sha256: str,
        on_record: Callable[[Mapping[str, Any]], None],
    ) -> None:
        self._camera, self._look, self._on_record = shooting.camera, shooting.look, on_record
        self._bodies: dict[str, ChosenBody] = {}
        self._sizes: dict[str, Size] = {}
        self._actors: dict[str, int] = {}
        self._server = CarlaServer(address)
        try:
            facts = self._server.accept(map_sha256)
            self._ground = self._server.ground()
            self._server.take_over(shooting.frame_s)
            self._server.turn_lights_green()
            weather = self._server.set_weather(weather_of(shooting.look))
            self._offer = Offer(self._server)
            for name, (object_class, size) in shooting.objects.items():
                self._add(name, object_class, size)
            camera = shooting.camera
            eye = camera_pose(shooting.start, shooting.vut_size, camera, self._ground)
            self._eye = self._server.start_camera(camera_attributes(camera), eye)
            for _ in range(math.ceil(_EXPOSURE_S / shooting.frame_s)):
                self._server.tick()
            self._record: dict[str, Any] = {
                "schema": SCENE_SCHEMA,
                "address": str(address),
                "version": facts.version,
                "client_version": facts.client_version,
                "map_name": facts.map_name,
                "map_sha256": facts.map_sha256,
                "synchronous": True,
                "step_s": shooting.frame_s,
                "first_frame": self._server.tick(),
                "seed": shooting.seed,
                "rate_hz": camera.rate_hz,
                "camera": self._eye.attributes,
                "settings": self._server.settings(),
                "weather": weather,
                "triggers": list(shooting.triggers),
                "counterpart": self._server.is_counterpart(),
            }
            self._server.set_timeout(_FRAME_TIMEOUT_S)
            self._tell()
        except BaseException:
            self._server.close()
            raise

    @property
    def record(self) -> Mapping[str, Any]:
        """The facts that a reader of the pictures needs (docs/carla.md)."""
        bodies = {name: body_record(body, self._sizes[name]) for name, body in self._bodies.items()}
        return {**self._record, "bodies": bodies}

    def draw(self, scene: Scene, stamp_ns: int, _index: int) -> Array:
        self._follow(scene)
        placements = [self._placed(state, scene, stamp_ns) for state in scene.others]
        vut, camera = scene.vut, self._camera
        eye = camera_pose(vut.pose, vut.size, camera, self._ground)
        frame = self._server.step([*placements, Placement(self._eye.actor, eye)])
        picture = self._server.picture(self._eye, frame)
        off_m = math.dist((picture.pose.x_m, picture.pose.y_m), (eye.x_m, eye.y_m))
        turn = abs(math.remainder(picture.pose.yaw_deg - eye.yaw_deg, 360.0))
        if off_m > _CAMERA_M or turn > _CAMERA_DEG:
            raise PeerError(
                f"CARLA's picture of frame {frame} was taken {off_m:.3f} m and {turn:.2f} degrees "
                "from where the camera was put"
            )
        return picture.pixels

    def close(self) -> list[str]:
        return self._server.close()

    def _follow(self, scene: Scene) -> None:
        """Add bodies of objects that appeared, and destroy those of objects that are gone."""
        present = {state.object_id: state for state in scene.others}
        for gone in [name for name in self._actors if name not in present]:
            self._server.destroy([self._actors.pop(gone)])
        new = [state for name, state in present.items() if name not in self._actors]
        for state in new:
            self._add(state.object_id, state.object_class, state.size)
        if new:
            self._tell()

    def _add(self, object_id: str, object_class: ObjectClass, size: Size) -> None:
        actor, body = self._offer.spawn(object_id, object_class, size)
        self._bodies[object_id], self._sizes[object_id] = body, size
        self._actors[object_id] = actor

    def _tell(self) -> None:
        self._on_record(self.record)

    def _placed(self, state: ObjectState, scene: Scene, stamp_ns: int) -> Placement:
        actor = self._actors[state.object_id]
        if state.object_class is ObjectClass.PEDESTRIAN:
            return Placement(actor, feet_pose(state.pose, self._ground), max(0.0, state.speed_mps))
        box = self._bodies[state.object_id].box
        pose = vehicle_pose(state.pose, state.size, box, self._ground)
        if state.object_class not in _WITH_LIGHTS:
            return Placement(actor, pose)
        lights = _LOW_BEAM if self._look.light == "dusk" else 0
        lights |= _BRAKE if state.acceleration_mps2 < BRAKE_MPS2 else 0
        side = scene.indicators.get(state.object_id)
        if side is not None and is_lit(stamp_ns):
            lights |= _LEFT if side is Indicator.LEFT else _RIGHT
        return Placement(actor, pose, lights=lights)
