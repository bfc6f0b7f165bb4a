"""Answers kept on the disk, byte for byte, so that no question is paid for twice."""

from __future__ import annotations

from pathlib import Path

from ssp_core.errors import InputError
from ssp_core.files import make_folder, write_bytes


class Cache:
    """A folder of answers, by the hash of the whole request (model, prompt, parameters, text).

    Args:
        folder: made where it isn't there; None keeps nothing.

    Raises:
        InputError: the folder can't be made or written to.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = None if folder is None else make_folder(folder)

    def find(self, request_sha256: str) -> bytes | None:
        """The answer to a request, None: it was never asked.

        Raises:
            InputError: there is a file that can't be read.
        """
        path = self._path(request_sha256)
        if path is None:
            return None
        try:
            return path.read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise InputError(f"can't be read: {error.strerror}", file=path) from error

    def keep(self, request_sha256: str, body: bytes) -> None:
        """Writes an answer as it came."""
        path = self._path(request_sha256)
        if path is not None:
            write_bytes(path, body)

    def _path(self, request_sha256: str) -> Path | None:
        name = request_sha256.removeprefix("sha256:")
        return None if self._folder is None else self._folder / name[:2] / f"{name}.body"
