"""Fixtures of the tests of the backend ``openai``: a chat service, and the backend that asks it."""

from __future__ import annotations

from typing import Any

import pytest

from ssp_vla_bridge.backends.openai_chat import OpenAIBackend, read_options
from tests.support.models.chat_service import chat_service


@pytest.fixture
def service(monkeypatch):
    for name in ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
        monkeypatch.delenv(name.lower(), raising=False)
    for name in ("API_KEY", "ADMIN_KEY", "ORG_ID", "PROJECT_ID"):
        monkeypatch.setenv(f"OPENAI_{name}", "not-for-this-server")
    with chat_service() as found:
        yield found


@pytest.fixture
def waits():
    """The waits between tries, which are noted and not waited for."""
    return []


@pytest.fixture
def make_openai(service, waits):
    """The backend that asks the service; options of a test go before these."""

    def make(**options: Any) -> OpenAIBackend:
        given = {"base_url": service.url, "model": "seer-7b", "timeout_s": 60.0, **options}
        return OpenAIBackend(read_options(given), waits.append)

    return make
