"""The answer within a model's output (METHOD 5.4b): without reasoning, and without further turns.

Adapters, the text extractor, its LLM stage and the prompts of later stages read what this module
calls the answer, and nothing else.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum
from unicodedata import decimal

_REASONING = (
    "think|thinking|thought|thoughts|reasoning|reason|analysis|scratch[-_]?pad|reflection|cot"
    "|chain[-_]?of[-_]?thoughts?|monologue|deliberation"
)
# Any word may stand before one that means thinking alone; "scene_analysis" heads an answer.
_IN_TAG = (
    rf"(?:\w{{1,12}}:)?(?:(?:(?:inner|internal|private|hidden|deep|ant)[-_]?)?(?:{_REASONING})"
    r"|[\w-]{1,14}[-_](?:think|thinking|thoughts?|reasoning|monologue|scratch[-_]?pad))"
    "(?:[-_]?(?:process|steps?|content|block|trace)|_never_used_[0-9a-f]{8,40})?"
)
# A mark of reasoning in the spellings of models: <think>, [THINK], <seed:think>, ◁think▷,
# <|begin_of_thought|>, <|START_THINKING|>. Each may carry attributes, and servers may escape its
# brackets. Square brackets also head sections ("[Reasoning]"), so that only words that head none
# are marks in them.
_MARK = re.compile(
    rf"(?P<begin>(?:<|&lt;)\s?{_IN_TAG}(?:\s[^<>]{{0,80}})?(?<!/)(?:>|&gt;)|[\[{{]think(?:ing)?[\]}}]"
    rf"|<\|(?:begin_of_|start_|begin_)?(?:{_REASONING})(?:_start|_begin)?\|>|◁think▷|<unused94>|<\|inner_prefix\|>"
    # Granite and Apriel; gpt-oss where its marks were taken out, but not its channels' names.
    r"|(?P<heading>^[ \t]*here(?: is|'s|’s) my thought process:|\A\s*/think\n"
    r"|<\|im_start\|>\s*(?:assistant/)?think\b|<details\s+type=\"reasoning\"[^<>]{0,80}>"
    r"|<details>\s*<summary>\s*(?:thought|thinking|reasoning)\b[^<>]{0,60}</summary>)"
    r"|^[ \t]*here are my reasoning steps:"
    r"|(?-i:\Aanalysis(?=[A-Z])|assistant(?:analysis|commentary)(?=[ A-Z])))"
    rf"|(?P<end>(?:<\s?/|&lt;/)\s?{_IN_TAG}\s*(?:>|&gt;)|[\[{{]/think(?:ing)?[\]}}]"
    rf"|<\|/?end_(?:of_)?(?:{_REASONING})\|>|<\|(?:{_REASONING})_end\|>|<\|/(?:{_REASONING})\|>"
    r"|◁/think▷|<unused95>|<\|inner_suffix\|>"
    r"|\[begin final response\]|<\|content\|>|(?-i:assistantfinal)"
    r"|^[ \t]*(?:\.\.\.|…)[ \t]*done thinking\.?[ \t]*$)"  # of Ollama's command line
    r"|(?P<response>^[ \t]*here(?: is|'s|’s) my response:|</details>"
    r"|<\|im_end\|>\s*<\|im_start\|>assistant\b)"
    # Channels: what stands in any other one than the final one is no answer.
    r"|(?P<channel>(?:<\|start\|>\s*assistant\s*)?<\|channel\|?>\s*(?P<name>\w+)[^<\n]{0,80}"
    r"(?:<\|message\|>|(?=<channel\|>)|\n))",
    re.IGNORECASE | re.MULTILINE,
)
_FINAL_CHANNELS = frozenset({"final", "answer", "response"})
# The end of a channel that isn't the last one.
_CHANNEL_END = re.compile(r"<\|end\|>|<channel\|>|(?=<\|start\|>)", re.IGNORECASE)

# A fence that its information string calls reasoning; one without an end takes all that follows.
_FENCED = re.compile(
    rf"^[ \t]*(?P<fence>`{{3,}}|~{{3,}})[ \t]*(?:{_REASONING})[ \t]*\n(?P<inside>.*?)"
    r"(?:^[ \t]*(?P=fence)[ \t]*$|\Z)",
    re.IGNORECASE | re.MULTILINE | re.DOTALL,
)

# A model's own role, and what templates put between a role and its turn.
_SELF = r"(?:assistant|model|chatbot|ai|gpt)"
_OTHERS = r"(?:user|human|system|tool|observation|developer|function|instruction)"
# Marks with which a server's template ends a turn, or opens another one.
_END = re.compile(
    r"<\|(?:im_end|eot_id|eom_id|end|end_of_turn|endofturn|endoftext|end_of_text|return|eos|eot|eom"
    r"|stop|role_end|end_of_sentence|end_of_turn_token|start_of_turn_token)\|>"
    rf"|<\|(?:im_|hy_)?(?:{_OTHERS}|{_SELF})(?:_token|_start|_end)?\|>"
    rf"|<\|(?:im_start|start_header_id|header_start|start_of_role|start|begin|turn)\|?>"
    rf"\s*(?:(?:{_OTHERS}|{_SELF})\b)?"
    rf"|<(?:end_of_turn|end_of_utterance|eos|/s|eot|turn\|)>|<start_of_turn>\s*\w*"
    rf"|<role>\s*(?:{_OTHERS}|{_SELF})\s*</role>|\[\|(?:endofturn|{_OTHERS}|{_SELF})\|\]"
    rf"|<(?:extra_id_1|special_1[0-2])>\s*(?:{_OTHERS}|{_SELF})?|\[e~\[|\]~b\]\w*"
    r"|<\|(?:im_sep|sep|pad|prompter)\|>|<pad>|\[pad\]|<reserved_10[67]>"
    r"|<\|end▁of▁sentence\|>|\[/?inst\]|<<sys>>|\[end final response\]",
    re.IGNORECASE,
)
# A line that opens a turn: the speaker's name and a colon, perhaps in bold or as a heading, or the
# name alone, which is left of a template whose marks were taken out. A human with a number or a
# remark is a speaker only where somebody speaks: "Human 1: crosses" is a road user.
_NAMED = r"(?:user|human|system|assistant|tool|instruction)"
_REMARK = r"(?:[ \t]*#?\d{1,2}(?!\d))?(?:[ \t]*\([^()\n]{1,30}\))?"
_SPEECH = (
    r"(?=[^\n]{0,300}(?:\?|\b(?:you|your|please)\b)"
    r"|[ \t*_]*(?:\n[ \t]*)?(?:i|we|ok|okay|thanks?)\b)"
)
_SPEAKER = re.compile(
    r"^[ \t]*(?:>[ \t]*)?(?:#{1,6}[ \t]*)?(?:\*\*?|__?)?"
    rf"(?:{_NAMED}(?:\*\*?|__?)?[ \t]*:|(?:user|assistant){_REMARK}(?:\*\*?|__?)?[ \t]*:"
    rf"|human{_REMARK}(?:\*\*?|__?)?[ \t]*:{_SPEECH}|(?:user|human)[ \t]+[-–—](?=\s){_SPEECH})"
    rf"|^[ \t]*\[{_NAMED}\][ \t]*(?::|$)|^[ \t]*\[user\](?=[ \t])|^[ \t]*\({_NAMED}\)[ \t]*:"
    r"|^[ \t]*\{\s*\"role\"\s*:\s*\"(?:user|human|system|tool)\""
    rf"|^[ \t]*<{_NAMED}>[ \t]*$|<(?:user|human)>[ \t]*:"
    r"|^[ \t]*<(?:user>|human>(?!(?s:.{0,2000}?)</human>))"
    rf"|^#{{1,6}}[ \t]*{_NAMED}[ \t]*$|^[ \t]*(\*\*|__)(?:user|human|assistant)\1[ \t]*$"
    r"|(?-i:^(?:user|system|assistant)[ \t]*$|(?<=\n\n)(?:User|Human|Assistant)[ \t]*$"
    r"|(?<=[.!?\])}`*])(?:user|assistant)\n\n)",
    re.IGNORECASE | re.MULTILINE,
)
_OPENS_OWN = re.compile(
    rf"\s*(?:<s>|<bos>|<\|begin_of_text\|>|<\|(?:im_|hy_)?{_SELF}(?:_token|_start)?\|>"
    rf"(?:\s*(?:{_SELF}\s*)?<\|im_middle\|>)?|<\|start_of_turn_token\|>"
    rf"|<\|(?:im_start|start_header_id|header_start|start_of_role|start|begin|turn)\|?>\s*{_SELF}\b"
    rf"\s*(?:<\|(?:im_sep|end_header_id|header_end|end_of_role|message)\|>)?"
    rf"|<start_of_turn>\s*model\s*|<role>\s*{_SELF}\s*</role>|\[\|{_SELF}\|\]|\]~b\]{_SELF}\b"
    rf"|<(?:extra_id_1|special_1[0-2])>\s*{_SELF}\b|\[/inst\]"
    r"|\[assistant\](?:[ \t]*:|[ \t]*(?=\n))|<assistant>[ \t]*(?=\n)"
    rf"|(?:#{{1,6}}[ \t]*)?(?:\*\*|__)?(?:assistant{_REMARK}|\(assistant\)|response)(?:\*\*|__)?"
    r"[ \t]*:(?:\*\*|__)?[ \t]*"
    r"|(?:#{1,6}[ \t]*(?:assistant|response)|\*\*(?:assistant|response)\*\*"
    r"|__(?:assistant|response)__|(?-i:assistant))[ \t]*(?=\n))",
    re.IGNORECASE,
)
# Digits, brackets and signs of full width, which some models write; one character each, so that
# spans keep their places.
_FULL_WIDTH = {code: code - 0xFEE0 for code in range(0xFF01, 0xFF5F)} | {
    0x3000: 0x20, 0x3010: 0x5B, 0x3011: 0x5D, 0x3014: 0x5B, 0x3015: 0x5D, 0x3001: 0x2C,
    0x066B: 0x2E, 0x060C: 0x2C,  # Arabic decimal mark and comma
}  # fmt: skip
_OTHER_DIGIT = re.compile(r"[^\D0-9]")


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
    """Split an output into reasoning, answer and what follows the own turn (METHOD 5.4b).

    Reasoning goes first: marks without an end take all that follows, an end mark without a
    beginning takes all before it. The answer then ends at the first end-of-turn mark, or at the
    line that opens another turn. Characters of full width are read as the plain ones. An output
    without any mark is its own answer.
    """
    notes = []
    output = plain_width(output)
    text, reasoning = _without_reasoning(output)
    fenced = [match["inside"].strip() for match in _FENCED.finditer(text)]
    if fenced:
        text = _FENCED.sub("", text)
        reasoning = "\n".join(part for part in (reasoning, *fenced) if part)
    if text != output:
        notes.append("reasoning was left out")
        text = text.strip()
    begin = 0
    while (opening := _OPENS_OWN.match(text, begin)) is not None:
        begin = opening.end()
    own = text[begin:]
    ends = [match.start() for match in (_END.search(own), _SPEAKER.search(own)) if match]
    if ends:
        end = min(ends)
        rest = _END.sub("", own[end:]).strip()
        if rest:
            notes.append("what follows the end of the own turn was left out")
        own = own[:end].rstrip()
    return AnswerText(own, reasoning, tuple(notes))


def _without_reasoning(output: str) -> tuple[str, str]:
    answer_parts: list[str] = []
    reasoning: list[str] = []
    at, inside, headed = 0, False, False
    channel_end = None
    for mark in _MARK.finditer(output):
        if mark.start() < at or (mark["response"] and not (inside and headed)):
            continue
        headed = bool(mark["heading"]) or (headed and inside)
        before = output[at : mark.start()]
        at = mark.end()
        if inside and channel_end is not None:
            # A channel ends with its own mark, or where the next one begins.
            before = _CHANNEL_END.split(before, maxsplit=1)[0]
        (reasoning if inside else answer_parts).append(before)
        if mark["channel"]:
            inside = mark["name"].lower() not in _FINAL_CHANNELS
            channel_end = _CHANNEL_END
            if not inside:
                reasoning += answer_parts
                answer_parts = []
        elif mark["begin"]:
            inside = True
        else:
            if not inside:
                reasoning += answer_parts
                answer_parts = []
            inside, channel_end = False, None
    rest = output[at:]
    if inside and channel_end is not None and (end := _CHANNEL_END.search(rest)) is not None:
        reasoning.append(rest[: end.start()])
        answer_parts.append(rest[end.end() :])
    else:
        (reasoning if inside else answer_parts).append(rest)
    return "".join(answer_parts), "\n".join(part.strip() for part in reasoning if part.strip())


def plain_width(text: str) -> str:
    """Replace full-width characters and other scripts' digits by ASCII; the length stays."""
    if text.isascii():
        return text
    return _OTHER_DIGIT.sub(lambda digit: str(decimal(digit[0])), text.translate(_FULL_WIDTH))


