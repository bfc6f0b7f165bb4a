"""Errors of chat services: where a reply holds one, what it says, and whether a filter refused."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from ssp_core.files.strict_json import parse_strict

LOOKED_AT = 4096  # characters of what a server says
PASSING = frozenset({408, 409, 425, 429})
_SHOWN = 200
_DEPTH = 4  # an error within an error, as gateways send on what they got
_CODES = ("code", "type", "status", "status_code", "error_code", "http_status")
_MESSAGES = ("message", "msg", "detail", "error_msg", "status_msg")
_WITHIN = ("error", "errors", "innererror", "detail", "metadata", "raw")
# Names of refusals by a filter, among them those that services quote in messages.
_NAMED = (
    r"content_?filter|content_?policy|responsibleaipolicyviolation|data_?inspection_?failed"
    r"|prohibited_?content|inappropriate[ _]?content|sensitive (?:content|words?)"
    r"|敏感(?:内容|词|信息)"
)
_CODE = re.compile(rf"{_NAMED}|content_?moderation|moderation|safety_?system|usage_?polic", re.I)
_CODE_OF_SERVICE = re.compile(
    r"service|unavailable|limit|quota|timeout|(?<!violation)_error$", re.I
)
_REFUSED = (
    r"(?:flag(?:ged|s)|block(?:ed|s)|filtered|reject(?:ed|s)|refused|disallowed|prohibited"
    r"|den(?:ied|ies)|violat\w+|trigger\w+|against|breach\w*|not allowed"
    r"|(?:not|n[o'’]t) (?:pass|comply|meet))"
)
_POLICY = (
    r"(?:content management polic|content (?:filter|polic|moderation)"
    r"|safety (?:system|filter|polic)|usage polic|moderation|guardrail)"
)
_MESSAGE = re.compile(
    rf"{_NAMED}|flagged (?:as|by|for)"
    rf"|\b{_REFUSED}\b[^.;\n]{{0,120}}\b{_POLICY}|\b{_POLICY}[^.;\n]{{0,120}}\b{_REFUSED}\b",
    re.I,
)
# What goes by: the service, not the request, is in the way.
_PASSES = re.compile(
    r"unavailable|time[ds]?[ -]?out|quota|rate[ _-]?limit|overload|temporar|connection"
    r"|(?:try|retry)(?: it)?(?: again)? later|too many requests|maintenance|out of memory"
    r"|internal (?:server )?error",
    re.I,
)


@dataclass(frozen=True)
class _ErrorTexts:
    """Codes, as text, and messages of an error with those that it passes on."""

    codes: tuple[str, ...]
    messages: tuple[str, ...]


def error_in(reply: Mapping[str, Any]) -> Any:
    """Find the error of a reply with status 200, as servers name it; None: there is none.

    Errors that stand beside choices count; a message or a detail does where there are none.
    """
    if (error := _own_error(reply)) is not None:
        return error
    status = reply.get("base_resp")
    if isinstance(status, dict) and status.get("status_code"):
        return {"message": status.get("status_msg"), "code": status["status_code"]}
    if reply.get("error_code") not in (None, 0, "0", "") and reply.get("error_msg"):
        return {"message": reply["error_msg"], "code": reply["error_code"]}
    texts = [reply.get("detail"), reply.get("message")]
    if reply.get("choices") or not any(one and not isinstance(one, dict) for one in texts):
        return None
    return {key: reply[key] for key in (*_CODES, *_MESSAGES) if key in reply}


def error_beside(choice: Mapping[str, Any], message: Mapping[str, Any]) -> Any:
    """Find the error of a choice or of its message; None: there is none."""
    error = _own_error(choice)
    return _own_error(message) if error is None else error


def _own_error(holder: Mapping[str, Any]) -> Any:
    """Find what stands under ``error`` or ``errors``; None where that is empty."""
    for key in ("error", "errors"):
        error = holder.get(key)
        inside = error.values() if isinstance(error, dict) else error
        if any(inside) if isinstance(inside, Iterable) else error:
            codes = {name: holder[name] for name in ("code", "status_code") if name in holder}
            return {**codes, key: error} if codes else error
    return None


def is_filtered(error: Any, status: int = 200) -> bool:
    """Tell whether an error says that a filter refused this request or its answer.

    Its codes and messages count and no other keys. What passes is no refusal: a status of 408, 409,
    425, 429 or 5xx, as the code of the error or of the reply, and a service that is away or busy.

    Args:
        error: as it stands in the reply, or its text.
        status: of the reply.
    """
    texts = _read(error)
    numbers = {int(code) for code in texts.codes if code.isascii() and code.isdigit()} | {status}
    if any(number in PASSING or 500 <= number <= 599 for number in numbers):
        return False
    text = "\n".join(texts.messages)[:LOOKED_AT]
    if _PASSES.search(text):
        return False
    filter_codes = (code for code in texts.codes if _CODE.search(code))
    return any(not _CODE_OF_SERVICE.search(code) for code in filter_codes) or bool(
        _MESSAGE.search(text)
    )


def error_text(error: Any) -> str:
    """Return what an error says, on one line; its code where it holds no message."""
    texts = _read(error)
    text = next((one for one in (*texts.messages, *texts.codes) if one.strip()), str(error))
    return " ".join(text.split())[:_SHOWN]


def _read(error: Any) -> _ErrorTexts:
    texts = list(_walk(error, _DEPTH))
    codes = tuple(text[:_SHOWN] for is_code, text in texts if is_code)
    return _ErrorTexts(codes, tuple(text for is_code, text in texts if not is_code))


def _walk(error: Any, depth: int) -> Iterator[tuple[bool, str]]:
    """Yield codes (True) and messages (False) of an error and of those within it."""
    if isinstance(error, str):
        within = _parsed(error)
        if within is None or not depth:
            yield False, error
        else:
            yield from _walk(within, depth - 1)
    elif isinstance(error, list) and depth:
        for one in error[:_DEPTH]:
            yield from _walk(one, depth - 1)
    elif isinstance(error, dict):
        for key in _CODES:
            code = error.get(key)
            if isinstance(code, str | int) and not isinstance(code, bool):
                yield True, str(code)
        for key in _MESSAGES:
            if isinstance(error.get(key), str):
                yield from _walk(error[key], depth and depth - 1)
        for key in _WITHIN if depth else ():
            within = error.get(key)
            if isinstance(within, dict | list) or (key in ("error", "raw") and within):
                yield from _walk(within, depth - 1)


def _parsed(text: str) -> Any:
    """Return the value that a message holds as JSON; None where it is a message."""
    if not text.lstrip().startswith(("{", "[")):
        return None
    try:
        return parse_strict(text)
    except ValueError:
        return None


def looks_like_html(body: bytes) -> bool:
    """Tell whether a page came where JSON was expected."""
    start = body[:1024].lstrip(b"\xef\xbb\xbf \t\r\n").lower()
    return start.startswith((b"<!doctype", b"<html", b"<?xml", b"<head", b"<body", b"<!--"))
