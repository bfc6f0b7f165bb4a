"""Object targets: references, tracking and local safety; the SIL world and its camera.

Its public API is what ``PUBLIC`` names; docs/api.md describes it.
"""

from typing import Any

from ssp_core.public_names import public_name

# Loaded when they are asked for, so that a node or command pays for what it uses alone.
PUBLIC = {
    "Body": "ssp_ot_controller.bodies.body",
    "Scene": "ssp_ot_controller.camera.renderer.scene",
    "Tracker": "ssp_ot_controller.control.tracker",
    "render": "ssp_ot_controller.camera.renderer.render",
}


def __getattr__(name: str) -> Any:
    return public_name(__name__, PUBLIC, name)
