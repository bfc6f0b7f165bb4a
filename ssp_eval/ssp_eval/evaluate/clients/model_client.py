"""The way to a model: its interface, and models in this process."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from ssp_core.errors import InputError
from ssp_eval.evaluate.clients.model_replies import IgnoredAnswers, ModelReply
from ssp_eval.evaluate.clients.models import ModelSpec
from ssp_vla_bridge.backend import Backend, make_backend, respond
from ssp_vla_bridge.messages import Request


class ModelClient(Protocol):
    """Answers the requests of one cell, one at a time."""

    @property
    def ignored(self) -> IgnoredAnswers:
        """Answers that came and weren't used."""

    def ask(self, request: Request) -> ModelReply:
        """Return the reply; a model that fails costs this reply and raises nothing."""


class ModelClients(Protocol):
    """Gives the client of a cell, starting what has to be started."""

    def client(self, model: ModelSpec, options: Mapping[str, Any]) -> ModelClient:
        """Return the client of a model.

        Raises:
            PeerError: the model's bridge doesn't start or can't be reached.
        """


class InProcessClient:
    """A backend in this process, without ROS."""

    def __init__(self, name: str, backend: Backend) -> None:
        self._name = name
        self._backend = backend

    @property
    def ignored(self) -> IgnoredAnswers:
        """A call has one result: nothing comes late or twice."""
        return IgnoredAnswers()

    def ask(self, request: Request) -> ModelReply:
        return ModelReply(respond(self._backend, self._name, request).response)


class InProcessClients:
    """All models in this process; attached ones can't be reached from here."""

    def client(self, model: ModelSpec, options: Mapping[str, Any]) -> ModelClient:
        if model.attached:
            raise InputError(
                "an attached bridge is reached over topics only",
                field="attach",
                value=model.name,
                remedy="leave attach out, and give the backend",
            )
        return InProcessClient(model.name, make_backend(model.backend_name, options))


class ClientsWithAnswerers:
    """The way to the models, and in this process the answerers that a campaign adds to them.

    They say the same wherever they are, so that no process is started for them, least of all in a
    ROS domain that isn't ours.
    """

    def __init__(self, models: ModelClients) -> None:
        self._models, self._ours = models, InProcessClients()

    def client(self, model: ModelSpec, options: Mapping[str, Any]) -> ModelClient:
        """Return the client of a model; see ModelClients."""
        return (self._ours if model.answerer else self._models).client(model, options)
