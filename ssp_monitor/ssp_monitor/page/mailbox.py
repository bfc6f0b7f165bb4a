"""What one viewer is still to get: of each kind only the newest, so that a slow one drops, never
queues."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping

Payload = str | bytes


class Mailbox:
    """One slot per kind of message; must be used in one event loop."""

    def __init__(self) -> None:
        self._slots: dict[str, Payload] = {}
        self._filled = asyncio.Event()
        self.dropped = 0
        self.filled_ns = 0

    def put(self, kind: str, payload: Payload) -> None:
        """The newest of its kind; an older one that wasn't fetched is dropped."""
        if kind in self._slots:
            self.dropped += 1
        self._slots[kind] = payload
        self.filled_ns = time.monotonic_ns()
        self._filled.set()

    async def take(self) -> Mapping[str, Payload]:
        """Everything there is, as soon as there is something."""
        await self._filled.wait()
        self._filled.clear()
        taken, self._slots = self._slots, {}
        return taken
