"""The options of the backend ``openai``, checked before anything is asked."""

from __future__ import annotations

import base64
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np

from ssp_core.chat.answer_text import Ending, ending, split_answer
from ssp_core.chat.client import NoAnswer, OpenAIChat, Policy, Reply
from ssp_core.chat.completion import BrokenOff, Completion, NoCompletion, read_completion
from ssp_core.chat.errors import looks_like_html
from ssp_core.credentials import gives_away
from ssp_core.errors import InputError, PeerError
from ssp_core.hashing import canonical_json, sha256_bytes, sha256_json
from ssp_vla_bridge.backend import (
    NO_IMAGES,
    BrokenOffError,
    DeclinedError,
    NoTimeError,
    NotTakenError,
    address_option,
    check_options,
    is_blind,
    key_option,
    number_option,
)
from ssp_vla_bridge.backends.given_back import (
    CONTROL,
    FACTS,
    before_trajectory,
    check_continued,
    turned,
)
from ssp_vla_bridge.messages import Answer, Frame, Request
from ssp_vla_bridge.native_history import previous_stage
from ssp_vla_bridge.prompts import Prompt, find_stages, visible_request
from ssp_vla_bridge.stopwatch import ENCODING, part

_TYPES: dict[str, type] = {
    "base_url": str,
    "model": str,
    "api_key_env": str,
    "interface": str,
    "temperature": float,
    "seed": int,
    "top_p": float,
    "presence_penalty": float,
    "frequency_penalty": float,
    "max_tokens": int,
    "timeout_s": float,
    "tries": int,
    "image_width": int,
    "extra": dict,
    "give_back": str,
    "images": str,
}
# Default, least and most.
_DECODING: dict[str, tuple[float, float, float]] = {
    "temperature": (0.0, 0.0, 2.0),
    "seed": (0, -(2**63), 2**63 - 1),
    "top_p": (1.0, 0.0, 1.0),
    "presence_penalty": (0.0, -2.0, 2.0),
    "frequency_penalty": (0.0, -2.0, 2.0),
    "max_tokens": (1024, 1, 1 << 20),
}
_OURS = frozenset({"model", "messages", "stream", "n", *_DECODING})


@dataclass(frozen=True)
class Options:
    """The settings of requests to a chat service.

    Args:
        base_url: up to and with ``/v1``.
        model: as the server names it.
        decoding: parameters of every request, in the words of the interface; those that are None
            are not sent.
        timeout_s: for a whole answer with all its stages and tries.
        tries: of one stage.
        give_back: which fact of its own text is turned before it plans (given_back.FACTS); empty:
            it isn't given its text back.
        image_width_px: wider frames are scaled down to this; None: frames are sent as they are.
        blind: no picture is sent, and the prompts say so (option ``images: none``).
        api_key_env: name of the variable with the key, empty: the server wants none.
    """

    base_url: str
    model: str
    interface: str
    decoding: Mapping[str, float | None]
    timeout_s: float = 60.0
    tries: int = 3
    image_width_px: int | None = None
    blind: bool = False
    give_back: str = ""
    extra: Mapping[str, Any] = field(default_factory=dict)
    api_key_env: str = ""
    key: str | None = field(default=None, repr=False)

    @property
    def parameters(self) -> dict[str, Any]:
        """Return the parameters of every request besides model and messages."""
        sent = {name: value for name, value in self.decoding.items() if value is not None}
        return {**sent, "stream": False, **self.extra}


