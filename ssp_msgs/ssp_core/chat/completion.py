"""The completion that a server returns: its text, why it ended, and what it counted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ssp_core.chat.answer_text import Ending, ending
from ssp_core.chat.endings import blocked_for, worst_end
from ssp_core.chat.errors import error_beside, error_in, error_text, is_filtered, looks_like_html
from ssp_core.files.strict_json import parse_strict

_TOKENS = ("prompt_tokens", "completion_tokens", "total_tokens")
_WORD = 200  # characters of a name that a server reports


class NoCompletion(ValueError):
    """A reply is no chat completion; the message says why, as a clause."""


class BrokenOff(NoCompletion):
    """The server broke the answer off, or reports an error; another time there may be one."""


@dataclass(frozen=True)
class Completion:
    """A server's answer to one request.

    Args:
        text: of the model; None: the reply holds none.
        parts: number of parts that the text came in, 0 for plain text.
        left_out: kinds of parts that are neither text nor reasoning.
        reasoning: thoughts that the server keeps apart from the text, empty where it has none.
        refusal: why the model or the server declines, None: it doesn't.
        usage: reported numbers of tokens, by OpenAI's names.
    """

    text: str | None
    parts: int = 0
    left_out: tuple[str, ...] = ()
    reasoning: str = ""
    refusal: str | None = None
    finish_reason: str | None = None
    model: str | None = None
    system_fingerprint: str | None = None
    usage: Mapping[str, int] | None = None

    @property
    def cut_off(self) -> bool:
        """True where the answer ended at the limit of tokens."""
        return ending(self.finish_reason) is Ending.LIMIT


def read_completion(body: bytes) -> Completion:
    """Read a reply; what it reports besides the text is taken where it has the right type.

    Raises:
        NoCompletion: it is no JSON, or holds not exactly one choice with a message.
        BrokenOff: it says an error, that the answer was broken off (METHOD 5.4b), or a list of no
            choices.
    """
    if looks_like_html(body):
        raise NoCompletion("it is a page of HTML")
    if not body.strip():
        raise NoCompletion("it is empty")
    try:
        value = parse_strict(body)
    except ValueError as error:
        raise NoCompletion(f"as JSON it is wrong: {error}") from None
    if not isinstance(value, dict):
        raise NoCompletion("it is no JSON object")
    choices = value.get("choices")
    if (wrong := error_in(value)) is not None:
        return _of_error(wrong, "it")
    if not choices and (why := blocked_for(value)):
        return Completion(None, refusal=f"filtered by the server: {_word(why)}")
    if "choices" in value and not choices:
        raise BrokenOff("it holds no choices")
    if not isinstance(choices, list):
        raise NoCompletion("it holds no choices")
    if len(choices) > 1:
        raise NoCompletion(f"it holds {len(choices)} choices where one was asked for")
    choice = choices[0]
    message = choice.get("message") if isinstance(choice, dict) else None
    if not isinstance(message, dict):
        raise NoCompletion("its choice holds no message")
    if (wrong := error_beside(choice, message)) is not None:
        return _of_error(wrong, "its choice")
    end = worst_end(choice, message, value)
    if end.ending is Ending.BROKEN:
        raise BrokenOff(f"the server broke the answer off ({_word(end.text)})")
    content = _content(message)
    if content.text is not None and not _is_unicode(content.text):
        raise NoCompletion("its text holds half of a surrogate pair, which is no character")
    refusal = content.refusal
    if end.ending is Ending.FILTERED:
        refusal = refusal or f"filtered by the server ({_word(end.text)})"
    apart = [message.get(key) for key in ("reasoning_content", "reasoning", "thinking")]
    reasoning = [_sound(one) for one in apart if isinstance(one, str) and one][:1]
    return Completion(
        text=content.text,
        parts=content.parts,
        left_out=content.left_out,
        reasoning="\n".join([*reasoning, *content.reasoning]),
        refusal=refusal,
        finish_reason=_word(end.reason),
        model=_word(value.get("model")),
        system_fingerprint=_word(value.get("system_fingerprint")),
        usage=_usage(value.get("usage")),
    )


def _of_error(error: Any, holder: str) -> Completion:
    """Return the refusal of a filter.

    Raises:
        BrokenOff: the error is another one.
    """
    text = _sound(error_text(error))
    if is_filtered(error):
        return Completion(None, refusal=f"filtered by the server: {text}")
    raise BrokenOff(f"{holder} says: {text}")


@dataclass(frozen=True)
class _Content:
    """A message's content, with its parts sorted."""

    text: str | None
    parts: int = 0
    reasoning: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    refusal: str | None = None


