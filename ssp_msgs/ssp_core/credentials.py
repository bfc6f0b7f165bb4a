"""API keys and page tokens: checked where they are read, and kept out of texts and files."""

from __future__ import annotations

import html
import json
import re
from urllib.parse import quote, urlsplit

from ssp_core.errors import InputError

_SHOWN = "[key]"
_PART = 8  # so many characters of a key in a row are taken for a piece of it
# An ASCII character as JSON may also write it; some encoders write "+" and "&" so.
_ESCAPED = re.compile(rb"\\u00([2-7][0-9a-fA-F])")
_PLACEHOLDER = 8  # a shorter key is a word such as "none" or "EMPTY" and no secret


def redact(text: str, key: str | None) -> str:
    """Return the text with every occurrence of the key, and of a longer piece of it, replaced.

    A piece is 8 characters in a row, as a message may have been cut within the key. The key is
    also found as JSON, HTML and a URL would write it.

    Args:
        text: that may quote the key, such as a server's error.
        key: None or empty: there is none.
    """
    if not key:
        return text
    hidden = bytearray(len(text))
    for form in _forms(key):
        size = min(_PART, len(form))
        for part in {form[i : i + size] for i in range(len(form) - size + 1)}:
            at = text.find(part)
            while at >= 0:
                hidden[at : at + size] = b"\1" * size
                at = text.find(part, at + 1)
    pieces = []
    for i, character in enumerate(text):
        if not hidden[i]:
            pieces.append(character)
        elif not i or not hidden[i - 1]:
            pieces.append(_SHOWN)
    return "".join(pieces)


def gives_away(body: bytes, key: str | None) -> bool:
    """Tell whether a reply holds the whole key; a placeholder such as "none" is no secret."""
    if not key or len(key) < _PLACEHOLDER:
        return False
    plain = _ESCAPED.sub(lambda match: bytes([int(match[1], 16)]), body)
    return any(form.encode() in text for form in _forms(key) for text in (body, plain))


def is_http_address(url: str) -> bool:
    """Tell whether a request over HTTP can go to an address: scheme, host, and a port or none."""
    try:
        parts = urlsplit(url)
        return parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        return False


def without_userinfo(url: str) -> str:
    """Return an address without the name and password that may stand in it."""
    try:
        parts = urlsplit(url)
        return parts._replace(netloc=parts.netloc.rpartition("@")[2]).geturl()
    except ValueError:
        return "the address"


def check_key(variable: str, key: str | None, remedy: str) -> str:
    """Return the key that an environment variable holds.

    Args:
        variable: name of the environment variable, for the error.
        key: its value, None: there is no such variable.
        remedy: what the user may do instead of exporting the key, for the error.

    Raises:
        InputError: there is no key, or one that no header can carry.
    """
    if key is None or not key.strip():
        raise InputError(
            f"the environment has no {variable}, or it is empty", remedy=f"export it, or {remedy}"
        )
    key = key.strip()
    if not all("!" <= character <= "~" for character in key):
        raise InputError(
            f"the key in the environment's {variable} holds a blank, a control character or one "
            "outside ASCII, which no request can carry",
            remedy="export the key alone",
        )
    return key


def _forms(key: str) -> set[str]:
    as_json = json.dumps(key)[1:-1]
    return {key, as_json, as_json.replace("/", "\\/"), html.escape(key), quote(key, safe="")}


# A token on a command line could be read by every user of the machine.
TOKEN_VARIABLE = "SSP_PAGE_TOKEN"
LEAST_TOKEN = 16


def check_token(token: str, field: str) -> str:
    """Return the token as it is, when it can be one.

    Raises:
        InputError: it is too short, or has characters that no header carries.
    """
    if len(token) < LEAST_TOKEN or not token.isascii() or not token.isprintable() or " " in token:
        raise InputError(
            f"must have {LEAST_TOKEN} printable ASCII characters at least, and no space",
            field=field,
            remedy="leave it out, and one is made",
        )
    return token
