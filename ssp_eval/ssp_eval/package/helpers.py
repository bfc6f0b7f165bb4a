"""Calls that this process shares with others: what none of them has begun is done here."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Generic, TypeVar

from ssp_core.errors import HostError
from ssp_core.host.terminal import ignore_stop_signals

Result = TypeVar("Result")


@dataclass(frozen=True)
class Call(Generic[Result]):
    """A call that a helper may have begun.

    Args:
        here: does it in this process.
        there: its future in a helper; None: there is no helper.
    """

    here: Callable[[], Result]
    there: Future[Result] | None

    def result(self) -> Result:
        """Do it here where no helper has begun it, and wait for the helper otherwise.

        Raises:
            HostError: the helper was killed.
        """
        if self.there is None or self.there.cancel():
            return self.here()
        try:
            return self.there.result()
        except BrokenProcessPool as error:
            raise HostError("a helper process was killed; give the same command again") from error


class Helpers:
    """Processes beside this one, for a block; they end at once when it is left early.

    Args:
        count: how many; none does all calls here.
    """

    def __init__(self, count: int) -> None:
        # A fresh interpreter each: a fork would take along the locks of this one's threads.
        context = multiprocessing.get_context("spawn")
        self._before = multiprocessing.active_children()
        self._pool = ProcessPoolExecutor(count, context, ignore_stop_signals) if count else None

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

        def here() -> Result:
            return function(*arguments)

        there = None if self._pool is None else self._pool.submit(function, *arguments)
        return Call(here, there)


def results(calls: Sequence[Call[Result]]) -> list[Result]:
    """Return the results in the calls' order; this process begins with the last, helpers didn't."""
    return [call.result() for call in reversed(calls)][::-1]
