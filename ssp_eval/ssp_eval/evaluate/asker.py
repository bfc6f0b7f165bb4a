"""The seam to the models: who answers a request, over topics or in this process."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Protocol

from ssp_core.errors import InputError
from ssp_eval.evaluate.controls import CLIP_START_NS, CONTROLS, LABELS_FILE
from ssp_vla_bridge.core.backend import (
    BACKENDS,
    Backend,
    check_options,
    make_backend,
    parse_options,
    respond,
)
from ssp_vla_bridge.core.request import Request
from ssp_vla_bridge.core.response import Response


@dataclass(frozen=True)
class ModelSpec:
    """One model of a campaign.

    Args:
        name: on the topics and in the results.
        options: of its backend; placeholders stand for what differs from cell to cell.
        attached: its bridge runs already, and isn't ours to start or stop.
    """

    name: str
    options: Mapping[str, Any] = field(default_factory=dict)
    attached: bool = False

    def options_for(self, labels_file: str, clip_start_ns: int) -> dict[str, Any]:
        """The backend's options for one cell."""
        filled = {LABELS_FILE: labels_file, CLIP_START_NS: clip_start_ns}
        return {
            key: filled.get(value, value) if isinstance(value, str) else value
            for key, value in self.options.items()
        }

    def key_options(self, labels_sha256: str) -> dict[str, Any]:
        """The options as far as an answer depends on them: content instead of places."""
        filled = {LABELS_FILE: labels_sha256}
        return {
            key: filled.get(value, value) if isinstance(value, str) else value
            for key, value in self.options.items()
        }


def bridge_spec(text: str) -> ModelSpec:
    """The model of ``NAME`` or ``NAME={"option": value}``.

    Raises:
        InputError: the options are no JSON object.
    """
    name, _, options = text.partition("=")
    return ModelSpec(name, {**CONTROLS.get(name, {}), **parse_options(options)})


def check_bridge(model: ModelSpec) -> None:
    """Refuses a bridge that can't be started here, before anything is asked.

    Raises:
        InputError: no backend has that name, or its options are wrong.
    """
    if model.name not in BACKENDS:
        raise InputError(
            "no such bridge",
            field="bridge",
            value=model.name,
            remedy=f"known are {', '.join(sorted(BACKENDS))}; one of your own is started by "
            "itself and named with --attach",
        )
    filled = ModelSpec(model.name, CONTROLS.get(model.name, {})).options_for("", 0)
    if filled:
        # What only the cell knows isn't there yet; names and types can be checked without it.
        known = {key: type(value) for key, value in filled.items()}
        check_options(model.name, model.options_for("", 0), known)
    else:
        make_backend(model.name, model.options)


class Loss(StrEnum):
    """Why a label time has no record, in the words of tables and reports."""

    DIED = "bridge died"
    UNREACHABLE = "bridge unreachable"
    SILENT = "no answer in time"
    UNUSABLE = "unusable answer"
    ERROR = "bridge answered an error"
    NO_QUESTION = "nothing to ask"


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
        return DirectAsker(model.name, make_backend(model.name, options))
