"""The topics that the view publishes. Two for the markers: what stands still is latched, and a late
reader of a latched topic that also carries what moves would get the newest of that instead."""

from __future__ import annotations

from ssp_core import names

SCENE_MARKERS = "markers/scene"
OBJECT_MARKERS = "markers/objects"

PUBLISHED: dict[str, str] = {
    names.absolute(SCENE_MARKERS): "visualization_msgs/msg/MarkerArray",
    names.absolute(OBJECT_MARKERS): "visualization_msgs/msg/MarkerArray",
    names.DIAGNOSTICS: "diagnostic_msgs/msg/DiagnosticArray",
}
