"""The options of the backend ``openai``, checked before anything is asked."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

from ssp_core.credentials import check_key, gives_away, is_http_address
from ssp_core.errors import InputError
from ssp_core.hashing import canonical_json
from ssp_vla_bridge.core.backend import check_options
from ssp_vla_bridge.core.prompts import find_stages

_TYPES: dict[str, type] = {
    "base_url": str, "model": str, "api_key_env": str, "interface": str, "temperature": float,
    "seed": int, "top_p": float, "presence_penalty": float, "frequency_penalty": float,
    "max_tokens": int, "timeout_s": float, "tries": int, "image_width": int, "extra": dict,
}  # fmt: skip
# What each may be; null leaves a parameter of the request out, for servers that refuse it.
_DECODING: dict[str, tuple[float | None, float, float]] = {
    "temperature": (0.0, 0.0, 2.0),
    "seed": (0, -(2**63), 2**63 - 1),
    "top_p": (1.0, 0.0, 1.0),
    "presence_penalty": (0.0, -2.0, 2.0),
    "frequency_penalty": (0.0, -2.0, 2.0),
    "max_tokens": (1024, 1, 1 << 20),
}
_OURS = frozenset({"model", "messages", "stream", "n", *_DECODING})


@dataclass(frozen=True)
class Options:
    """What to ask whom, and how.

    Args:
        base_url: up to and with ``/v1``.
        model: as the server names it.
        interface: whose prompts are used.
        decoding: parameters of every request, in the words of the interface; those that are None
            are not sent.
        timeout_s: for a whole answer with all its stages and tries.
        tries: of one stage.
        image_width_px: wider frames are scaled down to this; None: frames are sent as they are.
        extra: further parameters of every request.
        api_key_env: name of the variable with the key, empty: the server wants none.
        key: the key; it is never shown.
    """

    base_url: str
    model: str
    interface: str
    decoding: Mapping[str, float | None]
    timeout_s: float = 60.0
    tries: int = 3
    image_width_px: int | None = None
    extra: Mapping[str, Any] = field(default_factory=dict)
    api_key_env: str = ""
    key: str | None = field(default=None, repr=False)

    @property
    def parameters(self) -> dict[str, Any]:
        """What goes into every request besides model and messages."""
        sent = {name: value for name, value in self.decoding.items() if value is not None}
        return {**sent, "stream": False, **self.extra}


def read_options(given: Mapping[str, Any], environ: Mapping[str, str] = os.environ) -> Options:
    """The options, with the key from the environment.

    Raises:
        InputError: one is missing, unknown or wrong, or the variable holds no key.
    """
    # A null is a parameter that isn't sent; of other options it is what leaving them out is.
    check_options("openai", {k: v for k, v in given.items() if v is not None}, _TYPES)
    check_options("openai", dict.fromkeys(given.keys() - _TYPES.keys()), _TYPES)
    for name in ("base_url", "model"):
        if not str(given.get(name) or "").strip():
            raise InputError(
                "is missing",
                field=f"backend_options.{name}",
                remedy='give such as {"base_url": "http://localhost:8000/v1", "model": "NAME"}',
            )
    interface = given.get("interface") or "openemma"
    find_stages(interface)
    extra = given.get("extra") or {}
    try:
        shown = canonical_json([given["model"], extra])
    except (ValueError, TypeError) as error:
        raise InputError(
            f"is no JSON ({error})", field="backend_options.extra", value=extra
        ) from error
    for name in sorted(_OURS & extra.keys()):
        remedy = "it is set by the bridge"
        if name in _TYPES:
            remedy = "it is an option of its own"
        raise InputError("is no extra parameter", field=f"backend_options.extra.{name}",
                         remedy=remedy)  # fmt: skip
    variable = given.get("api_key_env") or ""
    key = None
    if variable:
        remedy = "leave api_key_env out where the server wants no key"
        key = check_key(variable, environ.get(variable), remedy)
        if gives_away(shown, key):
            raise InputError(
                "the key stands in model or extra, which are recorded",
                field="backend_options",
                remedy="leave the key to the environment",
            )
    return Options(
        base_url=_address(given["base_url"]),
        model=given["model"],
        interface=interface,
        decoding={name: _decoding(given, name) for name in _DECODING},
        timeout_s=_within(given, "timeout_s", 60.0, 0.001, 86400.0),
        tries=int(_within(given, "tries", 3, 1, 20)),
        image_width_px=_width(given),
        extra=dict(extra),
        api_key_env=variable,
        key=key,
    )


def _decoding(given: Mapping[str, Any], name: str) -> float | None:
    default, low, high = _DECODING[name]
    if name in given and given[name] is None:
        return None
    return _within(given, name, default or 0, low, high)


def _width(given: Mapping[str, Any]) -> int | None:
    if given.get("image_width") is None:
        return None
    return int(_within(given, "image_width", 0, 16, 8192))


def _within(given: Mapping[str, Any], name: str, default: float, low: float, high: float) -> float:
    value = given.get(name)
    number: float = default if value is None else value
    if not (math.isfinite(number) and low <= number <= high):
        raise InputError(
            f"must lie in [{low:g}, {high:g}]", field=f"backend_options.{name}", value=number
        )
    return number


def _address(url: str) -> str:
    try:
        parts = urlsplit(url)
        clean = not (parts.username or parts.password or parts.query or parts.fragment)
    except ValueError:
        clean = True
    if not clean:
        raise InputError(
            "holds a name, a password, a query or a fragment",  # which is not shown: it is a secret
            field="backend_options.base_url",
            remedy="name the environment variable that holds a key with api_key_env",
        )
    if not is_http_address(url):
        raise InputError(
            "is no address",
            field="backend_options.base_url",
            value=url,
            remedy="give such as http://localhost:8000/v1",
        )
    return url
