"""The interview: questions in order, each with earlier findings; answers are kept in a folder."""

from __future__ import annotations

import base64
import itertools
import json
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field

from ssp_core.chat.client import Chat
from ssp_core.errors import InputError, PeerError, not_read
from ssp_core.files.folders import make_folder
from ssp_core.files.reading import load_model
from ssp_core.files.writing import write_bytes, write_json
from ssp_core.hashing import sha256_bytes, sha256_json
from ssp_core.names import VUT_ID
from ssp_core.run_file.values import Strict
from ssp_scenario_manager.event_spec.model import UNRESOLVED
from ssp_scenario_manager.extract.answers import (
    BadAnswer,
    Finding,
    Scope,
    answer_schema,
    findings,
    listed,
    printable,
    read_answer,
    reply_text,
    words_of,
)
from ssp_scenario_manager.extract.clip import Clip
from ssp_scenario_manager.extract.questions import (
    AGAIN_TEXT,
    ANNOTATION_TEXT,
    EARLIER_TEXT,
    FRAME_TEXT,
    QUESTIONS,
    RULES,
    Question,
)
from ssp_scenario_manager.scenarios.events.kinds import KINDS

DECODING: Mapping[str, Any] = {"temperature": 0.0, "seed": 0, "max_completion_tokens": 4096}


def with_pictures(message: Mapping[str, Any], clip: Clip) -> dict[str, Any]:
    """Return a message of a request as it is sent: pictures as data URLs."""
    if isinstance(message["content"], str):
        return dict(message)
    jpegs = {f"frames/{shot.number:06d}.jpg": shot.jpeg for shot in clip.shots}
    content = []
    for part in message["content"]:
        if part["type"] == "image_url":
            data = base64.b64encode(jpegs[part["image_url"]["file"]]).decode()
            url = f"data:image/jpeg;base64,{data}"
            content.append({"type": "image_url", "image_url": {"url": url}})
        else:
            content.append(part)
    return {**message, "content": content}


def kind_texts() -> dict[str, str]:
    """Describe each known kind of interaction by the first line of its module."""
    texts = {}
    for name, kind in KINDS.items():
        about = sys.modules[kind.plans.__module__].__doc__ or name
        texts[name] = about.strip().splitlines()[0]
    return texts


def question_text(question: Question, scope: Scope, filling: Mapping[str, str]) -> str:
    """Return a question with its fields, and for each the words that may be answered."""
    lines = [question.text.format(**filling)]
    for ask in question.asks:
        if ask.shape == "count":
            allowed = "a range of whole numbers from min to max, the same where you are sure"
        elif ask.shape == "frame":
            allowed = f"1 to {scope.frames}, or {UNRESOLVED}"
        else:
            many = "one or more of: " if ask.shape == "words" else "one of: "
            allowed = many + ", ".join(words_of(ask, scope))
        lines.append(f"- {ask.key}: {ask.text.format(**filling)} Answer: {allowed}.")
    return "\n".join(lines)


INDEX_FILE = "index.json"
_HASH_PATTERN = r"^sha256:[0-9a-f]{64}$"
Hash = Annotated[str, Field(pattern=_HASH_PATTERN)]


class StoredAnswer(Strict):
    """One reply: its file, its hash, and why it couldn't be used (empty: it could)."""

    file: Annotated[str, Field(pattern=r"^answers/[a-z0-9_.-]+\.body$")]
    sha256: Hash
    problems: list[str]


class StoredQuestion(Strict):
    """One request and its replies in order."""

    request: str
    request_sha256: Hash
    answers: list[StoredAnswer]


class Index(Strict):
    """The file ``index.json``: requests by ``<question>-<start of its hash>``."""

    schema_: Literal["ssp.extraction/1"] = Field("ssp.extraction/1", alias="schema")
    questions: dict[str, StoredQuestion] = {}


