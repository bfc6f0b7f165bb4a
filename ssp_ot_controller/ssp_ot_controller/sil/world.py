"""The simulated world without ROS: bodies, the VUT's driver and SUMO under them, in steps.

In lockstep a barrier says who has still to answer a step before the world may go on.

This file owns the ground truth of the present step (``World``), and which answers to it are missing
(``StepBarrier``). The step only rises. A participant that was dropped isn't waited for again.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from operator import attrgetter
from typing import Protocol

from ssp_core.cdr.steps import RECORDER_LAG_STEPS
from ssp_core.clock import seconds_to_ns
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import Role, SessionPhase
from ssp_ot_controller.bodies.dynamics import Command
from ssp_ot_controller.sil.disturbance import Actuator
from ssp_ot_controller.sil.plant import BodyPlant, OwnBodies
from ssp_ot_controller.sil.vut_driver import VutDriver

# A body that hears no command for this long brakes as hard as it can, whoever is to blame.
BODY_TIMEOUT_S = 0.2
# In these states of the session the world steps on until everything stands, and then holds.
_ID = attrgetter("object_id")
OVER = (SessionPhase.FINISHED, SessionPhase.ABORTED, SessionPhase.IDLE)


class TrafficSimulation(Protocol):
    """The part of SUMO that the world needs: takes the poses of our objects, moves the traffic."""

    def step(self, poses: list[ObjectState]) -> list[ObjectState]: ...

    def traffic(self) -> list[ObjectState]: ...


class World:
    """Ground truth of one run.

    Args:
        scene: supplies traffic; SumoWorld, or an in-memory one in tests.
        plant: moves the bodies; None: ours.
    """

    def __init__(
        self, run: RunSpec, scene: TrafficSimulation, plant: BodyPlant | None = None
    ) -> None:
        self._run = run
        self._scene = scene
        self._plant = plant or OwnBodies(run)
        self.step_index = 0
        self._bodies = self._plant.start()
        specs = (run.vut, *run.targets)
        # Asked for in every step, and looked up by word each time.
        self._kinds = {
            spec.id: (spec.cls, Role.VUT if spec is run.vut else Role.OT, spec.size)
            for spec in specs
        }
        self._step_ns = seconds_to_ns(run.step_s)
        self._actuators = {spec.id: Actuator(run, spec.id) for spec in specs}
        self.driver = VutDriver(run)
        self._observe(scene.traffic())

    @property
    def now_ns(self) -> int:
        """Simulated time of the present state."""
        return self.step_index * self._step_ns

    def objects(self) -> list[ObjectState]:
        """Return the ground truth of everything, sorted by id."""
        return list(self._everyone)

    def vut(self) -> ObjectState:
        return self._own[self._run.vut.id]

    def advance(
        self, commands: Mapping[str, tuple[int, Command]], drive_vut: bool
    ) -> list[ObjectState]:
        """Go one step on.

        Args:
            commands: newest command of each object, with the step that it answered. An object
                without one, or with one that is older than BODY_TIMEOUT_S, brakes hard and holds
                its steering. The VUT's are those of an external driver.
            drive_vut: False: the VUT's driver brakes to a standstill.

        Returns:
            Ground truth after the step, sorted by id.
        """
        vut_id, now_ns = self._run.vut.id, self.now_ns
        body_commands = {}
        for object_id in self._bodies:
            if object_id == vut_id:
                command = self._vut_command(commands, drive_vut)
            else:
                command = self._object_command(object_id, commands)
            body_commands[object_id] = self._actuators[object_id].actuate(command, now_ns)
        self._bodies = self._plant.step(self._bodies, body_commands)
        self.step_index += 1
        own = self._states()
        self._observe(self._scene.step(list(own.values())), own)
        return self.objects()

    def _observe(
        self, traffic: list[ObjectState], own: dict[str, ObjectState] | None = None
    ) -> None:
        """Take the ground truth of an instant."""
        self._own = own or self._states()
        self._everyone = sorted([*self._own.values(), *traffic], key=_ID)

    def all_stand(self) -> bool:
        """Tell whether VUT and object targets stand; traffic doesn't count."""
        return all(body.speed_mps == 0.0 for body in self._bodies.values())

    def _object_command(
        self, object_id: str, commands: Mapping[str, tuple[int, Command]]
    ) -> Command:
        step, command = commands.get(object_id, (-1, None))
        age_s = (self.step_index - step) * self._run.step_s
        if command is None or not command.is_finite or age_s > BODY_TIMEOUT_S:
            body = self._bodies[object_id]
            # Steering stays as it is: that is where the object was led last.
            return Command(0.0, body.curvature_1pm, body.yaw_rad, emergency_stop=True)
        return command

    def _vut_command(self, commands: Mapping[str, tuple[int, Command]], drive_vut: bool) -> Command:
        vut = self.vut()
        external = None
        if vut.object_id in commands:
            step, command = commands[vut.object_id]
            external = (self.step_index - step) * self._run.step_s, command
        others = [s for s in self._everyone if s.object_id != vut.object_id]
        return self.driver.command(vut, others, external, drives=drive_vut)

    def _states(self) -> dict[str, ObjectState]:
        """Return the states of the bodies, by id."""
        now_ns, states = self.now_ns, {}
        for object_id, body in self._bodies.items():
            cls, role, size = self._kinds[object_id]
            states[object_id] = ObjectState(
                object_id,
                cls,
                role,
                now_ns,
                body.x_m,
                body.y_m,
                body.yaw_rad,
                body.speed_mps,
                body.acceleration_mps2,
                body.yaw_rate_radps,
                size,
                self.step_index + 1,
            )
        return states


