"""What a model said in its own last answer about the same clip, stage by stage."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ssp_vla_bridge.core.request import Request
from ssp_vla_bridge.core.response import Response


@dataclass(frozen=True)
class Said:
    """Text of a stage, and the time that it was about, ns."""

    text: str
    stamp_ns: int


def stage_text(response: Response, name: str) -> str | None:
    """The raw text of a stage by its span in ``decoding["stages"]``; None: there is none.

    A span that isn't one, or lies outside the text, names no stage.

    Args:
        response: whoever made it.
        name: of the stage.
    """
    stages = response.decoding.get("stages")
    for stage in stages if isinstance(stages, list) else ():
        if isinstance(stage, Mapping) and stage.get("name") == name:
            start, end = stage.get("start"), stage.get("end")
            if not (isinstance(start, int) and isinstance(end, int)):
                continue
            if 0 <= start <= end <= len(response.text):
                return response.text[start:end]
    return None


def previous_stage(request: Request, name: str) -> Said | None:
    """What the request's earlier answer said in a stage; None: nothing, or it wasn't earlier."""
    previous = request.previous
    if previous is None or previous.error_code or previous.stamp_ns >= request.stamp_ns:
        return None
    text = stage_text(previous, name)
    return Said(text.strip(), previous.stamp_ns) if text and text.strip() else None
