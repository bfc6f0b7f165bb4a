"""From a question to a request: the text, the frames with their times, the schema."""

from __future__ import annotations

import base64
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ssp_scenario_manager.interactions import KINDS
from ssp_scenario_manager.spec.extract.answers import Scope, answer_schema, words_of
from ssp_scenario_manager.spec.extract.frames import Clip
from ssp_scenario_manager.spec.extract.questions import (
    ANNOTATION_TEXT,
    EARLIER_TEXT,
    FRAME_TEXT,
    RULES,
    Question,
)
from ssp_scenario_manager.spec.model import UNRESOLVED

DECODING: Mapping[str, Any] = {"temperature": 0.0, "seed": 0, "max_completion_tokens": 4096}


@dataclass(frozen=True)
class Context:
    """What a request holds besides its question.

    Args:
        model: as the server names it.
        times_s: clip times of the frames.
        pictures: file and hash of each.
        earlier: answers so far, by question.
        filling: of the braces in the question's text.
        annotation: shown to the model, None: it sees none.
        use_schema: ask the server to hold answers to the schema.
    """

    model: str
    times_s: Sequence[float]
    pictures: Sequence[Mapping[str, str]]
    earlier: Mapping[str, Any]
    filling: Mapping[str, Any]
    annotation: str | None = None
    use_schema: bool = True


def build_request(question: Question, name: str, scope: Scope, context: Context) -> dict[str, Any]:
    """Everything that is sent, with the pictures by file and hash.

    Args:
        question: of the definition.
        name: of this request; it names the schema.
        scope: of live vocabularies.
        context: the rest.
    """
    content: list[dict[str, Any]] = []
    frames = zip(context.times_s, context.pictures, strict=True)
    for index, (t_s, picture) in enumerate(frames, start=1):
        content.append({"type": "text", "text": FRAME_TEXT.format(index=index, t_s=t_s)})
        content.append({"type": "image_url", "image_url": dict(picture)})
    text = []
    if context.earlier:
        earlier = json.dumps(context.earlier, ensure_ascii=False)
        text.append(EARLIER_TEXT.format(earlier=earlier))
    if context.annotation:
        text.append(ANNOTATION_TEXT.format(annotation=context.annotation))
    text.append(question_text(question, scope, _filled(context)))
    content.append({"type": "text", "text": "\n".join(text)})
    request: dict[str, Any] = {
        "model": context.model,
        "messages": [
            {"role": "system", "content": RULES},
            {"role": "user", "content": content},
        ],
        **DECODING,
    }
    if context.use_schema:
        schema = answer_schema(question, scope)
        request["response_format"] = {
            "type": "json_schema",
            "json_schema": {"name": name, "strict": True, "schema": schema},
        }
    return request


def with_pictures(message: Mapping[str, Any], clip: Clip) -> dict[str, Any]:
    """A message of a request as it is sent: pictures as data URLs."""
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
    """What each known kind of interaction is: the first line of its module."""
    texts = {}
    for name, kind in KINDS.items():
        about = sys.modules[kind.plans.__module__].__doc__ or name
        texts[name] = about.strip().splitlines()[0]
    return texts


def question_text(question: Question, scope: Scope, filling: Mapping[str, str]) -> str:
    """A question with its fields, and for each the words that may be answered."""
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


def _filled(context: Context) -> dict[str, str]:
    """What stands in a question's braces."""
    begins = ["approach (from frame 1)"]
    for phase, frame in context.earlier.get("phases", {}).items():
        since = "beginning unresolved" if frame == UNRESOLVED else f"from frame {frame}"
        begins.append(f"{phase} ({since})")
    return {
        "phases": ", ".join(begins),
        "kinds": " ".join(f"{name}: {about}" for name, about in kind_texts().items()),
        **{key: str(value) for key, value in context.filling.items()},
    }