_OF_REASONING = frozenset(
    {"thinking", "reasoning", "reasoning_text", "redacted_thinking", "thought", "thoughts", "think"}
    | {"reasoning_content", "analysis"}
)
_OF_TEXT = frozenset({"text", "output_text"})
# Keys by which a part or message of kind text says that it is reasoning.
_REASONING_FLAGS = frozenset({"thought", "thinking", "reasoning"})
_CHANNELS = ("channel", "phase")
_CHANNELS_OF_REASONING = _OF_REASONING | {"commentary"}


def _content(message: Mapping[str, Any]) -> _Content:
    """Sort a message's content into text, reasoning and refusal.

    Raises:
        NoCompletion: it is no text, or holds a part that is neither where no part is a text.
    """
    content = message.get("content")
    refusal = message.get("refusal")
    refused = refusal if isinstance(refusal, str) and refusal else None
    if isinstance(content, str) and _is_reasoning(message):
        content = [{"type": "reasoning", "text": content}]
    if content is None or isinstance(content, str):
        return _Content(content, refusal=_sound(refused) if refused else None)
    if isinstance(content, dict):
        content = [content]
    if not isinstance(content, list):
        raise NoCompletion("its content is no text")
    texts: list[str] = []
    reasoning: list[str] = []
    others: list[str] = []
    for element in content:
        part = {"text": element} if isinstance(element, str) else element
        kind = _kind(part)
        if kind == "refusal" and isinstance(part.get("refusal"), str):
            refused = refused or part["refusal"] or None
        elif kind in _OF_TEXT and isinstance(part.get("text"), str):
            texts.append(part["text"])
        elif kind.partition(".")[0] in _OF_REASONING:
            reasoning.append(_sound(_text_within(part)))
        else:
            others.append(_sound(kind[:_WORD]) or "without a type")
    if others and not texts:
        raise NoCompletion("its content holds a part that is no text")
    return _Content(
        "".join(texts) if texts else None,
        len(content),
        tuple(reasoning),
        tuple(dict.fromkeys(others)),
        _sound(refused) if refused else None,
    )


def _kind(part: Any) -> str:
    """Return the kind of a part of a content; one that holds a text and says no kind is a text."""
    if not isinstance(part, dict):
        return ""
    if _is_reasoning(part):
        return "thought"
    kind = part.get("type", "text" if isinstance(part.get("text"), str) else "")
    return kind if isinstance(kind, str) else ""


def _is_reasoning(holder: Mapping[str, Any]) -> bool:
    """Tell whether a part or message says by a flag or channel that it is reasoning."""
    metadata = holder.get("metadata")
    for place in (holder, metadata if isinstance(metadata, dict) else {}):
        flags = (key for key, value in place.items() if value is True)
        if any(_plain_flag(key) in _REASONING_FLAGS for key in flags):
            return True
        channels = (place.get(key) for key in _CHANNELS)
        if any(isinstance(one, str) and one.lower() in _CHANNELS_OF_REASONING for one in channels):
            return True
    return False


def _plain_flag(key: str) -> str:
    """Return a flag's name in lower case, without "is"."""
    return key.lower().replace("_", "").removeprefix("is")


def _text_within(part: Mapping[str, Any]) -> str:
    """Return the text of a part of reasoning, plain or again in parts."""
    for key in (*sorted(_OF_REASONING), "text", "summary", "content"):
        value = part.get(key)
        if isinstance(value, str):
            return value
        if isinstance(value, list):
            texts = [one.get("text") for one in value if isinstance(one, dict)]
            return "\n".join(text for text in texts if isinstance(text, str))
    return ""


def _usage(value: Any) -> dict[str, int] | None:
    if not isinstance(value, dict):
        return None
    token_counts = {
        key: value[key]
        for key in _TOKENS
        if isinstance(value.get(key), int) and not isinstance(value[key], bool)
    }
    return token_counts or None


def _word(value: Any) -> str | None:
    return _sound(value[:_WORD]) if isinstance(value, str) else None


def _sound(text: str) -> str:
    """Return the text with what is no character as a question mark."""
    return text.encode("utf-8", "replace").decode()


def _is_unicode(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True
