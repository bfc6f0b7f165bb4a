"""What may be asked about a label time, and a memory of the last questions about a clip."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ssp_vla_bridge.messages import Request
from ssp_vla_bridge.window import Preprocessing

# Nine questions of ten frames of 960 × 540 px.
_MOST_BYTES = 32 << 20


@dataclass(frozen=True)
class Question:
    """A request for one label time; ``t_s`` is the clip time of its newest frame."""

    label_t_s: float
    t_s: float
    request: Request


@dataclass(frozen=True)
class NoQuestion:
    """Why there is nothing to ask at a label time."""

    label_t_s: float
    reason: str


class KeptQuestions:
    """The questions of one clip under the rules that were used last, as far as there is room.

    Models with the same rules are asked the same, one after the other, and each frame is looked
    at by its hash: neither needs the bag again. Other rules empty the memory.
    """

    def __init__(self) -> None:
        self._rules: Preprocessing | None = None
        self._kept: dict[float, Question | NoQuestion] = {}
        self._left_bytes = 0

    def get(
        self,
        label_t_s: float,
        rules: Preprocessing,
        make: Callable[[float, Preprocessing], Question | NoQuestion],
    ) -> Question | NoQuestion:
        """The question about a label time, made where it isn't kept.

        Args:
            label_t_s: clip time of the label.
            rules: which frames and ego samples it holds.
            make: gives the question.
        """
        if rules != self._rules:
            self._rules, self._kept, self._left_bytes = rules, {}, _MOST_BYTES
        question = self._kept.get(label_t_s)
        if question is None:
            question = make(label_t_s, rules)
            size = 0
            if isinstance(question, Question):
                size = sum(len(frame.jpeg) for frame in question.request.frames)
            if size <= self._left_bytes:
                self._left_bytes -= size
                self._kept[label_t_s] = question
        return question