def read_options(options: Mapping[str, Any]) -> Options:
    """Return the options, with the key from the environment.

    Raises:
        InputError: one is missing, unknown or wrong, or the variable holds no key.
    """
    # A null is a parameter that isn't sent; of other options it is what leaving them out is.
    check_options("openai", {k: v for k, v in options.items() if v is not None}, _TYPES)
    check_options("openai", dict.fromkeys(options.keys() - _TYPES.keys()), _TYPES)
    for name in ("base_url", "model"):
        if not str(options.get(name) or "").strip():
            raise InputError(
                "is missing",
                field=f"backend_options.{name}",
                remedy='give such as {"base_url": "http://localhost:8000/v1", "model": "NAME"}',
            )
    interface = options.get("interface") or "openemma"
    find_stages(interface)
    extra = options.get("extra") or {}
    try:
        recorded = canonical_json([options["model"], extra])
    except (ValueError, TypeError) as error:
        raise InputError(
            f"is no JSON ({error})",
            field="backend_options.extra",
            value=extra,
            remedy="write it as JSON, without NaN",
        ) from error
    for name in sorted(_OURS & extra.keys()):
        remedy = "it is set by the bridge"
        if name in _TYPES:
            remedy = "it is an option of its own"
        raise InputError(
            "is no extra parameter", field=f"backend_options.extra.{name}", remedy=remedy
        )
    give_back = options.get("give_back") or ""
    if give_back and give_back not in FACTS:
        raise InputError(
            "is nothing that can be turned",
            field="backend_options.give_back",
            value=give_back,
            remedy=f"known: {', '.join(FACTS)}",
        )
    if (images := options.get("images")) not in (None, NO_IMAGES):
        raise InputError(
            "is no choice of pictures",
            field="backend_options.images",
            value=images,
            remedy=f"{NO_IMAGES} asks without any; left out, the frames are sent",
        )
    key = key_option(options)
    if gives_away(recorded, key):
        raise InputError(
            "the key stands in model or extra, which are recorded",
            field="backend_options",
            remedy="leave the key to the environment",
        )
    width = options.get("image_width")
    return Options(
        base_url=address_option(options["base_url"], "base_url", "http://localhost:8000/v1"),
        model=options["model"],
        interface=interface,
        decoding={name: _decoding(options, name) for name in _DECODING},
        timeout_s=number_option(options, "timeout_s", 60.0, 0.001, 86400.0),
        tries=int(number_option(options, "tries", 3, 1, 20)),
        image_width_px=None
        if width is None
        else int(number_option(options, "image_width", 0, 16, 8192)),
        blind=is_blind(options),
        give_back=give_back,
        extra=dict(extra),
        api_key_env=options.get("api_key_env") or "",
        key=key,
    )


def _decoding(options: Mapping[str, Any], name: str) -> float | None:
    """Return a parameter of the request; null leaves it out, for servers that refuse it."""
    if name in options and options[name] is None:
        return None
    return number_option(options, name, *_DECODING[name])


# What continues a text that is given, for vLLM and SGLang; others refuse what they don't know.
_GOES_ON = {"continue_final_message": True, "add_generation_prompt": False}
STAGE_GAP = "\n\n"
_JPEG_QUALITY = 95
_SHOWN = 200
_CHARACTERS_OF_REASONING = 100_000


@dataclass(frozen=True)
class _StageAnswer:
    """One stage's question and answer."""

    name: str
    prompt: Prompt
    text: str
    completion: Completion
    tries: int
    latency_s: float
    turned_texts: Mapping[str, str] = field(default_factory=dict)


