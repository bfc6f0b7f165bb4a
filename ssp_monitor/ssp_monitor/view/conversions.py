"""Marks and statuses as messages."""

from __future__ import annotations

import math
from collections.abc import Iterable

from geometry_msgs.msg import Point
from visualization_msgs.msg import Marker, MarkerArray

from ssp_core.names import MAP_FRAME
from ssp_core.ros import stamp_from_ns
from ssp_monitor.view.marks import Gone, Mark


def marker_of(mark: Mark | Gone, stamp_ns: int) -> Marker:
    """One marker, or the deletion of one."""
    marker = Marker()
    marker.header.frame_id = MAP_FRAME
    marker.header.stamp = stamp_from_ns(stamp_ns)
    marker.ns, marker.id = mark.space, mark.number
    if isinstance(mark, Gone):
        marker.action = Marker.DELETE
        return marker
    marker.action, marker.type = Marker.ADD, int(mark.shape)
    position, orientation = marker.pose.position, marker.pose.orientation
    position.x, position.y = mark.at.x_m, mark.at.y_m
    # A line's points have their own height.
    position.z = 0.0 if mark.points else mark.z_m
    orientation.z, orientation.w = math.sin(mark.at.yaw_rad / 2), math.cos(mark.at.yaw_rad / 2)
    marker.scale.x, marker.scale.y, marker.scale.z = mark.size_m
    colour = marker.color
    colour.r, colour.g, colour.b = mark.colour.red, mark.colour.green, mark.colour.blue
    colour.a = mark.colour.alpha
    marker.points = [Point(x=x, y=y, z=mark.z_m) for x, y in mark.points]
    marker.text = mark.text
    return marker


def marker_array(marks: Iterable[Mark | Gone], stamp_ns: int) -> MarkerArray:
    """All of them in one message."""
    return MarkerArray(markers=[marker_of(mark, stamp_ns) for mark in marks])
