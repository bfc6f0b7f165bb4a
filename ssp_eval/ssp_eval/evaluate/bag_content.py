"""What a bag holds while it is open: its hash, worked out beside, and that it stays the same."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from threading import Event

from ssp_core.bag.reader import BagReader
from ssp_core.errors import InputError
from ssp_core.files import Closing
from ssp_eval.recordings.provenance import content_sha256


class BagContent(Closing):
    """The content of an open bag.

    Hashing gives the interpreter free: it costs no time where a processor is idle.

    Args:
        bag: open.

    Raises:
        InputError: a file of it is gone.
    """

    def __init__(self, bag: BagReader) -> None:
        self._bag = bag
        self._before = [_state(file) for file in bag.files]
        self._closed = Event()
        self._beside = ThreadPoolExecutor(1)
        self._digest = self._beside.submit(content_sha256, bag, self._go_on)

    def _go_on(self) -> None:
        if self._closed.is_set():
            raise CancelledError

    @property
    def is_hashed(self) -> bool:
        """True when nobody has to wait for the hash."""
        return self._digest.done()

    @property
    def sha256(self) -> str:
        """Hash of what was in the bag when it was opened; waits until it is known.

        Raises:
            InputError: a file of it can't be read, or was changed since.
        """
        with self.watched():
            return self._digest.result()

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Refuses what is read within the block if the bag was changed: it has another hash.

        It is refused for that also where reading it failed, since what is read by the index of
        another file looks damaged.

        Raises:
            InputError: naming the file.
        """
        try:
            yield
        finally:
            self._check_same()

    def _check_same(self) -> None:
        for file, before in zip(self._bag.files, self._before, strict=True):
            if _state(file) != before:
                raise InputError(
                    "was changed while it was evaluated",
                    file=file,
                    remedy="let recordings be while they are evaluated, and give the command again",
                )

    def close(self) -> None:
        """Ends the hashing at once: after Ctrl-C nobody waits for a hundred gigabytes."""
        self._closed.set()
        self._beside.shutdown()


def _state(file: Path) -> tuple[int, int]:
    # Not the number of the file: some network file systems give a new one each time.
    try:
        found = os.stat(file)
    except OSError as error:
        raise InputError(f"can't be read: {error.strerror}", file=file) from error
    return found.st_size, found.st_mtime_ns