class OpenAIBackend:
    """Asks one model; one answer at a time, as a server is not deterministic under concurrency."""

    def __init__(self, options: Options, sleep: Callable[[float], None] = time.sleep) -> None:
        self._options = options
        self._stages = find_stages(options.interface)
        self._turn = threading.Lock()
        self.interface = options.interface
        self.model_id = options.model
        policy = Policy(timeout_s=options.timeout_s, tries=options.tries)
        self._chat = OpenAIChat(
            options.base_url,
            options.model,
            options.key,
            policy,
            sleep=sleep,
            remedies=_remedies(options.api_key_env),
        )

    def answer(self, request: Request) -> Answer:
        """Return the stages' texts and how they came.

        Raises:
            NotTakenError: the server is away or too busy; the line names the stage and says why.
            BrokenOffError: the server broke off or failed.
            DeclinedError: the model or a filter declines.
            NoTimeError: there is no whole answer in time.
            PeerError: a stage has no answer for another reason.
        """
        end_s = time.monotonic() + self._options.timeout_s
        if not self._turn.acquire(timeout=self._options.timeout_s):
            raise NoTimeError(f"waited {self._options.timeout_s:g} s for the answer before")
        try:
            return self._answer(request, end_s)
        finally:
            self._turn.release()

    def _answer(self, request: Request, end_s: float) -> Answer:
        request = visible_request(request, blind=self._options.blind)
        with part(ENCODING):
            pictures = [self._picture(frame) for frame in request.frames]
        before: dict[str, str] = {}
        stage_answers = []
        for stage in self._stages:
            turned_texts = (
                self._turned_texts(before) if before and stage is self._stages[-1] else {}
            )
            prompt = stage.build(request, turned_texts or before)
            one = replace(self._ask(stage.name, prompt, pictures, end_s), turned_texts=turned_texts)
            if self._options.give_back and len(self._stages) == 1:
                one = self._continue_stage(one, pictures, end_s)
            before[stage.name] = split_answer(one.text).text
            stage_answers.append(one)
        return Answer(
            STAGE_GAP.join(one.text for one in stage_answers),
            decoding=self._facts(request, stage_answers),
        )

    def _turned_texts(self, before: Mapping[str, str]) -> dict[str, str]:
        """Return the texts of earlier stages as they are given back; empty: unchanged.

        Raises:
            PeerError: they don't say the fact that is to be turned.
        """
        fact = self._options.give_back
        turned_texts = {
            name: turned(text, fact, is_plan=name == "intent") for name, text in before.items()
        }
        self._check_turned(turned_texts != before)
        return turned_texts if fact else {}

    def _check_turned(self, is_turned: bool) -> None:
        fact = self._options.give_back
        if fact not in ("", CONTROL) and not is_turned:
            raise PeerError(f"n/a: its text says no {fact} that could be turned")

    def _continue_stage(
        self, own: _StageAnswer, pictures: Sequence[Mapping[str, Any]], end_s: float
    ) -> _StageAnswer:
        """Return the text of one stage with the trajectory that follows from it as given back.

        Raises:
            PeerError: there is nothing to give back, or the server doesn't go on with it.
        """
        preamble = before_trajectory(split_answer(own.text).text)
        turned_preamble = turned(preamble, self._options.give_back)
        self._check_turned(turned_preamble != preamble)
        on = self._ask(own.name, own.prompt, pictures, end_s, turned_preamble)
        check_continued(on.text)
        return replace(
            on,
            text=f"{preamble} {on.text.lstrip()}",
            tries=own.tries + on.tries,
            latency_s=own.latency_s + on.latency_s,
            turned_texts={own.name: turned_preamble},
        )

    def _ask(
        self,
        name: str,
        prompt: Prompt,
        pictures: Sequence[Mapping[str, Any]],
        end_s: float,
        begun: str = "",
    ) -> _StageAnswer:
        """Ask one stage.

        Args:
            name: of the stage.
            prompt: of the stage.
            pictures: as message parts, with the frames in them.
            end_s: when the answer must be there, s on the monotonic clock.
            begun: the beginning of the answer, with which the server goes on.
        """
        begun_s = time.monotonic()
        messages: list[dict[str, Any]] = []
        if prompt.system:
            messages.append({"role": "system", "content": prompt.system})
        parts = [*pictures, {"type": "text", "text": prompt.text}]
        # Servers of models without eyes may know no parts.
        messages.append({"role": "user", "content": parts if pictures else prompt.text})
        parameters = self._options.parameters
        if begun:
            messages.append({"role": "assistant", "content": begun})
            parameters = {**parameters, **_GOES_ON}
        try:
            reply = self._chat.request(messages, parameters, end_s - begun_s)
            completion, text = _read(reply)
        except PeerError as error:
            raise _kind_of(error)(f"stage {name}: {error}") from None
        return _StageAnswer(name, prompt, text, completion, reply.tries, time.monotonic() - begun_s)

    def _picture(self, frame: Frame) -> dict[str, Any]:
        data = base64.b64encode(scaled(frame.jpeg, self._options.image_width_px)).decode()
        return {"type": "image_url", "image_url": {"url": f"data:image/jpeg;base64,{data}"}}

    def _facts(self, request: Request, stage_answers: Sequence[_StageAnswer]) -> dict[str, Any]:
        options = self._options
        stages, notes, start = [], [], 0
        for one in stage_answers:
            end = start + len(one.text)
            stages.append({"name": one.name, "start": start, "end": end, **_stage_facts(one)})
            notes += [f"{one.name}: {note}" for note in _notes(one.completion, options.model)]
            start = end + len(STAGE_GAP)
        previous = previous_stage(request, "intent") if self._carries_intent else None
        return {
            "interface": options.interface,
            "model": options.model,
            **options.decoding,
            "stream": False,
            "extra": dict(options.extra),
            "frames": len(request.frames),
            "image_width_px": options.image_width_px,
            "timeout_s": options.timeout_s,
            "tries": options.tries,
            **({"images": NO_IMAGES} if options.blind else {}),
            **({"give_back": options.give_back} if options.give_back else {}),
            "prompt_sha256": sha256_json([one.prompt.sha256 for one in stage_answers]),
            "previous_intent_sha256": sha256_bytes(previous.text.encode()) if previous else None,
            "stages": stages,
            "notes": notes,
        }

    @property
    def _carries_intent(self) -> bool:
        return self._options.interface == "openemma"


