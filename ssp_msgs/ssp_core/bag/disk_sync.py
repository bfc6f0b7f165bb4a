"""Has what was written reach the disk, in a thread of its own."""

from __future__ import annotations

import os
import threading


class DiskSync:
    """Runs fdatasync behind the writer's back, so that a slow disk doesn't hold it up.

    The thread starts with the first request and works on descriptors of its own, so a file may
    be closed at any time. Requests for a file that already waits for its turn are one request:
    no more than one is running and one waiting per file, however slow the disk is.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._waiting: dict[str, int] = {}
        self._stopped = False
        self._error: OSError | None = None
        self._thread: threading.Thread | None = None

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
                self._waiting[name] = os.dup(descriptor)
                self._changed.notify()
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="bag-sync", daemon=True)
            self._thread.start()

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
            self._changed.notify()

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
                descriptor = self._waiting.pop(name)
            try:
                os.fdatasync(descriptor)
            except OSError as error:
                self._error = error
            finally:
                os.close(descriptor)
