"""The empty control: no text and no trajectory, whatever is asked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ssp_vla_bridge.core.backend import check_options
from ssp_vla_bridge.core.request import Request
from ssp_vla_bridge.core.response import Answer


class Silent:
    """Must score 0 in every metric that isn't null."""

    model_id = "ssp/silent/1"

    def answer(self, request: Request) -> Answer:
        return Answer("")


def make(options: Mapping[str, Any]) -> Silent:
    """Raises InputError: it has no options."""
    check_options("silent", options, {})
    return Silent()
