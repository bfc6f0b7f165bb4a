"""The endpoints that several nodes share: frames of a camera, and states of objects."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CameraInfo, CompressedImage

from ssp_core import names, ros
from ssp_core.cdr.states import StateArray, decode_state, decode_states
from ssp_core.motion.state import ObjectState as State
from ssp_core.run_file.model import Camera, RunSpec
from ssp_core.world.camera import intrinsics
from ssp_core.world.camera_messages import encode_camera_info, encode_frame
from ssp_core.world.transforms import encode_transform, mount
from ssp_msgs.msg import ObjectState, ObjectStates


class CameraPublishers:
    """Frames of a camera with its pinhole numbers, and where it is mounted."""

    def __init__(self, node: Node, camera: Camera, info_qos: QoSProfile) -> None:
        self._lens = intrinsics(camera)
        self._image = node.create_publisher(CompressedImage, names.CAMERA_IMAGE, ros.SENSOR)
        self._info = node.create_publisher(CameraInfo, names.CAMERA_INFO, info_qos)
        self._mount = node.create_publisher(TransformStamped, names.CAMERA_MOUNT, ros.LATCHED)
        self._mount.publish(encode_transform(mount(camera)))

    def publish(self, stamp_ns: int, jpeg: bytes) -> None:
        """Publish a frame behind its numbers, which know no distortion."""
        self._info.publish(encode_camera_info(stamp_ns, self._lens))
        self._image.publish(encode_frame(stamp_ns, jpeg))


def subscribe_states(
    node: Node, run: RunSpec, object_ids: Iterable[str], on_state: Callable[[State], None]
) -> None:
    """Hear the states of objects, in whichever way the run's targets send theirs.

    Args:
        node: owns the subscriptions.
        run: says whether all targets' states come in one message.
        object_ids: that are heard; in one message all targets are.
        on_state: takes each state.
    """

    def on_states(states: StateArray) -> None:
        for state in states.states:
            on_state(state)

    targets = {target.id for target in run.targets}
    for object_id in object_ids:
        if not (run.states_in_one and object_id in targets):
            topic = names.state_topic(object_id)
            ros.subscribe_raw(node, ObjectState, topic, decode_state, on_state, ros.STATE)
    if run.states_in_one and targets.intersection(object_ids):
        topic = names.OBJECT_STATES
        ros.subscribe_raw(node, ObjectStates, topic, decode_states, on_states, ros.STATE)
