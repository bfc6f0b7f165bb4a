"""The bridge's ROS parameters, read once when the node starts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ssp_core.node_interface import Parameter
from ssp_vla_bridge.backend import parse_options
from ssp_vla_bridge.window import find_interface


@dataclass(frozen=True)
class BridgeParams:
    """The configuration of one bridge.

    BRIDGE explains each field, and ``backend`` is never empty.
    """

    model: str
    backend: str
    backend_options: dict[str, Any]
    timeout_s: float
    queue_limit: int
    interface: str
    shadow_hz: float


BRIDGE = (
    Parameter(
        "model",
        "constant_velocity",
        "name on the topics",
        text="letters, digits and underscores, a letter first",
        pattern=r"[A-Za-z][A-Za-z0-9_]*",
    ),
    Parameter(
        "backend",
        "",
        "backend that answers; empty: the one named as model",
        text="name of a backend, module:factory, or empty",
    ),
    Parameter("backend_options", "", "its options", text="a JSON object, or empty", secret=True),
    Parameter(
        "timeout_s",
        60.0,
        "time limit from request to answer, s; a later answer is discarded",
        least=0.001,
        most=86400,
    ),
    Parameter(
        "queue_limit",
        4,
        "requests that may wait beside the one being processed",
        least=1,
        most=1_000_000,
    ),
    Parameter(
        "interface",
        "",
        "frames and ego samples that the model gets in shadow mode; empty: the backend's",
        text="name of an interface, or empty",
    ),
    Parameter(
        "shadow_hz",
        0.0,
        "rate of requests about a running session, Hz of its clock; 0: never",
        most=100,
    ),
)
NODES = {"vla_bridge": BRIDGE}


def bridge_params(parameters: Mapping[str, Any]) -> BridgeParams:
    """Convert the values of BRIDGE to the bridge's configuration.

    Raises:
        InputError: the backend's options are no JSON object, or there is no such interface.
    """
    if parameters["interface"]:
        find_interface(parameters["interface"])
    options = parse_options(parameters["backend_options"])
    backend = parameters["backend"] or parameters["model"]
    return BridgeParams(**{**parameters, "backend": backend, "backend_options": options})
