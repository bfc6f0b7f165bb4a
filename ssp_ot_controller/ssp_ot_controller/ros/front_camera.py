"""The node ``front_camera``: renders the VUT's forward view on the world's ticks."""

from __future__ import annotations

import sys
import time
from collections import deque
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_msgs.msg import String

from ssp_core import names
from ssp_core.carla.acceptance import ServerOfRun
from ssp_core.cdr import steps
from ssp_core.errors import InputError
from ssp_core.hashing import canonical_json
from ssp_core.ros import (
    LATCHED,
    STATE,
    StopRequest,
    declare,
    run_node,
    subscribe_raw,
    take_arrived,
    take_the_rest,
)
from ssp_core.run_file.model import Camera, RunSpec, load_run
from ssp_core.world.scenery import left_out
from ssp_msgs.msg import StepDone, WorldTick
from ssp_ot_controller.camera.frames import Odometer, Schedule, jpeg, steps_per_frame
from ssp_ot_controller.camera.painter import Painter, RasterPainter
from ssp_ot_controller.camera.renderer.scene import Indicators, Scene
from ssp_ot_controller.ros.endpoints import CameraPublishers
from ssp_ot_controller.ros.parameters import FRONT_CAMERA

_CHECK_PERIOD_S = 0.2
_DROP_REPORT_PERIOD_S = 5.0
_REALTIME_BACKLOG = 1  # frames that may wait while one is drawn


@dataclass(frozen=True)
class _Job:
    step: int
    stamp_ns: int
    scene: Scene


class FrontCamera(Node):
    """Draws in a worker thread, in order; in lockstep nothing is dropped."""

    def __init__(self, stop: StopRequest) -> None:
        super().__init__(names.FRONT_CAMERA, namespace=names.NAMESPACE)
        self._stop = stop
        self._failure: BaseException | None = None
        parameters = declare(self, FRONT_CAMERA)
        run_file = parameters["run_file"]
        self._run: RunSpec = load_run(run_file)
        if self._run.camera is None:
            raise InputError(
                "asks for no pictures",
                file=run_file,
                field="camera",
                remedy="give the run a camera, or don't start front_camera",
            )
        self._camera: Camera = self._run.camera
        for text in left_out(self._run.road):
            self.get_logger().warning(text)
        self._schedule = Schedule(steps_per_frame(self._camera.rate_hz, self._run.step_s))
        self._odometer = Odometer()
        self._indicators = Indicators(self._run.road)
        # Loading kernels or a map takes seconds: do it before anybody can see this node.
        self._painter = self._make_painter(run_file, parameters["carla"], parameters["map_file"])
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="render")
        self._waiting: deque[Future[None]] = deque()
        self._dropped = 0
        self._reported = 0
        self._output = CameraPublishers(self, self._camera, LATCHED)
        self._done = self.create_publisher(StepDone, names.STEP_DONE, STATE)
        tick, decode = names.WORLD_TICK, steps.decode_tick
        self._ticks = subscribe_raw(self, WorldTick, tick, decode, self._on_tick, STATE)
        self.create_timer(_CHECK_PERIOD_S, self._check, clock=steady)
        self.create_timer(_DROP_REPORT_PERIOD_S, self._report_drops, clock=steady)

    def _make_painter(self, run_file: str, carla: str, map_file: str) -> Painter:
        run, camera = self._run, self._camera
        if camera.renderer == "raster":
            return RasterPainter(run, camera)
        if run.mode != "lockstep":
            raise InputError(
                "CARLA draws in lockstep only: by the wall clock a late picture would be lost",
                file=run_file,
                field="mode",
                value=run.mode,
                remedy="run it in lockstep",
            )
        from ssp_ot_controller.camera.carla_painter import CarlaPainter, Shooting

        server = ServerOfRun.of_parameters(carla, map_file, "--camera")
        publisher = self.create_publisher(String, names.CAMERA_RENDERER, LATCHED)

        def tell(record: Mapping[str, Any]) -> None:
            publisher.publish(String(data=canonical_json(record).decode()))

        shooting = Shooting.of_run(run, camera)
        return CarlaPainter(shooting, server.address, server.map_sha256, tell)

    def _on_tick(self, tick: steps.WorldTick) -> None:
        states = tuple(s for s in tick.objects if s.is_finite)
        self._odometer.update(states)
        now_ns = time.monotonic_ns()
        is_due, self._schedule = self._schedule.decide(tick.step, tick.running, now_ns)
        if not is_due:
            return
        vut = next((s for s in states if s.object_id == self._run.vut.id), None)
        if vut is None:
            self.get_logger().error(
                f"tick {tick.step}: no place of {self._run.vut.id!r}, so no frame", once=True
            )
            return
        blinking = self._indicators.update(states, tick.stamp_ns)
        self._check()
        if not tick.lockstep and len(self._waiting) > _REALTIME_BACKLOG:
            self._dropped += 1
            return
        scene = Scene(self._run.road, vut, states, self._odometer.snapshot(), blinking)
        job = _Job(tick.step, tick.stamp_ns, scene)
        self._waiting.append(self._worker.submit(self._publish_frame, job))

    def _publish_frame(self, job: _Job) -> None:
        """Draw, publish and answer the step, in the worker thread."""
        index = job.step // self._schedule.every
        picture = self._painter.draw(job.scene, job.stamp_ns, index)
        data = jpeg(picture, self._camera.jpeg_quality)
        self._output.publish(job.stamp_ns, data)
        self._done.publish(steps.encode_done(steps.StepDone(names.FRONT_CAMERA, job.step)))

    def _check(self) -> None:
        """Forget finished frames; the first that failed stops the node."""
        while self._waiting and self._waiting[0].done():
            error = self._waiting.popleft().exception()
            if error is not None and self._failure is None:
                self._failure = error
                self._stop.set("no picture")

    def _report_drops(self) -> None:
        if self._dropped > self._reported:
            self.get_logger().warning(
                f"{self._dropped - self._reported} frames dropped, {self._dropped} in all: "
                "drawing doesn't keep up with the wall clock"
            )
            self._reported = self._dropped

    def close(self) -> None:
        """Draw what has come, so that a session's last frame is never missing; say what was lost.

        Raises the error for which the node stops.
        """
        if self._failure is None:
            take_the_rest(partial(take_arrived, self._ticks))
        self._worker.shutdown(wait=True, cancel_futures=self._failure is not None)
        for line in self._painter.close():
            self.get_logger().error(line)
        self._report_drops()
        if self._failure is not None:
            raise self._failure


def main() -> int:
    return run_node(FrontCamera, FrontCamera.close)


if __name__ == "__main__":
    sys.exit(main())
