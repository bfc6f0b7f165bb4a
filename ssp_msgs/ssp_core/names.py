"""Names of nodes, topics and services: relative, below the namespace ``/ssp``."""

from __future__ import annotations

import math
from contextlib import suppress
from urllib.parse import parse_qsl

from ssp_core.addresses import host_and_port

NAMESPACE = "/ssp"
VUT_ID = "vut"
MAP_FRAME = "map"

CLOCK = "/clock"
TF = "/tf"  # where every tf2 listener hears them
TF_STATIC = "/tf_static"
DIAGNOSTICS = "/diagnostics"  # where every tool looks for it
WORLD_TICK = "world/tick"
STEP_DONE = "world/step_done"
ACTUATOR_COMMANDS = "world/actuator_commands"
VUT_COMMAND = "vut/command"
HEARTBEAT = "manager/heartbeat"
HEARTBEAT_REPLY = "manager/heartbeat_reply"
LINK_STATUS = "manager/link_status"
OBJECT_STATES = "object_states"
FAULT_EVENT = "fault_event"
SESSION_STATE = "session_state"
TRIGGER_EVENT = "trigger_event"
PHASE_EVENT = "phase_event"
SAFETY_EVENT = "safety_event"
RECORDER_STATUS = "recorder_status"
LOCALISATION_STATUS = "vut/localisation_status"
BODY_STATUS = "body_status"
CAMERA_IMAGE = "vut/front_camera/image/compressed"
CAMERA_INFO = "vut/front_camera/camera_info"
CAMERA_MOUNT = "vut/front_camera/mount"
WORLD_PLANT = "sil_world/plant"  # what moves the bodies, where it isn't ours
CAMERA_RENDERER = "vut/front_camera/renderer"  # what drew the pictures, where it isn't ours

SIL_WORLD = "sil_world"
FRONT_CAMERA = "front_camera"
OBJECT_TARGET = "object_target"
SCENARIO_MANAGER = "scenario_manager"
MONITOR = "monitor"
RUNNER = "ssp_run"
MONITOR_PAGE = "monitor_page"  # the operators' page
VUT_ADAPTER = "vut_adapter"
VUT_DRIVER = "vut_driver"  # who publishes vut/command, when the VUT has an external driver

SESSION_COMMANDS = ("connect", "arm", "disarm", "start", "stop", "abort", "all_clear", "reset")
LOAD_SCENARIO = "load_scenario"
RUN_SCENARIO = "run_scenario"


def absolute(topic: str) -> str:
    """Return the topic's full name, as it stands in a bag."""
    return topic if topic.startswith("/") else f"{NAMESPACE}/{topic}"


def state_topic(object_id: str) -> str:
    return f"{object_id}/state"


def reference_topic(object_id: str) -> str:
    return f"{object_id}/reference"


def ack_topic(object_id: str) -> str:
    return f"{object_id}/reference_ack"


def rules_topic(object_id: str) -> str:
    """Name the topic on which an object publishes its rules."""
    return f"{object_id}/rules"


def declared_topic(participant: str) -> str:
    """Name the topic on which a participant of a live session declares its kind."""
    return f"declared/{participant}"


def iso_frames_topic(object_id: str) -> str:
    """Name the topic with the raw frames of an object that speaks ISO 22133."""
    return f"{object_id}/iso_frames"


# How a body is addressed, for error messages.
BODY_ADDRESSES = "udp://HOST:PORT, iso22133://HOST[:PORT][?report=FILE] or mirror"
ISO_LEVER = ("forward_m", "left_m")  # options: where the point lies that the object reports


def udp_body(address: str) -> tuple[str, int] | None:
    """Return host and port of a body that speaks the body protocol; None for another address.

    Args:
        address: ``udp://HOST:PORT``, with brackets around the host where it is IPv6.
    """
    scheme, _, text = address.partition("://")
    endpoint = host_and_port(text)
    if scheme != "udp" or endpoint is None:
        return None
    host, port = endpoint
    return (host, port) if port is not None and 0 < port < 65536 else None


def iso_body(address: str) -> tuple[str, int | None, dict[str, str]] | None:
    """Return host, port and options of an ISO 22133 object; None for another address.

    Args:
        address: ``iso22133://HOST[:PORT][?NAME=VALUE&…]``; without a port it is None. Process data
            go by UDP to the port below.
    """
    scheme, _, rest = address.partition("://")
    text, _, query = rest.partition("?")
    endpoint = host_and_port(text)
    if scheme != "iso22133" or endpoint is None:
        return None
    host, port = endpoint
    if port is not None and not 1 < port < 65536:
        return None
    options = dict(parse_qsl(query, keep_blank_values=True))
    if not {"report", "waive", *ISO_LEVER} >= set(options):
        return None
    with suppress(ValueError):
        if all(math.isfinite(float(options.get(name, "0"))) for name in ISO_LEVER):
            return host, port, options
    return None


def command_service(object_id: str) -> str:
    return f"{object_id}/command"


def vla_request_topic(model: str) -> str:
    return f"vla/{model}/request"


def vla_response_topic(model: str) -> str:
    return f"vla/{model}/response"


def vla_latency_topic(model: str) -> str:
    return f"vla/{model}/latency"
