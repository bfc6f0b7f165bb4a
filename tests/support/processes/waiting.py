"""Waiting for what another thread or process does."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

DEADLINE_S = 300.0
ANSWER_S = 5.0


def pause() -> None:
    """Leave the processor to others for 5 ms."""
    time.sleep(0.005)


def until(
    condition: Callable[[], object],
    what: str | Callable[[], str] = "change",
    between: Callable[[], object] = pause,
) -> None:
    """Returns when a condition holds; fails when it takes too long."""
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        late = time.monotonic() > deadline
        assert not late, f"no {what if isinstance(what, str) else what()} in time"
        between()


def answer_of(
    client: Any, request: Any, spin_until: Callable[[Callable[[], bool], str], None]
) -> Any:
    """Asks a service, again while no answer comes, and returns the first one.

    A server that doesn't know its client's reader yet drops the answer, whatever the client sees
    of the server. A command that was carried out is then refused in its new state.
    """
    spin_until(client.service_is_ready, f"{client.srv_name} is there")
    calls = [client.call_async(request)]
    again = time.monotonic() + ANSWER_S

    def answered() -> bool:
        nonlocal again
        if time.monotonic() > again:
            calls.append(client.call_async(request))
            again = time.monotonic() + ANSWER_S
        return any(call.done() for call in calls)

    spin_until(answered, f"{client.srv_name} answers")
    return next(call.result() for call in calls if call.done())
