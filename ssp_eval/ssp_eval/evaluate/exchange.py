"""One request, one answer: which answers count, and what becomes of the others."""

from __future__ import annotations

import json

from ssp_eval.evaluate.asker import Ignored, Reply
from ssp_vla_bridge.messages import Request, Response

# Far more than a model has to say about one picture; without a bound one answer could fill the
# disk, and every reader of the cell would have to carry it.
MOST_CHARACTERS = 1 << 20
MOST_NUMBERS = 1 << 18
# A name is listed in every summary.
MOST_NAME = 1000


def unusable(response: Response) -> str:
    """Why an answer can't be stored, whatever it says; empty where it can.

    Args:
        response: as it came.
    """
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
    except (ValueError, TypeError, RecursionError) as error:
        return f"the answer's decoding is no JSON: {error}"
    if decoding > MOST_CHARACTERS:
        return f"the answer's decoding has {decoding} characters, more than {MOST_CHARACTERS}"
    return ""


class Exchange:
    """The conversation with one model. Only the first answer to the open request is used."""

    def __init__(self) -> None:
        self.ignored = Ignored()
        self._open: Request | None = None
        self._reply: Reply | None = None
        self._answered: set[str] = set()
        self._given_up: set[str] = set()

    def open(self, request: Request) -> None:
        """A request is about to be sent.

        Raises:
            ValueError: another one is open still.
        """
        if self._open is not None:
            raise ValueError(f"request {self._open.request_id} is open still")
        self._open = request
        self._reply = None

    def offer(self, response: Response) -> None:
        """An answer came; it is used, or counted as late, duplicate or unknown."""
        asked = self._open
        if asked is not None and response.request_id == asked.request_id:
            self._answered.add(asked.request_id)
            self._open = None
            problem = unusable(response)
            self._reply = Reply(None, problem) if problem else Reply(response)
            if response.stamp_ns != asked.stamp_ns:
                reason = f"the answer is stamped {response.stamp_ns} ns, asked was {asked.stamp_ns}"
                self._reply = Reply(None, reason)
        elif response.request_id in self._given_up:
            self.ignored.late += 1
        elif response.request_id in self._answered:
            self.ignored.duplicate += 1
        else:
            self.ignored.unknown += 1

    def offer_unreadable(self, request_id: str, reason: str) -> None:
        """An answer came that can't be read; it costs its own request only."""
        if self._open is not None and request_id == self._open.request_id:
            self._answered.add(request_id)
            self._open = None
            self._reply = Reply(None, f"the answer can't be read: {reason}")
        else:
            self.ignored.unknown += 1

    def take(self) -> Reply | None:
        """The reply to the last request, once; None while there is none."""
        reply, self._reply = self._reply, None
        return reply

    def give_up(self) -> None:
        """Nobody waits for the open request any more; an answer from now on is late."""
        if self._open is not None:
            self._given_up.add(self._open.request_id)
            self._open = None