class Store:
    """The folder of one extraction, new or begun before.

    Raises:
        InputError: the folder can't be made, or its index is not valid.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = make_folder(folder)
        index = folder / INDEX_FILE
        self._questions: dict[str, StoredQuestion] = {}
        if index.exists():
            self._questions = dict(load_model(Index, index).questions)

    def keep_frame(self, number: int, jpeg: bytes) -> dict[str, str]:
        """Write a picture and return its file and hash, as they stand in requests."""
        name = f"frames/{number:06d}.jpg"
        path = self.folder / name
        if not path.is_file() or path.read_bytes() != jpeg:
            write_bytes(path, jpeg)
        return {"file": name, "sha256": sha256_bytes(jpeg)}

    def begin(self, question: str, request: dict[str, Any]) -> str:
        """Write a request where it isn't there yet; return the key of it and its answers."""
        digest = sha256_json(request)
        key = f"{question}-{digest.removeprefix('sha256:')[:8]}"
        if key not in self._questions:
            name = f"requests/{key}.json"
            write_json(self.folder / name, request)
            self._questions[key] = StoredQuestion(request=name, request_sha256=digest, answers=[])
            self._save()
        return key

    def finished(self, key: str) -> bytes | None:
        """Return the usable reply to a request, None while there is none.

        Raises:
            InputError: the file is gone or was changed since.
        """
        for answer in self._questions[key].answers:
            if not answer.problems:
                return self._read(answer)
        return None

    def keep(self, key: str, body: bytes) -> str:
        """Write a reply as it came; return its file's name."""
        names = (f"answers/{key}-{number}.body" for number in itertools.count(1))
        answer_files = {answer.file for answer in self._questions[key].answers}
        name = next(n for n in names if n not in answer_files and not (self.folder / n).exists())
        write_bytes(self.folder / name, body)
        return name

    def judge(self, key: str, name: str, problems: Iterable[str]) -> None:
        """Note whether a kept reply can be used."""
        digest = sha256_bytes((self.folder / name).read_bytes())
        answer = StoredAnswer(file=name, sha256=digest, problems=list(problems))
        entry = self._questions[key]
        self._questions[key] = entry.model_copy(update={"answers": [*entry.answers, answer]})
        self._save()

    def describe(self, keys: Iterable[str]) -> dict[str, dict[str, str]]:
        """Return the hashes of the requests and of the answers that were used, for the log."""
        hashes = {}
        for key in keys:
            entry = self._questions[key]
            used = next(answer for answer in entry.answers if not answer.problems)
            hashes[key] = {"request": entry.request_sha256, "answer": used.sha256}
        return hashes

    def _read(self, answer: StoredAnswer) -> bytes:
        path = self.folder / answer.file
        try:
            data = path.read_bytes()
        except OSError as error:
            raise not_read(path, error) from error
        if sha256_bytes(data) != answer.sha256:
            raise InputError(
                "was changed after it was stored",
                file=path,
                value=sha256_bytes(data),
                remedy=f"its hash was {answer.sha256}; remove {self.folder} to ask anew",
            )
        return data

    def _save(self) -> None:
        index = Index(questions=self._questions)
        write_json(self.folder / INDEX_FILE, index.model_dump(mode="json", by_alias=True))


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
        annotation: text of an annotation that the model is shown, None: it sees none.
        advance: called with (questions answered, questions in all).
    """

    clip: Clip
    chat: Chat
    store: Store
    use_schema: bool = True
    annotation: str | None = None
    advance: Callable[[int, int], None] = lambda *_: None
    _earlier: dict[str, Any] = field(default_factory=dict)
    _keys: list[str] = field(default_factory=list)
    _total: int = 7

    def run(self) -> Interview:
        """Ask all questions.

        Raises:
            PeerError: the server or the model gives no usable answer; what was answered is kept.
            InputError: a kept answer was changed.
        """
        scope = Scope(len(self.clip.shots))
        road = self._fields("road", scope)
        vut = self._fields("vut", scope)
        items = listed(self._ask("targets", "targets", scope, {}))
        items_by_id = {f"ot{i}": item for i, item in enumerate(items, start=1)}
        self._earlier["targets"] = {
            name: {"class": finding.value["class"], "description": description}
            for name, (finding, description) in items_by_id.items()
        }
        # Without an OT there is nothing that could interact; only the gate's question is left.
        self._total = 7 + 2 * len(items) if items else 4
        scope = Scope(scope.frames, tuple(items_by_id))
        targets = tuple(
            Target(name, description, finding, self._fields("target", scope, name, description))
            for name, (finding, description) in items_by_id.items()
        )
        interaction = self._fields("interaction", scope) if targets else {}
        phases = self._fields("phases", scope) if targets else {}
        motion = {VUT_ID: self._fields("motion_vut", scope)} if targets else {}
        for target in targets:
            motion[target.id] = self._fields("motion", scope, target.id, target.description)
        gate = self._fields("gate", scope)
        return Interview(road, vut, targets, interaction, phases, motion, gate, tuple(self._keys))

    def _fields(
        self, key: str, scope: Scope, about: str | None = None, description: str = ""
    ) -> dict[str, Finding]:
        name = f"{key}_{about}" if about else key
        filling = {"id": about, "description": description} if about else {}
        findings_by_field = findings(self._ask(key, name, scope, filling))
        self._earlier[name] = {field: finding.value for field, finding in findings_by_field.items()}
        return findings_by_field

    def _ask(self, key: str, name: str, scope: Scope, filling: Mapping[str, Any]) -> BaseModel:
        question = QUESTIONS[key]
        request = self._request(question, name, scope, filling)
        stored = self.store.begin(name, request)
        self._keys.append(stored)
        body = self.store.finished(stored)
        if body is not None:
            answer = read_answer(question, scope, reply_text(body, str(self.store.folder)))
        else:
            answer = self._new_answer(question, name, scope, request, stored)
        self.advance(len(self._keys), self._total)
        return answer

    def _request(
        self, question: Question, name: str, scope: Scope, filling: Mapping[str, Any]
    ) -> dict[str, Any]:
        """Return all that is sent, with the pictures by file and hash; ``name`` is the schema's."""
        content: list[dict[str, Any]] = []
        for index, shot in enumerate(self.clip.shots, start=1):
            text = FRAME_TEXT.format(index=index, t_s=shot.t_s)
            picture = self.store.keep_frame(shot.number, shot.jpeg)
            content.append({"type": "text", "text": text})
            content.append({"type": "image_url", "image_url": picture})
        paragraphs = []
        if self._earlier:
            earlier = json.dumps(self._earlier, ensure_ascii=False)
            paragraphs.append(EARLIER_TEXT.format(earlier=earlier))
        if self.annotation:
            paragraphs.append(ANNOTATION_TEXT.format(annotation=self.annotation))
        paragraphs.append(question_text(question, scope, self._filled(filling)))
        content.append({"type": "text", "text": "\n".join(paragraphs)})
        request: dict[str, Any] = {
            "model": self.chat.model,
            "messages": [
                {"role": "system", "content": RULES},
                {"role": "user", "content": content},
            ],
            **DECODING,
        }
        if self.use_schema:
            schema = answer_schema(question, scope)
            request["response_format"] = {
                "type": "json_schema",
                "json_schema": {"name": name, "strict": True, "schema": schema},
            }
        return request

    def _filled(self, filling: Mapping[str, Any]) -> dict[str, str]:
        """Return the texts that replace a question's braces."""
        begins = ["approach (from frame 1)"]
        for phase, frame in self._earlier.get("phases", {}).items():
            since = "beginning unresolved" if frame == UNRESOLVED else f"from frame {frame}"
            begins.append(f"{phase} ({since})")
        return {
            "phases": ", ".join(begins),
            "kinds": " ".join(f"{name}: {about}" for name, about in kind_texts().items()),
            **{key: str(value) for key, value in filling.items()},
        }

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
                bad_reply = {"role": "assistant", "content": text[:_KEPT_OF_BAD] or "(nothing)"}
                messages = [*request["messages"], bad_reply, {"role": "user", "content": again}]
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
