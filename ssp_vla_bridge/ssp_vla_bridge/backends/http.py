"""The backend ``http``: options of a model behind an HTTP service (http_service.py asks it)."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

from ssp_core.errors import InputError
from ssp_vla_bridge.backends.http_line import Line
from ssp_vla_bridge.backends.http_service import HttpService, Patience
from ssp_vla_bridge.core.backend import check_options
from ssp_vla_bridge.core.interfaces import find_interface

_SHORTEST_KEY = 8

OPTIONS: dict[str, type] = {
    "url": str,
    "interface": str,
    "timeout_s": float,
    "start_s": float,
    "api_key_env": str,
    "max_mb": float,
    "tries": int,
}


def make(options: Mapping[str, Any]) -> HttpService:
    """A model behind HTTP, for the options in OPTIONS; waits for it at most ``start_s``.

    Raises:
        InputError: the options are wrong.
    """
    return make_service("http", options)


def make_service(
    name: str,
    options: Mapping[str, Any],
    interface: str = "waypoints",
    defaults: Mapping[str, Any] | None = None,
) -> HttpService:
    """As make, with another name, interface and defaults.

    Raises:
        InputError: the options are wrong.
    """
    check_options(name, options, OPTIONS)
    chosen = {**(defaults or {}), **options}
    if "url" not in chosen:
        raise InputError(
            "is missing",
            field="backend_options.url",
            remedy="give the service's address, such as http://127.0.0.1:8300",
        )
    patience = Patience(
        timeout_s=_within(chosen, "timeout_s", Patience.timeout_s, 0.001, 86400.0),
        start_s=_within(chosen, "start_s", Patience.start_s, 0.0, 86400.0),
        tries=int(_within(chosen, "tries", Patience.tries, 1, 100)),
    )
    max_mb = _within(chosen, "max_mb", 16.0, 0.001, 1024.0)
    key_name = str(chosen.get("api_key_env", ""))
    key = _key(key_name) if "api_key_env" in chosen else None
    headers = {} if key is None else {"Authorization": f"Bearer {key}"}
    line = Line(str(chosen["url"]), headers, round(max_mb * (1 << 20)))
    spoken = find_interface(str(chosen.get("interface", interface))).name
    service = HttpService(line, spoken, patience, key, key_name)
    service.wait_ready()
    return service


def _within(
    options: Mapping[str, Any], key: str, default: float, least: float, most: float
) -> float:
    value = options.get(key, default)
    if not least <= value <= most:
        raise InputError(
            f"must lie in [{least:g}, {most:g}]", field=f"backend_options.{key}", value=value
        )
    return float(value)


def _key(name: str) -> str:
    """The key in an environment variable; no message shows it."""
    key = os.environ.get(name, "") if name and "\0" not in name else ""
    field = "backend_options.api_key_env"
    if not key:
        raise InputError(
            "names an environment variable that isn't set or is empty",
            field=field,
            value=name if len(name) < 40 else None,
            remedy="export the key under that name; a key itself is never an option",
        )
    if len(key) < _SHORTEST_KEY or not key.isascii() or not key.isprintable() or " " in key:
        raise InputError(
            f"the variable {name} holds no key: at least {_SHORTEST_KEY} printable characters "
            "without spaces",
            field=field,
        )
    return key
