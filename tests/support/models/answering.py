"""Ways to models in this process that remember what they were asked, and answer as a test says."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from ssp_eval.evaluate.clients.model_client import InProcessClients, ModelClient
from ssp_eval.evaluate.clients.model_replies import IgnoredAnswers, ModelReply
from ssp_eval.evaluate.clients.models import ModelSpec
from ssp_vla_bridge.messages import Request

Reply = Callable[[int, Request], ModelReply]


class Answering:
    """All models of a campaign.

    Args:
        reply: to the n-th request, from 0; None: what the model's own backend says.
    """

    ignored = IgnoredAnswers()

    def __init__(self, reply: Reply | None = None) -> None:
        self.reply, self.requests = reply, list[Request]()

    @property
    def count(self) -> int:
        return len(self.requests)

    def client(self, model: ModelSpec, options: Mapping[str, Any]) -> ModelClient:
        if self.reply is None:
            self.inner = InProcessClients().client(model, options)
        return self

    def ask(self, request: Request) -> ModelReply:
        self.requests.append(request)
        if self.reply is None:
            return self.inner.ask(request)
        return self.reply(self.count - 1, request)
