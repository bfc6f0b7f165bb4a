"""Keeps keys out of options: these are written into cells, logs and the process list."""

from __future__ import annotations

import re
from typing import Any

from ssp_core.errors import InputError

# By name: api_key, x-api-key, authorization, secret, hf_token; not max_tokens, not api_key_env.
_NAME = re.compile(
    r"(?:.*_)?(?:api_?key|secret|secret_key|password|passwd|authorization|credentials?|bearer)"
    r"|(?:(?:api|access|auth|bearer|secret|hf|service|refresh|id)_)?token|key"
)
# By value: what the vendors give out, an authorization header, a password in an address.
_VALUE = re.compile(
    r"\b(?:sk|pk|rk|hf|gsk|xai|ghp|AIza)[-_]?[A-Za-z0-9_-]{20,}|\b[Bb]earer\s+\S{8,}|://[^/\s@]+:[^/\s@]+@"
)
_REMEDY = "put it into an environment variable and name that with the option api_key_env"


def refuse_secrets(value: Any, file: str | None = None, field: str = "") -> None:
    """Refuses what is or looks like a key, wherever it stands; the message doesn't repeat it.

    Args:
        value: options, or a whole models file, as parsed.
        file: for the message.
        field: path of the value.

    Raises:
        InputError: with the field, and where a key may stand instead.
    """
    if isinstance(value, dict):
        for key, inner in value.items():
            place = f"{field}.{key}" if field else str(key)
            name = str(key).lower().replace("-", "_")
            if _NAME.fullmatch(name) and inner is not None and not isinstance(inner, dict | bool):
                raise InputError("is a secret's place", file=file, field=place, remedy=_REMEDY)
            refuse_secrets(inner, file, place)
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            refuse_secrets(inner, file, f"{field}[{index}]")
    elif isinstance(value, str) and _VALUE.search(value):
        raise InputError("looks like a secret", file=file, field=field or None, remedy=_REMEDY)
