"""What stands in a chat completion, or why it is none."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ssp_core.chat import looks_like_html
from ssp_core.strict_json import parse_strict

_TOKENS = ("prompt_tokens", "completion_tokens", "total_tokens")
_WORD = 200  # characters of a name that a server reports


class NoCompletion(ValueError):
    """A reply is no chat completion; the message says why, as a clause."""


@dataclass(frozen=True)
class Completion:
    """What a server says in answer to one request.

    Args:
        text: of the model; None: the reply holds none.
        parts: number of parts that the text came in, 0 for plain text.
        reasoning: thoughts that the server keeps apart from the text, empty where it has none.
        refusal: why the model or the server declines, None: it doesn't.
        finish_reason: as reported.
        model: as reported.
        system_fingerprint: as reported.
        usage: reported numbers of tokens, by OpenAI's names.
    """

    text: str | None
    parts: int = 0
    reasoning: str = ""
    refusal: str | None = None
    finish_reason: str | None = None
    model: str | None = None
    system_fingerprint: str | None = None
    usage: Mapping[str, int] | None = None

    @property
    def cut_off(self) -> bool:
        """True where the answer ended at the limit of tokens."""
        return self.finish_reason == "length"


def read_completion(body: bytes) -> Completion:
    """Reads a reply; what it reports besides the text is taken where it has the right type.

    Raises:
        NoCompletion: it is no JSON, says an error, or holds not exactly one choice with a message.
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
    if not isinstance(choices, list) or not choices:
        said = _error_text(value.get("error"))
        raise NoCompletion(f"it says: {said}" if said else "it holds no choices")
    if len(choices) > 1:
        raise NoCompletion(f"it holds {len(choices)} choices where one was asked for")
    choice = choices[0]
    message = choice.get("message") if isinstance(choice, dict) else None
    if not isinstance(message, dict):
        raise NoCompletion("its choice holds no message")
    text, parts, refusal = _content(message)
    if text is not None and not _is_unicode(text):
        raise NoCompletion("its text holds half of a surrogate pair, which is no character")
    finish = _word(choice.get("finish_reason"))
    if finish == "content_filter":
        refusal = refusal or "filtered by the server"
    reasoning = message.get("reasoning_content") or message.get("reasoning")
    return Completion(
        text=text,
        parts=parts,
        reasoning=_sound(reasoning) if isinstance(reasoning, str) else "",
        refusal=refusal,
        finish_reason=finish,
        model=_word(value.get("model")),
        system_fingerprint=_word(value.get("system_fingerprint")),
        usage=_usage(value.get("usage")),
    )


def _content(message: Mapping[str, Any]) -> tuple[str | None, int, str | None]:
    """Text, number of parts, refusal."""
    content = message.get("content")
    refusal = message.get("refusal")
    refused = refusal if isinstance(refusal, str) and refusal else None
    if content is None or isinstance(content, str):
        return content, 0, _sound(refused) if refused else None
    if not isinstance(content, list):
        raise NoCompletion("its content is no text")
    texts = []
    for part in content:
        kind = part.get("type") if isinstance(part, dict) else None
        if kind == "refusal" and isinstance(part.get("refusal"), str):
            refused = refused or part["refusal"] or None
        elif kind == "text" and isinstance(part.get("text"), str):
            texts.append(part["text"])
        else:
            raise NoCompletion("its content holds a part that is no text")
    return "".join(texts) if texts else None, len(content), _sound(refused) if refused else None


def _usage(value: Any) -> dict[str, int] | None:
    if not isinstance(value, dict):
        return None
    found = {
        key: value[key]
        for key in _TOKENS
        if isinstance(value.get(key), int) and not isinstance(value[key], bool)
    }
    return found or None


def _word(value: Any) -> str | None:
    return _sound(value[:_WORD]) if isinstance(value, str) else None


def _sound(text: str) -> str:
    """The text with what is no character as a question mark."""
    return text.encode("utf-8", "replace").decode()


def _is_unicode(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def _error_text(error: Any) -> str:
    said = error.get("message") if isinstance(error, dict) else error
    return _sound(" ".join(said.split())[:_WORD]) if isinstance(said, str) else ""
