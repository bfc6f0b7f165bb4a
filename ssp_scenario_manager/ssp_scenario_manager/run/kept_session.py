"""The words of a session in one process, kept in their order.

What is done with a run is known when it is over: a bag is made of what was kept, with the bytes
that one written meanwhile would have, and without another run.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

from ssp_core.vocabulary import SessionPhase
from ssp_core.world.plant import StepReport
from ssp_scenario_manager.session import outbox


class SessionListener(Protocol):
    """Takes what a session's nodes would say."""

    def hear(self, report: StepReport) -> None:
        """Take a report of world, VUT and objects."""
        ...

    def sent(self, fact: outbox.Outgoing) -> None:
        """Take a fact that the session sends."""
        ...

    def answer(self, now_ns: int, session: SessionPhase) -> None:
        """Take the manager's word after a step."""
        ...


class KeptSession:
    """A listener that keeps everything; it is a SessionListener."""

    def __init__(self) -> None:
        self._entries: list[StepReport | outbox.Outgoing | tuple[int, SessionPhase]] = []

    def hear(self, report: StepReport) -> None:
        """Keep a report of world, VUT and objects."""
        self._entries.append(report)

    def sent(self, fact: outbox.Outgoing) -> None:
        """Keep a fact that the session sends."""
        self._entries.append(fact)

    def answer(self, now_ns: int, session: SessionPhase) -> None:
        """Keep the manager's word after a step."""
        self._entries.append((now_ns, session))

    def reports(self) -> Iterator[StepReport]:
        """Yield the reports, those of the world that holds included."""
        return (one for one in self._entries if isinstance(one, StepReport))

    def facts(self) -> Iterator[outbox.Outgoing]:
        """Yield what the session sent."""
        return (one for one in self._entries if not isinstance(one, StepReport | tuple))

    def tell(self, listener: SessionListener) -> None:
        """Tell another listener everything, in its order."""
        for one in self._entries:
            if isinstance(one, StepReport):
                listener.hear(one)
            elif isinstance(one, tuple):
                listener.answer(*one)
            else:
                listener.sent(one)
