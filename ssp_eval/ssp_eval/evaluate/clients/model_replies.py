"""The replies of models: what can be stored, and the reasons for label times without a record."""

from __future__ import annotations

import json
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from ssp_vla_bridge.messages import ErrorCode, Response

# A reason for people is a line, whatever a bridge writes into its error message.
MOST_REASON = 400


class Loss(StrEnum):
    """The reason why a label time has no record, in the words of tables and reports."""

    DIED = "bridge died"
    UNREACHABLE = "bridge unreachable"
    SILENT = "no answer in time"
    OVERLOAD = "bridge overloaded"
    UNUSABLE = "unusable answer"
    BROKEN_OFF = "answer broken off"
    DECLINED = "the model declined"
    ERROR = "bridge answered an error"
    NO_QUESTION = "nothing to ask"


# What is owed to bridge, server or network, and to no model: a cell with such a loss measures them.
OUTAGE = frozenset(Loss) - {Loss.NO_QUESTION, Loss.DECLINED}
# What the same question may get an answer after. A bridge keeps no state between requests, so
# asking again is safe; where the answer would be the same error again, it is useless.
PASSING = frozenset({Loss.DIED, Loss.UNREACHABLE, Loss.SILENT, Loss.OVERLOAD, Loss.BROKEN_OFF})
_OF_CODE = {
    ErrorCode.TIMEOUT: Loss.SILENT,
    ErrorCode.OVERLOAD: Loss.OVERLOAD,
    ErrorCode.BROKEN_OFF: Loss.BROKEN_OFF,
    ErrorCode.DECLINED: Loss.DECLINED,
}


def loss_of(response: Response) -> tuple[Loss | None, str]:
    """Return the loss of a response without a record, and its reason; (None, "") with a record."""
    code = response.error_code
    if not code:
        return None, ""
    is_error_code = code in set(ErrorCode)
    loss = _OF_CODE.get(ErrorCode(code), Loss.ERROR) if is_error_code else Loss.ERROR
    return loss, f"the bridge answered error {code}: {response.error_msg[:MOST_REASON]}"


@dataclass(frozen=True)
class ModelReply:
    """The outcome of one request: a response (which may hold an error), or why there is none.

    Args:
        response: None where none came or it can't be used.
        loss: the kind of that reason; it counts only where there is no response.
    """

    response: Response | None
    reason: str = ""
    loss: Loss = Loss.UNUSABLE


@dataclass
class IgnoredAnswers:
    """Answers that came and weren't used."""

    late: int = 0
    duplicate: int = 0
    unknown: int = 0

    def plus(self, now: IgnoredAnswers, before: IgnoredAnswers) -> IgnoredAnswers:
        """Return these counts plus the answers that came between two counts."""
        return IgnoredAnswers(
            self.late + now.late - before.late,
            self.duplicate + now.duplicate - before.duplicate,
            self.unknown + now.unknown - before.unknown,
        )

    def to_json(self) -> dict[str, int]:
        return {"late": self.late, "duplicate": self.duplicate, "unknown": self.unknown}


# Far more than a model has to say about one picture; without a bound one answer could fill the
# disk, and every reader of the cell would have to carry it.
MOST_CHARACTERS = 1 << 20
MOST_NUMBERS = 1 << 18
# Settings are a few lines; all of a cell's answers' together must fit into its summary.
MOST_DECODING = 1 << 16
# Decoding facts that differ by answer and stay with it, such as a model's thoughts.
PER_ANSWER = frozenset(
    (
        "stages",
        "usage",
        "latency_s",
        "notes",
        "frames",
        "prompt_sha256",
        "previous_intent_sha256",
    )
)
# A name is listed in every summary.
MOST_NAME = 1000


def settings_of(response: Response) -> dict[str, Any]:
    """Return the decoding settings of an answer, without those that differ by answer."""
    return {key: value for key, value in response.decoding.items() if key not in PER_ANSWER}


def unusable(response: Response) -> str:
    """Say why an answer can't be stored, whatever its content; empty where it can."""
    texts = (response.text, response.error_msg, response.model_id, response.model)
    characters = sum(len(text) for text in texts)
    if characters > MOST_CHARACTERS:
        return f"the answer has {characters} characters, more than {MOST_CHARACTERS}"
    if len(response.model_id) > MOST_NAME:
        return f"the model's name has {len(response.model_id)} characters, more than {MOST_NAME}"
    numbers = sum(len(array.data) + len(array.shape) for array in response.arrays)
    if numbers > MOST_NUMBERS:
        return f"the answer has {numbers} numbers, more than {MOST_NUMBERS}"
    try:
        decoding = len(json.dumps(dict(response.decoding), allow_nan=False))
        settings = len(json.dumps(settings_of(response), allow_nan=False))
    except (ValueError, TypeError, RecursionError) as error:
        return f"the answer's decoding is no JSON: {error}"
    for count, most in ((decoding, MOST_CHARACTERS), (settings, MOST_DECODING)):
        if count > most:
            return f"the answer's decoding has {count} characters, more than {most}"
    return ""
