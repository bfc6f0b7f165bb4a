"""Plays the camera driver: what the VUT's camera would see of the states that are published."""

from __future__ import annotations

import sys
import time

from geometry_msgs.msg import TransformStamped
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, CompressedImage

from ssp_core import names, ros
from ssp_core.cdr.states import StateArray, decode_state, decode_states
from ssp_core.errors import InputError
from ssp_core.motion.state import ObjectState as State
from ssp_core.run_file.model import load_run
from ssp_core.world.camera import intrinsics
from ssp_core.world.transforms import encode_transform, mount
from ssp_msgs.msg import ObjectState, ObjectStates
from ssp_ot_controller.camera.frames import Odometer, jpeg
from ssp_ot_controller.camera.renderer.render import render, warm_up
from ssp_ot_controller.camera.renderer.scene import Scene
from ssp_ot_controller.ros import conversions
from ssp_ot_controller.ros.parameters import PLAYED_CAMERA


class PlayedCamera(Node):
    """Draws the newest states at the camera's rate; none before the VUT is there."""

    def __init__(self, stop: ros.StopRequest) -> None:
        super().__init__("played_camera", namespace=names.NAMESPACE)
        run_file = ros.declare(self, PLAYED_CAMERA)["run_file"]
        self._run = run = load_run(run_file)
        if run.camera is None:
            raise InputError("has no camera to play", file=run_file, field="camera")
        self._camera = run.camera
        warm_up(run.road, run.look, self._camera, run.seed)
        self._states: dict[str, State] = {}
        self._odometer = Odometer()
        self._frames = 0
        self._image = self.create_publisher(CompressedImage, names.CAMERA_IMAGE, ros.SENSOR)
        self._info = self.create_publisher(CameraInfo, names.CAMERA_INFO, ros.SENSOR)
        self._mount = self.create_publisher(TransformStamped, names.CAMERA_MOUNT, ros.LATCHED)
        self._mount.publish(encode_transform(mount(self._camera)))
        sub, topic = ros.subscribe_raw, names.state_topic
        for object_id in [run.vut.id, *([] if run.states_in_one else [t.id for t in run.targets])]:
            sub(self, ObjectState, topic(object_id), decode_state, self._on_state, ros.STATE)
        if run.states_in_one:
            arrays = names.OBJECT_STATES
            sub(self, ObjectStates, arrays, decode_states, self._on_states, ros.STATE)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0 / self._camera.rate_hz, self._publish, clock=steady)

    def _on_state(self, state: State) -> None:
        self._states[state.object_id] = state

    def _on_states(self, array: StateArray) -> None:
        for state in array.states:
            self._on_state(state)

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
        stamp = ros.stamp_from_ns(stamp_ns)
        self._info.publish(conversions.info_message(stamp, intrinsics(self._camera)))
        data = jpeg(picture, self._camera.jpeg_quality)
        self._image.publish(conversions.image_message(stamp, data))


def main() -> None:
    """Entry point of the node."""
    sys.exit(ros.run_node(PlayedCamera, lambda node: None))


if __name__ == "__main__":
    main()
