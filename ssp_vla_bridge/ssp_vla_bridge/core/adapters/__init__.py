"""Adapters by name: from a raw response to text and trajectory (METHOD 5.4).

An adapter parses and converts coordinates; it repairs nothing and never raises on a response.
"""

from __future__ import annotations

from collections.abc import Callable

from ssp_core.errors import InputError
from ssp_vla_bridge.core.adapters.types import Adapted, AdapterInfo
from ssp_vla_bridge.core.adapters.waypoints import adapt_waypoints
from ssp_vla_bridge.core.response import Response

__all__ = ["ADAPTERS", "Adapted", "AdapterInfo", "adapt", "check_adapter"]

ADAPTERS: dict[str, Callable[[Response], Adapted]] = {
    "waypoints": adapt_waypoints,
}


def adapt(adapter_name: str, response: Response) -> Adapted:
    """Text and trajectory of a response, read as the named interface defines it.

    Raises:
        InputError: there is no adapter of that name.
    """
    check_adapter(adapter_name)
    return ADAPTERS[adapter_name](response)


def check_adapter(adapter_name: str) -> None:
    """Raises InputError when there is no adapter of that name, naming those that there are."""
    if adapter_name not in ADAPTERS:
        raise InputError(
            "unknown adapter",
            field="adapter",
            value=adapter_name,
            remedy=f"known are {', '.join(sorted(ADAPTERS))}",
        )
