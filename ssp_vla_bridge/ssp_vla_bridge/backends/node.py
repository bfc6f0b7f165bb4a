"""The options of a bridge's node that runs already, for drivers; they are read without ROS."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ssp_core.errors import InputError, PeerError, SspError
from ssp_core.run_file.driven import is_driver_name
from ssp_vla_bridge.backend import CODES, check_options, number_option
from ssp_vla_bridge.messages import ErrorCode

_BACKEND = "node"
_KNOWN = {"topic": str, "domain_id": int, "interface": str, "start_s": float}
_START_S = 30.0
# The ports of a higher domain don't exist.
_MOST_DOMAIN = 232
_ERRORS = {code: kind for kind, code in CODES.items()}


@dataclass(frozen=True)
class NodeOptions:
    """A running node.

    Args:
        topic: the model's name on its topics.
        domain_id: in which it runs.
        start_s: it is waited for so long when a run begins.
    """

    topic: str
    domain_id: int
    start_s: float


def read_options(options: Mapping[str, Any]) -> NodeOptions:
    """Return the options of the backend.

    Raises:
        InputError: one is missing or wrong.
    """
    check_options(_BACKEND, options, _KNOWN)
    topic = options.get("topic", "")
    if not is_driver_name(topic):
        raise InputError(
            "must be the name of a model on its topics",
            field="backend_options.topic",
            value=topic,
            remedy="give the parameter `model` of the bridge's node",
        )
    if options.get("domain_id") is None:
        raise InputError(
            "is missing",
            field="backend_options.domain_id",
            remedy="give the ROS_DOMAIN_ID in which the bridge's node runs",
        )
    domain_id = number_option(options, "domain_id", 0, 0, _MOST_DOMAIN)
    return NodeOptions(
        topic, int(domain_id), number_option(options, "start_s", _START_S, 0.0, 600.0)
    )


def error_of(topic: str, code: int, text: str) -> SspError | None:
    """Return the error that a running bridge answered with; None: it is none.

    Args:
        topic: of its answers.
        code: error_code of VlaResponse.msg.
        text: error_msg of it.
    """
    try:
        error_code = ErrorCode(code)
    except ValueError:
        numbers = ", ".join(f"{one.value} {one.name}" for one in ErrorCode)
        return PeerError(
            f"{topic}: error_code is no number of VlaResponse.msg (got {code}, and {text!r}); "
            f"expected is one of {numbers}"
        )
    return None if error_code is ErrorCode.NONE else _ERRORS.get(error_code, PeerError)(text)
