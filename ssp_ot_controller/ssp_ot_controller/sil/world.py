"""The simulated world without ROS: bodies, the VUT's driver and SUMO under them, in steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Protocol

from ssp_core.clock import seconds_to_ns
from ssp_core.geometry import Polyline
from ssp_core.run_spec import ParticipantSpec, RunSpec
from ssp_core.state import ObjectState
from ssp_core.vocab import ControlState, Role
from ssp_ot_controller.core.bodies import BodyState, Command, brake_command, step_body
from ssp_ot_controller.core.driver import drive

# A body that hears no command for this long brakes as hard as it can, whoever is to blame.
BODY_TIMEOUT_S = 0.2


class Scene(Protocol):
    """What the world needs of SUMO: takes the poses of our objects, moves the traffic."""

    def step(self, poses: list[ObjectState]) -> list[ObjectState]: ...

    def traffic(self) -> list[ObjectState]: ...


class World:
    """Ground truth of one run.

    Args:
        run: the run.
        scene: supplies traffic; SumoWorld, or an in-memory one in tests.
    """

    def __init__(self, run: RunSpec, scene: Scene) -> None:
        self._run = run
        self._scene = scene
        self.step_index = 0
        self._bodies = {
            spec.id: BodyState.at_rest(spec.start.pose) for spec in [run.vut, *run.targets]
        }
        self._specs = {spec.id: spec for spec in [run.vut, *run.targets]}
        motion = run.vut.approach
        self._vut_path = Polyline(motion.path) if motion is not None else None
        self._traffic = scene.traffic()

    @property
    def now_ns(self) -> int:
        """Simulated time of the present state."""
        return self.step_index * seconds_to_ns(self._run.step_s)

    def objects(self) -> list[ObjectState]:
        """Ground truth of everything, sorted by id."""
        own = [self._state(spec) for spec in self._specs.values()]
        return sorted([*own, *self._traffic], key=lambda s: s.object_id)

    def vut(self) -> ObjectState:
        return self._state(self._run.vut)

    def advance(
        self, commands: Mapping[str, tuple[int, Command]], drive_vut: bool
    ) -> list[ObjectState]:
        """One step on.

        Args:
            commands: newest command of each object, with the step that it answered. An object
                without one, or with one that is older than BODY_TIMEOUT_S, brakes hard.
            drive_vut: False: the VUT's driver brakes to a standstill.

        Returns:
            Ground truth after the step, sorted by id.
        """
        dt_s = self._run.step_s
        everyone = self.objects()
        for object_id, body in list(self._bodies.items()):
            spec = self._specs[object_id]
            if spec is self._run.vut:
                command = self._vut_command(everyone, drive_vut)
                scale = 1.0
            else:
                command = self._object_command(object_id, commands)
                scale = self._run.disturbance.actuator_lag_scale
            self._bodies[object_id] = step_body(spec.cls, body, command, dt_s, lag_scale=scale)
        self.step_index += 1
        self._traffic = self._scene.step([self._state(spec) for spec in self._specs.values()])
        return self.objects()

    def all_stand(self) -> bool:
        """True when VUT and object targets stand; traffic doesn't count."""
        return all(body.speed_mps == 0.0 for body in self._bodies.values())

    def _object_command(
        self, object_id: str, commands: Mapping[str, tuple[int, Command]]
    ) -> Command:
        step, command = commands.get(object_id, (-1, None))
        age_s = (self.step_index - step) * self._run.step_s
        if command is None or not command.is_finite or age_s > BODY_TIMEOUT_S:
            return Command(0.0, 0.0, self._bodies[object_id].yaw_rad, emergency_stop=True)
        return command

    def _vut_command(self, everyone: list[ObjectState], drive_vut: bool) -> Command:
        vut, driver = self.vut(), self._run.driver
        comfortable = driver.comfortable_deceleration_mps2
        if self._vut_path is None:
            return brake_command(vut, comfortable)
        others = [s for s in everyone if s.object_id != vut.object_id]
        command = drive(vut, others, self._vut_path, driver, self._run.step_s)
        if drive_vut:
            return command
        # While it stops it keeps its lane, and brakes harder for what stops ahead of it.
        return replace(command, acceleration_mps2=min(command.acceleration_mps2, -comfortable))

    def _state(self, spec: ParticipantSpec) -> ObjectState:
        body = self._bodies[spec.id]
        return ObjectState(
            object_id=spec.id,
            object_class=spec.cls,
            role=Role.VUT if spec is self._run.vut else Role.OT,
            stamp_ns=self.now_ns,
            x_m=body.x_m,
            y_m=body.y_m,
            yaw_rad=body.yaw_rad,
            speed_mps=body.speed_mps,
            acceleration_mps2=body.acceleration_mps2,
            yaw_rate_radps=body.yaw_rate_radps,
            size=spec.size,
            sequence=self.step_index + 1,
            control_state=ControlState.OFF,
        )
