"""One request to a model over the OpenAI chat interface, and what to do when it doesn't answer.

The policy, which is also the library's only one (its own retries are off): a try ends after
``timeout_s`` without a whole answer. Silence, a refused or broken connection and the statuses 408,
409, 425, 429 and 5xx are tried again, ``tries`` times in all, after 1, 2, 4 … seconds, or after
what ``Retry-After`` says (in seconds) where that is at most ``longest_wait_s``. Everything else is
final at once. What comes back is the body as it came; nothing here looks into it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import openai

from ssp_core.errors import PeerError

_AGAIN = frozenset({408, 409, 425, 429})
_REMEDIES = {
    400: "a server that can't hold answers to a schema needs --no-schema; one that finds the "
    "request too long needs fewer --frames or a smaller --width",
    401: "name the variable that holds the key with --api-key-env",
    403: "name the variable that holds the key with --api-key-env",
    404: "--model must be a name that the server serves, and --base-url usually ends in /v1",
    413: "give fewer --frames or a smaller --width",
}


@dataclass(frozen=True)
class Policy:
    """Patience with a server.

    Args:
        timeout_s: for one whole answer.
        tries: of one request.
        first_wait_s: before the second try; doubled for each further one.
        longest_wait_s: a server that wants a longer wait is given up.
        max_bytes: of one answer.
    """

    timeout_s: float = 120.0
    tries: int = 3
    first_wait_s: float = 1.0
    longest_wait_s: float = 60.0
    max_bytes: int = 1 << 20


class Chat(Protocol):
    """A model that answers; tests have their own."""

    @property
    def model(self) -> str:
        """Its name, as the server knows it."""

    def ask(self, messages: Sequence[Mapping[str, Any]], answer: Mapping[str, Any]) -> bytes:
        """The body of the reply to a request; raises PeerError when there is none.

        Args:
            messages: of the chat.
            answer: further parameters of the request: response_format, limits, decoding.
        """


class _Trouble(Exception):
    """One try failed.

    Args:
        reason: for people.
        final: another try would be of no use.
        wait_s: that the server asks for, None: it doesn't say.
        remedy: for people.
    """

    def __init__(
        self, reason: str, *, final: bool = False, wait_s: float | None = None, remedy: str = ""
    ) -> None:
        super().__init__(reason)
        self.reason, self.final, self.wait_s, self.remedy = reason, final, wait_s, remedy


class OpenAIChat:
    """A server that speaks the OpenAI chat interface, such as vLLM.

    Args:
        base_url: up to and with ``/v1``.
        model: as the server names it.
        api_key: None sends a word that says that there is none; no key is taken from the
            environment, so that none goes to a server that it isn't for.
        policy: patience.
        note: told of each try that failed.
        sleep: waits some seconds.
    """

    def __init__(
        self,
        base_url: str,
        model: str,
        api_key: str | None = None,
        policy: Policy | None = None,
        note: Callable[[str], None] = lambda _: None,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._url = base_url
        self._model = model
        self._policy = policy or Policy()
        self._note = note
        self._sleep = sleep
        self._client = openai.OpenAI(
            base_url=base_url,
            api_key=api_key or "none",
            max_retries=0,
            timeout=openai.Timeout(
                self._policy.timeout_s, connect=min(5.0, self._policy.timeout_s)
            ),
        )

    @property
    def model(self) -> str:
        return self._model

    def ask(self, messages: Sequence[Mapping[str, Any]], answer: Mapping[str, Any]) -> bytes:
        policy = self._policy
        wait_s = policy.first_wait_s
        for left in range(policy.tries - 1, -1, -1):
            try:
                return self._try(messages, answer)
            except _Trouble as trouble:
                asked_s = trouble.wait_s
                too_long = asked_s is not None and asked_s > policy.longest_wait_s
                if trouble.final or too_long or not left:
                    tries = "" if trouble.final else f" ({policy.tries - left} tries)"
                    remedy = f"; {trouble.remedy}" if trouble.remedy else ""
                    raise PeerError(f"{self._url}: {trouble.reason}{tries}{remedy}") from trouble
                pause_s = wait_s if asked_s is None else asked_s
                self._note(f"{self._url}: {trouble.reason}; trying again in {pause_s:g} s")
                self._sleep(pause_s)
                wait_s *= 2
        raise ValueError("a policy needs at least one try")

    def _try(self, messages: Sequence[Mapping[str, Any]], answer: Mapping[str, Any]) -> bytes:
        limit_s = self._policy.timeout_s
        silent = _Trouble(
            f"no whole answer within {limit_s:g} s",
            remedy="is the model still being loaded? give a larger --timeout",
        )
        started_s = time.monotonic()
        create = self._client.chat.completions.with_streaming_response.create
        request: dict[str, Any] = {"model": self._model, "messages": list(messages), **answer}
        try:
            with create(**request) as response:
                body = bytearray()
                for chunk in response.iter_bytes():
                    body += chunk
                    if len(body) > self._policy.max_bytes:
                        raise _Trouble(
                            f"the answer is larger than {self._policy.max_bytes >> 10} KiB",
                            final=True,
                        )
                    if time.monotonic() - started_s > limit_s:
                        raise silent
                return bytes(body)
        except _Trouble:
            raise
        except openai.APITimeoutError as error:
            raise silent from error
        except openai.APIConnectionError as error:
            raise _Trouble(
                f"the server can't be reached ({error.__cause__ or error})",
                remedy="start it, or give its --base-url",
            ) from error
        except openai.APIStatusError as error:
            raise _status(error) from error
        except openai.OpenAIError as error:
            raise _Trouble(f"the request can't be made: {error}", final=True) from error
        except Exception as error:  # a broken body raises what the HTTP library under openai has
            if time.monotonic() - started_s >= limit_s:
                raise silent from error
            raise _Trouble(f"the connection broke off within the answer ({error})") from error


def _status(error: openai.APIStatusError) -> _Trouble:
    code = error.status_code
    text = " ".join(str(error.message).split())
    shown = text if len(text) <= 300 else text[:297] + "..."
    return _Trouble(
        f"the server says {code}: {shown}",
        final=not (code in _AGAIN or code >= 500),
        wait_s=_seconds(error.response.headers.get("retry-after")),
        remedy=_REMEDIES.get(code, ""),
    )


def _seconds(text: str | None) -> float | None:
    """Retry-After in seconds; None where it isn't there, or is a date."""
    try:
        seconds = float(text) if text else -1.0
    except ValueError:
        return None
    return seconds if seconds >= 0 else None
