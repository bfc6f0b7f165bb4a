"""Adapters and bridges from VLA services to topics.

Its public API is what ``PUBLIC`` names; docs/api.md describes it.
"""

from typing import Any

from ssp_core.public_names import public_name

# Loaded when they are asked for, so that a node or command pays for what it uses alone.
PUBLIC = {
    "Answer": "ssp_vla_bridge.messages",
    "CameraGeometry": "ssp_vla_bridge.messages",
    "DrivingTask": "ssp_vla_bridge.messages",
    "EgoSample": "ssp_vla_bridge.messages",
    "Frame": "ssp_vla_bridge.messages",
    "NativeArray": "ssp_vla_bridge.messages",
    "Request": "ssp_vla_bridge.messages",
    "Response": "ssp_vla_bridge.messages",
}


def __getattr__(name: str) -> Any:
    return public_name(__name__, PUBLIC, name)
