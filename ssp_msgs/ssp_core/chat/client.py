"""One question to a model over the OpenAI chat interface, and the policy of retries.

The policy, which is the only one (the library's own retries are off):

- A try ends after ``timeout_s`` without a whole answer; all tries and the waits between them end
  after ``deadline_s``, and no wait is begun that would outlast it.
- Tried again, ``tries`` times in all, is what can't have been answered: a server that can't be
  reached, and one that says 408, 409, 425, 429 or 5xx. The wait is 1, 2, 4 … seconds, or what
  ``Retry-After`` says (in seconds) where that is at most ``longest_wait_s``.
- Silence and a connection that breaks off are final: the answer may have been made, paid for and
  lost, and a second one may differ. ``retry_lost`` says that this is all right.
- Everything else is final: another status, an answer that is too large, a redirect.

What comes back is the body as it came; nothing here looks into it but for the key: it stands in no
message, and an answer that holds it is refused.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from ssp_core.chat.errors import LOOKED_AT, PASSING, is_filtered, looks_like_html
from ssp_core.credentials import gives_away, redact, without_userinfo
from ssp_core.errors import PeerError
from ssp_core.files.strict_json import parse_strict

if TYPE_CHECKING:  # the library is imported with the first question; it takes its time
    from ssp_core.chat.transport import FailedRequest, RawReply

NO_KEY = "none"  # what servers get that want no key
_NOT_TAKEN = frozenset(
    {"unreachable", "408", "409", "425", "429", "502", "503", "504", "529"}
    | {str(code) for code in range(520, 525)}  # of a gateway that finds no server behind it
)
_SHOWN = 300  # characters of what a server says


@dataclass(frozen=True)
class Policy:
    """Patience with a server.

    Args:
        timeout_s: for one whole answer.
        first_wait_s: before the second try; doubled for each further one.
        longest_wait_s: a server that wants a longer wait is given up.
        max_bytes: of one answer.
        deadline_s: for all tries and the waits between them; None: none.
        retry_lost: ask again where an answer may have been made and was lost.
    """

    timeout_s: float = 120.0
    tries: int = 3
    first_wait_s: float = 1.0
    longest_wait_s: float = 60.0
    max_bytes: int = 1 << 20
    deadline_s: float | None = None
    retry_lost: bool = False


@dataclass(frozen=True)
class Trouble:
    """One try failed.

    Args:
        kind: by which a remedy is found: ``unreachable``, ``lost``, ``too_large``, ``unsendable``,
            ``key``; what an error's message names, ``images``, ``length``, ``option``, ``filter``,
            a model or a key that isn't known (``404``, ``401``), too large a request or picture
            (``413``); else the status as text.
        safe: nothing was answered, so that asking again costs nothing.
        lost: an answer may have been made.
        late: no whole answer came within the time that it had.
        wait_s: that the server asks for, None: it doesn't say.
    """

    kind: str
    reason: str
    safe: bool = False
    lost: bool = False
    late: bool = False
    wait_s: float | None = None


@dataclass(frozen=True)
class Reply:
    """The body of an answer as it came, and how many tries it took."""

    body: bytes
    tries: int


class NoAnswer(PeerError):
    """There is no answer; one line with the reason and what can be done.

    Args:
        not_taken: the service was away or too busy to take the request; later it may.
        late: no whole answer came in time; another time it may.
        filtered: a filter of the service refused the request or the answer; that is final.
        failed: the service says 5xx, of the request nothing that would bring it again; later there
            may be an answer.
    """

    def __init__(
        self,
        message: str,
        not_taken: bool = False,
        late: bool = False,
        filtered: bool = False,
        failed: bool = False,
    ) -> None:
        super().__init__(message)
        self.not_taken = not_taken
        self.late = late
        self.filtered = filtered
        self.failed = failed


class Chat(Protocol):
    """A model that answers; tests have their own."""

    @property
    def model(self) -> str:
        """Its name, as the server knows it."""

    def ask(self, messages: Sequence[Mapping[str, Any]], answer: Mapping[str, Any]) -> bytes:
        """Return the body of the reply to a request; raise PeerError when there is none.

        Args:
            messages: of the conversation, as the API has them: ``role`` and ``content``.
            answer: further parameters of the request: response_format, limits, decoding.
        """


def pause_s(policy: Policy, trouble: Trouble, tries: int, left_s: float | None) -> float | None:
    """Compute how long to wait before the next try; None: there is none."""
    if tries >= policy.tries or not (trouble.safe or (trouble.lost and policy.retry_lost)):
        return None
    if trouble.wait_s is not None:
        wait_s = trouble.wait_s
        if wait_s > policy.longest_wait_s:
            return None
    else:
        wait_s = min(policy.first_wait_s * 2.0 ** min(tries - 1, 60), policy.longest_wait_s)
    return wait_s if left_s is None or wait_s < left_s else None


class OpenAIChat:
    """A server that speaks the OpenAI chat interface, such as vLLM; asked from one thread.

    Args:
        base_url: up to and with ``/v1``.
        api_key: None sends a word that says that there is none; no key is taken from the
            environment, so that none goes to a server that it isn't for.
        note: called with each try that failed.
        remedies: what a person can do, by kind of trouble (Trouble.kind).
    """

    def __init__(
        self,
        base_url: str,
        model: str,
        api_key: str | None = None,
        policy: Policy | None = None,
        note: Callable[[str], None] = lambda _: None,
        sleep: Callable[[float], None] = time.sleep,
        remedies: Mapping[str, str] | None = None,
    ) -> None:
        self._url = base_url
        self._shown_url = without_userinfo(base_url)
        self._model = model
        self._key = api_key
        self._policy = policy or Policy()
        self._note = note
        self._sleep = sleep
        self._remedies = remedies or {}
        if self._policy.tries < 1:
            raise ValueError("a policy needs at least one try")
        # Here and not above: it takes its time, which only those who ask should spend, and not
        # out of the time of an answer.
        from ssp_core.chat import transport

        self._http = transport

    @property
    def model(self) -> str:
        return self._model

    def ask(self, messages: Sequence[Mapping[str, Any]], answer: Mapping[str, Any]) -> bytes:
        return self.request(messages, answer).body

    def request(
        self,
        messages: Sequence[Mapping[str, Any]],
        answer: Mapping[str, Any],
        deadline_s: float | None = None,
    ) -> Reply:
        """Return the reply to a request; must not be called from within an event loop.

        Args:
            messages: see ``Chat.ask``.
            answer: see ``Chat.ask``.
            deadline_s: for this request, where it is shorter than the policy's.

        Raises:
            NoAnswer: there is none.
        """
        policy = self._policy
        limits_s = [limit for limit in (policy.deadline_s, deadline_s) if limit is not None]
        end_s = time.monotonic() + min(limits_s) if limits_s else None
        request = {"model": self._model, "messages": list(messages), **answer}
        tries = 0
        while True:
            left_s = None if end_s is None else end_s - time.monotonic()
            if left_s is not None and left_s <= 0.0:
                over = Trouble("deadline", "the time for an answer is over")
                raise NoAnswer(self._message(over, tries), late=True)
            limit_s = policy.timeout_s if left_s is None else min(policy.timeout_s, left_s)
            key = self._key or NO_KEY
            response = self._http.exchange(self._url, key, request, limit_s, policy.max_bytes)
            tries += 1
            trouble = self._trouble(response)
            if isinstance(trouble, bytes):
                return Reply(trouble, tries)
            left_s = None if end_s is None else end_s - time.monotonic()
            wait_s = pause_s(policy, trouble, tries, left_s)
            if wait_s is None:
                raise NoAnswer(
                    self._message(trouble, tries),
                    not_taken=trouble.kind in _NOT_TAKEN,
                    late=trouble.late,
                    filtered=trouble.kind == _FILTER,
                    failed=trouble.kind.isdigit() and int(trouble.kind) >= 500,
                )
            self._note(f"{self._shown_url}: {trouble.reason}; trying again in {wait_s:g} s")
            self._sleep(wait_s)

    def _trouble(self, response: RawReply | FailedRequest) -> Trouble | bytes:
        """Return a failed reply as trouble without the key in it, or the body of an answer."""
        kinds = self._http.Failure
        if isinstance(response, self._http.FailedRequest):
            late = response.failure is kinds.LATE
            return Trouble(
                (kinds.LOST if late else response.failure).value,
                redact(" ".join(response.reason.split()), self._key),
                safe=response.failure is kinds.UNREACHABLE,
                lost=late or response.failure is kinds.LOST,
                late=late,
            )
        code = response.status
        if code != 200:
            text = redact(_error_message(response.body), self._key)
            excerpt = text if len(text) <= _SHOWN else text[: _SHOWN - 3] + "..."
            if 300 <= code < 400:
                excerpt = "it sends on to another address, which is not followed"
            topic = _topic(code, text, response.body)
            return Trouble(
                topic or str(code),
                f"the server says {code}" + (f": {excerpt}" if excerpt else ""),
                safe=(code in PASSING or code >= 500) and topic != _FILTER,
                wait_s=self._http.retry_after_s(response.headers),
            )
        if gives_away(response.body, self._key):
            return Trouble("key", "the answer holds the key that was sent and is not kept")
        return response.body

    def _message(self, trouble: Trouble, tries: int) -> str:
        remedy = self._remedies.get(trouble.kind, "")
        tries_text = f" ({tries} tries)" if tries > 1 else ""
        return f"{self._shown_url}: {trouble.reason}{tries_text}" + (
            f"; {remedy}" if remedy else ""
        )


_SAY_WHY = frozenset({400, 403, 404, 413, 422, 500, 501})
_OF_REQUEST = frozenset({400, 404, 422})
_FILTER = "filter"
# Texts of a server that ran out of it speak of what it was at, such as images, and not of a cause.
_MEMORY = re.compile(r"out of memory|\bOOM\b|outofmemory|cannot allocate|CUDA error", re.I)
_TOPICS = (
    (
        "length",
        re.compile(
            r"context (?:length|window|size)|context_length|maximum context|exceed_context|n_ctx"
            r"|too many (?:\w+ )?tokens|max(?:imum)? (?:model|sequence|input|prompt) length"
            r"|max_(?:new|completion)?_?tokens\W{0,3} (?:is too large|must be)|completion tokens"
            r"|max_model_len|token count\b[^.;\n]{0,30}exceeds|maximum number of (?:\w+ )?tokens"
            r"|(?:token|input|prompt|message|sequence)s?(?: token)? length\b[^.;\n]{0,20}"
            r"(?:should be|must be|exceed|limit)|(?:prompt|input) tokens exceed"
            r"|reduce (?:your|the) (?:prompt|length|input|message)"
            r"|(?:prompt|input|request) (?:is |was )?too (?:long|large)"
            r"|\btokens\b[^;\n]{0,80}\bexceeds? the (?:limit|maximum)",
            re.I,
        ),
    ),
    (
        "images",
        re.compile(
            r"\b(?:images?|image_url|vision|multi-?modal|pictures?|mmproj)\b"
            r"|content\W{1,4}(?:must be|should be|expected) a? ?(?:valid )?str",
            re.I,
        ),
    ),
)
# The same of a refused request, with a model or a key that isn't known, and options.
_TOPICS_OF_REQUEST = (
    (
        "404",
        re.compile(
            r"\bmodel\b(?:[^.;,\n]|\.(?!\s)){0,80}\b(?:(?:do|does|is|was|could)(?: not|n[o'’]t)"
            r" (?:be )?(?:exist|found|available|served)|not (?:exist|found)|unknown)"
            r"|\bnot a valid model\b|(?:invalid|unknown|no such|unsupported) model\b",
            re.I,
        ),
    ),
    (
        "413",
        re.compile(
            r"\b(?:body|payload|entity)\b[^.;\n]{0,20}\btoo (?:large|big|long)\b"
            r"|\bimages?\b[^;\n]{0,60}\b(?:dimensions?|resolution|pixels?|[km]i?b|bytes|width)\b",
            re.I,
        ),
    ),
    *_TOPICS,
    ("401", re.compile(r"\bapi[ _-]?key\b|unauthori[sz]ed|authenticat|credential", re.I)),
    (
        "option",
        re.compile(
            r"temperature|\bseed\b|\btop_?[pk]\b|penalt(?:y|ies)|max_(?:\w+_)?tokens|logprobs"
            r"|response_format|json_schema|grammar|guided_|\bstream"
            # One that is missing is none of ours.
            r"|(?<!missing )(?<!missing required )\b(?:param(?:eter)?|argument)s?\b"
            r"|\b(?:extra|unknown|unexpected|additional|unrecogni[sz]ed) "
            r"(?:\w+ )?(?:inputs?|fields?|keys?|propert\w+|options?|keyword)"
            r"|unsupported value",
            re.I,
        ),
    ),
)


def _topic(code: int, text: str, body: bytes) -> str:
    """Name the cause that an error's message states; empty where it is none that is known here."""
    if code not in _SAY_WHY:
        return ""
    if is_filtered(body[: 1 << 16].decode("utf-8", "replace"), code):
        return _FILTER
    if code == 403 or _MEMORY.search(text):
        return ""
    topics = _TOPICS_OF_REQUEST if code in _OF_REQUEST else _TOPICS
    return next((name for name, words in topics if words.search(text)), "")


def _error_message(body: bytes) -> str:
    """Return an error's message on one line, else its text."""
    text = body[:LOOKED_AT].decode("utf-8", "replace")
    if looks_like_html(body):
        return "(a page of HTML)"
    try:
        value = parse_strict(body)
    except ValueError:
        value = None
    if isinstance(value, dict):
        error = value.get("error", value)
        message = error.get("message", error.get("detail")) if isinstance(error, dict) else error
        text = message if isinstance(message, str) else text
    return " ".join("".join(c if c.isprintable() else " " for c in text[:LOOKED_AT]).split())
