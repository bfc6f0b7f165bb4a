"""Asks the questions in their order, each with what was found before, and keeps every answer.

An answer that can't be used is asked for again with what was wrong with it, ``ANSWER_TRIES`` times
in all. A question whose usable answer lies in the store is not asked again, so that an interrupted
extraction goes on where it stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from pydantic import BaseModel

from ssp_core.chat import Chat
from ssp_core.errors import PeerError
from ssp_scenario_manager.spec.extract.answers import (
    BadAnswer,
    Finding,
    Scope,
    findings,
    listed,
    printable,
    read_answer,
)
from ssp_scenario_manager.spec.extract.frames import Clip
from ssp_scenario_manager.spec.extract.prompt import Context, build_request, with_pictures
from ssp_scenario_manager.spec.extract.questions import AGAIN_TEXT, QUESTIONS, Question
from ssp_scenario_manager.spec.extract.reply import reply_text
from ssp_scenario_manager.spec.extract.store import Store

ANSWER_TRIES = 3
_KEPT_OF_BAD = 2000  # characters of an unusable answer that the model is shown again


@dataclass(frozen=True)
class Target:
    """One OT as it was listed, and what was found about it."""

    id: str
    description: str
    listed: Finding
    place: Mapping[str, Finding]


@dataclass(frozen=True)
class Interview:
    """All that the model said about a clip, by question.

    Args:
        road, vut, interaction, phases, gate: findings by field.
        targets: the OTs.
        motion: findings by participant and phase; the value holds the words of a cell.
        keys: of the requests in the store, in the order in which they were asked.
    """

    road: Mapping[str, Finding]
    vut: Mapping[str, Finding]
    targets: tuple[Target, ...]
    interaction: Mapping[str, Finding]
    phases: Mapping[str, Finding]
    motion: Mapping[str, Mapping[str, Finding]]
    gate: Mapping[str, Finding]
    keys: tuple[str, ...]


@dataclass
class Interviewer:
    """Asks one model about one clip.

    Args:
        clip: sampled.
        chat: the model.
        store: keeps requests and replies.
        use_schema: ask the server to hold answers to the schema.
        annotation: text of an annotation that the model is shown, None: it sees none.
        advance: called with (questions answered, questions in all).
    """

    clip: Clip
    chat: Chat
    store: Store
    use_schema: bool = True
    annotation: str | None = None
    advance: Callable[[int, int], None] = lambda *_: None
    vut_id: str = "vut"
    _earlier: dict[str, Any] = field(default_factory=dict)
    _keys: list[str] = field(default_factory=list)
    _total: int = 7

    def run(self) -> Interview:
        """Asks everything.

        Raises:
            PeerError: the server or the model gives no usable answer; what was answered is kept.
            InputError: a kept answer was changed.
        """
        scope = Scope(len(self.clip.shots), (), self.vut_id)
        road = self._fields("road", scope)
        vut = self._fields("vut", scope)
        items = listed(self._ask(QUESTIONS["targets"], "targets", scope, {}))
        names = [f"ot{i}" for i in range(1, len(items) + 1)]
        self._earlier["targets"] = {
            name: {"class": item.finding.value["class"], "description": item.description}
            for name, item in zip(names, items, strict=True)
        }
        self._total += 2 * len(items)
        scope = Scope(scope.frames, tuple(names), self.vut_id)
        targets = tuple(
            Target(
                name,
                item.description,
                item.finding,
                self._fields("target", scope, name, item.description),
            )
            for name, item in zip(names, items, strict=True)
        )
        # Without an OT there is nothing that could interact; only the gate's question is left.
        if not targets:
            self._total = 4
            gate = self._fields("gate", scope)
            return Interview(road, vut, (), {}, {}, {}, gate, tuple(self._keys))
        interaction = self._fields("interaction", scope)
        phases = self._fields("phases", scope)
        motion = {self.vut_id: self._fields("motion_vut", scope)}
        for target in targets:
            motion[target.id] = self._fields("motion", scope, target.id, target.description)
        gate = self._fields("gate", scope)
        keys = tuple(self._keys)
        return Interview(road, vut, targets, interaction, phases, motion, gate, keys)

    def _fields(
        self, key: str, scope: Scope, about: str | None = None, description: str = ""
    ) -> dict[str, Finding]:
        name = f"{key}_{about}" if about else key
        filling = {"id": about, "description": description} if about else {}
        found = findings(self._ask(QUESTIONS[key], name, scope, filling))
        self._earlier[name] = {field: finding.value for field, finding in found.items()}
        return found

    def _ask(
        self, question: Question, name: str, scope: Scope, filling: Mapping[str, Any]
    ) -> BaseModel:
        request = build_request(question, name, scope, self._context(filling))
        key = self.store.begin(name, request)
        self._keys.append(key)
        kept = self.store.finished(key)
        if kept is not None:
            answer = read_answer(question, scope, reply_text(kept, str(self.store.folder)))
        else:
            answer = self._new_answer(question, name, scope, request, key)
        self.advance(len(self._keys), self._total)
        return answer

    def _new_answer(
        self, question: Question, name: str, scope: Scope, request: dict[str, Any], key: str
    ) -> BaseModel:
        messages = list(request["messages"])
        parameters = {k: v for k, v in request.items() if k not in ("messages", "model")}
        problems: tuple[str, ...] = ()
        file = ""
        for _ in range(ANSWER_TRIES):
            body = self.chat.ask([with_pictures(m, self.clip) for m in messages], parameters)
            file = self.store.keep(key, body)
            where = str(self.store.folder / file)
            text = ""
            try:
                text = reply_text(body, where)
                answer = read_answer(question, scope, text)
            except BadAnswer as bad:
                problems = bad.problems
                self.store.judge(key, file, problems)
                again = AGAIN_TEXT.format(problems=printable("; ".join(problems)))
                said = {"role": "assistant", "content": text[:_KEPT_OF_BAD] or "(nothing)"}
                messages = [*request["messages"], said, {"role": "user", "content": again}]
                continue
            except PeerError as error:
                self.store.judge(key, file, [str(error)])
                raise PeerError(f"question {name}: {error}") from error
            self.store.judge(key, file, [])
            return answer
        raise PeerError(
            f"question {name}: {self.chat.model} gave no usable answer in {ANSWER_TRIES} tries; "
            f"the last one: {'; '.join(problems)} (kept in {self.store.folder / file}); what was "
            "answered is kept, so that the same command goes on from here, with --model of "
            "another one if need be"
        )

    def _context(self, filling: Mapping[str, Any]) -> Context:
        pictures = [self.store.keep_frame(shot.number, shot.jpeg) for shot in self.clip.shots]
        return Context(
            model=self.chat.model,
            times_s=[shot.t_s for shot in self.clip.shots],
            pictures=pictures,
            earlier=self._earlier,
            filling=filling,
            annotation=self.annotation,
            use_schema=self.use_schema,
        )
