"""The seam to the models: who answers a request, over topics or in this process."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Protocol

from ssp_core.errors import InputError
from ssp_eval.evaluate.model_spec import ModelSpec
from ssp_vla_bridge.backend import Backend, make_backend, respond
from ssp_vla_bridge.messages import ErrorCode, Request, Response

# A reason for people is a line, whatever a bridge writes into its error message.
MOST_REASON = 400


class Loss(StrEnum):
    """Why a label time has no record, in the words of tables and reports."""

    DIED = "bridge died"
    UNREACHABLE = "bridge unreachable"
    SILENT = "no answer in time"
    OVERLOAD = "bridge overloaded"
    UNUSABLE = "unusable answer"
    ERROR = "bridge answered an error"
    NO_QUESTION = "nothing to ask"


# What the same question may get an answer after. A bridge keeps no state between requests, so
# asking again is safe; where the answer would be the same error again, it is useless.
PASSING = frozenset({Loss.DIED, Loss.UNREACHABLE, Loss.SILENT, Loss.OVERLOAD})
_OF_CODE = {ErrorCode.TIMEOUT: Loss.SILENT, ErrorCode.OVERLOAD: Loss.OVERLOAD}


def loss_of(response: Response) -> tuple[Loss | None, str]:
    """Why a response makes no record, and the same for people; (None, "") where it makes one."""
    code = response.error_code
    if not code:
        return None, ""
    known = code in set(ErrorCode)
    loss = _OF_CODE.get(ErrorCode(code), Loss.ERROR) if known else Loss.ERROR
    return loss, f"the bridge answered error {code}: {response.error_msg[:MOST_REASON]}"


@dataclass(frozen=True)
class Reply:
    """What came of one request: a response (which may hold an error), or why there is none.

    Args:
        response: None where none came or it can't be used.
        reason: why there is none, for people.
        loss: the kind of that reason; it counts only where there is no response.
    """

    response: Response | None
    reason: str = ""
    loss: Loss = Loss.UNUSABLE


@dataclass
class Ignored:
    """Answers that came and weren't used."""

    late: int = 0
    duplicate: int = 0
    unknown: int = 0

    def to_json(self) -> dict[str, int]:
        return {"late": self.late, "duplicate": self.duplicate, "unknown": self.unknown}


class Asker(Protocol):
    """Answers the requests of one cell, one at a time."""

    @property
    def ignored(self) -> Ignored:
        """Answers that came and weren't used."""

    def ask(self, request: Request) -> Reply:
        """The reply; a model that fails costs this reply and raises nothing."""


class Askers(Protocol):
    """Gives the asker of a cell, starting what has to be started."""

    def asker(self, model: ModelSpec, options: Mapping[str, Any]) -> Asker:
        """Raises PeerError: the model's bridge doesn't start or can't be reached."""


class DirectAsker:
    """A backend in this process, without ROS."""

    def __init__(self, name: str, backend: Backend) -> None:
        self._name = name
        self._backend = backend

    @property
    def ignored(self) -> Ignored:
        """A call has one result: nothing comes late or twice."""
        return Ignored()

    def ask(self, request: Request) -> Reply:
        return Reply(respond(self._backend, self._name, request).response)


class DirectAskers:
    """All models in this process; attached ones can't be reached from here."""

    def asker(self, model: ModelSpec, options: Mapping[str, Any]) -> Asker:
        if model.attached:
            raise InputError(
                "an attached bridge is reached over topics only", field="attach", value=model.name
            )
        return DirectAsker(model.name, make_backend(model.backend_name, options))


class WithAnswerers:
    """The way to the models, and in this process the answerers that a campaign adds to them.

    They say the same wherever they are, so that no process is started for them, least of all in a
    ROS domain that isn't ours.

    Args:
        models: the way to all others.
    """

    def __init__(self, models: Askers) -> None:
        self._models, self._ours = models, DirectAskers()

    def asker(self, model: ModelSpec, options: Mapping[str, Any]) -> Asker:
        """The asker of a model; see Askers."""
        return (self._ours if model.answerer else self._models).asker(model, options)