class Ending(StrEnum):
    """The reason that a server gives for the end of an answer."""

    WHOLE = "whole"
    LIMIT = "limit"
    BROKEN = "broken"
    FILTERED = "filtered"
    UNKNOWN = "unknown"


# What a server says in so many words; of other reasons the parts of their names tell.
_ENDING_WORDS: dict[Ending, frozenset[str]] = {
    Ending.WHOLE: frozenset(
        {"", "null", "none", "stop", "eos", "eot", "eog", "eos_token", "eog_token", "stop_token"}
        | {"end_turn", "end_of_turn", "end", "stop_sequence", "stop_string", "complete", "done"}
        | {"completed", "finish", "finished", "success", "stopped", "eos_found", "stopped_eos"}
        | {"stop_string_found", "stop_criteria_met", "stopped_word"}
    ),
    Ending.LIMIT: frozenset(
        {"error_limit", "incomplete", "num_predict", "n_predict", "cutoff", "cut_off"}
    ),
    Ending.BROKEN: frozenset(
        {"time_limit", "rate_limit", "rate_limit_exceeded", "not_finished", "unfinished"}
        | {"insufficient_system_resource", "user_stopped", "stopped_by_user", "in_progress"}
    ),
}
_ENDING_OF = {word: ending for ending, words in _ENDING_WORDS.items() for word in words}
_ENDING_PARTS: dict[Ending, frozenset[str]] = {
    Ending.FILTERED: frozenset(
        {"filter", "filtered", "safety", "unsafe", "recitation", "blocklist", "blocked", "refusal"}
        | {"prohibited", "spii", "sensitive", "moderation", "policy", "toxic", "guardrail", "armor"}
        | {"refused", "moderated", "guardrails", "flagged", "violation", "harm", "harmful"}
        | {"censored", "jailbreak"}
    ),
    Ending.BROKEN: frozenset(
        {"error", "errored", "abort", "aborted", "cancel", "cancelled", "canceled", "failed"}
        | {"failure", "timeout", "timed", "interrupted", "interrupt", "disconnected", "disconnect"}
        | {"shutdown", "unloaded", "unload", "killed", "crashed", "preempted", "exception"}
        | {"malformed", "overloaded", "unavailable", "unclosed", "oom", "expired", "memory"}
        | {"halted", "shutting", "closed", "hangup"}
        | {"busy", "connection", "unreachable", "overload", "throttled"}
        | {
            "died",
            "dead",
            "fault",
            "terminated",
            "evicted",
            "lost",
            "dropped",
            "deadline",
            "stalled",
        }
        | {"resource", "resources", "quota", "reset"}
    ),
    Ending.LIMIT: frozenset(
        {"length", "limit", "max", "maximum", "budget", "truncated", "truncation", "context"}
        | {"exceeded", "exhausted"}
    ),
}


def ending(finish_reason: str | None) -> Ending:
    """Read a server's reason for the end of an answer, in any case and spelling.

    A server that says nothing ended the answer by itself.
    """
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", finish_reason or "")
    word = re.sub(r"[\W_]+", "_", spaced).strip("_").lower()
    word = word.removeprefix("finish_reason_").removeprefix("stop_reason_")
    if word in _ENDING_OF:
        return _ENDING_OF[word]
    parts = frozenset(word.split("_"))
    return next((end for end, some in _ENDING_PARTS.items() if parts & some), Ending.UNKNOWN)
