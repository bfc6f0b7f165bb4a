"""The world's side of a session in one process: world, VUT and all object targets, without ROS.

It does in one call what ``sil_world`` and ``object_target`` do with a step in lockstep, in the same
order, so that the states are the same to the last bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from ssp_core import names
from ssp_core.carla.acceptance import ServerOfRun
from ssp_core.carla.client import client_library
from ssp_core.cdr.steps import Heartbeat, WorldTick
from ssp_core.clock import seconds_to_ns
from ssp_core.errors import InputError
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import SessionPhase
from ssp_core.world.driver import (
    DriveReport,
    PlanDriver,
    RecordedAnswer,
    SeeingDriver,
    make_driver,
)
from ssp_core.world.plant import LimitFact, LinkFact, ManagerUpdate, OnServer, StepReport
from ssp_ot_controller.bodies.dynamics import Command
from ssp_ot_controller.driving.pilot import pilot_of
from ssp_ot_controller.objects.pool import ObjectPool
from ssp_ot_controller.objects.state_machine import ObjectEvent
from ssp_ot_controller.sil.disturbance import Channel
from ssp_ot_controller.sil.plant import BodyPlant
from ssp_ot_controller.sil.scene import scene_of
from ssp_ot_controller.sil.vut_driver import DRIVER_TIMEOUT_S
from ssp_ot_controller.sil.world import OVER, TrafficSimulation, World

if TYPE_CHECKING:
    from ssp_ot_controller.camera.painter import Painter

# While the world holds it repeats its state so often, on the clock of those who wait.
HOLD_PERIOD_S = 0.1


class InProcessPlant:
    """See ssp_core.world.plant.Plant.

    Args:
        scene: SUMO, or a scene without traffic.
        bodies: what moves VUT and targets; None: our own bodies.
        driver: of a driven run; None where there is none, or it answers with no plans.
    """

    def __init__(
        self,
        run: RunSpec,
        scene: TrafficSimulation,
        resources: ExitStack,
        bodies: BodyPlant | None = None,
        driver: PlanDriver | SeeingDriver | None = None,
    ) -> None:
        self._pilot = None if run.driven is None else pilot_of(run, run.driven, driver)
        self._run = run
        self._resources = resources
        self._world = World(run, scene, bodies)
        self._pool = ObjectPool(run)
        self._vut = Channel(run, names.VUT_ID)
        self._commands: dict[str, tuple[int, Command]] = {}
        self._references_sent = {t.id: 0 for t in run.targets}
        self._beats = 0
        self._steady_ns = 0
        self._running = False
        self._over = False
        self._driver_end_reported = False
        self._vut_state: ObjectState | None = None

    def hold(self, word: ManagerUpdate) -> StepReport:
        self._hear(word)
        self._steady_ns += seconds_to_ns(HOLD_PERIOD_S)
        return self._report(word.session, self._world.now_ns)

    def command(self, object_id: str, command: int, event_version: str) -> str:
        event = ObjectEvent(command)
        reply = self._pool.command(object_id, event, event_version, self._steady_ns)
        return "" if reply.accepted else reply.error_msg

    def advance(self, word: ManagerUpdate) -> StepReport:
        self._hear(word)
        self._running = not self._over
        before_ns = self._world.now_ns
        self._world.advance(self._commands, word.session is SessionPhase.RUNNING)
        self._steady_ns += seconds_to_ns(self._run.step_s)
        if word.session in OVER and self._world.all_stand():
            self._running, self._over = False, True
        return self._report(word.session, before_ns)

    def close(self) -> None:
        self._resources.close()

    def _hear(self, word: ManagerUpdate) -> None:
        for reference in word.references:
            self._references_sent[reference.object_id] += 1
            self._pool.take_reference(reference)
        self._beats += 1
        sent = dict(self._references_sent)
        beat = Heartbeat(word.stamp_ns, names.SCENARIO_MANAGER, self._beats, 0, word.session, sent)
        self._pool.take_heartbeat(beat, 0)

    def _report(self, session: SessionPhase, before_ns: int) -> StepReport:
        """Report the reaction of VUT and objects to the world's present state."""
        world, now_ns = self._world, self._world.now_ns
        limits, driver = [], world.driver
        faults = [change.fact(names.SIL_WORLD, before_ns) for change in driver.fault_changes]
        driver.fault_changes.clear()
        if driver.external_is_silent and not self._driver_end_reported:
            self._driver_end_reported = True
            limits.append(self._driver_lost(driver.external_silence_s))
        # As in the node: in the step in which the run ends, too, the VUT's state is disturbed.
        stepped = self._running or (self._over and before_ns != now_ns)
        armed = session is SessionPhase.ARMED
        changes = self._vut.begin(now_ns, running=stepped, armed=armed)
        faults += (change.fact(names.SIL_WORLD, now_ns) for change in changes)
        vut_states = self._vut.up(self._vut.measure(world.vut(), now_ns), now_ns)
        truths = world.objects()
        self._pool.take_states(vut_states)
        running, beats = self._running, self._beats
        tick = WorldTick(now_ns, world.step_index, running, True, beats, 0, tuple(truths))
        self._pool.take_tick(tick, self._steady_ns)
        answer = self._pool.step(self._steady_ns)
        if answer is None:
            raise RuntimeError("the objects wait for something that was never sent")
        for object_id, command in answer.commands:
            self._commands[object_id] = world.step_index, command
        drive = self._drive(vut_states, truths) if self._running or not self._over else None
        if drive is not None and drive.died and not self._driver_end_reported:
            self._driver_end_reported = True
            limits.append(self._driver_lost(0.0, f"it ended: {drive.died}"))
        return StepReport(
            step=world.step_index,
            now_ns=now_ns,
            running=self._running,
            truths=tuple(truths),
            vut_states=tuple(vut_states),
            target_states=answer.states,
            acks=answer.acks,
            limits=(
                *limits,
                *(one.fact(names.OBJECT_TARGET, answer.now_ns) for one in answer.events),
            ),
            faults=(
                *faults,
                *(change.fact(names.OBJECT_TARGET, now_ns) for change in answer.faults),
            ),
            links=() if self._running else self._links(),
            drive=drive,
        )

    def _drive(
        self, vut_states: Sequence[ObjectState], truths: Sequence[ObjectState]
    ) -> DriveReport | None:
        """Have the driver of a driven run lead the VUT on from its newest state."""
        if vut_states:
            self._vut_state = vut_states[-1]
        if self._pilot is None or self._vut_state is None:
            return None
        return self._pilot.lead(self._world, self._vut_state, truths, self._commands)

    def _driver_lost(self, silence_s: float, words: str = "") -> LimitFact:
        return LimitFact(
            SafetyCode.PARTICIPANT_LOST,
            names.SIL_WORLD,
            names.VUT_DRIVER,
            silence_s,
            DRIVER_TIMEOUT_S,
            self._world.now_ns,
            words,
        )

    def _links(self) -> tuple[LinkFact, ...]:
        facts = []
        for object_id in self._pool.object_ids:
            link = self._pool.links_of(object_id)
            delay_s = math.inf if link.cut else link.up_s + link.down_s
            facts.append(LinkFact(object_id, link.clock_offset_s, delay_s))
        return tuple(facts)