def _kind_of(error: PeerError) -> type[PeerError]:
    """Choose the exception to raise in the place of an error of the chat."""
    if isinstance(error, BrokenOffError | DeclinedError):
        return type(error)
    if isinstance(error, NoAnswer) and error.filtered:
        return DeclinedError
    if isinstance(error, NoAnswer) and error.not_taken:
        return NotTakenError
    if isinstance(error, NoAnswer) and error.failed:
        return BrokenOffError
    return NoTimeError if isinstance(error, NoAnswer) and error.late else PeerError


def _read(reply: Reply) -> tuple[Completion, str]:
    """Read a reply and its text.

    Raises:
        BrokenOffError: it was broken off, or holds no text though no limit ended it.
        DeclinedError: the model or a filter declines.
        PeerError: there is no text in it that could be used.
    """
    try:
        completion = read_completion(reply.body)
    except BrokenOff as error:
        raise BrokenOffError(f"the answer can't be used: {error}") from None
    except NoCompletion as error:
        remedy = "; base_url usually ends in /v1" if looks_like_html(reply.body) else ""
        raise PeerError(f"the answer is no chat completion: {error}{remedy}") from None
    if completion.refusal:
        raise DeclinedError(f"the model declines to answer: {completion.refusal[:_SHOWN]}")
    # What the limit ended is the model's answer, even where it ended before any text.
    if completion.text is None and not completion.cut_off:
        why = f" (finish_reason {completion.finish_reason})" if completion.finish_reason else ""
        raise BrokenOffError(f"the answer holds no text{why}")
    text = completion.text or ""
    if "\0" in text:  # ROS would end the string there without a word
        raise PeerError("the answer's text holds a NUL character, which no message can carry")
    return completion, text


def _stage_facts(one: _StageAnswer) -> dict[str, Any]:
    completion = one.completion
    facts: dict[str, Any] = {
        "prompt_sha256": one.prompt.sha256,
        "latency_s": round(one.latency_s, 4),
        "tries": one.tries,
        "model_reported": completion.model,
        "system_fingerprint": completion.system_fingerprint,
        "finish_reason": completion.finish_reason,
        "usage": dict(completion.usage) if completion.usage else None,
    }
    if one.turned_texts:
        facts["given_back"] = {
            name: text[:_CHARACTERS_OF_REASONING] for name, text in one.turned_texts.items()
        }
    if completion.reasoning:
        facts["reasoning"] = completion.reasoning[:_CHARACTERS_OF_REASONING]
    return facts


def _notes(completion: Completion, model: str) -> list[str]:
    notes = []
    if completion.cut_off:
        notes.append("cut off at the limit of tokens")
    elif ending(completion.finish_reason) is Ending.UNKNOWN:
        notes.append(f"it ended for a reason that isn't known here: {completion.finish_reason}")
    if completion.left_out:
        notes.append(f"parts that are no text were left out: {', '.join(completion.left_out)}")
    if not (completion.text or "").strip():
        remedy = "; give a larger max_tokens" if completion.cut_off else ""
        notes.append(f"the text is empty{remedy}")
    if completion.parts:
        notes.append(f"the text came in {completion.parts} parts")
    if completion.model is not None and completion.model != model:
        notes.append("the server names another model than was asked for")
    return notes


def scaled(jpeg: bytes, width_px: int | None) -> bytes:
    """Return a frame scaled down to a width, as JPEG; the same bytes if it is no wider.

    Raises:
        ValueError: it is no picture.
    """
    if width_px is None:
        return jpeg
    image = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise ValueError("the frame is no picture")
    height, width = image.shape[:2]
    if width <= width_px:
        return jpeg
    size = (width_px, max(1, round(height * width_px / width)))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return data.tobytes()


def _remedies(variable: str) -> dict[str, str]:
    key = "name the environment variable that holds the key with the option api_key_env"
    if variable:
        key = f"the key in the variable that api_key_env names ({variable}) is not accepted"
    return {
        "unreachable": "start the server, or give its base_url",
        "lost": "it is not asked again, as the answer may have been made",
        "401": key,
        "403": key,
        "404": "model must be a name that the server serves, and base_url usually ends in /v1",
        "option": "a decoding option that the server refuses is left out by null",
        "images": "give a model that takes pictures, or fewer, or images: none, which asks without",
        "length": "give fewer frames, an image_width, or a smaller max_tokens",
        "filter": "a filter of the server refused it, which is final",
        "413": "give fewer frames or an image_width",
        "429": "the server is busy or a quota is used up",
    }


def make(options: Mapping[str, Any]) -> OpenAIBackend:
    """Make the backend; raise InputError for a wrong option or a key that isn't there."""
    return OpenAIBackend(read_options(options))
