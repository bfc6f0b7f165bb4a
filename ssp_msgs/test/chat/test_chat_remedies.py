"""The remedy of an error of a chat service is that of what its message names, not of its status."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from ssp_core.chat import transport
from ssp_core.chat.client import NoAnswer, OpenAIChat, Policy
from ssp_core.chat.completion import read_completion

BY_REMEDY = yaml.safe_load(Path(__file__).with_name("chat_messages.yaml").read_text())
REMEDIES = {kind: f"remedy {kind}" for kind in BY_REMEDY if kind}
MESSAGES = [(kind, *one) for kind, many in BY_REMEDY.items() for one in many]


@pytest.mark.parametrize(("remedy", "status", "message"), MESSAGES)
def test_the_message_decides(
    monkeypatch: pytest.MonkeyPatch, remedy: str, status: int, message: str
) -> None:
    body = json.dumps({"error": {"message": message}}).encode()
    monkeypatch.setattr(transport, "exchange", lambda *_: transport.RawReply(status, {}, body))
    chat = OpenAIChat("http://127.0.0.1:9/v1", "m", policy=Policy(tries=1), remedies=REMEDIES)
    with pytest.raises(NoAnswer) as told:
        chat.request([], {})
    assert str(told.value).partition("; remedy ")[2] == remedy
    assert told.value.filtered == (remedy == "filter")


def test_a_question_that_a_filter_blocked_is_declined_and_no_outage() -> None:
    blocked = {"promptFeedback": {"blockReason": "SAFETY"}, "choices": []}
    said = read_completion(json.dumps(blocked).encode())
    assert said.refusal == "filtered by the server: blockReason SAFETY"
