"""The end of an answer as chat services state it, in the choice and beside it."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from ssp_core.chat.answer_text import Ending, ending

# Reasons in so many words; one that isn't known counts where no other stands before it.
_REASONS = (
    "finish_reason",
    "finishReason",
    "done_reason",
    "stop_reason",
    "finish_details",
    "native_finish_reason",
)
# What says a reason only where it is one that makes the answer less than whole.
_SIGNS = ("stop_type", "status", "incomplete_details")
_IF_TRUE = ("truncated", "stopped_limit", "incomplete", "interrupted", "aborted", "cancelled")
_IF_FALSE = ("done", "finished", "is_finished", "completed")
_FILTERS = "content_filter_results"
_WITHIN = ("type", "reason", "finish_reason")
# The question itself was blocked, so that there may be no choice.
_FEEDBACK = (("promptFeedback", "blockReason"), ("prompt_feedback", "block_reason"))
_NAME = re.compile(r"[A-Za-z]+(?:[_-][A-Za-z]+)*")
_RANK = {Ending.LIMIT: 1, Ending.FILTERED: 2, Ending.BROKEN: 3}


@dataclass(frozen=True)
class StatedEnd:
    """One statement of a service about the end of an answer.

    Args:
        reason: in the service's words, None: it says nothing.
        text: the key with what it says.
    """

    reason: str | None = None
    text: str = ""

    @property
    def ending(self) -> Ending:
        return ending(self.reason)


def worst_end(*places: Mapping[str, Any]) -> StatedEnd:
    """Find the worst end that is stated: broken off, filtered, at the limit, then the first one.

    Args:
        places: the choice, its message and the reply, the first of which counts most.
    """
    stated = (one for place in places for one in _stated_ends(place))
    return max(stated, key=lambda one: _RANK.get(one.ending, 0), default=StatedEnd())


def blocked_for(reply: Mapping[str, Any]) -> str:
    """Return why a filter blocked the question of a reply; empty where none did."""
    for key, name in _FEEDBACK:
        feedback = reply.get(key)
        reason = feedback.get(name) if isinstance(feedback, dict) else None
        if isinstance(reason, str) and reason and "UNSPECIFIED" not in reason:
            return f"{name} {reason}"
    return ""


def _stated_ends(place: Mapping[str, Any]) -> Iterator[StatedEnd]:
    is_first = True
    for key in _REASONS:
        reason = _reason(place.get(key))
        # Token and text at which a server stopped stand there too, beside the reason.
        is_mark = key == "stop_reason" and (
            isinstance(place.get(key), int)
            or not (is_first or reason is None or _NAME.fullmatch(reason))
        )
        if reason is not None and not is_mark:
            is_first = False
            yield StatedEnd(reason, f"{key} {reason}")
    signs = [
        (key, _reason(place.get(key))) for key in _SIGNS if not isinstance(place.get(key), int)
    ]
    signs += [(key, key) for key in _IF_TRUE if place.get(key) is True]
    signs += [(key, "not_finished") for key in _IF_FALSE if place.get(key) is False]
    if _holds_filtered(place.get(_FILTERS)):
        signs.append((_FILTERS, "content_filter"))
    for key, reason in signs:
        if ending(reason) in _RANK:
            value_text = str(place[key]).lower() if isinstance(place[key], bool) else reason
            yield StatedEnd(reason, f"{key} {value_text}")


def _reason(reason: Any) -> str | None:
    """Return a reason that may stand in an object with further details."""
    if isinstance(reason, dict):
        reason = next((reason[key] for key in _WITHIN if reason.get(key) is not None), None)
    return reason if reason is None or isinstance(reason, str) else str(reason)


def _holds_filtered(results: Any) -> bool:
    """Tell whether a category of a filter's results says that it was filtered."""
    return isinstance(results, dict) and any(
        isinstance(one, dict) and one.get("filtered") is True for one in results.values()
    )
