"""Messages as rclpy has them: a second way beside the codecs that the nodes use."""

from __future__ import annotations

from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState
from ssp_core.names import MAP_FRAME
from ssp_core.ros import stamp_from_ns
from ssp_msgs.msg import ObjectState as ObjectStateMsg
from ssp_msgs.msg import Reference as ReferenceMsg
from ssp_msgs.msg import ReferencePoint as ReferencePointMsg


def state_to_msg(state: ObjectState) -> ObjectStateMsg:
    """ObjectState.msg of a state."""
    message = ObjectStateMsg()
    message.header.stamp = stamp_from_ns(state.stamp_ns)
    message.header.frame_id = MAP_FRAME
    message.object_id = state.object_id
    message.object_class = int(state.object_class)
    message.role = int(state.role)
    message.control_state = int(state.control_state)
    message.sequence = state.sequence
    message.x = state.x_m
    message.y = state.y_m
    message.yaw = state.yaw_rad
    message.speed = state.speed_mps
    message.acceleration = state.acceleration_mps2
    message.yaw_rate = state.yaw_rate_radps
    message.front = state.size.front_m
    message.rear = state.size.rear_m
    message.width = state.size.width_m
    message.height = state.size.height_m
    message.position_std = state.position_std_m
    message.reference_id = state.reference_id
    message.error_longitudinal = state.error_longitudinal_m
    message.error_lateral = state.error_lateral_m
    message.error_yaw = state.error_yaw_rad
    return message


def reference_to_msg(reference: Reference) -> ReferenceMsg:
    """Reference.msg of a reference."""
    message = ReferenceMsg()
    message.header.stamp = stamp_from_ns(reference.dispatched_ns)
    message.header.frame_id = MAP_FRAME
    message.reference_id = reference.reference_id
    message.object_id = reference.object_id
    message.event_version = reference.event_version
    message.purpose = reference.purpose
    message.execute_at = stamp_from_ns(reference.execute_at_ns)
    message.expires_at = stamp_from_ns(reference.expires_at_ns)
    message.points = [
        ReferencePointMsg(
            t=p.t_s,
            x=p.x_m,
            y=p.y_m,
            yaw=p.yaw_rad,
            speed=p.speed_mps,
            acceleration=p.acceleration_mps2,
            curvature=p.curvature_1pm,
        )
        for p in reference.points
    ]
    return message
