"""Adapters by name: from a raw response to text and trajectory (METHOD 5.4).

An adapter parses and converts coordinates; it repairs nothing and never raises on a response.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

from ssp_core.errors import InputError
from ssp_vla_bridge.adapters.adapted import AdaptedResponse, AdapterInfo, answer_part, cut_parts
from ssp_vla_bridge.adapters.pairs import CORRECTED, NATIVE, adapt_lightemma, adapt_openemma
from ssp_vla_bridge.adapters.points import (
    ALPAMAYO_MODE,
    WAYPOINTS_FRAME,
    adapt_alpamayo,
    adapt_llavida,
    adapt_waypoints,
)
from ssp_vla_bridge.adapters.points import LLAVIDA_FRAME as LLAVIDA_MODE
from ssp_vla_bridge.messages import Request, Response

__all__ = ["ADAPTERS", "AdaptedResponse", "AdapterInfo", "adapt", "check_adapter"]


class Read(Protocol):
    """Reads a response as one interface defines it."""

    def __call__(self, response: Response, request: Request | None, mode: str) -> AdaptedResponse:
        """Return text and trajectory; raise on nothing.

        Args:
            response: as it came.
            request: that it answers, by which an echo of the prompt is known; None: not at hand.
            mode: one of the adapter's modes.
        """


@dataclass(frozen=True)
class _Adapter:
    read: Read
    modes: tuple[str, ...]  # the first is the default
    # Its text is a chain of causation: the model's statement, though it is marked as reasoning.
    states_reasons: bool = False


ADAPTERS: dict[str, _Adapter] = {
    "waypoints": _Adapter(adapt_waypoints, (WAYPOINTS_FRAME,)),
    "openemma": _Adapter(adapt_openemma, (CORRECTED, NATIVE)),
    "lightemma": _Adapter(adapt_lightemma, (NATIVE, CORRECTED)),
    "llavida": _Adapter(adapt_llavida, (LLAVIDA_MODE,)),
    "alpamayo": _Adapter(adapt_alpamayo, (ALPAMAYO_MODE,), states_reasons=True),
}


def adapt(adapter_name: str, response: Response, request: Request | None = None) -> AdaptedResponse:
    """Return text and trajectory of a response, read as the named interface defines it.

    Args:
        adapter_name: ``name`` or ``name:mode``.
        response: as it came.
        request: that it answers; None: not at hand.

    Raises:
        InputError: there is no adapter or mode of that name.
    """
    name, mode = check_adapter(adapter_name)
    adapter = ADAPTERS[name]
    notes: tuple[str, ...] = ()
    if not adapter.states_reasons:
        response, notes = answer_part(response)
    adapted = adapter.read(response, request, mode)
    cut = tuple(f"{part}: cut off at the limit of tokens" for part in cut_parts(response))
    info = replace(adapted.info, notes=(*adapted.info.notes, *notes, *cut))
    return replace(adapted, info=info) if notes or cut else adapted


def check_adapter(adapter_name: str) -> tuple[str, str]:
    """Name and mode of ``name`` or ``name:mode``.

    Raises:
        InputError: there is none, naming those that there are.
    """
    name, _, mode = adapter_name.partition(":")
    adapter = ADAPTERS.get(name)
    if adapter is None:
        raise InputError(
            "unknown adapter",
            field="adapter",
            value=adapter_name,
            remedy=f"known: {', '.join(sorted(ADAPTERS))}",
        )
    if (mode or adapter.modes[0]) not in adapter.modes:
        raise InputError(
            "unknown mode of the adapter",
            field="adapter",
            value=adapter_name,
            remedy=f"known: {', '.join(f'{name}:{one}' for one in adapter.modes)}",
        )
    return name, mode or adapter.modes[0]
