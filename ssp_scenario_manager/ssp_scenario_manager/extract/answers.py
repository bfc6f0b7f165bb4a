"""An answer of the model: its text in a server's reply, its schema, and whether it keeps to it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, create_model

from ssp_core.chat.answer_text import split_answer
from ssp_core.chat.completion import BrokenOff, NoCompletion, read_completion
from ssp_core.errors import PeerError
from ssp_core.files.model_errors import field_path
from ssp_core.files.strict_json import parse_strict
from ssp_core.hashing import canonical_json
from ssp_core.names import VUT_ID
from ssp_scenario_manager.event_spec.model import UNRESOLVED
from ssp_scenario_manager.extract.questions import (
    CELL_PHASES,
    MAX_COUNT,
    MAX_TARGETS,
    NONE,
    Ask,
    Question,
)
from ssp_scenario_manager.scenarios.events.kinds import KINDS

MAX_TEXT = 300
_STRICT = ConfigDict(extra="forbid", strict=True)
_Share = Annotated[float, Field(ge=0, le=1)]
_MAX_PROBLEMS = 8


@dataclass(frozen=True)
class Scope:
    """The context that live vocabularies are made from.

    Args:
        frames: number of frames that the model is shown.
        targets: ids of the OTs found so far.
    """

    frames: int
    targets: tuple[str, ...] = ()


@dataclass(frozen=True)
class Finding:
    """One answered field.

    Args:
        value: a word, a list of words, {min, max} of a count, a frame's number, or for a cell the
            word of each of its fields.
        confidence: as the model gave it, in [0, 1].
        frames: numbers of the evidence frames, from 1, rising.
    """

    value: Any
    confidence: float
    frames: tuple[int, ...]


class BadAnswer(Exception):
    """An answer that can't be used; ``problems`` say why, each naming a field."""

    def __init__(self, problems: Sequence[str]) -> None:
        self.problems = tuple(problems)
        super().__init__("; ".join(problems))


def words_of(ask: Ask, scope: Scope) -> tuple[str, ...]:
    """Return the vocabulary of a field, live words first."""
    live: dict[str | None, tuple[str, ...]] = {
        None: (),
        "kinds": tuple(KINDS),
        "targets": scope.targets,
        "targets_or_none": (*scope.targets, NONE),
        "participants": (VUT_ID, *scope.targets),
    }
    return (*live[ask.live], *ask.words)


def answer_model(question: Question, scope: Scope) -> type[BaseModel]:
    """Make the model that an answer to a question must fit."""
    if question.layout == "list":
        words = {ask.key: (_value(ask, scope), ...) for ask in question.asks}
        item = _model(
            "item",
            {
                **words,
                "description": (Annotated[str, Field(min_length=1, max_length=MAX_TEXT)], ...),
                **_grounds(scope),
            },
        )
        return _model(question.key, {"items": (_list_of(item, 0, MAX_TARGETS), ...)})
    if question.layout == "cells":
        words = {ask.key: (_value(ask, scope), ...) for ask in question.asks}
        cell = _model("cell", {**words, **_grounds(scope)})
        return _model(question.key, dict.fromkeys(CELL_PHASES, (cell, ...)))
    fields = {
        ask.key: (_model(ask.key, {"value": (_value(ask, scope), ...), **_grounds(scope)}), ...)
        for ask in question.asks
    }
    return _model(question.key, fields)


def answer_schema(question: Question, scope: Scope) -> dict[str, Any]:
    """Return the answer's model as JSON schema: self-contained, no titles, every key required."""
    schema = answer_model(question, scope).model_json_schema()
    shared = schema.pop("$defs", {})
    plain: dict[str, Any] = _plain(schema, shared)
    return plain


def _plain(value: Any, shared: Mapping[str, Any]) -> Any:
    if isinstance(value, dict):
        if "$ref" in value:
            return _plain(shared[value["$ref"].rpartition("/")[2]], shared)
        # A field may be called title; the schema's own titles are words, not schemas.
        members = {k: v for k, v in value.items() if k != "title" or isinstance(v, dict)}
        return {key: _plain(item, shared) for key, item in members.items()}
    if isinstance(value, list):
        return [_plain(item, shared) for item in value]
    return value


