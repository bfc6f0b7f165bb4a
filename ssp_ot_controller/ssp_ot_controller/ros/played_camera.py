"""Plays the camera driver: what the VUT's camera would see of the states that are published."""

from __future__ import annotations

import sys
import time

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from ssp_core import names, ros
from ssp_core.errors import InputError
from ssp_core.motion.state import ObjectState as State
from ssp_core.run_file.model import load_run
from ssp_core.run_file.participation import CAMERA, ParticipantKind
from ssp_ot_controller.camera.frames import Odometer, jpeg
from ssp_ot_controller.camera.renderer.render import render, warm_up
from ssp_ot_controller.camera.renderer.scene import Scene
from ssp_ot_controller.ros.endpoints import CameraPublishers, subscribe_states
from ssp_ot_controller.ros.parameters import PLAYED_CAMERA


class PlayedCamera(Node):
    """Draws the newest states at the camera's rate; none before the VUT is there."""

    def __init__(self, _stop: ros.StopRequest) -> None:
        super().__init__("played_camera", namespace=names.NAMESPACE)
        run_file = ros.declare(self, PLAYED_CAMERA)["run_file"]
        self._run = run = load_run(run_file)
        if run.camera is None:
            raise InputError(
                "has no camera to play",
                file=run_file,
                field="camera",
                remedy="compile the run with a camera",
            )
        self._camera = run.camera
        ros.declare_kind(self, ParticipantKind.SIMULATED, CAMERA)
        warm_up(run.road, run.look, self._camera, run.seed)
        self._states: dict[str, State] = {}
        self._odometer = Odometer()
        self._frames = 0
        self._output = CameraPublishers(self, self._camera, ros.SENSOR)
        ids = [run.vut.id, *(target.id for target in run.targets)]
        subscribe_states(self, run, ids, self._on_state)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0 / self._camera.rate_hz, self._publish, clock=steady)

    def _on_state(self, state: State) -> None:
        self._states[state.object_id] = state

    def _publish(self) -> None:
        run = self._run
        vut = self._states.get(run.vut.id)
        if vut is None:
            return
        # A frame's stamp is the middle of its exposure, before it is read out and compressed.
        stamp_ns = time.time_ns()
        states = tuple(s.extrapolated(stamp_ns) for _, s in sorted(self._states.items()))
        vut = vut.extrapolated(stamp_ns)
        self._odometer.update(states)
        scene = Scene(run.road, vut, states, self._odometer.snapshot())
        picture = render(scene, run.look, self._camera, self._frames, run.seed)
        self._frames += 1
        self._output.publish(stamp_ns, jpeg(picture, self._camera.jpeg_quality))


def main() -> None:
    """Run the node."""
    sys.exit(ros.run_node(PlayedCamera, lambda _node: None))


if __name__ == "__main__":
    main()
