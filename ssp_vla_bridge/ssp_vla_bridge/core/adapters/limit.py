"""Which parts of an answer its decoding says were cut off at the limit of tokens."""

from __future__ import annotations

from collections.abc import Mapping

from ssp_vla_bridge.core.response import Response

MOTION = "motion"
_REASON = "length"  # finish_reason of OpenAI's interface
_WHOLE = "answer"
_NAME_LENGTH = 40


def cut_parts(response: Response) -> tuple[str, ...]:
    """Names of the stages that were cut off; ``answer`` where decoding says it of the whole.

    Args:
        response: whoever made it; ``finish_reason`` is looked for in its ``decoding`` and in each
            of ``decoding["stages"]``.
    """
    stages = response.decoding.get("stages")
    found = []
    for stage in stages if isinstance(stages, list) else ():
        if isinstance(stage, Mapping) and stage.get("finish_reason") == _REASON:
            name = stage.get("name")
            found.append(name[:_NAME_LENGTH] if isinstance(name, str) else "a stage")
    if response.decoding.get("finish_reason") == _REASON:
        found.append(_WHOLE)
    return tuple(dict.fromkeys(found))


def motion_is_cut(response: Response) -> bool:
    """Whether the text that holds the motion ends where the tokens did.

    Args:
        response: whoever made it.
    """
    return not {MOTION, _WHOLE}.isdisjoint(cut_parts(response))