def read_answer(question: Question, scope: Scope, text: str) -> BaseModel:
    """Return the answer in a model's text.

    One fence of three backticks around it is taken off, as chat models like to put one there, and
    so is a block of thoughts before it; nothing else is.

    Raises:
        BadAnswer: it is no JSON, or doesn't fit the schema.
    """
    try:
        value = parse_strict(_bare(text))
    except ValueError as error:
        raise BadAnswer([f"the answer is no JSON: {error}"]) from None
    if not isinstance(value, dict):
        raise BadAnswer(["the answer must be a JSON object"])
    try:
        return answer_model(question, scope).model_validate(value)
    except ValidationError as error:
        problems = [
            f"{field_path(e['loc'], value, missing=e['type'] == 'missing') or 'the answer'}: "
            f"{e['msg']}{_input_note(e)}"
            for e in error.errors()
        ]
        left = len(problems) - _MAX_PROBLEMS
        more = [f"and {left} more"] if left > 0 else []
        raise BadAnswer([*problems[:_MAX_PROBLEMS], *more]) from None


def findings(answer: BaseModel) -> dict[str, Finding]:
    """Return the fields of an answer of layout ``fields`` or ``cells``."""
    return {key: _finding(item) for key, item in answer.model_dump().items()}


def listed(answer: BaseModel) -> list[tuple[Finding, str]]:
    """Return the items of an answer of layout ``list``, each with its description."""
    items = answer.model_dump()["items"]
    return [(_finding(item), printable(item["description"])) for item in items]


def printable(text: str) -> str:
    """Put a model's words on one line, without characters that could steer a terminal."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def _finding(item: dict[str, Any]) -> Finding:
    words = {k: v for k, v in item.items() if k not in ("confidence", "evidence", "description")}
    value = words["value"] if set(words) == {"value"} else words
    frames = tuple(sorted(set(item["evidence"])))
    return Finding(value, float(item["confidence"]), frames)


def _model(name: str, fields: Mapping[str, tuple[Any, Any]]) -> type[BaseModel]:
    model: type[BaseModel] = create_model(name, __config__=_STRICT, **fields)  # type: ignore[call-overload]
    return model


def _grounds(scope: Scope) -> dict[str, tuple[Any, Any]]:
    evidence = _list_of(_number(range(1, scope.frames + 1)), 1, scope.frames)
    return {"confidence": (_Share, ...), "evidence": (evidence, ...)}


def _value(ask: Ask, scope: Scope) -> Any:
    if ask.shape == "count":
        number = _number(range(MAX_COUNT + 1))
        return _model("count", {"min": (number, ...), "max": (number, ...)})
    if ask.shape == "frame":
        return _number((*range(1, scope.frames + 1), UNRESOLVED))
    words = _one_of(words_of(ask, scope))
    return _list_of(words, 1, None) if ask.shape == "words" else words


# Types that are known only when a question is asked; a type checker can't follow them.
def _one_of(values: Iterable[int | str]) -> Any:
    return Literal[tuple(values)]


def _list_of(item: Any, low: int, high: int | None) -> Any:
    return Annotated[list[item], Field(min_length=low, max_length=high)]


def _number(values: Iterable[int | str]) -> Any:
    return Annotated[_one_of(values), BeforeValidator(_no_boolean)]


def _no_boolean(value: object) -> object:
    if isinstance(value, bool):  # true equals 1 for Python, and so for Literal
        raise ValueError("must be a number")
    return value


def _bare(text: str) -> str:
    text = split_answer(text).text.strip()
    if text.startswith("```") and text.endswith("```") and "\n" in text:
        text = text.partition("\n")[2].removesuffix("```").strip()
    return text


def _input_note(error: Any) -> str:
    if error["type"] == "missing" or not isinstance(error["input"], str | int | float):
        return ""
    input_text = printable(canonical_json(error["input"]).decode())
    return f" (got {input_text if len(input_text) <= 60 else input_text[:57] + '...'})"


def reply_text(body: bytes, where: str) -> str:
    """Return the text that the model wrote.

    Args:
        body: of the server's reply.
        where: file in which the body stands, for messages.

    Raises:
        PeerError: it is no chat completion, or the model declined to answer.
        BadAnswer: the answer was cut off, or is empty; another try may help.
    """
    try:
        completion = read_completion(body)
    except BrokenOff as error:
        raise BadAnswer([f"the answer can't be used: {printable(str(error))}"]) from error
    except NoCompletion as error:
        raise PeerError(
            f"the server's reply is no chat completion: {printable(str(error))} (kept in {where}); "
            "--base-url usually ends in /v1"
        ) from error
    if completion.refusal:
        raise PeerError(
            f"the model declines to answer: {printable(completion.refusal)[:200]} (kept in "
            f"{where}); another model may answer, or write the event by hand"
        )
    if completion.cut_off:
        raise BadAnswer(["the answer was cut off at the limit of its length"])
    if not completion.text or not completion.text.strip():
        raise BadAnswer(["the answer is empty"])
    return completion.text