class StepBarrier:
    """Answers of the participants by step; those that were dropped aren't waited for.

    Args:
        participants: nodes that answer every step.
        object_ids: objects whose actuator command is part of the answer of ``owner``.
        owner: the participant that commands the objects.
        camera: the participant that answers frame steps only, None for none.
        leader: the participant that answers after all others.
        frame_steps: every how many steps a frame is due; the camera may lag that much.
        recorder: the participant that may lag RECORDER_LAG_STEPS, and is waited for once it was
            heard; None for none.
    """

    def __init__(
        self,
        participants: Iterable[str],
        object_ids: Iterable[str],
        owner: str,
        camera: str | None,
        frame_steps: int,
        leader: str,
        recorder: str | None = None,
    ) -> None:
        # Step 0, at which the world holds, is answered again and again: whose answer has come once
        # is heard, which a participant that has just been discovered isn't for sure.
        self._done = dict.fromkeys(participants, -1)
        self._commanded = dict.fromkeys(object_ids, -1)
        self._owner = owner
        self._camera = camera
        self._leader = leader
        self._frame_steps = frame_steps
        self._frame_done = -1
        self._recorder = recorder
        self._recorded: int | None = None
        self.dropped: set[str] = set()

    def on_done(self, participant: str, step: int) -> None:
        if participant == self._camera:
            self._frame_done = max(self._frame_done, step)
        elif participant == self._recorder:
            self._recorded = max(self._recorded or 0, step)
        elif participant in self._done:
            self._done[participant] = max(self._done[participant], step)

    def on_command(self, object_id: str, step: int) -> None:
        if object_id in self._commanded:
            self._commanded[object_id] = max(self._commanded[object_id], step)

    def drop(self, participant: str) -> None:
        """Let the world go on without this participant from now on."""
        self.dropped.add(participant)

    def unheard(self) -> list[str]:
        """List those whose answer to step 0 is missing.

        The leader's, which starts the run, comes later.
        """
        missing = [name for name in self.waiting_for(0) if name != self._leader]
        if self._recorder is not None and self._recorded is None:
            missing.append(self._recorder)
        # Its answer to step 0 isn't waited for before the next frame is due; lost, it would be
        # waited for in vain, since the camera answers a step that is over no more.
        if self._camera is not None and self._frame_done < 0 and self._camera not in missing:
            missing.append(self._camera)
        return missing

    def lost(self, step: int) -> list[str]:
        """List, of those that are waited for, the ones that don't wait for another one themselves.

        The leader answers a step when the others have: while one of them is missing, its own
        silence says nothing.
        """
        missing = self.waiting_for(step)
        return [name for name in missing if name != self._leader] or missing

    def waiting_for(self, step: int) -> list[str]:
        """Return the participants that keep the world from going from ``step`` to ``step + 1``."""
        missing = [name for name, last_step in self._done.items() if last_step < step]
        if self._owner not in missing and any(c < step for c in self._commanded.values()):
            missing.append(self._owner)
        if self._camera is not None:
            newest_due = (step + 1 - self._frame_steps) // self._frame_steps * self._frame_steps
            if newest_due >= 0 and self._frame_done < newest_due:
                missing.append(self._camera)
        if self._recorded is not None and step - self._recorded > RECORDER_LAG_STEPS:
            missing.append(str(self._recorder))
        return [name for name in missing if name not in self.dropped]
