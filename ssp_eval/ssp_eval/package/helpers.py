"""Calls that are shared with helper processes; the main process does those not yet begun."""

from __future__ import annotations

import multiprocessing
import signal
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from threading import Lock
from types import TracebackType
from typing import Any, Generic, TypeVar

from ssp_core.errors import HostError
from ssp_core.host.children import die_with_parent, worker_context
from ssp_core.host.terminal import ignore_stop_signals

Result = TypeVar("Result")


class Call(Generic[Result]):
    """A call that a helper may begin.

    Args:
        helpers: that may begin it.
        function: of a module.
        arguments: which can be pickled, as its result can.
    """

    def __init__(
        self, helpers: Helpers, function: Callable[..., Result], arguments: tuple[Any, ...]
    ) -> None:
        self.function, self.arguments = function, arguments
        # Of the helper that has begun it; None: none has.
        self.there: Future[Result] | None = None
        self._helpers = helpers

    def result(self) -> Result:
        """Do it here where no helper has begun it, and wait for the helper otherwise.

        Raises:
            HostError: the helper was killed.
        """
        if self._helpers.take_back(self) or self.there is None:
            return self.function(*self.arguments)
        try:
            return self.there.result()
        except BrokenProcessPool as error:
            raise HostError("a helper process was killed; give the same command again") from error


class Helpers:
    """Processes beside this one, for a block; they end at once when it is left early.

    A helper is given a call when it has nothing else to do: a pool would take one more for each
    process, which then waits there while this process has nothing to do.

    Args:
        count: how many; none does all calls here.
    """

    def __init__(self, count: int) -> None:
        self._before = multiprocessing.active_children()
        self._pool = ProcessPoolExecutor(count, worker_context(), _begin) if count else None
        self._lock = Lock()
        self._waiting = deque[Call[Any]]()
        self._idle = count

    def __enter__(self) -> Helpers:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        _error: BaseException | None,
        _traceback: TracebackType | None,
    ) -> None:
        if self._pool is None:
            return
        with self._lock:
            self._waiting.clear()
        if kind is not None:
            for process in multiprocessing.active_children():
                if process not in self._before:
                    process.terminate()
        self._pool.shutdown(cancel_futures=True)

    def begin(self, function: Callable[..., Result], *arguments: Any) -> Call[Result]:
        """Give a call to the helpers.

        Args:
            function: of a module.
            arguments: which can be pickled, as its result can.
        """
        call = Call(self, function, arguments)
        with self._lock:
            self._waiting.append(call)
        self._hand_out()
        return call

    def take_back(self, call: Call[Any]) -> bool:
        """Take a call from the helpers that none has begun; tell whether there was one."""
        with self._lock, suppress(ValueError):
            self._waiting.remove(call)
            return True
        return False

    def _hand_out(self) -> None:
        """Give waiting calls to idle helpers."""
        with self._lock:
            futures = []
            while self._pool is not None and self._waiting and self._idle:
                call = self._waiting[0]
                try:
                    call.there = self._pool.submit(call.function, *call.arguments)
                except BrokenProcessPool:
                    break  # the call whose helper was killed says so
                self._waiting.popleft()
                self._idle -= 1
                futures.append(call.there)
        # Outside of the lock: what is done already calls at once.
        for future in futures:
            future.add_done_callback(self._on_done)

    def _on_done(self, _: Future[Any]) -> None:
        with self._lock:
            self._idle += 1
        self._hand_out()


def _begin() -> None:
    """Begin a helper, which may be a fork: SIGTERM and the end of the other process end it."""
    ignore_stop_signals()
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    die_with_parent()


def results(calls: Sequence[Call[Result]]) -> list[Result]:
    """Return the results in the calls' order; this process begins with the last, helpers didn't."""
    return [call.result() for call in reversed(calls)][::-1]
