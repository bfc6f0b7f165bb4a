"""What every adapter gives."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ssp_vla_bridge.core.response import Response
from ssp_vla_bridge.core.trajectory import Trajectory


@dataclass(frozen=True)
class AdapterInfo:
    """How a response was read; goes into the behaviour record (METHOD 5.3).

    Args:
        name: the adapter's name.
        mode: which of its readings was used.
        origin_added: True when the frame's origin was put in as the point at t = 0 (METHOD 5.4).
        notes: what a reader of the scores should know, one clause each.
    """

    name: str
    mode: str
    origin_added: bool = False
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Adapted:
    """Text and trajectory of one response.

    Args:
        text: the model's text, as it is.
        trajectory: None when the native output is missing or invalid.
        invalid: why it is None, reasons of METHOD 5.3.
        info: how it was read.
    """

    text: str
    trajectory: Trajectory | None
    invalid: tuple[str, ...]
    info: AdapterInfo


def without_trajectory(
    response: Response, info: AdapterInfo, reason: str, note: str = ""
) -> Adapted:
    """What an adapter gives where it can't read a trajectory.

    Args:
        response: raw; of one with an error, the error is the note.
        info: name and mode.
        reason: of METHOD 5.3.
        note: why.
    """
    if response.error_code:
        note = f"error {response.error_code} instead of an answer"
    return Adapted(response.text, None, (reason,), replace(info, notes=(*info.notes, note)))
