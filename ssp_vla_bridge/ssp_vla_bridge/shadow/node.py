"""The topics of a running session, as a bridge in shadow mode hears them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, CompressedImage

from ssp_core import names
from ssp_core.cdr.states import decode_state
from ssp_core.ros import LATCHED, SENSOR, STATE, session_ns, subscribe_raw
from ssp_core.world.camera import Mounting
from ssp_msgs.msg import ObjectState
from ssp_vla_bridge.core.camera import geometry_of, mounting_of
from ssp_vla_bridge.core.request import Frame
from ssp_vla_bridge.shadow.follower import Follower


class Shadow:
    """Feeds a follower from the forward camera and the VUT's own states, and nothing else.

    Args:
        node: owns the subscriptions.
        follower: is fed.
        due: called when a request about the newest frame is due.
    """

    def __init__(self, node: Node, follower: Follower, due: Callable[[], None]) -> None:
        self._follower = follower
        self._due = due
        self._info: Any = None
        self._mount: Mounting | None = None
        node.create_subscription(CameraInfo, names.CAMERA_INFO, self._on_info, LATCHED)
        node.create_subscription(TransformStamped, names.CAMERA_MOUNT, self._on_mount, LATCHED)
        image = names.CAMERA_IMAGE
        subscribe_raw(node, CompressedImage, image, _frame_of, self._on_frame, SENSOR, raw=False)
        topic = names.state_topic(names.VUT_ID)
        subscribe_raw(node, ObjectState, topic, decode_state, follower.state, STATE)

    def _on_info(self, msg: Any) -> None:
        self._info = msg
        self._see_camera()

    def _on_mount(self, msg: Any) -> None:
        self._mount = mounting_of(msg.transform)
        self._see_camera()

    def _see_camera(self) -> None:
        if self._info is not None:
            self._follower.camera = geometry_of(self._info, self._mount)

    def _on_frame(self, frame: Frame) -> None:
        if self._follower.frame(frame):
            self._due()


def _frame_of(msg: Any) -> Frame:
    return Frame(session_ns(msg.header.stamp), bytes(msg.data))
