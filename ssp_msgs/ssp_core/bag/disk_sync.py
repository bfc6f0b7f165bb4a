"""Has what was written reach the disk, in a thread of its own."""

from __future__ import annotations

import os
import threading
import time

# A sync that takes longer makes the writer wait for it, so that what the disk can't keep up with
# waits where it is counted and bounded, and not in the system's memory.
OVERDUE_S = 1.0
# How long one request waits at most: the writer must still notice that it is to end.
LONGEST_WAIT_S = 5.0


class DiskSync:
    """Runs fdatasync behind the writer's back, so that a disk's hiccup doesn't hold it up.

    The thread starts with the first request and works on descriptors of its own, so a file may
    be closed at any time. Requests for a file that already waits for its turn are one request:
    no more than one is running and one waiting per file, however slow the disk is.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._waiting: dict[str, tuple[int, float]] = {}
        self._running_since_s: float | None = None
        self._stopped = False
        self._error: OSError | None = None
        self._thread: threading.Thread | None = None

    @property
    def age_s(self) -> float:
        """Seconds since the oldest request that is not done yet, 0.0 when all are done."""
        with self._changed:
            return self._age_s()

    def _age_s(self) -> float:
        since = [asked_s for _, asked_s in self._waiting.values()]
        if self._running_since_s is not None:
            since.append(self._running_since_s)
        return time.monotonic() - min(since) if since else 0.0

    def request(self, name: str, descriptor: int) -> None:
        """Asks for a file to be synchronised soon.

        Args:
            name: of the file; a name waits once.
            descriptor: open for writing.

        Raises:
            OSError: an earlier request failed: what was written may be lost.
        """
        with self._changed:
            self._raise()
            if name not in self._waiting:
                self._waiting[name] = (os.dup(descriptor), time.monotonic())
                self._changed.notify_all()
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="bag-sync", daemon=True)
            self._thread.start()

    def wait_for_overdue(self) -> None:
        """Returns when no request is older than OVERDUE_S, or after LONGEST_WAIT_S.

        Raises:
            OSError: a request failed: what was written may be lost.
        """
        with self._changed:
            self._changed.wait_for(
                lambda: self._error is not None or self._stopped or self._age_s() <= OVERDUE_S,
                LONGEST_WAIT_S,
            )
            self._raise()

    def finish(self) -> None:
        """Waits until everything asked for is done, and ends the thread.

        Raises:
            OSError: a request failed.
        """
        self.abandon()
        if self._thread is not None:
            self._thread.join()
        self._raise()

    def abandon(self) -> None:
        """Lets the thread end when it has done what it was asked for; doesn't wait for it."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def _raise(self) -> None:
        if self._error is not None:
            raise OSError(self._error.errno, self._error.strerror)

    def _run(self) -> None:
        while True:
            with self._changed:
                while not self._waiting and not self._stopped:
                    self._changed.wait()
                if not self._waiting:
                    return
                name = next(iter(self._waiting))
                descriptor, self._running_since_s = self._waiting.pop(name)
            failed = None
            try:
                os.fdatasync(descriptor)
            except OSError as error:
                failed = error
            finally:
                os.close(descriptor)
            with self._changed:
                self._error = failed or self._error
                self._running_since_s = None
                self._changed.notify_all()
