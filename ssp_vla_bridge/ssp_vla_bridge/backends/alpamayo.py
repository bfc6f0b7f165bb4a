"""Alpamayo behind its sidecar (sidecars/alpamayo_sidecar.py), which runs in the model's Python."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ssp_vla_bridge.backends.http import make_service
from ssp_vla_bridge.backends.http_service import HttpService

DEFAULTS = {"url": "http://127.0.0.1:8301", "timeout_s": 120.0}


def make(options: Mapping[str, Any]) -> HttpService:
    """The backend ``http`` with Alpamayo's interface, its sidecar's port and its patience.

    Raises:
        InputError: the options are wrong.
    """
    return make_service("alpamayo", options, "alpamayo", DEFAULTS)
