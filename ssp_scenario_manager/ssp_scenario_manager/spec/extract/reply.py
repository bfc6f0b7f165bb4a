"""The text in a server's reply, or why there is none."""

from __future__ import annotations

import json
from typing import Any

from ssp_core.errors import PeerError
from ssp_scenario_manager.spec.extract.answers import BadAnswer, printable


def reply_text(body: bytes, where: str) -> str:
    """What the model wrote.

    Args:
        body: of a chat completion.
        where: file in which the body stands, for messages.

    Raises:
        PeerError: it is no chat completion, or the model declined to answer.
        BadAnswer: the answer was cut off, or is empty; another try may help.
    """
    try:
        value: Any = json.loads(body)
        choice = value["choices"][0]
        message = choice["message"]
        content, refused = message.get("content"), message.get("refusal")
        finish = choice.get("finish_reason")
    except (ValueError, TypeError, LookupError, AttributeError, RecursionError) as error:
        raise PeerError(
            f"the server's reply is no chat completion (kept in {where}); --base-url usually ends "
            "in /v1"
        ) from error
    if refused or finish == "content_filter":
        said = printable(str(refused or "filtered by the server"))[:200]
        raise PeerError(
            f"the model declines to answer: {said} (kept in {where}); another model may answer, "
            "or write the event by hand"
        )
    if finish == "length":
        raise BadAnswer(["the answer was cut off at the limit of its length"])
    if not isinstance(content, str) or not content.strip():
        raise BadAnswer(["the answer is empty"])
    return content