def make_plant(
    run: RunSpec, work_dir: Path | None, answers: Sequence[RecordedAnswer] | None = None
) -> InProcessPlant:
    """Make world and objects of a run; SUMO is there only where there is traffic to move.

    Args:
        run: of the session.
        work_dir: for SUMO's files.
        answers: that its driver gave in a run before, and repeats; None: it is asked.

    Raises:
        InputError: a run that needs processes or a clock.
    """
    if run.mode != "lockstep":
        raise InputError(
            "a run in one process has no clock to follow",
            field="mode",
            value=run.mode,
            remedy="run it in lockstep, or in processes of their own",
        )
    if run.plant != "bodies":
        raise InputError(
            "a run in one process moves our own bodies only",
            field="plant",
            value=run.plant,
            remedy="run it in processes of their own",
        )
    if run.driver.external:
        raise InputError(
            "a run in one process has no external driver of the VUT",
            field="driver.external",
            remedy="run it in processes of their own",
        )
    with ExitStack() as resources:
        scene = resources.enter_context(scene_of(run, work_dir))
        driven = run.driven
        driver = None if driven is None else make_driver(driven.driver, driven.options, answers)
        if isinstance(driver, SeeingDriver):
            resources.callback(driver.close)
        return InProcessPlant(run, scene, resources.pop_all(), driver=driver)


class InProcessCamera:
    """See ssp_core.world.plant.SessionCamera.

    Args:
        connect: makes what draws; it is called for the first frame. None: our own renderer draws.
    """

    def __init__(self, run: RunSpec, connect: Callable[[], Painter] | None = None) -> None:
        # The renderer's kernels take a second to load.
        from ssp_ot_controller.camera.redraw import Redrawing

        self._drawing, self._connect = Redrawing(run), connect
        self._painter: Painter | None = None

    def picture(
        self,
        step: int,
        stamp_ns: int,
        truths: Sequence[ObjectState],
        drawn: bytes | None = None,
    ) -> bytes | None:
        scene = self._drawing.see(step, stamp_ns, truths)
        if scene is None or drawn is not None:
            return drawn
        if self._painter is None and self._connect is not None:
            self._painter = self._connect()
        return self._drawing.draw(scene, step, stamp_ns, self._painter).jpeg

    def close(self) -> list[str]:
        return [] if self._painter is None else self._painter.close()


def make_camera(run: RunSpec, server: ServerOfRun | None, on_server: OnServer) -> InProcessCamera:
    """Make the camera of a run that has one, see ssp_core.world.plant.make_camera."""
    camera = run.camera
    if camera is None or camera.renderer == "raster":
        return InProcessCamera(run)
    if server is None:
        raise InputError(
            "asks a CARLA server, and none is given",
            field="camera.renderer",
            value=camera.renderer,
            remedy="name it: --camera carla://HOST:PORT",
        )
    from ssp_ot_controller.camera.carla_painter import CarlaPainter, Shooting

    client_library()
    arguments = Shooting.of_run(run, camera), server.address, server.map_sha256, on_server
    return InProcessCamera(run, lambda: CarlaPainter(*arguments))
