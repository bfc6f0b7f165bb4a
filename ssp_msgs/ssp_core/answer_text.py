"""The answer within a model's output (METHOD 5.4b): without reasoning, and without further turns.

Adapters, the text extractor, its LLM stage and the prompts of later stages read what this module
calls the answer, and nothing else.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum

_REASONING = (
    "think|thinking|thought|thoughts|reasoning|reason|analysis|scratchpad|reflection|cot"
    "|chain_of_thought|inner_monologue"
)
# A mark of reasoning in the spellings of models: <think>, [THINK], <seed:think>, ◁think▷,
# <|begin_of_thought|>, <|START_THINKING|>. Each may carry attributes. Square brackets also head
# sections ("[Reasoning]"), so that only words that head none are marks in them.
_MARK = re.compile(
    rf"(?P<begin><(?:\w{{1,12}}:)?(?:{_REASONING})(?:\s[^<>]{{0,80}})?>|\[think(?:ing)?\]"
    rf"|<\|(?:begin_of_|start_|begin_)?(?:{_REASONING})(?:_start|_begin)?\|>|◁think▷|<unused94>)"
    rf"|(?P<end></(?:\w{{1,12}}:)?(?:{_REASONING})\s*>|\[/think(?:ing)?\]"
    rf"|<\|/?end_(?:of_)?(?:{_REASONING})\|>|<\|(?:{_REASONING})_end\|>|<\|/(?:{_REASONING})\|>"
    r"|◁/think▷|<unused95>)"
    # Channels: what stands in any other one than the final one is no answer.
    r"|(?P<channel>(?:<\|start\|>\s*assistant\s*)?<\|?channel\|?>\s*(?P<name>\w+)[^<]{0,80}"
    r"(?:<\|message\|>|<channel\|>|\n))",
    re.IGNORECASE,
)
_FINAL_CHANNELS = frozenset({"final", "answer", "response"})
# The end of a channel that isn't the last one.
_CHANNEL_END = re.compile(r"<\|end\|>|<channel\|>|(?=<\|start\|>)", re.IGNORECASE)

# Marks with which a server's template ends a turn.
_END = re.compile(
    r"<\|(?:im_end|eot_id|eom_id|end|end_of_turn|endoftext|end_of_text|return|eos|eot|user|human"
    r"|system|tool|observation)\|>"
    r"|<\|(?:im_start|start_header_id|start)\|>\s*(?!assistant\b)\w*"
    r"|<(?:end_of_turn|eos|/s|eot)>|<start_of_turn>\s*(?:user|system|tool)\b"
    r"|<｜end▁of▁sentence｜>|<｜User｜>|\[/?INST\]|<\|(?:START|END)_OF_TURN_TOKEN\|>"
    # A second turn of the model's own.
    r"|<\|im_start\|>\s*assistant\b|<\|start_header_id\|>\s*assistant\b|<start_of_turn>\s*model\b"
    r"|<\|assistant\|>|<｜Assistant｜>",
    re.IGNORECASE,
)
# A line that opens a turn: the speaker's name, a colon, perhaps in bold or as a heading.
_SPEAKER = re.compile(
    r"^[ \t]*(?:#{1,6}[ \t]*)?(?:\*\*|__)?"
    r"(user|human|system|assistant|tool|instruction)(?:\*\*|__)?[ \t]*:(?:\*\*|__)?",
    re.IGNORECASE | re.MULTILINE,
)
_OPENS_OWN = re.compile(
    r"\s*(?:<s>|<bos>|<\|begin_of_text\|>|<\|im_start\|>\s*assistant\s*|<\|assistant\|>"
    r"|<\|start_header_id\|>\s*assistant\s*<\|end_header_id\|>|<start_of_turn>\s*model\s*"
    r"|<｜Assistant｜>|\[/INST\]"
    r"|(?:#{1,6}[ \t]*)?(?:\*\*|__)?(?:assistant|response)(?:\*\*|__)?[ \t]*:(?:\*\*|__)?[ \t]*"
    r"|#{1,6}[ \t]*(?:assistant|response)[ \t]*(?=\n))",
    re.IGNORECASE,
)
# Digits, brackets and signs of full width, which some models write; one character each, so that
# spans keep their places.
_FULL_WIDTH = {code: code - 0xFEE0 for code in range(0xFF01, 0xFF5F)} | {
    0x3000: 0x20, 0x3010: 0x5B, 0x3011: 0x5D, 0x3014: 0x5B, 0x3015: 0x5D, 0x3001: 0x2C,
}  # fmt: skip


@dataclass(frozen=True)
class AnswerText:
    """One output of a model, parted.

    Args:
        text: the answer.
        reasoning: what was taken out as reasoning, without its marks.
        notes: one clause each on what was left out.
    """

    text: str
    reasoning: str = ""
    notes: tuple[str, ...] = ()


def split_answer(output: str) -> AnswerText:
    """Part an output into reasoning, answer and what follows the own turn (METHOD 5.4b).

    Reasoning goes first: marks without an end take all that follows, an end mark without a
    beginning takes all before it. The answer then ends at the first end-of-turn mark, or at the
    line that opens another turn. An output without any mark is its own answer, unchanged.
    """
    notes = []
    text, reasoning = _without_reasoning(output)
    if text != output:
        notes.append("reasoning was left out")
        text = text.strip()
    own = text
    while (opening := _OPENS_OWN.match(own)) is not None:
        own = own[opening.end() :]
    ends = [match.start() for match in (_END.search(own), _SPEAKER.search(own)) if match]
    if ends:
        end = min(ends)
        rest = _END.sub("", own[end:]).strip()
        if rest:
            notes.append("what follows the end of the own turn was left out")
        own = own[:end].rstrip()
    return AnswerText(own, reasoning, tuple(notes))


def _without_reasoning(output: str) -> tuple[str, str]:
    kept: list[str] = []
    reasoning: list[str] = []
    at, inside = 0, False
    channel_end = None
    for mark in _MARK.finditer(output):
        if mark.start() < at:
            continue
        before = output[at : mark.start()]
        at = mark.end()
        if inside and channel_end is not None:
            # A channel ends with its own mark, or where the next one begins.
            before = _CHANNEL_END.split(before, maxsplit=1)[0]
        (reasoning if inside else kept).append(before)
        if mark["channel"]:
            inside = mark["name"].lower() not in _FINAL_CHANNELS
            channel_end = _CHANNEL_END
            if not inside:
                reasoning += kept
                kept = []
        elif mark["begin"]:
            inside = True
        else:
            if not inside:
                reasoning += kept
                kept = []
            inside, channel_end = False, None
    rest = output[at:]
    if inside and channel_end is not None and (end := _CHANNEL_END.search(rest)) is not None:
        reasoning.append(rest[: end.start()])
        kept.append(rest[end.end() :])
    else:
        (reasoning if inside else kept).append(rest)
    return "".join(kept), "\n".join(part.strip() for part in reasoning if part.strip())


def plain_width(text: str) -> str:
    """Replace characters of full width by their usual forms; the length stays the same."""
    return text if text.isascii() else text.translate(_FULL_WIDTH)


class Ending(StrEnum):
    """Why a server says that an answer ended."""

    WHOLE = "whole"
    LIMIT = "limit"
    BROKEN = "broken"
    FILTERED = "filtered"
    UNKNOWN = "unknown"


_ENDINGS: dict[Ending, frozenset[str]] = {
    Ending.WHOLE: frozenset(
        {"stop", "eos", "eos_token", "end_turn", "end", "stop_sequence", "stop_token", "complete"}
        | {"completed", "done", "finish", "finished", "success", "stopped", "end_of_turn"}
    ),
    Ending.LIMIT: frozenset(
        {"length", "max_tokens", "model_length", "max_length", "max_new_tokens", "token_limit"}
        | {"max_output_tokens", "max_completion_tokens", "context_length", "limit", "incomplete"}
        | {"max_tokens_reached", "model_context_window_exceeded", "context_window", "truncated"}
        | {"context_length_exceeded"}
    ),
    Ending.BROKEN: frozenset(
        {"error", "abort", "aborted", "cancel", "cancelled", "canceled", "failed", "failure"}
        | {"timeout", "timed_out", "interrupted", "interrupt", "network_error", "server_error"}
        | {"internal_error", "other_error", "disconnected", "malformed_response"}
        | {"insufficient_system_resource"}
    ),
    Ending.FILTERED: frozenset(
        {"content_filter", "content_filtered", "safety", "recitation", "blocklist", "refusal"}
        | {"prohibited_content", "spii", "image_safety", "sensitive", "moderation", "filtered"}
        | {"content_policy", "guardrail_intervened"}
    ),
}  # fmt: skip
_ENDING_OF = {word: ending for ending, words in _ENDINGS.items() for word in words}


def ending(finish_reason: str | None) -> Ending:
    """Read a server's reason for the end of an answer, in any case and spelling.

    A server that says nothing ended the answer by itself.
    """
    if finish_reason is None or not finish_reason.strip():
        return Ending.WHOLE
    word = re.sub(r"[\s\-.]+", "_", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", finish_reason.strip()))
    word = word.lower().removeprefix("finish_reason_").removeprefix("stop_reason_")
    return _ENDING_OF.get(word, Ending.UNKNOWN)
